"""Writing files whole: the old content stays until the new one is complete, and what a command reads it does not write over."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from stressbot_planner.errors import ErrorCode, StressbotError

OUTPUT = "--output"


def check_output(path: Path, *inputs: str | Path | None) -> None:
    """Refuse a place that cannot be written to, or that is one of the inputs under whatever name, before any work is done.

    Raises:
        StressbotError: UNREADABLE_FILE, naming `--output`.
    """
    try:
        if str(path) == "-":
            raise _refusal("is a dash: give the name of a file, ./- for one that is called so")
        with suppress(FileNotFoundError, NotADirectoryError):
            os.lstat(path)  # tells names that cannot be
        for other in inputs:
            if other is not None and path.exists() and Path(other).exists() and path.samefile(other):
                raise _refusal(f"{path} is read by this command: give another name")
        if path.is_dir():
            raise _refusal(f"{path} is a folder: give the name of a file")
        if not path.parent.is_dir():
            raise _refusal(f"the folder {path.parent} does not exist: make it first")
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise _refusal(f"{path} may not be written: give another name, or change the permissions")
    except OSError as error:  # such as a name that is too long
        raise _refusal(f"{path} cannot be used ({error.strerror}): give another name") from error
    except ValueError as error:  # a null character
        raise _refusal(f"{path} cannot be used ({error}): give another name") from error


def make_folder(path: Path) -> None:
    """Make a folder, and those above it, unless it is there.

    Raises:
        StressbotError: UNREADABLE_FILE, naming `--output`.
    """
    try:
        if str(path) == "-":
            raise _refusal("is a dash: give the name of a folder, ./- for one that is called so")
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise _refusal(f"cannot make the folder {path} ({getattr(error, 'strerror', None) or error}): give another name") from error
    if not os.access(path, os.W_OK):
        raise _refusal(f"nothing may be written to the folder {path}: give another name, or change the permissions")


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8; raises as `replacing` does."""
    with replacing(path) as stream:
        stream.write(text.encode("utf-8"))


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that takes its name when the block ends well, and is gone if it does not.

    Links are followed. A device or a pipe is written to as it is.

    Raises:
        StressbotError: UNREADABLE_FILE if it cannot be written.
    """
    try:
        with _special(path) if _is_special(path) else _regular(Path(os.path.realpath(path))) as stream:
            yield stream
    except OSError as error:
        raise _refusal(f"cannot write {path}: {error.strerror or error}") from error


def _is_special(path: Path) -> bool:
    return path.exists() and not path.is_file()


def _special(path: Path) -> BinaryIO:
    return open(path, "wb")


@contextmanager
def _regular(path: Path) -> Iterator[BinaryIO]:
    part = path.parent / f".stressbot-{os.getpid()}-{os.urandom(4).hex()}.part"
    stream = os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb")
    try:
        with stream:
            yield stream
            if path.exists():
                os.fchmod(stream.fileno(), stat.S_IMODE(path.stat().st_mode))
        os.replace(part, path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def _refusal(message: str) -> StressbotError:
    return StressbotError(ErrorCode.UNREADABLE_FILE, OUTPUT, message)
