"""`optimize`: durations over a group order, minimised under "every robot at its goal, no bodies overlap".

The paper's numerical optimisation, grown up: exact derivatives, clearances, many starts. Each start repeats the
groups in a random order, with a random first guess around the group lengths of the linear-program bound.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from stressbot_planner.bounds import group_lengths
from stressbot_planner.collision import Shapes, clearance_of
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.kinematics import execution_time, path_length, replay
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.central_path import CentralPath, Order
from stressbot_planner.primitives import Activate
from stressbot_planner.problem import Problem

ACTIVATIONS_PER_ROBOT = 12
"""K = 12 n: twice as many as are nearly always enough for exact goals, so that gaps can be kept too."""

CLOSE_TO_BOUND = 1.02
"""A plan this close to the lower bound ends the search."""

PATIENCE = 12
"""So do this many valid plans in a row that are not better."""

_SPARES = (1.3, 1.6)
"""First guesses are this much longer than the bound, in turn: short ones end short, long ones find ways around."""

_TURNING_WEIGHT = 0.01
"""Cost of a unit length of G_m under the path objective, where turning is free."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the shortest of the valid plans found from several starts, for any turning radii."""
    if not problem.swarm.equal_speeds:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            "swarm.speed",
            "differs between robots, which this planner cannot do yet: use 'optimize_paper' or 'rrt'",
        )
    begin = settings.clock()

    def out_of_time() -> bool:
        return settings.clock() - begin > settings.time_limit

    if problem.goal_error(problem.starts[:, :2]) <= problem.tolerance:
        return Outcome(())
    shapes = Shapes.of(problem.environment)
    margin = float(problem.swarm.body_radius.min()) / 3
    bound = problem.lower_bounds.path_length if settings.objective == "path" else problem.lower_bounds.execution_time
    best, best_value, history = None, np.inf, []
    nearest, nearest_gap = None, -np.inf
    starts = valid = since_better = 0
    for order, guess in _starts(problem, settings.objective, rng):
        if out_of_time() or best_value <= CLOSE_TO_BOUND * bound or since_better >= PATIENCE:
            break
        starts += 1
        lengths = CentralPath(problem, shapes, order, margin).solve(guess, out_of_time)
        if lengths is None:
            continue
        groups, lengths, gap = _prune(problem, shapes, order, lengths, margin)
        if gap > nearest_gap:
            nearest, nearest_gap = (groups, lengths), gap
        if gap <= 0:
            continue
        valid += 1
        since_better += 1
        path, time = path_length(problem.swarm, groups, lengths), execution_time(problem.swarm, lengths)
        value = path if settings.objective == "path" else time
        if value < best_value:
            if value < 0.995 * best_value:
                since_better = 0
            best, best_value = (groups, lengths), value
            history.append((settings.clock() - begin, path, time))
    details = {"starts": starts, "valid_starts": valid}
    if best is None:
        reason = f"no collision-free plan from {starts} starts within {settings.time_limit:g} s"
        if nearest is not None:
            reason += f"; the closest one reaches the goals with bodies overlapping by {-nearest_gap:.3g}"
        return Outcome(_primitives(nearest), reason, details=details)
    return Outcome(_primitives(best), history=tuple(history), details=details)


def _primitives(activations: tuple[np.ndarray, np.ndarray] | None) -> tuple[Activate, ...] | None:
    if activations is None:
        return None
    return tuple(Activate(int(group), float(length)) for group, length in zip(*activations, strict=True))


def _starts(problem: Problem, objective: str, rng: np.random.Generator) -> Iterator[tuple[Order, np.ndarray]]:
    """Yield group orders with first guesses, without end."""
    swarm = problem.swarm
    used = np.flatnonzero((swarm.group_sizes > 0) | (np.arange(swarm.m) == swarm.m - 1))
    if objective == "path":
        weight = np.maximum(swarm.group_sizes.astype(float), _TURNING_WEIGHT)
    else:
        weight = np.ones(swarm.m)
    lengths = group_lengths(swarm, problem.starts, problem.goals, weight)
    lengths[-1] = 2 * np.pi * float(swarm.turning_radius.mean()) / _SPARES[0]
    lengths = np.maximum(lengths, 0.05 * lengths.max())
    cycles = -(-max(ACTIVATIONS_PER_ROBOT * swarm.n, 24) // len(used))
    for spare in itertools.cycle(_SPARES):
        groups = np.tile(rng.permutation(used), cycles) + 1
        order = Order(groups, swarm.membership[groups - 1], weight[groups - 1])
        yield order, spare * lengths[groups - 1] / cycles * rng.uniform(0.5, 1.5, len(groups))


def _prune(
    problem: Problem, shapes: Shapes, order: Order, lengths: np.ndarray, margin: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Leave out activations too short to matter, as many as goals and gaps allow; each costs time to select.

    Returns:
        Groups, lengths and the smallest gap.
    """

    def smallest_gap(groups, lengths):
        poses = replay(problem.swarm, problem.starts, groups, lengths)
        return clearance_of(problem.swarm, shapes, poses, groups, lengths).gap

    best = (order.groups, lengths, smallest_gap(order.groups, lengths))
    cost = float(order.cost @ lengths)
    for share in (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3):
        keep = lengths > share * lengths.mean()
        if keep.sum() < 2 * problem.swarm.n:
            break
        shorter = order.subset(keep)
        restored = CentralPath(problem, shapes, shorter, margin).restore(lengths[keep])
        if restored is None or shorter.cost @ restored > 1.001 * cost:
            break
        gap = smallest_gap(shorter.groups, restored)
        if gap <= min(best[2], 0.1 * margin):
            break
        best = (shorter.groups, restored, gap)
    return best
