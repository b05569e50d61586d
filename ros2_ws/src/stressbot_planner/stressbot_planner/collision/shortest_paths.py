"""Shortest paths: collision-free polylines of one disc among discs, polygons and walls: a visibility graph around corners."""

import numpy as np

from stressbot_planner.collision.clearance import environment_gap, kept_gap, moving_points_gap
from stressbot_planner.system.kernels import kernel

RING = 8
"""Corners that a disc's outline, or the round-off of a polygon's corner, is replaced by."""


class DiscPaths:
    """Shortest ways of one disc to one goal, from anywhere.

    Args:
        goal: shape (2,), units.
        radius: of the moving disc.
        margin: gap that ways keep; a leg from or to a place with a smaller gap keeps that.
        slack: see `Problem.slack`.
        circles: x, y, radius, shape (c, 3); other robots at rest are circles too.
        edges: of polygons, see `collision.Shapes`.
        edge_ends: likewise.
        walls: likewise.
    """

    def __init__(self, goal: np.ndarray, radius: float, margin: float, slack: float, circles, edges, edge_ends, walls):
        surroundings = radius, circles, edges, edge_ends, walls
        self._surroundings = margin, slack, *surroundings
        self.nodes = np.vstack([goal, _corners(margin, *surroundings)])
        self.distance, self.next = _distances(self.nodes, *self._surroundings)

    def ahead(self, point: np.ndarray) -> tuple[float, int]:
        """Return the distance of a point (2,) from the goal along its way, and the first node on it; infinite, -1: none."""
        return _first_node(np.ascontiguousarray(point), self.nodes, self.distance, *self._surroundings)

    def way(self, point: np.ndarray) -> np.ndarray | None:
        """Return waypoints from a point to the goal, shape (w, 2), or None."""
        _, node = self.ahead(point)
        if node < 0:
            return None
        way = [point]
        while node >= 0:
            way.append(self.nodes[node])
            node = self.next[node]
        return np.array(way)


def _corners(margin, radius, circles, edges, edge_ends, walls) -> np.ndarray:
    """Return points around discs and polygon corners at which the disc keeps its margin, shape (k, 2)."""
    angles = 2 * np.pi * np.arange(RING) / RING
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    reach = (radius + 1.001 * margin) / np.cos(np.pi / RING)
    centers = np.vstack([circles[:, :2], edges[:, :2]])
    size = np.concatenate([circles[:, 2] / np.cos(np.pi / RING) + reach, np.full(len(edges), reach)])
    corners = (centers[:, None] + size[:, None, None] * around).reshape(-1, 2)
    return corners[_are_free(corners, margin, radius, circles, edges, edge_ends, walls)]


@kernel()
def _are_free(points, margin, radius, circles, edges, edge_ends, walls):
    free = np.empty(len(points), dtype=np.bool_)
    for k in range(len(points)):
        free[k] = _blocker(points[k], points[k], margin, radius, circles, edges, edge_ends, walls, -1) < 0
    return free


@kernel()
def _margin_at(point, margin, slack, radius, circles, edges, edge_ends, walls):
    gap, _, _, _ = environment_gap(point[0], point[1], 1.0, 0.0, 0.0, radius, circles, edges, edge_ends, walls)
    return min(margin, kept_gap(0.999 * max(gap, 0.0), max(gap, -slack), slack))


@kernel()
def _blocker(a, b, margin, radius, circles, edges, edge_ends, walls, likely):
    """Return which circle blocks a straight segment (a likely one is looked at first), their count if others do, -1 if none."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.hypot(dx, dy)
    ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
    for c in range(-1, circles.shape[0]):
        k = likely if c < 0 else c
        if 0 <= k < circles.shape[0]:
            gap, _ = moving_points_gap(a[0] - circles[k, 0], a[1] - circles[k, 1], ux, uy, length)
            if gap - radius - circles[k, 2] < margin:
                return k
    gap, _, _, _ = environment_gap(a[0], a[1], ux, uy, length, radius, circles[:0], edges, edge_ends, walls)
    return -1 if gap >= margin else circles.shape[0]


@kernel()
def _distances(nodes, margin, slack, radius, circles, edges, edge_ends, walls):
    """Return the distance of each node from the first, and the next node on its way there (-1: none): Dijkstra.

    An edge is looked at only if it would shorten a way.
    """
    count = len(nodes)
    distance, following, done = np.full(count, np.inf), np.full(count, -1), np.zeros(count, dtype=np.bool_)
    distance[0] = 0.0
    blocker = -1
    last_margin = _margin_at(nodes[0], margin, slack, radius, circles, edges, edge_ends, walls)
    for _ in range(count):
        here = -1
        for k in range(count):
            if not done[k] and (here < 0 or distance[k] < distance[here]):
                here = k
        if not np.isfinite(distance[here]):
            break
        done[here] = True
        kept = margin if here else last_margin
        for k in range(count):
            through = distance[here] + np.hypot(nodes[k, 0] - nodes[here, 0], nodes[k, 1] - nodes[here, 1])
            if not done[k] and through < distance[k]:
                blocker = _blocker(nodes[here], nodes[k], kept, radius, circles, edges, edge_ends, walls, blocker)
                if blocker < 0:
                    distance[k], following[k] = through, here
    return distance, following


@kernel()
def _first_node(point, nodes, distance, margin, slack, radius, circles, edges, edge_ends, walls):
    first_margin = _margin_at(point, margin, slack, radius, circles, edges, edge_ends, walls)
    last_margin = min(first_margin, _margin_at(nodes[0], margin, slack, radius, circles, edges, edge_ends, walls))
    total = distance + np.hypot(nodes[:, 0] - point[0], nodes[:, 1] - point[1])
    blocker = -1
    for _ in range(len(nodes)):
        best = np.argmin(total)
        if not np.isfinite(total[best]):
            break
        kept = first_margin if best else last_margin
        blocker = _blocker(point, nodes[best], kept, radius, circles, edges, edge_ends, walls, blocker)
        if blocker < 0:
            return total[best], best
        total[best] = np.inf
    return np.inf, -1
