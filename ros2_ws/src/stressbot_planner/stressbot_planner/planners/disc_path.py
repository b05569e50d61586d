"""Shortest collision-free polyline of one disc among discs, polygons and walls: a visibility graph around corners."""

import numpy as np
from numba import njit
from scipy.sparse.csgraph import dijkstra

from stressbot_planner.collision import environment_gap

RING = 8
"""Corners that a disc's outline, or the round-off of a polygon's corner, is replaced by."""


def shortest_path(
    start: np.ndarray, goal: np.ndarray, radius: float, margin: float, circles, edges, edge_ends, walls
) -> np.ndarray | None:
    """Return waypoints from start to goal, shape (w, 2), that keep a gap of margin; None if there are none.

    Args:
        start: shape (2,), units.
        goal: shape (2,).
        radius: of the moving disc.
        margin: gap to keep.
        circles: x, y, radius, shape (c, 3); other robots at rest are circles too.
        edges: of polygons, see `collision.Shapes`.
        edge_ends: likewise.
        walls: likewise.
    """
    ends = np.array([start, goal])
    if _segment_is_clear(ends[0], ends[1], radius, margin, circles, edges, edge_ends, walls):
        return ends
    angles = 2 * np.pi * np.arange(RING) / RING
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    reach = (radius + 1.001 * margin) / np.cos(np.pi / RING)
    centers = np.vstack([circles[:, :2], edges[:, :2]])
    size = np.concatenate([(circles[:, 2]) / np.cos(np.pi / RING) + reach, np.full(len(edges), reach)])
    corners = (centers[:, None] + size[:, None, None] * around).reshape(-1, 2)
    free = [_segment_is_clear(corner, corner, radius, margin, circles, edges, edge_ends, walls) for corner in corners]
    nodes = np.vstack([ends, corners[np.array(free, dtype=bool)]])
    lengths = _visible(nodes, radius, margin, circles, edges, edge_ends, walls)
    distance, previous = dijkstra(lengths, indices=0, return_predecessors=True)
    if not np.isfinite(distance[1]):
        return None
    way = [1]
    while way[-1] != 0:
        way.append(previous[way[-1]])
    return nodes[way[::-1]]


@njit(cache=True)
def _segment_is_clear(a, b, radius, margin, circles, edges, edge_ends, walls):
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = np.hypot(dx, dy)
    ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
    gap, _, _, _ = environment_gap(a[0], a[1], ux, uy, length, radius, circles, edges, edge_ends, walls)
    return gap >= margin


@njit(cache=True)
def _visible(nodes, radius, margin, circles, edges, edge_ends, walls):
    """Return the lengths of clear straight lines between nodes, 0 where there is none."""
    count = nodes.shape[0]
    lengths = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            if _segment_is_clear(nodes[i], nodes[j], radius, margin, circles, edges, edge_ends, walls):
                lengths[i, j] = lengths[j, i] = np.hypot(nodes[i, 0] - nodes[j, 0], nodes[i, 1] - nodes[j, 1])
    return lengths
