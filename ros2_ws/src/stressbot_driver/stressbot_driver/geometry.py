"""Where bodies may lie: discs against each other, against walls, circles and polygons. Vectorised over robots."""

import numpy as np

# Bodies may touch: decimal coordinates do not add up exactly, so a gap of this part of the radii counts as contact.
TOUCHING = 1e-9

# Of a polygon, in scenario units: products of lengths far below would vanish.
SHORTEST_SIDE = 1e-9


def first_overlap(xy: np.ndarray, radius: np.ndarray) -> tuple[int, int] | None:
    """Indices of two discs that overlap, or None. `xy` (n, 2), `radius` (n,); memory O(n).

    A sweep along x: after sorting, only discs nearer than two largest radii in x are compared.
    """
    order = np.argsort(xy[:, 0], kind="stable")
    x, y, r = xy[order, 0], xy[order, 1], radius[order]
    reach = 2.0 * radius.max(initial=0.0)
    for shift in range(1, len(x)):
        dx = x[shift:] - x[:-shift]
        near = dx <= reach
        if not near.any():
            return None
        need = (r[shift:] + r[:-shift]) * (1.0 - TOUCHING)
        hit = near & (np.hypot(dx, y[shift:] - y[:-shift]) < need)
        if hit.any():
            first = int(np.argmax(hit))
            return tuple(sorted((int(order[first]), int(order[first + shift]))))
    return None


def outside_walls(xy: np.ndarray, radius: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """True (n,) where a disc reaches beyond `walls` = (x_min, x_max, y_min, y_max)."""
    slack = radius * (1.0 - TOUCHING)
    x, y = xy[:, 0], xy[:, 1]
    return (x - slack < walls[0]) | (x + slack > walls[1]) | (y - slack < walls[2]) | (y + slack > walls[3])


def inside_circle(xy: np.ndarray, radius: np.ndarray, center: np.ndarray, circle_radius: float) -> np.ndarray:
    """True (n,) where a disc overlaps a circle."""
    gap = np.hypot(xy[:, 0] - center[0], xy[:, 1] - center[1])
    return gap < (radius + circle_radius) * (1.0 - TOUCHING)


def inside_polygon(xy: np.ndarray, radius: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """True (n,) where a disc overlaps the polygon with `corners` (k, 2)."""
    inside = np.zeros(len(xy), dtype=bool)
    close = np.zeros(len(xy), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = np.clip(((xy - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest = a + along[:, None] * (b - a)
        close |= np.hypot(*(xy - nearest).T) < radius * (1.0 - TOUCHING)
        straddles = (a[1] > xy[:, 1]) != (b[1] > xy[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = a[0] + (xy[:, 1] - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
        inside ^= straddles & (xy[:, 0] < crossing)
    return inside | close


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
