"""Where robots have been: places far enough apart, and of those no more than a page can draw."""

import numpy as np

from stressbot_planner.view.scene import PLACE

STEP = 3.0
"""µm; at least one robot has gone so far from one of the places kept to the next."""

MOST_PLACES = 60_000
"""Of all robots together that a page draws."""


class Trail:
    """Places of all robots, in the order of time."""

    def __init__(self, most: int = MOST_PLACES) -> None:
        """`most` is of all robots together; when there are more, every other one is dropped."""
        self._kept: list[np.ndarray] = []
        self._most = most

    def clear(self) -> None:
        """Forget all."""
        self._kept = []

    def add(self, poses: np.ndarray) -> bool:
        """Keep poses (n, 3), µm and rad, NaN where a robot is not seen, if the places are new; return whether they were."""
        if self._kept:
            gone = np.hypot(*(poses - self._kept[-1])[:, :2].T)
            appeared = np.isnan(self._kept[-1]).any(axis=1) & np.isfinite(poses).all(axis=1)
            if not (gone >= STEP).any() and not appeared.any():
                return False
        self._kept.append(poses.copy())
        if sum(map(len, self._kept)) > self._most:
            self._kept = self._kept[::2]
        return True

    def poses(self) -> np.ndarray:
        """Return what is kept, shape (times, n, 3)."""
        return np.array(self._kept)

    def told(self) -> list[list[float | None]]:
        """Return plain data: x and y of each robot in turn, one list a time."""
        rows = (np.round(poses[:, :2], PLACE).ravel().tolist() for poses in self._kept)
        return [[value if np.isfinite(value) else None for value in row] for row in rows]
