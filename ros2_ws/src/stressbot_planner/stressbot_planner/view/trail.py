"""Where robots have been: places far enough apart, and of those no more than a page can draw."""

import numpy as np

from stressbot_planner.view.scene import PLACE

STEP = 3.0
"""µm; at least one robot has gone so far from one of the places kept to the next."""

MOST_PLACES = 60_000
"""Of all robots together; when there are more, every other one is dropped."""


class Trail:
    """Places of all robots, in the order of time."""

    def __init__(self) -> None:
        self._kept: list[np.ndarray] = []

    def clear(self) -> None:
        """Forget all."""
        self._kept = []

    def add(self, places: np.ndarray) -> bool:
        """Keep places (n, 2), µm, NaN where a robot is not seen, if they are new; return whether they were."""
        if self._kept:
            gone = np.hypot(*(places - self._kept[-1]).T)
            appeared = np.isnan(self._kept[-1]).any(axis=1) & np.isfinite(places).all(axis=1)
            if not (gone >= STEP).any() and not appeared.any():
                return False
        self._kept.append(places.copy())
        if sum(map(len, self._kept)) > MOST_PLACES:
            self._kept = self._kept[::2]
        return True

    def told(self) -> list[list[float | None]]:
        """Return plain data: x and y of each robot in turn, one list a time."""
        rows = (np.round(places, PLACE).ravel().tolist() for places in self._kept)
        return [[value if np.isfinite(value) else None for value in row] for row in rows]
