"""What was sent to an instrument and what it answered: one JSON object a line, written as it happens."""

import hashlib
import json
import os
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

PATIENCE = 0.5
"""[s] for which a disk may keep a line."""

MOST_LINES = 10_000


def log_folder() -> Path:
    """Where ROS keeps its logs (ROS_LOG_DIR, else ROS_HOME/log, else ~/.ros/log)."""
    if folder := os.environ.get("ROS_LOG_DIR"):
        return Path(folder)
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "log"


class Recorder:
    """A record that never gets in the way: it is written on a thread of its own, since a disk may be full, and may hang.

    A failure to write is kept in `failure` and ends the recording.

    Each line holds `time` [s since 1970] and either `sent`, `received` or `event`; a binary block that was sent is told by
    `block_bytes` and `block_sha256`.
    """

    def __init__(self, folder: Path, now: Callable[[], float] = time.time) -> None:
        """Begin a new file `instrument-<UTC>-<process>.jsonl` in `folder`, which is made if it is missing."""
        self._now = now
        self._file = None
        self.failure: OSError | None = None
        stamp = datetime.fromtimestamp(now(), UTC).strftime("%Y%m%dT%H%M%S.%f")
        self.path = folder / f"instrument-{stamp}-{os.getpid()}.jsonl"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Unbuffered: a line that could not be written is known at once, and nothing is lost with the process.
            self._file = open(self.path, "xb", buffering=0)  # noqa: SIM115
        except OSError as error:
            self.failure = error
        self._lines: queue.Queue[bytes | threading.Event | None] = queue.Queue(MOST_LINES)
        self._thread = threading.Thread(target=self._work, name="record", daemon=True)
        self._thread.start()

    def sent(self, command: str, block: bytes | None = None) -> None:
        """A command that is about to go out, with its binary block."""
        fields: dict[str, Any] = {"sent": command}
        if block is not None:
            fields |= {"block_bytes": len(block), "block_sha256": hashlib.sha256(block).hexdigest()}
        self._write(fields)

    def received(self, answer: str) -> None:
        """An answer of the instrument."""
        self._write({"received": answer})

    def event(self, text: str) -> None:
        """Anything else that a reader of the record should know."""
        self._write({"event": text})

    def flush(self) -> None:
        """Wait until everything is written, though not for long: a disk that takes longer is a failure too."""
        written = threading.Event()
        self._put(written)
        if self.failure is None and not written.wait(PATIENCE):
            self.failure = self.failure or OSError(f"the disk has not taken a line for {PATIENCE:g} s")

    def close(self) -> None:
        """End the record; may be called twice."""
        self._put(None)
        self._thread.join(PATIENCE)

    def _write(self, fields: dict[str, Any]) -> None:
        self._put(json.dumps({"time": self._now(), **fields}).encode() + b"\n")

    def _put(self, line: bytes | threading.Event | None) -> None:
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.failure = self.failure or OSError(f"the disk is {MOST_LINES} lines late")

    def _work(self) -> None:
        while (line := self._lines.get()) is not None:
            if isinstance(line, threading.Event):
                line.set()
            elif self._file is not None and self.failure is None:
                try:
                    if self._file.write(line) != len(line):
                        raise OSError("the line was cut short")
                except OSError as error:
                    self.failure = error
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
