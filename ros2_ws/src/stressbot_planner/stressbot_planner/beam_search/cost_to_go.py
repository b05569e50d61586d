"""Cost-to-go: how far each robot has to go among walls and obstacles from anywhere: one map a robot, other robots left aside.

The way of a body to its goal costs its length, more along walls. A map holds by how much that exceeds the straight line, at the
nodes of a grid, so that a robot that sees its goal has exactly the straight line to go.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from stressbot_planner.collision.clearance import Shapes, environment_gap
from stressbot_planner.system.kernels import kernel

FINE = 0.5
"""Of the smallest body radius: spacing of the nodes, if they do not become too many. Points get as many as there may be."""

CELLS = 250
"""Along the longer side at most."""

WIDE, DEAR = 1.5, 2.0
"""Where the gap to the environment is 0 a way costs 1 + DEAR times its length, and less up to a gap of WIDE body radii, or that
many nodes."""

_STEPS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))


class DistanceMaps(NamedTuple):
    """Attributes:
        low: corner of the grid, units, shape (2,).
        size: spacing of its nodes, units.
        excess: cost of the way beyond the straight line, units, shape (n, a, b).
        goals: shape (n, 2).
    """

    low: np.ndarray
    size: float
    excess: np.ndarray
    goals: np.ndarray

    def ways_left(self, places: np.ndarray) -> np.ndarray:
        """Return the cost of the way that each robot has left from places (n, 2), shape (n,)."""
        return np.array([way_left(j, x, y, *self)[0] for j, (x, y) in enumerate(places)])


def distance_maps(
    shapes: Shapes, body: np.ndarray, starts: np.ndarray, goals: np.ndarray, fine: float = FINE
) -> DistanceMaps:
    """Return the maps of robots with bodies (n,) that go from starts (n, 2) to goals (n, 2), with nodes so fine.

    Where there is no way at all, the map has the straight line, and as much again as the whole map's diagonal.
    """
    low, high = _extent(shapes, body, starts, goals)
    size = max(fine * float(body.min()), float((high - low).max()) / CELLS)
    count = np.ceil((high - low) / size).astype(np.int64) + 1
    nodes = low + size * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1)
    excess = np.empty((len(body), *count))
    for radius in np.unique(body):
        same = np.flatnonzero(body == radius)
        gaps = _gaps(nodes.reshape(-1, 2), radius, *shapes.kernel_arguments).reshape(count)
        for j, costs in zip(same, _ways(nodes, size, gaps, radius, goals[same]), strict=True):
            straight = np.hypot(*np.moveaxis(nodes - goals[j], -1, 0))
            far = costs.max(where=np.isfinite(costs), initial=0.0) + float(np.hypot(*(high - low)))
            excess[j] = np.maximum(np.where(np.isfinite(costs), costs, far) - straight, 0.0)
    return DistanceMaps(low, size, excess, np.array(goals, dtype=float))


def _extent(shapes: Shapes, body: np.ndarray, starts: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    points = np.vstack([starts, goals, shapes.edges[:, :2]])
    room = max(4 * float(body.max()), 0.05 * float(np.ptp(points, axis=0).max()))
    low, high = points.min(axis=0) - room, points.max(axis=0) + room
    if len(shapes.circles):
        reach = shapes.circles[:, 2:] + room
        low = np.minimum(low, (shapes.circles[:, :2] - reach).min(axis=0))
        high = np.maximum(high, (shapes.circles[:, :2] + reach).max(axis=0))
    return np.maximum(low, shapes.walls[::2]), np.minimum(high, shapes.walls[1::2])


@kernel()
def _gaps(points, radius, circles, edges, edge_ends, walls):
    gaps = np.empty(len(points))
    for k in range(len(points)):
        gaps[k] = environment_gap(points[k, 0], points[k, 1], 1.0, 0.0, 0.0, radius, circles, edges, edge_ends, walls)[0]
    return gaps


def _ways(nodes: np.ndarray, size: float, gaps: np.ndarray, radius: float, goals: np.ndarray) -> np.ndarray:
    """Return the cost of the cheapest way from each node to each goal, shape (k, a, b), infinite where there is none."""
    free = gaps > 0
    price = 1 + DEAR * np.clip(1 - gaps / (WIDE * max(radius, size)), 0, 1)
    index = np.arange(gaps.size, dtype=np.int32).reshape(gaps.shape)  # csgraph of scipy 1.11 takes no other
    tails, heads, weights = [], [], []
    for i, j in _STEPS:
        a = np.s_[: gaps.shape[0] - i, max(-j, 0) : gaps.shape[1] - max(j, 0)]
        b = np.s_[i:, max(j, 0) : gaps.shape[1] - max(-j, 0)]
        both = free[a] & free[b]
        ends = index[a][both], index[b][both]
        tails += ends
        heads += ends[::-1]
        weights += 2 * [(size * np.hypot(i, j) * (price[a] + price[b]) / 2)[both]]
    for k, goal in enumerate(goals):
        away = np.hypot(*np.moveaxis(nodes - goal, -1, 0))
        around = free & (away < 4 * size)
        tails.append(np.full(around.sum(), gaps.size + k, dtype=np.int32))
        heads.append(index[around])
        weights.append(np.maximum(away[around], 1e-9 * size))
    total = gaps.size + len(goals)
    # Goals have edges only away from them: nobody's way may lead through the goal of another.
    graph = coo_array((np.concatenate(weights), (np.concatenate(tails), np.concatenate(heads))), shape=(total, total)).tocsr()
    cost = dijkstra(graph, indices=np.arange(gaps.size, total))[:, : gaps.size].reshape(-1, *gaps.shape)
    return _filled(cost)


def _filled(cost: np.ndarray) -> np.ndarray:
    """Return costs with those of neighbours where there is no way, two nodes deep, so that it can be interpolated."""
    for _ in range(2):
        padded = np.pad(cost, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
        around = [
            padded[:, 1 + i : padded.shape[1] - 1 + i, 1 + j : padded.shape[2] - 1 + j]
            for i in (-1, 0, 1) for j in (-1, 0, 1)
        ]
        cost = np.where(np.isfinite(cost), cost, np.min(around, axis=0))
    return cost


@kernel()
def way_left(j, x, y, low, size, excess, goals):
    """Return (cost of the way that robot j has left at x, y; its derivatives with respect to x and y)."""
    dx, dy = x - goals[j, 0], y - goals[j, 1]
    straight = np.hypot(dx, dy)
    u, v = (x - low[0]) / size, (y - low[1]) / size
    within = 0.0 <= u <= excess.shape[1] - 1, 0.0 <= v <= excess.shape[2] - 1  # the excess goes on unchanged outside
    u = min(max(u, 0.0), excess.shape[1] - 1.000001)
    v = min(max(v, 0.0), excess.shape[2] - 1.000001)
    a, b = int(u), int(v)
    u -= a
    v -= b
    e00, e10, e01, e11 = excess[j, a, b], excess[j, a + 1, b], excess[j, a, b + 1], excess[j, a + 1, b + 1]
    value = straight + (1 - u) * (1 - v) * e00 + u * (1 - v) * e10 + (1 - u) * v * e01 + u * v * e11
    gx = within[0] * ((1 - v) * (e10 - e00) + v * (e11 - e01)) / size
    gy = within[1] * ((1 - u) * (e01 - e00) + u * (e11 - e10)) / size
    if straight > 0.0:
        gx += dx / straight
        gy += dy / straight
    return value, gx, gy
