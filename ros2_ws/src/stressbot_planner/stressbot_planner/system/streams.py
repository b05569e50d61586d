"""How a command ends when it is interrupted, when nobody reads it any more, or when files, memory or room run out: in one line."""

import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress

from stressbot_msgs.wording import sentence

from stressbot_planner.errors import StressbotError
from stressbot_planner.system.interrupts import none_lost

SOLVED, FAILED, BAD_INPUT, NO_PLAN, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes of all commands. FAILED: something that it needs is not to be had, or what it did went wrong."""


def run(name: str, command: Callable[[], int]) -> int:
    """Run a command and return its exit code. A reader of its output that has seen enough is no error."""
    _fill()
    code = SOLVED
    try:
        if not _is_somewhere():
            complain(name, "the working directory is gone: change to another one")
            return FAILED
        with none_lost():
            code = command()
    except SystemExit as end:  # argparse
        if isinstance(end.code, str):
            complain(name, end.code)
        code = end.code if isinstance(end.code, int) else FAILED if end.code else SOLVED
    except StressbotError as error:
        complain(name, str(error))
        code = BAD_INPUT
    except KeyboardInterrupt:
        complain(name, "interrupted")
        code = INTERRUPTED
    except BrokenPipeError:
        pass
    except (OSError, ImportError) as error:  # a library that cannot be loaded is one more file that cannot be opened
        complain(name, f"cannot go on: {error}")
        code = FAILED
    except MemoryError:
        complain(name, "cannot go on: out of memory")
        code = FAILED
    return code if _flushed(name) else FAILED


def complain(name: str, message: str) -> None:
    """Say what is wrong in one line on standard error, after all that was printed before."""
    with suppress(OSError):
        sys.stdout.flush()  # what cannot be written stays there, for `run` to find
    with suppress(OSError):
        sys.stderr.write(f"{name}: {sentence(message)}\n")
        sys.stderr.flush()


def _fill() -> None:
    """Give a process that was started without a stream an empty one, so that no file gets its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that knows no ×


def _is_somewhere() -> bool:
    """Whether there is a working directory; libraries fail without one while they are imported."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _flushed(name: str) -> bool:
    """Write out what waits in the streams; what cannot be written is dropped, or the interpreter would complain at its end."""
    done = True
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            if stream is sys.stdout and not isinstance(error, BrokenPipeError):
                complain(name, f"standard output cannot be written: {error.strerror}")
                done = False
    return done
