"""What keeps the gate from being held up: by other processes, by memory that is not there, by Ctrl-C, by its own garbage."""

import ctypes
import gc
import os
import resource
import signal
import sys
from contextlib import suppress
from pathlib import Path

DRIVER, PLAYING, GATE = 5, 9, 10
"""Real-time priorities: above all that is not real-time, below the kernel's own threads, and the gate above its driver."""

NAME = b"stressbot-gate"
_PR_SET_NAME = 15
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14
IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)


def harden() -> str:
    """Do what this system allows for the calling thread and its process; return what it does not.

    Signals that end or stop a whole session are ignored: the gate ends with its driver, at rest.
    """
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    libc = ctypes.CDLL(None, use_errno=True)
    with suppress(AttributeError):
        libc.prctl(_PR_SET_NAME, NAME, 0, 0, 0)
    sys.setswitchinterval(0.0005)  # the thread that plays gives way to the one that stops
    gc.freeze()
    gc.disable()
    refused = []
    if (why := real_time(GATE)) is not None:
        refused.append(f"SCHED_FIFO ({why})")
    if (why := _lock_memory(libc)) is not None:
        refused.append(f"locked memory ({why})")
    return f"does without {' and '.join(refused)}: see docs/safety.md" if refused else ""


def real_time(priority: int) -> str | None:
    """SCHED_FIFO for this thread and those that it will start, 0 for the ordinary scheduler; why not, if so."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO if priority else os.SCHED_OTHER, os.sched_param(priority))
    except OSError as error:
        return error.strerror
    return None


def _lock_memory(libc: ctypes.CDLL) -> str | None:
    # Within a limit, locking what comes later would make later allocations fail.
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] != resource.RLIM_INFINITY and not _may_lock():
        return "RLIMIT_MEMLOCK"
    try:
        failed = libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)
    except AttributeError as error:
        return str(error)
    return os.strerror(ctypes.get_errno()) if failed else None


def _may_lock() -> bool:
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return False
    effective = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
    return bool(int(effective, 16) >> _CAP_IPC_LOCK & 1)
