"""Shortest collision-free polyline of one disc among discs, polygons and walls: a visibility graph around corners."""

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix
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
    nodes = np.vstack([ends, _free_corners(radius, margin, circles, edges, edge_ends, walls)])
    lengths = _visible(nodes, radius, margin, circles, edges, edge_ends, walls)
    distance, previous = dijkstra(lengths, indices=0, return_predecessors=True)
    if not np.isfinite(distance[1]):
        return None
    way = [1]
    while way[-1] != 0:
        way.append(previous[way[-1]])
    return nodes[way[::-1]]


def path_lengths(starts: np.ndarray, goals: np.ndarray, radius: float, circles, edges, edge_ends, walls) -> np.ndarray:
    """Return lengths of shortest paths from starts (s, 2) to goals (g, 2), shape (s, g); infinite where there are none.

    One visibility graph serves all pairs; ways around corners come out a little too long, as in `shortest_path`. The
    disc is taken 1 % smaller, so that it may touch what it passes.
    """
    margin = 0.005 * radius
    shapes = circles, edges, edge_ends, walls
    corners = _free_corners(0.99 * radius, margin, *shapes)
    lengths = _visible(np.vstack([starts, goals, corners]), 0.99 * radius, margin, *shapes)
    paths = dijkstra(csr_matrix(lengths), directed=False, indices=np.arange(len(starts)))
    found = paths[:, len(starts) : len(starts) + len(goals)]
    # a length of 0 would be no edge
    return np.where(np.all(starts[:, None] == goals, axis=2), 0.0, found)


def _free_corners(radius: float, margin: float, circles, edges, edge_ends, walls) -> np.ndarray:
    """Return corners, shape (c, 2), around which a disc passes circles and polygons."""
    angles = 2 * np.pi * np.arange(RING) / RING
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    reach = (radius + 1.001 * margin) / np.cos(np.pi / RING)
    centers = np.vstack([circles[:, :2], edges[:, :2]])
    size = np.concatenate([(circles[:, 2]) / np.cos(np.pi / RING) + reach, np.full(len(edges), reach)])
    corners = (centers[:, None] + size[:, None, None] * around).reshape(-1, 2)
    free = [_segment_is_clear(corner, corner, radius, margin, circles, edges, edge_ends, walls) for corner in corners]
    return corners[np.array(free, dtype=bool)]


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
