"""Goals as requests name them, and errors about them in the words of the request."""

import re

import numpy as np
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.srv import PlanMotion

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.conversion import Scene


def goals_of_request(
    request: PlanMotion.Request | MoveSwarm.Goal, scene: Scene, starts: np.ndarray
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return goals (n, 2), units, and the rows of the robots that the request names; it names all if it names none.

    Raises:
        StressbotError: WRONG_COUNT, UNKNOWN_ROBOT, DUPLICATE_GOAL or NOT_FINITE.
    """
    count = len(request.robots)
    for field in ("goal_x", "goal_y"):
        if len(getattr(request, field)) != count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, field, f"has {len(getattr(request, field))} entries for {count} robots: give one each"
            )
    if count == 0:
        return scene.goals, tuple(range(scene.swarm.n))
    goals = starts[:, :2].copy()
    named = set()
    for index, robot in enumerate(request.robots):
        row = scene.row(robot, f"robots[{index}]")
        if row in named:
            raise StressbotError(ErrorCode.DUPLICATE_GOAL, f"robots[{index}]", f"is {robot} again: give each robot one goal")
        named.add(row)
        for axis, field in enumerate(("goal_x", "goal_y")):
            value = getattr(request, field)[index]
            if not np.isfinite(value):
                raise StressbotError(ErrorCode.NOT_FINITE, f"{field}[{index}]", f"is {value}: give a finite number")
            goals[row, axis] = value / scene.unit
    return goals, tuple(sorted(named))


def named_for_request(error: StressbotError, scene: Scene, exchangeable: tuple[int, ...] = ()) -> StressbotError:
    """Return an error about robots, starts or goals that names robots as the request does, and the unit of its lengths."""
    if match := re.fullmatch(r"robots\[(\d+)\]", error.field):
        return StressbotError(error.code, f"robot {scene.ids[int(match[1])]}", error.message)
    if match := re.fullmatch(r"goals\[(\d+)\]", error.field):
        what, row = "goal", exchangeable[int(match[1])]
    elif match := re.fullmatch(r"robots\[(\d+)\]\.(start|goal)", error.field):
        what, row = "goal" if match[2] == "goal" else "measured pose", int(match[1])
    else:
        return error
    return StressbotError(error.code, f"{what} of robot {scene.ids[row]}", f"{error.message} {units(scene)}")


def units(scene: Scene) -> str:
    """Return in which unit lengths of the library are, for people."""
    return f"(lengths in units of {scene.unit:g} m)"
