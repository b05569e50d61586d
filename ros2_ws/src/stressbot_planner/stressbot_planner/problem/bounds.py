"""Lower bounds on any plan: a small linear program that holds with obstacles too."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from stressbot_planner.model.swarm import Swarm
from stressbot_planner.problem.turning import Rows


class LowerBounds(NamedTuple):
    """Least path length summed over robots (units) and least driving time (s) of any plan."""

    path_length: float
    execution_time: float


def lower_bounds(
    swarm: Swarm, starts: np.ndarray, goals: np.ndarray, tolerance: float = 0.0, parked: tuple[int, ...] = ()
) -> LowerBounds:
    """Return the bounds for starts, x and y first, shape (n, 2) or more, and goals (n, 2), each reached within tolerance.

    Groups of parked robots (rows) do not count.
    """
    slid = swarm.slides.sum(axis=1)
    return LowerBounds(
        path_length=float(group_lengths(swarm, starts, goals, slid, tolerance, parked) @ slid),
        execution_time=float(group_lengths(swarm, starts, goals, np.ones(swarm.m), tolerance, parked).sum()) / swarm.speed,
    )


def bounds_of_stages(
    swarm: Swarm, places: Sequence[np.ndarray], tolerance: float = 0.0, parked: tuple[int, ...] = ()
) -> list[LowerBounds]:
    """Return the bounds of each stage: robots go by places, the first of which are their starts, each (n, 2), within tolerance."""
    return [
        lower_bounds(swarm, begin, end, tolerance * (1 if stage == 0 else 2), parked)
        for stage, (begin, end) in enumerate(pairwise(places))
    ]


def in_all(stages: Iterable[LowerBounds]) -> LowerBounds:
    """Return the bounds of a plan that goes through all of some stages: their sums."""
    return LowerBounds(*(sum(figures) for figures in zip(*stages, strict=True)))


def group_lengths(
    swarm: Swarm, starts: np.ndarray, goals: np.ndarray, cost: np.ndarray, tolerance: float = 0.0, parked: tuple[int, ...] = (),
    turning: Rows | None = None,
) -> np.ndarray:
    """Return total lengths t_i >= 0 of each group, shape (m,), of least cost, such that every robot slides far enough.

    Robot j slides by s_j times the sum of t_i over the groups it belongs to, and that is at least its straight distance:
    minimise cost . t subject to slides^T t >= |goal_j - start_j| - tolerance. `parked` and `turning` as in `least_lengths`.
    """
    distance = np.hypot(*(np.asarray(goals) - np.asarray(starts)[:, :2]).T)
    return least_lengths(swarm, np.maximum(distance - tolerance, 0.0), cost, parked, turning)


def least_lengths(
    swarm: Swarm, need: np.ndarray, cost: np.ndarray, parked: tuple[int, ...] = (), turning: Rows | None = None
) -> np.ndarray:
    """Return total lengths of each group, shape (m,), of least cost, by which each robot slides as far as it needs, shape (n,).

    Groups of parked robots (rows) have none. With `turning` robots turn as far as they need, too; infinite, if they cannot.
    """
    need = need / swarm.pace
    turning = turning or Rows(np.empty((0, swarm.m)), np.empty(0))
    if not need.any() and not len(turning.need):
        return np.zeros(swarm.m)
    from scipy.optimize import linprog  # takes half a second to load

    # the solver's tolerances are absolute: of sizes around 1
    unit = need.max() or float(swarm.turning_length.max())
    matrix = np.vstack([swarm.membership.T.astype(float), unit * turning.matrix])
    matrix[:, swarm.membership[:, list(parked)].any(axis=1)] = 0.0
    least = np.concatenate([need / unit, turning.need])
    size = np.abs(matrix).max(axis=1)
    size[size == 0] = 1.0
    result = linprog(cost / np.max(cost), A_ub=-matrix / size[:, None], b_ub=-least / size, method="highs")
    return np.full(swarm.m, np.inf) if result.x is None else unit * result.x
