"""Time as something that is handed in, so that playback can be tested without waiting for it."""

import time
from abc import ABC, abstractmethod
from threading import Event


class Clock(ABC):
    """A monotonic clock [s] that can wait, and be woken."""

    @abstractmethod
    def now(self) -> float:
        """Seconds since an arbitrary moment; never goes back."""

    @abstractmethod
    def wait_until(self, deadline: float, wake: Event) -> bool:
        """Wait for `deadline` (of `now`) or for `wake`, whichever comes first; True if `wake` is set."""


class WallClock(Clock):
    """The computer's monotonic clock: changes of the date do not disturb it."""

    # A sleeping thread wakes late by some 0.1 ms on an idle machine; the last stretch is polled instead.
    POLLED = 0.0005
    LONGEST = 3600.0  # [s] threads cannot wait for any number of seconds at once

    def now(self) -> float:
        return time.monotonic()

    def wait_until(self, deadline: float, wake: Event) -> bool:
        while (asleep := deadline - time.monotonic() - self.POLLED) > 0:
            if wake.wait(min(asleep, self.LONGEST)):
                return True
        while time.monotonic() < deadline:
            time.sleep(0)
            if wake.is_set():
                return True
        return wake.is_set()
