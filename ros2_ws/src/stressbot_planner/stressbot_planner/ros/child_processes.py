"""Node processes: each in a group of its own, its output in a log file, none left behind, not even if this process is killed."""

import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

from stressbot_msgs import lifeline

GRACE = ((signal.SIGINT, 10.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
"""How processes are asked to end, and how long each request may take, s."""


class ChildProcesses:
    """A set of processes; leaving the `with` block ends them all.

    Attributes:
        exit_codes: of those that have ended, by name; -N if signal N did it.
    """

    def __init__(self, log_folder: Path, environment: dict[str, str] | None = None):
        self._logs = log_folder
        self._environment = environment
        self._running: dict[str, subprocess.Popen] = {}
        self.exit_codes: dict[str, int] = {}

    def __enter__(self) -> "ChildProcesses":
        return self

    def __exit__(self, *_):
        self.close()

    def start(self, name: str, command: list[str]) -> subprocess.Popen:
        """Start a process; its output goes to <log folder>/<name>.log."""
        with open(self.log(name), "ab") as log:
            # A group of its own, so that Ctrl-C in the terminal reaches only us and the order of the end is ours.
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=(os.environ if self._environment is None else self._environment) | lifeline.environment(),
                start_new_session=True,
            )
        self._running[name] = process
        return process

    def log(self, name: str) -> Path:
        """Return the log file of a process."""
        return self._logs / f"{name}.log"

    def ended(self) -> list[str]:
        """Return the names of processes that have ended without being told to."""
        return [name for name, process in self._running.items() if process.poll() is not None]

    def stop(self, name: str, first: signal.Signals = signal.SIGINT) -> int:
        """End one process, beginning with a signal; return its exit code."""
        self._end([name], ((first, GRACE[0][1]), *GRACE[1:]))
        return self.exit_codes[name]

    def close(self) -> None:
        """End all that still run: SIGINT, then SIGTERM, then SIGKILL; at once if interrupted meanwhile."""
        try:
            self._end(list(self._running), GRACE)
        finally:
            for process in self._running.values():
                _signal_group(process, signal.SIGKILL)

    def _end(self, names: list[str], requests: tuple[tuple[signal.Signals, float], ...]) -> None:
        waiting = {name: self._running[name] for name in names}
        for number, patience in requests:
            for process in waiting.values():
                _signal_group(process, number)
            deadline = time.monotonic() + patience
            for name, process in list(waiting.items()):
                try:
                    self.exit_codes[name] = process.wait(max(0.0, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    continue
                # Whatever the node has started itself goes with it.
                _signal_group(process, signal.SIGKILL)
                del waiting[name], self._running[name]
            if not waiting:
                return


def _signal_group(process: subprocess.Popen, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, number)
