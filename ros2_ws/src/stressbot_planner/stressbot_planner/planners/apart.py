"""Places beside goals where bodies that touch at their goals do not: what plans of whole pulses aim at."""

import numpy as np

from stressbot_planner.collision.clearance import Shapes, environment_gap
from stressbot_planner.model.whole_pulses import ASIDE, LEEWAY
from stressbot_planner.problem.definition import Problem

ROUNDS, HALF = 20, 0.5
"""Moves of each body, at most, and by which share of what it lacks: others move, too."""

NEARBY, ROUNDED = 0.1, 1e-6
"""Steps: what a gap may lack, and how far beside a place it is looked at to see where it grows. Of that, what is round-off."""


def aims_apart(problem: Problem, gap: float, step: float) -> np.ndarray:
    """Return places beside goals, shape (n, 2), units: the goals themselves of robots that touch nothing there.

    Bodies are moved until those larger by `ASIDE` steps keep the gap from walls, obstacles and each other, as far as there is room
    within `LEEWAY` steps less as much. Robots in contact may touch.
    """
    swarm, shapes = problem.swarm, Shapes.of(problem.environment)
    radius, places, more, nearby = swarm.body_radius, problem.goals.copy(), ASIDE * step, NEARBY * step
    apart = radius[:, None] + radius + gap + 2 * more
    apart[(radius[:, None] + radius == 0) & (gap == 0)] = -np.inf
    for one, other in problem.contacts:
        apart[one, other] = apart[other, one] = radius[one] + radius[other] + nearby
    np.fill_diagonal(apart, -np.inf)

    def lacks(row: int, place: np.ndarray) -> float:
        around = environment_gap(*place, 1.0, 0.0, 0.0, radius[row] + gap + more, *shapes.kernel_arguments)[0]
        return -min(around, float((np.hypot(*(places - place).T) - apart[row]).min()))

    most = (LEEWAY - ASIDE) * step
    for _ in range(ROUNDS):
        moved = False
        for row in range(swarm.n):
            lack, place = lacks(row, places[row]), places[row].copy()
            if lack <= (1 + ROUNDED) * nearby:
                continue
            beside = nearby * np.eye(2)
            way = np.array([lacks(row, place - shift) - lacks(row, place + shift) for shift in beside])
            way *= min(HALF * lack, most) / max(float(np.hypot(*way)), 1e-300)
            aside = place + way - problem.goals[row]
            places[row] = problem.goals[row] + aside * min(1.0, most / max(float(np.hypot(*aside)), 1e-300))
            moved = True
        if not moved:
            break
    return places
