"""What an interface is, what may come out of it, and how long it may take."""

import signal
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from hypothesis.strategies import SearchStrategy

from stressbot_planner.errors import ErrorCode, StressbotError

DEADLINE = 10.0
"""s of processor time for one input, and six times as long by the clock: more counts as a hang."""

ACCEPTED = "accepted"


class Violation(AssertionError):
    """What must never happen."""


class Final(Violation):
    """No smaller input that does so as well is looked for: it took too long, or a node is dead now."""


class _Expired(BaseException):
    """Not an Exception: the code under test must not take it for one of its own."""


@dataclass(frozen=True, eq=False)
class Interface:
    """Where hostile data arrives.

    Attributes:
        name: for people.
        inputs: what arrives.
        attempt: the code that the nodes and tools run on it; returns what came of it (`outcome`), raises Violation or anything.
        weight: its share of a campaign, relative to the others'.
    """

    name: str
    inputs: SearchStrategy
    attempt: Callable[[Any], str]
    weight: float = 1.0

    def __call__(self, value: Any) -> str:
        """Try one input within the deadline.

        Raises:
            Violation: a hang, or an exception that is no documented refusal.
        """
        try:
            with within_deadline(), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # sums that overflow are found by what becomes of them
                return self.attempt(value)
        except Violation:
            raise
        except Exception as error:
            raise Violation(f"{self.name}: {error!r}") from error


def outcome(action: Callable[[], Any]) -> str:
    """Return ACCEPTED, or the name of the code of a refusal.

    Raises:
        Violation: the refusal names no field, says nothing, or is a defect (INTERNAL).
    """
    try:
        action()
    except StressbotError as error:
        check_refusal(error.code, error.field, error.message)
        return error.code.name
    return ACCEPTED


def check_refusal(code: int, field: str, message: str) -> None:
    """Raise Violation unless a refusal is one that docs promise: a known code, a field, a sentence."""
    if code not in ErrorCode._value2member_map_ or code in (ErrorCode.NONE, ErrorCode.INTERNAL) or not field or not message:
        raise Violation(f"a refusal that names no reason or no field: {code!r}, {field!r}, {message!r}")


@contextmanager
def within_deadline() -> Iterator[None]:
    """Raise Final if the block takes longer than DEADLINE, even if the block swallows exceptions."""
    expired, begin = False, (time.process_time(), time.monotonic())

    def expire(*_: object) -> None:
        nonlocal expired
        expired = True
        raise _Expired

    before = {number: signal.signal(number, expire) for number in (signal.SIGPROF, signal.SIGALRM)}
    timers = {signal.ITIMER_PROF: DEADLINE, signal.ITIMER_REAL: 6 * DEADLINE}
    timers = {timer: signal.setitimer(timer, limit) for timer, limit in timers.items()}  # somebody else's come back afterwards
    try:
        yield
    except _Expired:
        pass
    finally:
        for timer in timers:
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
        for timer, was in timers.items():
            signal.setitimer(timer, *was)
    if expired:
        taken = time.process_time() - begin[0], time.monotonic() - begin[1]
        raise Final(f"hangs: {taken[0]:.1f} s of processor time, {taken[1]:.1f} s in all")
