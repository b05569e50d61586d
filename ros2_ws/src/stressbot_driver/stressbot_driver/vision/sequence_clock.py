"""Which sequence time a picture belongs to: the driver says its own now and then, and pictures come late."""

from collections import deque
from dataclasses import dataclass

import numpy as np

KEPT = 300
"""Words of the driver: a picture may be so many old."""

REAL_TIME = 0.1
"""Sequence time runs as fast as the clock, unless it is off by more than this, relative."""

LEARNING = 0.3
"""s of a run from which its speed is told."""


@dataclass(frozen=True)
class DriverWord:
    """What the driver said: when [s], of which plan, sequence time [s], whether it runs, how long it takes [s]."""

    stamp: float
    plan: str
    time: float
    running: bool
    duration: float


class SequenceClock:
    """Sequence time by the driver's words, between them and a little beyond the last. How fast it runs is kept from run to run."""

    def __init__(self) -> None:
        self._words: deque[DriverWord] = deque(maxlen=KEPT)
        self._start: DriverWord | None = None  # the first word of the last run, which is the most exact one
        self._speed = 1.0

    def hear(self, word: DriverWord) -> None:
        """Take in what the driver said."""
        last = self._words[-1] if self._words else word
        self._words.append(word)
        if word.running and not (last.running and self._start and self._start.plan == word.plan):
            self._start = word
        if last.running and last.plan == word.plan:
            first = self._run(word.plan)[0]
            if (span := word.stamp - first.stamp) > LEARNING:
                speed = (word.time - first.time) / span
                self._speed = 1.0 if abs(speed - 1.0) < REAL_TIME else speed

    def _run(self, plan: str) -> list[DriverWord]:
        start = [self._start] if self._start and self._start.plan == plan else []
        return start + [word for word in self._words if word.plan == plan and word.running]

    def _origin(self, plan: str) -> float:
        """Sequence time of a run at stamp 0."""
        # The driver's word is of the last moment that it looked, which may have been a while ago.
        return max(word.time - self._speed * word.stamp for word in self._run(plan))

    def stamps(self, plan: str, times: np.ndarray) -> np.ndarray:
        """Return when sequence times of a run were, shape (k,); of a run that the driver has not told of, none."""
        return (times - self._origin(plan)) / self._speed if self._run(plan) else np.empty(0)

    def at(self, stamp: float) -> tuple[str, float] | None:
        """Return plan and sequence time at a moment; None if the driver has said nothing."""
        if not self._words:
            return None
        before = next((word for word in reversed(self._words) if word.stamp <= stamp), self._words[0])
        if not before.running:
            return before.plan, before.time
        origin, speed = self._origin(before.plan), self._speed
        after = next((word for word in self._words if word.plan == before.plan and word.stamp > stamp), None)
        latest = before.duration if after is None or after.running else after.time
        return before.plan, min(max(origin + speed * stamp, before.time), latest)
