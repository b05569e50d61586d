"""Interchangeable robots: which of them takes which goal.

Robots are coupled by their groups, so that the sum of distances says little. Robot j slides by the sum of t_i over the
groups it belongs to, times its pace; once it takes goal k, no plan is cheaper than

    L(taken) = min cost . t   subject to   slides^T t >= d[j, taken(j)],   t >= 0            (see `bounds`)
             = max sum_j lambda_j d[j, taken(j)]   over   slides lambda <= cost,   lambda >= 0.

The assignment sought makes L small. Column generation over mixtures of assignments yields good multipliers lambda:
each round an assignment solver answers them with the cheapest assignment under lambda_j d[j, k]. Each of these is then
improved where it stands: no robot may need more than its groups slide now, so that L cannot rise.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment, linprog

from stressbot_planner import planners
from stressbot_planner.collision.clearance import Shapes, environment_clearances
from stressbot_planner.collision.shortest_paths import DiscPaths
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Result

SPLITS = 11
"""Ways to split a length over the groups, the even one and random ones, that the first assignments are made for."""

MOST_COLUMNS = 60
"""Assignments in the mixture, at most."""

MOST_DESCENTS = 60
MOST_DESCENT_ENTRIES = 1_000_000
"""Number of assignments that are improved, the best first; and of these times pairs of robot and goal, in large swarms."""

GOOD_ENOUGH = 1.001
"""An assignment this close to the bound on all of them ends the search."""

MARGIN = 0.01
"""Gap that paths around obstacles keep, relative to `Swarm.girth`."""

_TIE = 1e-6
"""Weight, relative to the largest multiplier, of the distance of robots that the bound does not depend on."""


def solve(problem: Problem, planner: str, settings: planners.Settings) -> Result:
    """Let exchangeable robots take their goals, then plan as `planners.solve` does; the time limit holds for both."""
    return planners.solve(problem, planner, settings, lambda problem: assigned(problem, settings.objective))


def assigned(problem: Problem, objective: str) -> Problem:
    """Return the problem with the goals of its exchangeable robots exchanged among them, to suit an objective.

    Distances are those of shortest collision-free paths with all other robots left out. The order in which the goals
    stand now makes no difference, unless body radii differ: then no goal gets a larger body than has room there.
    """
    free = np.array(problem.exchangeable, dtype=int)
    if len(free) < 2:
        return problem
    swarm = problem.swarm
    weight, slid = planners.time_weight(objective), swarm.slides[:-1].sum(axis=1)
    need = np.hypot(*(problem.goals - problem.starts[:, :2]).T)
    distance = _distances(problem, free)
    scale = max(float(distance.max(where=np.isfinite(distance), initial=0.0)), float(need.max()), 1e-300)
    # A goal that cannot be reached is taken only if it must be: it is further away than all others together.
    distance = np.where(np.isfinite(distance), distance / scale, 2.0 * len(free))
    coupling = _Coupling(
        slides=swarm.slides[:-1].T,
        cost=(1.0 - weight) * slid / slid.mean() + weight,
        need=np.maximum(need - problem.tolerance, 0.0) / scale,
        free=free,
        distance=np.maximum(distance - problem.tolerance / scale, 0.0),
        allowed=swarm.body_radius[free, None] <= _room(problem)[free],
    )
    taken = _best(coupling).taken
    goals = problem.goals.copy()
    goals[free] = problem.goals[free[taken]]
    return replace(problem, goals=goals)


class _Assigned(NamedTuple):
    """An assignment: column taken[j] for row j, its bound L, the lengths t (m - 1,) and the multipliers lambda (n,)."""

    bound: float
    taken: np.ndarray
    lengths: np.ndarray
    multipliers: np.ndarray


@dataclass(frozen=True, eq=False)
class _Coupling:
    """What the bound L depends on.

    Attributes:
        slides: how far a robot slides with a group, per length: its pace or 0, shape (n, m - 1).
        cost: of each group, per length, shape (m - 1,).
        need: distance of each robot to the goal that it has, shape (n,); of those that are not free, all their lives.
        free: robots that may exchange goals, shape (f,).
        distance: of each of them to each of their goals, shape (f, f).
        allowed: which of these goals it may take, shape (f, f).
    """

    slides: np.ndarray
    cost: np.ndarray
    need: np.ndarray
    free: np.ndarray
    distance: np.ndarray
    allowed: np.ndarray

    def needs(self, taken: np.ndarray) -> np.ndarray:
        """Return the distance that each robot has to slide, shape (n,)."""
        need = self.need.copy()
        need[self.free] = self.distance[np.arange(len(taken)), taken]
        return need

    def evaluate(self, taken: np.ndarray) -> _Assigned:
        """Return an assignment with its bound."""
        result = linprog(self.cost, A_ub=-self.slides, b_ub=-self.needs(taken), method="highs")
        return _Assigned(result.fun, taken, result.x, -result.ineqlin.marginals)

    def cheapest(self, multipliers: np.ndarray, allowed: np.ndarray) -> np.ndarray:
        """Return the assignment of least sum of lambda_j d[j, k] over allowed pairs."""
        weights = multipliers[self.free] + _TIE * max(multipliers.max(), _TIE)
        return linear_sum_assignment(np.where(allowed, weights[:, None] * self.distance, np.inf))[1]


def _best(coupling: _Coupling) -> _Assigned:
    columns, bound = _columns(coupling)
    columns.sort(key=lambda column: column.bound)
    best = columns[0]
    for column in columns[: int(np.clip(MOST_DESCENT_ENTRIES / coupling.distance.size, 1, MOST_DESCENTS))]:
        best = min(best, _descend(coupling, column), key=lambda candidate: candidate.bound)
        if best.bound <= GOOD_ENOUGH * bound:
            break
    return best


def _columns(coupling: _Coupling) -> tuple[list[_Assigned], float]:
    """Return assignments whose mixtures minimise L, and the minimum, which no assignment is below."""
    n, groups = coupling.slides.shape
    random = np.random.default_rng(0).exponential(size=(SPLITS - 1, groups))
    # one for the sum of distances, the others for the sum of shares of what robots slide
    starts = [np.ones(n), *(1 / (coupling.slides @ lengths) for lengths in (np.ones(groups), *random))]
    columns = [coupling.evaluate(coupling.cheapest(multipliers, coupling.allowed)) for multipliers in starts]
    least = 0.0
    for _ in range(MOST_COLUMNS - len(columns)):
        mixture, multipliers = _mixture(coupling, columns)
        taken = coupling.cheapest(multipliers, coupling.allowed)
        least = max(least, float(multipliers @ coupling.needs(taken)))
        if least >= (1 - 1e-6) * mixture:
            break
        columns.append(coupling.evaluate(taken))
    return columns, least


def _mixture(coupling: _Coupling, columns: list[_Assigned]) -> tuple[float, np.ndarray]:
    """Return the least L of a weighted mean of assignments, and its multipliers."""
    needs = np.column_stack([coupling.needs(column.taken) for column in columns])
    lengths, weights = coupling.slides.shape[1], len(columns)
    result = linprog(
        np.concatenate([coupling.cost, np.zeros(weights)]),
        A_ub=np.hstack([-coupling.slides, needs]),
        b_ub=np.zeros(len(needs)),
        A_eq=np.concatenate([np.zeros(lengths), np.ones(weights)])[None],
        b_eq=[1.0],
        method="highs",
    )
    return result.fun, -result.ineqlin.marginals


def _descend(coupling: _Coupling, current: _Assigned) -> _Assigned:
    """Return the assignment where this ends: take the cheapest that needs no more of any robot than it slides now."""
    rows = np.arange(len(coupling.free))
    while True:
        slide = (coupling.slides @ current.lengths)[coupling.free]
        within = coupling.allowed & (coupling.distance <= slide[:, None])
        within[rows, current.taken] = True  # whatever rounding says
        following = coupling.evaluate(coupling.cheapest(current.multipliers, within))
        if not following.bound < (1 - 1e-9) * current.bound:
            return current
        current = following


def _distances(problem: Problem, free: np.ndarray) -> np.ndarray:
    """Return lengths of shortest paths from the starts of free robots to their goals, shape (f, f); infinite: none."""
    starts, goals = problem.starts[free, :2], problem.goals[free]
    if problem.environment.is_open_plane:
        return np.hypot(*(starts[:, None] - goals).T).T
    shapes = Shapes.of(problem.environment)
    radii, girth = problem.swarm.body_radius[free], problem.swarm.girth[free]
    distance = np.empty((len(free), len(free)))
    for radius in np.unique(radii):
        rows = np.flatnonzero(radii == radius)
        margin = MARGIN * float(girth[rows].min())
        for k, goal in enumerate(goals):
            paths = DiscPaths(goal, float(radius), margin, problem.slack, *shapes.kernel_arguments)
            distance[rows, k] = [paths.ahead(starts[row])[0] for row in rows]
    return distance


def _room(problem: Problem) -> np.ndarray:
    """Return the body radius that has room at each goal, shape (n,), whoever takes the others; at least the present one."""
    radius = problem.swarm.body_radius
    room = radius.copy()
    if np.ptp(radius) == 0:
        return room
    gaps = [found.gap for found in environment_clearances(problem.swarm, problem.environment, problem.goals)]
    for k in problem.exchangeable:
        others = np.arange(len(room)) != k
        between = np.hypot(*(problem.goals[others] - problem.goals[k]).T) - room[others]
        # a little less, so that rounding makes no two bodies overlap
        most = (1 - 1e-9) * min(radius[k] + gaps[k], float(between.min(initial=np.inf)))
        room[k] = max(radius[k], min(most, float(radius.max())))
    return room
