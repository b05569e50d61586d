"""A clock that ends whatever search looks at it."""

import time

A_YEAR = 3e7
"""s, more than any search may take."""


class StoppableClock:
    """Seconds, monotonic. Once `stopped` is set, each look is a year after the last one: time is over, also for later searches."""

    def __init__(self):
        self.stopped = False
        self._ahead = 0.0

    def __call__(self) -> float:
        if self.stopped:
            self._ahead += A_YEAR
        return time.monotonic() + self._ahead
