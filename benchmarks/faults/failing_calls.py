"""System calls of a gate that fail, or hang, one kind at a time."""

import mmap
import struct
import subprocess
from pathlib import Path

from faults.shifted_clock import compiler

SOURCE = Path(__file__).with_name("failing_calls.c")
CALLS = ("write", "send", "sendmsg", "recv", "recvmsg", "poll", "mmap", "close")
"""In the order of the library, from 1."""


class Calls:
    """What the calls of one process do."""

    def __init__(self, folder: Path):
        self._library, self._file = folder / "failing_calls.so", folder / "calls"
        subprocess.run([compiler(), "-shared", "-fPIC", "-O2", "-o", self._library, SOURCE, "-ldl"], check=True)
        self._file.write_bytes(bytes(12))
        with self._file.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), 12)

    @property
    def prefix(self) -> tuple[str, ...]:
        """Return what makes a command, and what it starts, ask here."""
        return "env", f"LD_PRELOAD={self._library}", f"STRESSBOT_CALLS={self._file}"

    def fail(self, pid: int, call: str, hang: bool) -> None:
        self._map[:] = struct.pack("3i", pid, CALLS.index(call) + 1, hang)

    def work(self) -> None:
        """All calls do what they should."""
        self._map[:] = bytes(12)
