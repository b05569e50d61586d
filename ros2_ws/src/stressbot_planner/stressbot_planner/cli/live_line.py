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
    """Shows the best plan so far in relation to its bound, tries, seconds left; nothing where standard error is no terminal."""

    def __init__(self, settings: "Settings", bounds: Callable[[], tuple[float, float]]):
        """`bounds` returns those of path length and execution time; it is called once there is something to compare."""
        self._settings, self._bounds = settings, bounds
        self._begin, self._next = time.monotonic(), 0.0
        self._is_shown = sys.stderr.isatty()
        self._best = math.inf, math.inf

    def __enter__(self):
        if self._is_shown:
            self._show("getting ready")
        return self

    def __exit__(self, *_):
        if self._is_shown:
            self._show("")

    def __call__(self, progress: "Progress") -> None:
        now = time.monotonic()
        if not self._is_shown:
            return
        if math.isfinite(progress.path_length):
            self._best = progress.path_length, progress.execution_time
        if now < self._next:
            return
        self._next = now + EVERY
        left = max(0.0, self._begin + self._settings.time_limit - now)
        parts = [self._how_good(), f"{progress.tries} tries"]
        if self._settings.max_tries is not None:
            parts[1] = f"{progress.tries} of {self._settings.max_tries} tries"
        else:
            parts.append(f"{left:.0f} s left")
        self._show(", ".join(parts) + "; Ctrl-C keeps the best plan")

    def _show(self, text: str) -> None:
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()

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
