"""Where labels of many points go, so that none hides another, nor a mark, nor more of the lines than need be."""

import numpy as np

_ANGLES = np.pi / 8 * np.array([2, 6, 14, 10, 0, 8, 4, 12, 1, 3, 5, 7, 9, 11, 13, 15])
"""Upper right first, as in print."""

_DISTANCES = np.array([0.8, 1.3, 2.0, 3.0, 4.2, 5.6, 7.5])
"""From the edge of a mark to the middle of its label, in heights of the label."""

_COST_OF_DISTANCE = 3.0
"""So many cells of a line may be hidden rather than be one height of a label farther away."""

_CELL = 3.0
"""Side of the squares in which lines are counted, in units of the page."""


def place(
    anchors: np.ndarray, marks: np.ndarray, sizes: np.ndarray, lines: np.ndarray, page: tuple[float, float]
) -> list[np.ndarray | None]:
    """Return the middle of each label; None where no room is left.

    Lengths are those of the page, e.g. points. One label after the other gets the best of some places around its point at
    which it hides no mark and no label: near, and with little of the lines behind it.

    Args:
        anchors: points, shape (k, 2).
        marks: half the side of what is drawn at each point, shape (k,).
        sizes: width and height of each label, shape (k, 2).
        lines: points along all lines, no farther apart than a label is high, shape (q, 2).
        page: width and height.
    """
    ink = _Ink(lines, page)
    low, high = list(anchors - marks[:, None]), list(anchors + marks[:, None])
    distance, angle = (grid.ravel() for grid in np.meshgrid(_DISTANCES, _ANGLES, indexing="ij"))
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    found: list[np.ndarray | None] = []
    for anchor, mark, size in zip(anchors, marks, sizes, strict=True):
        reach = mark + distance[:, None] * size[1] + [max(size[0] - size[1], 0.0) / 2, 0.0]
        middles = anchor + reach * direction
        lower, upper = middles - size / 2, middles + size / 2
        hides = np.any(np.all((lower[:, None] < high) & (upper[:, None] > low), axis=2), axis=1)
        free = np.flatnonzero(~hides & np.all((lower >= 0) & (upper <= page), axis=1))
        if not len(free):
            found.append(None)
            continue
        cost = ink.within(lower[free], upper[free]) + _COST_OF_DISTANCE * distance[free]
        best = free[int(np.argmin(cost))]
        low.append(lower[best])
        high.append(upper[best])
        found.append(middles[best])
    return found


class _Ink:
    """How much of some lines is within rectangles: sums over the cells of a grid."""

    def __init__(self, lines: np.ndarray, page: tuple[float, float]):
        self._shape = np.ceil(np.asarray(page) / _CELL).astype(int)
        cells = np.zeros(self._shape + 1)
        at = np.floor(lines / _CELL).astype(int)
        at = at[np.all((at >= 0) & (at < self._shape), axis=1)]
        cells[at[:, 0] + 1, at[:, 1] + 1] = 1
        self._sums = cells.cumsum(axis=0).cumsum(axis=1)

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return how many cells with ink rectangles touch; corners of shape (k, 2)."""
        x0, y0 = np.clip(np.floor(low / _CELL).astype(int), 0, self._shape).T
        x1, y1 = np.clip(np.ceil(high / _CELL).astype(int), 0, self._shape).T
        return self._sums[x1, y1] - self._sums[x0, y1] - self._sums[x1, y0] + self._sums[x0, y0]
