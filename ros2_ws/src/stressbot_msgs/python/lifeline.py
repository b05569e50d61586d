"""Processes that end with the one that started them, however that ends.

The starter hands its name on, and who follows it looks whether it is still there: the starter need not be the parent, and a process
that nobody has told to follow lives on by itself, as under `nohup`.
"""

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

VARIABLE = "STRESSBOT_STARTER"
LOOK = 0.2
GRACE = 10.0
"""s between looks, and for an orderly end"""

_followed: set[str] = set()


def name() -> str:
    """Return what tells this process from every other one, on any machine and at any time."""
    return f"{_place()} {os.getpid()} {_start(os.getpid())}"


def environment() -> dict[str, str]:
    """Return what a process that shall end with this one must find in its environment."""
    return {VARIABLE: name()}


def follow_starter(end: Callable[[], None] | None = None) -> None:
    """Follow the process that the environment names, if it names one. Processes that this one starts are not told."""
    follow(os.environ.pop(VARIABLE, ""), end)


def follow(starter: str, end: Callable[[], None] | None = None) -> None:
    """Call `end` once a process is gone, and kill this one 10 s later; at once if there is no `end`.

    Nothing happens if the starter is this process, followed already, or on another machine or in another container.
    """
    place, _, process = starter.rpartition(" ")[0].rpartition(" ")
    if not process or place != _place() or int(process) == os.getpid() or starter in _followed:
        return
    _followed.add(starter)

    def watch() -> None:
        while _start(int(process)) == starter.rpartition(" ")[2]:
            time.sleep(LOOK)
        if end is not None:
            end()
            time.sleep(GRACE)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()


def _place() -> str:
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:  # no Linux
        return ""


def _start(process: int) -> str:
    """Return when a process started, in ticks since boot; nothing if it has ended."""
    try:
        state, *fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if state in "ZX" else fields[18]
