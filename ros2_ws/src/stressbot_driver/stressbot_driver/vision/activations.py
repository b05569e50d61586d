"""What a voltage sequence does to robots when: which group is selected, and from when to when it drives."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Activations:
    """Of one sequence, in order of time.

    Attributes:
        groups: 1 to m, 0 where the code is that of no group; shape (E,).
        begins: of the drives, s of sequence time, shape (E,).
        ends: likewise.
    """

    groups: np.ndarray
    begins: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(
        cls,
        levels: np.ndarray,
        dwells: np.ndarray,
        epoch_ends: np.ndarray,
        trains: np.ndarray,
        symbol_levels: np.ndarray,
        drive_level: float,
        codes: np.ndarray,
    ) -> "Activations":
        """Read a sequence that keeps to the described levels.

        Args:
            levels: V, shape (N,); of trains the high one. Robots tell no signs apart.
            dwells: s, shape (N,).
            epoch_ends: shape (E,); epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1.
            trains: whether a segment is pulses, shape (N,).
            symbol_levels: V, shape (L,).
            drive_level: V, that moves robots in epochs without a train.
            codes: symbols of each group, shape (m, K).
        """
        size = np.abs(levels)
        ends = np.cumsum(dwells)
        held = np.isclose(size, drive_level)
        symbols = np.isclose(size[:, None], symbol_levels) & ~trains[:, None]
        known = {tuple(code): group for group, code in enumerate(codes.tolist(), start=1)}
        found, first = [], 0
        for last in epoch_ends.tolist():
            pulsed = trains[first:last]
            driven = first + np.flatnonzero(pulsed if pulsed.any() else held[first:last])
            if len(driven):
                code = tuple(np.nonzero(symbols[first : driven[0]])[1].tolist())
                found.append((known.get(code, 0), ends[driven[0]] - dwells[driven[0]], ends[driven[-1]]))
            first = last
        groups, begins, stops = zip(*found, strict=True) if found else ((), (), ())
        return cls(np.array(groups, dtype=int), np.array(begins, dtype=float), np.array(stops, dtype=float))

    def between(self, start: float, end: float) -> list[tuple[int, float, bool]]:
        """Return group, s driven, and whether the drive begins, of each part of a drive between two times; none if they are one."""
        if start == end:
            return []
        first, last = int(np.searchsorted(self.ends, start, "right")), int(np.searchsorted(self.begins, end, "left"))
        return [
            (int(self.groups[k]), float(min(end, self.ends[k]) - max(start, self.begins[k])), bool(start <= self.begins[k]))
            for k in range(first, last)
        ]

    def driving(self, time: float) -> bool:
        """Return whether robots move at a time."""
        k = int(np.searchsorted(self.begins, time, "right")) - 1
        return k >= 0 and time < float(self.ends[k])

    def begun(self, time: float) -> int:
        """Return how many have begun by a time."""
        return int(np.searchsorted(self.begins, time, "right"))

    def done(self, time: float) -> int:
        """Return how many have ended by a time."""
        return int(np.searchsorted(self.ends, time, "right"))


NOTHING = Activations(np.empty(0, dtype=int), np.empty(0), np.empty(0))
