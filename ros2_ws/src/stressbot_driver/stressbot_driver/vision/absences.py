"""When each robot was out of sight: whoever was so together with another one may have been exchanged for it by hand."""

import numpy as np

HAND = 1.0
"""s without sight in which nobody can exchange two robots; times that are told wrong make robots be missed for less."""


class Absences:
    """The last absence of each track.

    Attributes:
        seen: when each was seen last, s, shape (k,).
    """

    def __init__(self) -> None:
        self.seen = np.empty(0)
        self._left, self._back = np.empty(0), np.empty(0)

    def add(self, count: int, stamp: float) -> None:
        """Begin tracks that are seen now."""
        self.seen = np.concatenate([self.seen, np.full(count, stamp)])
        self._left = np.concatenate([self._left, np.full(count, np.inf)])
        self._back = np.concatenate([self._back, np.full(count, -np.inf)])

    def keep(self, rows: np.ndarray) -> None:
        """Forget all other tracks."""
        self.seen, self._left, self._back = self.seen[rows], self._left[rows], self._back[rows]

    def _away(self, stamp: float) -> np.ndarray:
        """Return which tracks are away, shape (k,), or come back now."""
        return self.seen < stamp - HAND

    def note(self, found: np.ndarray, stamp: float) -> None:
        """Take in which tracks are seen now, shape (k,)."""
        returned = found & self._away(stamp)
        self._left[returned], self._back[returned] = self.seen[returned], stamp
        self.seen[found] = stamp

    def together(self, track: int, stamp: float) -> np.ndarray:
        """Return which tracks, shape (k,), were away while this one was or is, itself among them if it was."""
        away = self._away(stamp)
        left, back = np.where(away, self.seen, self._left), np.where(away, stamp, self._back)
        return (left < back[track]) & (left[track] < back) & (left < back)
