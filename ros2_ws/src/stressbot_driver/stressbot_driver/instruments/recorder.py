"""What was sent to an instrument and what it answered: one JSON object a line, written as it happens."""

import hashlib
import json
import os
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any


def log_folder() -> Path:
    """Where ROS keeps its logs (ROS_LOG_DIR, else ROS_HOME/log, else ~/.ros/log)."""
    if folder := os.environ.get("ROS_LOG_DIR"):
        return Path(folder)
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "log"


class Recorder:
    """A record that never gets in the way: a failure to write is kept in `failure` and ends the recording.

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

    def close(self) -> None:
        """End the record; may be called twice."""
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self.failure = error

    def _write(self, fields: dict[str, Any]) -> None:
        if self._file is None:
            return
        line = json.dumps({"time": self._now(), **fields}).encode() + b"\n"
        try:
            if self._file.write(line) != len(line):
                raise OSError("the line was cut short")
        except OSError as error:
            self.failure = error
            self.close()
            self.failure = error
