"""How a search gets on, in one line of a terminal that is written anew."""

import math
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stressbot_planner.planners import Progress, Settings

EVERY = 0.1
"""s"""


class LiveLine:
    """A line that says the latest, some times a second; nothing where standard error is no terminal."""

    def __init__(self):
        self._next = 0.0
        self._is_shown = sys.stderr.isatty()

    def __enter__(self):
        if self._is_shown:
            self._show("getting ready")
        return self

    def __exit__(self, *_):
        if self._is_shown:
            self._show("")

    def say(self, text: Callable[[], str]) -> None:
        """Show a text, unless the one before is too new."""
        now = time.monotonic()
        if self._is_shown and now >= self._next:
            self._next = now + EVERY
            self._show(text())

    def _show(self, text: str) -> None:
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()


class PlanningLine(LiveLine):
    """Shows the best plan so far in relation to its bound, tries, seconds left."""

    def __init__(self, settings: "Settings", bounds: Callable[[], tuple[float, float]]):
        """`bounds` returns those of path length and execution time; it is called once there is something to compare."""
        super().__init__()
        self._settings, self._bounds = settings, bounds
        self._begin = time.monotonic()
        self._best = math.inf, math.inf

    def __call__(self, progress: "Progress") -> None:
        if math.isfinite(progress.path_length):
            self._best = progress.path_length, progress.execution_time
        self.say(lambda: self._told(progress))

    def _told(self, progress: "Progress") -> str:
        left = max(0.0, self._begin + self._settings.time_limit - time.monotonic())
        parts = [self._how_good(), f"{progress.tries} tries"]
        if self._settings.max_tries is not None:
            parts[1] = f"{progress.tries} of {self._settings.max_tries} tries"
        else:
            parts.append(f"{left:.0f} s left")
        return ", ".join(parts) + "; Ctrl-C keeps the best plan"

    def _how_good(self) -> str:
        length, duration = self._best
        if not math.isfinite(length):
            return "no plan yet"
        path, driving = self._bounds()
        told = []
        if self._settings.time_weight < 1:
            told.append(f"path {length / path:.3f}" if path > 0 else "path 0")
        if self._settings.time_weight > 0:
            told.append(f"time {duration / driving:.3f}" if driving > 0 else "time 0")
        return f"best {' and '.join(told)} × the lower bound"
