"""One gate an instrument: the later of two waits for the earlier one to end, removes it if nobody needs it, or is refused."""

import fcntl
import hashlib
import os
import signal
import struct
import time
from contextlib import suppress
from pathlib import Path

from stressbot_driver.errors import ErrorCode, StressbotError

PATIENCE = 3.0
"""[s] that a gate whose driver is gone has to bring its instrument to rest."""

FOLDER = Path("/tmp")
"""The same for everybody on this machine, whatever their environment."""

_LOCK = struct.Struct("hhqqi4x")  # struct flock of 64-bit Linux


def claim(resource: str) -> tuple[int, str]:
    """Hold `resource` for as long as the file descriptor is open; and what had to be done for it.

    The lock is the kernel's: it is free again when its holder ends, however it ends. Raises StressbotError BUSY if a driver
    that lives holds it, BACKEND_FAILURE if an old gate does not go away or there can be no lock.
    """
    digest = hashlib.sha256(resource.strip().upper().encode()).hexdigest()[:32]
    path = FOLDER / f"stressbot-gate-{digest}.lock"
    try:
        descriptor = _file(path)
    except OSError as error:
        raise StressbotError(
            ErrorCode.BACKEND_FAILURE, "backend", f"{path} cannot be locked ({error}): see to that file"
        ) from error
    limit, killed, said = time.monotonic() + PATIENCE, 0, ""
    while not _locked(descriptor):
        gate = _holder(descriptor)
        driver = _driver(gate)
        if driver is not None:
            os.close(descriptor)
            raise StressbotError(
                ErrorCode.BUSY, "backend", f"driver {driver} (its gate is {gate}) holds {resource}: end it, or choose another"
            )
        said = said or f"waited for gate {gate} of a driver that has ended"
        if gate and time.monotonic() > limit:
            if killed:
                os.close(descriptor)
                message = f"gate {gate} holds {resource} and does not end: end it by hand"
                raise StressbotError(ErrorCode.BACKEND_FAILURE, "backend", message)
            with suppress(ProcessLookupError, PermissionError):
                os.kill(gate, signal.SIGKILL)
            killed, limit = gate, time.monotonic() + PATIENCE
            said = f"killed gate {gate} of a driver that has ended: it had not ended by itself"
        time.sleep(0.01)
    return descriptor, said


def _file(path: Path) -> int:
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    with suppress(FileNotFoundError):
        return os.open(path, flags)  # somebody else's may only be opened like this
    descriptor = os.open(path, flags | os.O_CREAT, 0o666)
    with suppress(PermissionError):
        os.fchmod(descriptor, 0o666)
    return descriptor


def _locked(descriptor: int) -> bool:
    try:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _holder(descriptor: int) -> int:
    """The process that holds the lock; 0 if nobody does any more."""
    answer = fcntl.fcntl(descriptor, fcntl.F_GETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0))
    kind, _, _, _, holder = _LOCK.unpack(answer)
    return holder if kind != fcntl.F_UNLCK else 0


def _driver(gate: int) -> int | None:
    """The driver of a gate, which names it in its command line; None once it is another process's child."""
    try:
        named = int(Path(f"/proc/{gate}/cmdline").read_bytes().rstrip(b"\0").rsplit(b"\0", 1)[-1])
        parent = int(Path(f"/proc/{gate}/stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return named if named == parent else None
