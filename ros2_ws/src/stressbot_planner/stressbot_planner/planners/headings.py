"""Headings at goals, for planners that bring robots to places first: Rot turns them at the end, where nobody is displaced."""

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.planners.limit import Limit
from stressbot_planner.planners.motion import Motion
from stressbot_planner.primitives.expansion import TURN
from stressbot_planner.problem.definition import Problem

TRIES = 60
"""Turns of the others before Rot, at random: swings need room."""


def turn_to_goals(motion: Motion, rng: np.random.Generator, limit: Limit) -> str:
    """Add what turns robots at their goals to the headings there; return why they could not be turned, or nothing."""
    problem = motion.world.problem
    rows = problem.headed
    if not len(rows):
        return ""
    robots = tuple((rows + 1).tolist())
    for attempt in range(TRIES):
        if attempt and limit.late():
            break
        branch = Motion(motion.world, motion.poses, int(rows[0]))
        if attempt and not branch.turn(int(rng.integers(1, problem.swarm.m)), float(rng.uniform(0, TURN))):
            continue
        angles = np.mod(problem.goal_headings[rows] - branch.poses[rows, 2], TURN)
        if branch.orient(robots, tuple(angles.tolist())):
            motion.append(branch)
            return ""
    names = ", ".join(map(str, robots))
    return f"all robots are at their goals, but there is no room for the swings that turn robots {names} to their headings"


def check_headings_for_rot(problem: Problem) -> None:
    """Raise UNSUPPORTED if robots of different turning lengths have headings at their goals: Rot turns those of one."""
    lengths = problem.swarm.turning_length[problem.headed]
    for row in problem.headed[lengths != lengths[:1]][:1]:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            f"robots[{row}].goal",
            f"has a heading, and robot {row + 1} another turning radius ÷ speed than robot {problem.headed[0] + 1}, which has one, "
            "too: use the planner 'optimize'",
        )


def check_free_headings(problem: Problem, planner: str) -> None:
    """Raise UNSUPPORTED if a goal has a heading."""
    for row in problem.headed[:1]:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            f"robots[{row}].goal",
            f"has a heading, and the planner '{planner}' leaves headings free: use 'optimize', 'pure_control', 'sequential', "
            "'parallel' or 'rrt_rotation', or leave out the heading",
        )
