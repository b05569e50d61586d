"""Processes that can be told from all others by a mark in their environment, which those that they start inherit."""

import time
import uuid
from pathlib import Path

VARIABLE = "STRESSBOT_TEST_MARK"


def new_mark() -> dict[str, str]:
    """Return what marks a process, for its environment."""
    return {VARIABLE: uuid.uuid4().hex}


def marked(mark: dict[str, str]) -> list[int]:
    """Return the processes that carry a mark and have not ended."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark[VARIABLE].encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:  # it has ended meanwhile
            continue
    return found


def wait_until(condition, what, timeout=300.0):
    """Wait for a condition and return its value."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what} did not come within {timeout:g} s"
        time.sleep(0.02)
    return value
