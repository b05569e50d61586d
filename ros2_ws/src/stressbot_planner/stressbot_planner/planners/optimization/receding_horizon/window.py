"""One window: durations that bring everybody nearer to its goal, of which a part in front is kept clear of collisions."""

from collections.abc import Callable

import numpy as np

from stressbot_planner.planners.optimization.receding_horizon.aims import urgency_of
from stressbot_planner.planners.optimization.receding_horizon.guesses import Guess, careful, clearest, random_guess
from stressbot_planner.planners.optimization.receding_horizon.prefixes import Ground, Prefix
from stressbot_planner.planners.optimization.receding_horizon.schedule import Schedule
from stressbot_planner.planners.optimization.receding_horizon.soft_goals import SoftGoals, levenberg_marquardt

COMMIT, BUFFER = 0.5, 0.15
"""Shares of a window: what is kept if nothing collides in it nor in the buffer behind."""

LEAST_COMMIT, STEP_BACK = 0.05, 0.6
"""A shorter clear part is a failure; a clear part that ends early is kept up to this share of the buffer before its end."""

AIM_WEIGHTS, FIRST_STEPS, STEPS = (0.3, 0.02, 1e-4, 1e-6), 12, 20
"""Of the aims, falling until the first part is clear; steps with the first of them and with each other one."""

BEHIND = 0.2
"""Weight of gaps behind the first part of a window."""

LEAST_LENGTH = 0.05
"""Of a group that nobody needs, in relation to the one needed most."""

SCREENED, SCREENED_TAIL = 60, 8
"""Guesses of which the one that is clear for longest is taken, after a failure and before one."""

FIRST_TURN = 0.3
"""A guess begins with a random turn of all, up to this share of a whole one; after two failures of up to a whole one."""

SHRINK, LEAST_SHRINK = 0.8, 0.3
"""Lengths of activations after each failure in a row, and the least."""

MORE_THAN_NEEDED = 1.3
"""Of the lengths that would do for all that is left: a window is no longer than that."""

TOTAL_WEIGHT = 1 / 62
"""Of the price of all lengths, per robot."""


def look_ahead(
    ground: Ground, node: Prefix, schedule: Schedule, rng: np.random.Generator, failed: int, out_of_time: Callable[[], bool]
) -> Prefix | None:
    """Return the prefix after one window, None if too little of it is clear. So many windows have failed here before."""
    count = max(schedule.activations // len(ground.used), 2) * len(ground.used)
    path = schedule.pace * float(node.lengths.sum())
    longest = schedule.length * max(SHRINK**failed, LEAST_SHRINK)
    length = min(longest, max(MORE_THAN_NEEDED * path / count, LEAST_SHRINK * schedule.length))
    share = min(count * length / max(path, 1e-9), 1.0)
    wanted = np.maximum(node.lengths * share, LEAST_LENGTH * node.lengths.max() * share)
    wanted[-1] = schedule.turning * wanted[:-1].sum()
    groups, t = _first_guess(ground, node, rng, wanted, count, length, failed)
    total = count * length * float(ground.cost @ wanted / wanted.sum())
    commit, safe = int(COMMIT * count), int((COMMIT + BUFFER) * count)
    problem = SoftGoals(
        ground.crowd, node.poses, ground.crowd.slides_of(groups), ground.paths.aims(node.poses[:, :2], share),
        urgency_of(node.ways, node.lengths @ ground.crowd.slides.T), ground.cost[groups - 1], total, ground.margin,
        ground.least_gap, safe, BEHIND,
    )
    for stage, weight in enumerate(AIM_WEIGHTS):
        if stage == 0 and failed > 0 or out_of_time():
            continue
        here = levenberg_marquardt(problem, t, weight, TOTAL_WEIGHT * ground.crowd.n, STEPS if stage else FIRST_STEPS)
        t = here.t
        if stage > 0 and here.clear_until(ground.least_gap) > safe:
            break
    clear = ground.clear_until(node, groups, t)
    kept = commit if clear > safe else max(0, min(commit, clear - int(STEP_BACK * BUFFER * count)))
    if kept < LEAST_COMMIT * count:
        return None
    return ground.after(node, groups, t, kept, max(clear - kept - 2, 0))


def walk(ground: Ground, node: Prefix, least: int) -> Prefix | None:
    """Return the prefix after half of what is clear of the tail, None if that is less than so many activations."""
    if node.tail is None or node.clean < least:
        return None
    kept = max(node.clean // 2, 1)
    return ground.after(node, *node.tail, kept, node.clean - kept)


def _first_guess(
    ground: Ground, node: Prefix, rng: np.random.Generator, wanted: np.ndarray, count: int, length: float, failed: int
) -> Guess:
    """Return the tail of the window before and random activations, or of random guesses the clearest."""
    if node.tail is not None and failed == 0:
        groups, t = random_guess(ground, rng, count - len(node.tail[0]), wanted, length)
        return np.concatenate([node.tail[0], groups]), np.concatenate([node.tail[1], t])
    most_turn = 1.0 if failed > 1 else FIRST_TURN
    screened = SCREENED if failed > 0 or node.parent is None else SCREENED_TAIL
    guesses = (
        careful(ground, rng, random_guess(ground, rng, count, wanted, length), most_turn) for _ in range(screened)
    )
    return clearest(ground, node, guesses, count // 2)
