"""Signals while something runs. Ctrl-C during a search: the first ends it, what was found is kept; the second ends the command."""

import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

from stressbot_planner.system.clock import StoppableClock


@contextmanager
def handled(numbers: Iterable[signal.Signals], handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Let some signals call something, and afterwards what they did before."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


AGAIN = 0.05
"""s after which an interrupt that was lost is sent again."""


@contextmanager
def none_lost() -> Iterator[None]:
    """Send a KeyboardInterrupt again that came while an object was deleted, or in a callback, from where nothing can be raised."""
    before = sys.unraisablehook

    def hook(unraisable) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            before(unraisable)
            return
        again = threading.Timer(AGAIN, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        again.daemon = True
        again.start()

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


class EndedByCtrlC(StoppableClock):
    """A clock for a search, a context manager in which Ctrl-C stops it.

    Nothing is raised at the first Ctrl-C: an exception that comes while C code calls Python, as it does while compiled kernels are
    loaded, is lost.
    """

    def __enter__(self):
        self._before = signal.getsignal(signal.SIGINT)
        if self._before is not signal.SIG_IGN:
            signal.signal(signal.SIGINT, self._stop)
        return self

    def __exit__(self, *_):
        signal.signal(signal.SIGINT, self._before)

    def _stop(self, *_) -> None:
        self.stopped = True
        signal.signal(signal.SIGINT, signal.default_int_handler)
