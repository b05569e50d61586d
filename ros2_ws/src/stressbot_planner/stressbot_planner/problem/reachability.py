"""Proofs that no plan exists: a robot alone could not get from its start to its goal among walls and obstacles."""

import numpy as np

from stressbot_planner.collision.clearance import Shapes, environment_gap
from stressbot_planner.problem.definition import Problem
from stressbot_planner.system.kernels import kernel

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
    from scipy.ndimage import label  # takes a tenth of a second to load

    shapes, swarm = Shapes.of(problem.environment), problem.swarm
    starts, goals = problem.starts[:, :2], problem.goals
    corners = [starts.min(axis=0), starts.max(axis=0), goals.min(axis=0), goals.max(axis=0)]
    if len(shapes.circles):
        reach = shapes.circles[:, 2:] + 3 * swarm.girth.max()
        corners += [(shapes.circles[:, :2] - reach).min(axis=0), (shapes.circles[:, :2] + reach).max(axis=0)]
    if len(shapes.edges):
        reach = 3 * swarm.girth.max()
        corners += [shapes.edges[:, :2].min(axis=0) - reach, shapes.edges[:, :2].max(axis=0) + reach]
    low = np.min(corners, axis=0) - 1e-9
    size = float(np.max(np.max(corners, axis=0) - low)) / CELLS
    count = np.ceil((np.max(corners, axis=0) - low) / size).astype(np.int64) + 1
    start_cells, goal_cells = (((places - low) / size).astype(np.int64) for places in (starts, goals))
    reach = int(np.ceil(problem.tolerance / size)) + 1  # a goal ball may reach into the start's component
    unknown = np.ones(swarm.n, dtype=bool)
    blocked = []
    for radius in np.unique(swarm.body_radius)[::-1]:
        same = swarm.body_radius == radius
        if not (unknown & same).any():
            continue
        component = np.empty(count, dtype=np.int32)
        label(~_closed(low, size, count, radius, *shapes.kernel_arguments), np.ones((3, 3)), component)
        begin, end = component[tuple(start_cells.T)], component[tuple(goal_cells.T)]
        unknown &= (begin != end) | (begin == 0)  # where a large body gets through, smaller ones do
        for robot in np.flatnonzero(unknown & same):
            x, y = goal_cells[robot]
            ball = component[max(x - reach, 0) : x + reach + 1, max(y - reach, 0) : y + reach + 1]
            if not (ball == begin[robot]).any():
                blocked.append(int(robot))
    return min(blocked, key=lambda robot: (swarm.body_radius[robot], robot)) + 1 if blocked else None


@kernel()
def _closed(low, size, count, radius, circles, edges, edge_ends, walls):
    closed = np.empty((count[0], count[1]), dtype=np.bool_)
    for i in range(count[0]):
        for j in range(count[1]):
            x, y = low[0] + (i + 0.5) * size, low[1] + (j + 0.5) * size
            gap, _, _, _ = environment_gap(x, y, 1.0, 0.0, 0.0, radius, circles, edges, edge_ends, walls)
            closed[i, j] = gap < -0.7072 * size
    return closed
