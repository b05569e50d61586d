"""Ctrl-C during a search: the first one ends it, and what was found is kept; the second one ends the command."""

import signal

from stressbot_planner.system.clock import StoppableClock


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
