"""Where bodies may lie: discs against each other, against walls, circles and polygons. Vectorised over robots."""

from collections.abc import Sequence

import numpy as np

# Bodies may touch: computed lengths are rounded, so that a gap may be below zero by a share of the scene's size. The planner has
# the same.
TOUCHING = 1e-9
_COORDINATE_SHARE = 0.01

# Of a polygon, in scenario units: products of lengths far below would vanish.
SHORTEST_SIDE = 1e-9


def touching_slack(radius: np.ndarray, places: list[np.ndarray], walls: np.ndarray | None, obstacles: Sequence) -> float:
    """By how much the gap of bodies that touch may be below zero: TOUCHING times the largest body radius and a hundredth of the
    largest coordinate, of places (k, 2), walls and obstacles."""
    sizes = [*places, *([] if walls is None else [walls])]
    sizes += [np.abs(o.center) + o.radius if hasattr(o, "radius") else o.corners for o in obstacles]
    largest = max(float(np.abs(values).max(initial=0.0)) for values in sizes)
    return TOUCHING * (float(radius.max()) + _COORDINATE_SHARE * largest)


def first_overlap(xy: np.ndarray, radius: np.ndarray, slack: float) -> tuple[int, int] | None:
    """Indices of the first disc that overlaps one before it, that one first; or None. `xy` (n, 2), `radius` (n,); memory O(n).
    Points never do.

    A sweep along x: after sorting, only discs nearer than two largest radii in x are compared.
    """
    order = np.argsort(xy[:, 0], kind="stable")
    x, y, r = xy[order, 0], xy[order, 1], radius[order]
    reach = 2.0 * radius.max(initial=0.0)
    pairs = []
    for shift in range(1, len(x)):
        dx = x[shift:] - x[:-shift]
        near = dx <= reach
        if not near.any():
            break
        need = r[shift:] + r[:-shift] - slack
        hit = near & (np.hypot(dx, y[shift:] - y[:-shift]) < need)
        if hit.any():
            ends = np.sort([order[:-shift][hit], order[shift:][hit]], axis=0)
            pairs.append(ends[:, np.argmin(ends[1])])
    if not pairs:
        return None
    first, second = min(pairs, key=lambda pair: pair[1]).tolist()
    return first, second


def outside_walls(xy: np.ndarray, radius: np.ndarray, walls: np.ndarray, slack: float) -> np.ndarray:
    """True (n,) where a disc reaches beyond `walls` = (x_min, x_max, y_min, y_max)."""
    x, y = xy[:, 0], xy[:, 1]
    gap = np.min([x - walls[0], walls[1] - x, y - walls[2], walls[3] - y], axis=0) - radius
    return gap < -slack


def inside_circle(xy: np.ndarray, radius: np.ndarray, center: np.ndarray, circle_radius: float, slack: float) -> np.ndarray:
    """True (n,) where a disc overlaps a circle."""
    return np.hypot(xy[:, 0] - center[0], xy[:, 1] - center[1]) - circle_radius - radius < -slack


def inside_polygon(xy: np.ndarray, radius: np.ndarray, corners: np.ndarray, slack: float) -> np.ndarray:
    """True (n,) where a disc overlaps the polygon with `corners` (k, 2)."""
    inside = np.zeros(len(xy), dtype=bool)
    distance = np.full(len(xy), np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = np.clip(((xy - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest = a + along[:, None] * (b - a)
        distance = np.minimum(distance, np.hypot(*(xy - nearest).T))
        straddles = (a[1] > xy[:, 1]) != (b[1] > xy[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = a[0] + (xy[:, 1] - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
        inside ^= straddles & (xy[:, 0] < crossing)
    return np.where(inside, -distance, distance) - radius < -slack


def is_simple(corners: np.ndarray) -> bool:
    """Whether only neighbouring sides of a polygon (k, 2) touch, at their corner, and no side is too short. Time O(k²)."""
    begin, end = corners, np.roll(corners, -1, axis=0)
    side = end - begin
    if np.any(np.hypot(*side.T) < SHORTEST_SIDE):
        return False
    following = np.roll(side, -1, axis=0)
    if np.any((_cross(side, following) == 0.0) & (np.sum(side * following, axis=1) < 0.0)):
        return False  # turns back on itself
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    count = len(corners)
    for k in range(count):
        others = np.arange(k + 2, count - (k == 0))
        # the ends of each other side lie on one side of this one, or the other way round; or their boxes do not meet
        theirs = np.sign(_cross(side[k], begin[others] - begin[k])) * np.sign(_cross(side[k], end[others] - begin[k]))
        mine = np.sign(_cross(side[others], begin[k] - begin[others])) * np.sign(_cross(side[others], end[k] - begin[others]))
        apart = np.any((high[others] < low[k]) | (low[others] > high[k]), axis=1)
        if not np.all((theirs > 0) | (mine > 0) | apart):
            return False
    return True


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
