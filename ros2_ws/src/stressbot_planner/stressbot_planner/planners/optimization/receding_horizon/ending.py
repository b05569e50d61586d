"""The end of a plan: from a prefix to all goals at once, as least squares without residual, restored exactly."""

from collections.abc import Callable

import numpy as np

from stressbot_planner.model.goal_reaching import restore_goals
from stressbot_planner.planners.optimization.receding_horizon.guesses import clearest, random_guess
from stressbot_planner.planners.optimization.receding_horizon.prefixes import Ground, Prefix
from stressbot_planner.planners.optimization.receding_horizon.soft_goals import SoftGoals, levenberg_marquardt

PER_ROBOT, PER_ROBOT_NEAR = 18.0, 7.0
"""Activations of an end per robot: where all of the way is left, and where none is."""

OF_REST, OF_WHOLE, GROWTH = 1.4, 0.3, 1.1
"""Cost of an end: so much of the bound of the rest and of that of the whole; its growth with each try that fails."""

TURNING, LEAST = (0.15, 0.25, 0.4), 0.2
"""Turning of all in relation to the sliding; least length of a group, in relation to the largest."""

SCREENED = 8
"""Guesses of which the one that is clear for longest is taken."""

STAGES = ((0.1, 0.05, 15, 0.03), (0.01, 0.3, 20, 0.006), (0.1, 0.0, 40, 1.0))
"""Weight of aims, of the total, steps, residual per robot above which it is given up."""

NEAR_ENOUGH, FEW_OVERLAPS, RESTORED, REPAIR_STEPS = 0.3, 0.02, 2, 10
"""Largest miss and residual from which it is restored exactly, so often; with so many steps between."""

SHORTER, LEAST_SHORTER, SHORTENING_STEPS, TRUST = 0.05, 0.005, 12, 1.3
"""An end that was found is made shorter by this share, which grows where that works and falls by half where it does not, down to
the second; steps of it."""


def find_end(
    ground: Ground, node: Prefix, rng: np.random.Generator, cost: float, out_of_time: Callable[[], bool]
) -> Prefix | None:
    """Make one try from a prefix: return the prefix at the goals, of about this cost from there, None if it fails."""
    share = node.rest / max(ground.root.rest, 1e-9)
    per_robot = PER_ROBOT_NEAR + (PER_ROBOT - PER_ROBOT_NEAR) * min(2 * share, 1.0)
    count = max(int(per_robot * ground.crowd.n) // len(ground.used), 2) * len(ground.used)
    wanted = np.maximum(node.lengths, LEAST * node.lengths.max())
    wanted[-1] = rng.choice(TURNING) * wanted[:-1].sum()
    guesses = (random_guess(ground, rng, count, wanted, 1.0) for _ in range(SCREENED))
    scaled = ((groups, t * (cost / (ground.cost[groups - 1] @ t))) for groups, t in guesses)
    groups, guess = clearest(ground, node, scaled, count)
    problem = _problem(ground, node, groups, cost)
    t, here = guess, None
    for aim_weight, total_weight, steps, most in STAGES:
        here = levenberg_marquardt(problem, t, aim_weight, total_weight, steps, solve=aim_weight < 0.1 or total_weight == 0.0)
        if here.value > most * ground.crowd.n or out_of_time():
            return None
        t = here.t
    if here is None or np.abs(here.misses).max() > NEAR_ENOUGH or here.value > FEW_OVERLAPS:
        return None
    found = _exact(ground, node, groups, t)
    return None if found is None else ground.after(node, groups, found, len(found), 0)


def usual_cost(ground: Ground, node: Prefix) -> float:
    """Return what an end from a prefix is expected to cost."""
    return OF_REST * node.rest + OF_WHOLE * ground.root.rest


def shorten(ground: Ground, end: Prefix, out_of_time: Callable[[], bool]) -> Prefix:
    """Return an end (the piece after its parent) with less cost, by steps towards a smaller one, or the same."""
    node = end.parent
    if node is None:
        return end
    best, less = end, SHORTER
    while less > LEAST_SHORTER and not out_of_time():
        problem = _problem(ground, node, end.groups, (1 - less) * (best.done - node.done))
        here = levenberg_marquardt(problem, best.t, 0.1, 1.0, SHORTENING_STEPS, solve=True)
        found = _exact(ground, node, end.groups, here.t) if np.abs(here.misses).max() <= NEAR_ENOUGH else None
        if found is not None:
            shorter = ground.after(node, end.groups, found, len(found), 0)
            if shorter.done < best.done:
                best, less = shorter, TRUST * less
                continue
        less *= 0.5
    return best


def _problem(ground: Ground, node: Prefix, groups: np.ndarray, cost: float) -> SoftGoals:
    crowd = ground.crowd
    return SoftGoals(
        crowd, node.poses, crowd.slides_of(groups), ground.goals, np.ones(crowd.n), ground.cost[groups - 1], cost,
        ground.margin, ground.least_gap, len(groups),
    )


def _exact(ground: Ground, node: Prefix, groups: np.ndarray, t: np.ndarray) -> np.ndarray | None:
    """Return lengths (K,) near t that bring all robots to their goals without a collision, None if none were found."""
    problem = _problem(ground, node, groups, float(ground.cost[groups - 1] @ t))
    slides = np.ascontiguousarray(problem.slides.T)
    for _ in range(RESTORED):
        motion = slides, ground.crowd.turning_length, node.poses, ground.goals, ground.headings
        exact, there = restore_goals(*motion, t, ground.precision)
        if there and ground.clear_until(node, groups, exact) == len(t):
            return exact
        t = levenberg_marquardt(problem, t, 1.0, 0.0, REPAIR_STEPS, meetings=False, solve=True).t
    return None
