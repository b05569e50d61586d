"""Tasks that codewords are to suit: goals at random, or those of other scenario files."""

from dataclasses import replace

import numpy as np

from stressbot_planner.collision.clearance import Shapes, environment_clearances, environment_gap
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.problem.definition import Problem
from stressbot_planner.system.fields import FREE

DRAWS = 2000
"""Places that are drawn for a robot before the least distances are made smaller."""

SHRINKS = 6
"""How often, by half each time, the rest between them and contact is."""


def check_task(problem: Problem) -> None:
    """Raise UNSUPPORTED unless a problem is one of goals alone, which codewords can be chosen for."""
    for row in problem.headed[:1]:
        raise StressbotError(
            ErrorCode.UNSUPPORTED, f"robots[{row}].goal", "has a heading, and codewords are chosen for places: leave it out"
        )
    for row in problem.parked[:1]:
        raise StressbotError(
            ErrorCode.UNSUPPORTED, f"robots[{row}].goal", "is parked, and codewords are chosen for robots that move: give it a goal"
        )
    if len(problem.waypoints):
        elsewhere = np.any(problem.waypoints != problem.starts[:, :2], axis=(0, 2))
        field = f"robots[{int(np.argmax(elsewhere))}].waypoints"
        raise StressbotError(ErrorCode.UNSUPPORTED, field, "are in the way: codewords are chosen for goals alone; leave them out")


def random_task(problem: Problem, rng: np.random.Generator) -> Problem:
    """Return a task for the same robots in the same place: starts, headings and goals at random, each robot with its own goal.

    They are as far from each other and from obstacles as the closest ones of the problem are, or, where there is no room for that,
    less. Without walls they lie in the rectangle around the starts and goals of the problem.

    Raises:
        StressbotError: there is no room, naming `--tasks`.
    """
    starts, goals = (_places(problem, positions, rng) for positions in (problem.starts[:, :2], problem.goals))
    headings = rng.uniform(-np.pi, np.pi, problem.swarm.n)
    return replace(problem, starts=np.column_stack([starts, headings]), goals=goals, exchangeable=(), goal_headings=FREE)


def task_of(other: Problem, problem: Problem, source: str) -> Problem:
    """Return the task of another problem for the robots of this one.

    Raises:
        StressbotError: codewords cannot be chosen for it, or it has another number of robots, naming `--tasks`, or these do not fit
            there.
    """
    try:
        check_task(other)
    except StressbotError as error:
        raise StressbotError(error.code, "--tasks", f"{source}: {error.field} {error.message}") from error
    if other.swarm.n != problem.swarm.n:
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "--tasks",
            f"{source} has {other.swarm.n} robots, the scenario {problem.swarm.n}: give files for as many",
        )
    return replace(other, swarm=problem.swarm)


def _places(problem: Problem, given: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return places, shape (n, 2), no closer to each other and to obstacles than the given ones (n, 2) are."""
    radius, environment = problem.swarm.body_radius, problem.environment
    low, high = _box(problem)
    apart = [np.hypot(*(given[:j] - given[j]).T) - radius[:j] - radius[j] for j in range(1, len(given))]
    between = max(0.0, min((float(gaps.min()) for gaps in apart), default=0.0))
    margin = max(0.0, min((found.gap for found in environment_clearances(problem.swarm, environment, given)), default=0.0))
    margin = margin if np.isfinite(margin) else 0.0
    for shrink in range(SHRINKS + 1):
        places = np.empty_like(given)
        for j in range(len(given)):
            candidates = rng.uniform(low, high, (DRAWS, 2))
            distance = np.hypot(*(candidates[:, None] - places[:j]).transpose(2, 0, 1)) - radius[:j] - radius[j]
            free = candidates[(distance >= between / 2**shrink).all(axis=1)]
            place = next((one for one in free if _gap(problem, j, one) >= margin / 2**shrink), None)
            if place is None:
                break
            places[j] = place
        else:
            return places
    raise StressbotError(
        ErrorCode.OUT_OF_RANGE, "--tasks", f"finds no room for {len(given)} robots at random: name scenario files instead"
    )


def _gap(problem: Problem, row: int, place: np.ndarray) -> float:
    """Return the gap of one robot to obstacles and walls at a place, units."""
    shapes = Shapes.of(problem.environment)
    return environment_gap(*place, 1.0, 0.0, 0.0, problem.swarm.body_radius[row], *shapes.kernel_arguments)[0]


def _box(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    walls = problem.environment.workspace
    if walls is not None:
        return np.array([walls.x_min, walls.y_min]), np.array([walls.x_max, walls.y_max])
    corners = np.vstack([problem.starts[:, :2], problem.goals])
    return corners.min(axis=0), corners.max(axis=0)
