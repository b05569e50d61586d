"""Proofs that no plan exists: a robot alone could not get from its start to its goal among walls and obstacles."""

import numpy as np
from numba import njit
from scipy.ndimage import label

from stressbot_planner.collision import Shapes, environment_gap
from stressbot_planner.problem import Problem

CELLS = 200
"""Along the longer side of the map: what is too narrow by less than a cell's diagonal is left to the planner."""


def walled_in(problem: Problem) -> int | None:
    """Return the id of a robot whose goal cannot be reached by its body, with everybody else away; None if none is known.

    A cell of a grid is closed if its center is so deep in obstacles, grown by the body radius, that no point of the cell can
    be free. A free path visits neighbouring cells that are not closed, so that different components prove that there is none.
    The map ends where a path that leaves it could as well go along its edge: no obstacle is near there.
    """
    if problem.environment.is_open_plane:
        return None
    shapes, swarm = Shapes.of(problem.environment), problem.swarm
    starts, goals = problem.starts[:, :2], problem.goals
    corners = [starts.min(axis=0), starts.max(axis=0), goals.min(axis=0), goals.max(axis=0)]
    if len(shapes.circles):
        reach = shapes.circles[:, 2:] + 3 * swarm.body_radius.max()
        corners += [(shapes.circles[:, :2] - reach).min(axis=0), (shapes.circles[:, :2] + reach).max(axis=0)]
    if len(shapes.edges):
        reach = 3 * swarm.body_radius.max()
        corners += [shapes.edges[:, :2].min(axis=0) - reach, shapes.edges[:, :2].max(axis=0) + reach]
    low = np.min(corners, axis=0) - 1e-9
    size = float(np.max(np.max(corners, axis=0) - low)) / CELLS
    count = np.ceil((np.max(corners, axis=0) - low) / size).astype(np.int64) + 1
    for radius in np.unique(swarm.body_radius):
        open_cells = ~_closed(low, size, count, radius, *shapes.kernel_arguments)
        component, _ = label(open_cells, structure=np.ones((3, 3)))
        for robot in np.flatnonzero(swarm.body_radius == radius):
            ends = [component[tuple(((place - low) / size).astype(np.int64))] for place in (starts[robot], goals[robot])]
            if ends[0] != ends[1]:
                # a goal ball may reach into the start's component
                reach = int(np.ceil(problem.tolerance / size)) + 1
                x, y = ((goals[robot] - low) / size).astype(np.int64)
                ball = component[max(x - reach, 0) : x + reach + 1, max(y - reach, 0) : y + reach + 1]
                if not (ball == ends[0]).any():
                    return int(robot) + 1
    return None


@njit(cache=True)
def _closed(low, size, count, radius, circles, edges, edge_ends, walls):
    closed = np.empty((count[0], count[1]), dtype=np.bool_)
    for i in range(count[0]):
        for j in range(count[1]):
            x, y = low[0] + (i + 0.5) * size, low[1] + (j + 0.5) * size
            gap, _, _, _ = environment_gap(x, y, 1.0, 0.0, 0.0, radius, circles, edges, edge_ends, walls)
            closed[i, j] = gap < -0.7072 * size
    return closed
