"""Requests in the units of the library, and errors about them in the words of the request: metres, its fields, ids of robots."""

import re
from typing import NamedTuple

import numpy as np
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.action import PlanMotion as PlanMotionAction
from stressbot_msgs.scenario_text import schema
from stressbot_msgs.srv import PlanMotion

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.environment import Circle
from stressbot_planner.model.swarm import LARGEST, check_coordinates, check_positive
from stressbot_planner.problem.naming import renamed
from stressbot_planner.ros.conversion import Scene
from stressbot_planner.system.fields import FREE

Request = PlanMotion.Request | PlanMotionAction.Goal | MoveSwarm.Goal

FAR = 100.0
"""Largest distance of a goal in an open plane from the swarm, in extents of the swarm."""

MOST_STAGES = 1 + schema()["properties"]["robots"]["items"]["properties"]["waypoints"]["maxItems"]
"""As many as a scenario file may have."""

_TURNS = 10.0
"""Turning radii that a swarm extends at least, for robots that stand alone at their goal."""

_LENGTH = re.compile(r"(-?\d[\d.]*(?:e[-+]?\d+)?) units")


class Goals(NamedTuple):
    """What a request asks for.

    Attributes:
        places: at the end, shape (n, 2), units.
        headings: there, shape (n,), rad, NaN where they are free.
        exchangeable, parked: rows of robots that may exchange their places, and of those that stay.
        waypoints: places of the stages before, shape (s, n, 2), units.
    """

    places: np.ndarray
    headings: np.ndarray
    exchangeable: tuple[int, ...]
    parked: tuple[int, ...]
    waypoints: np.ndarray


def goals_of_request(request: Request, scene: Scene, starts: np.ndarray) -> Goals:
    """Return the goals of the request, or the scenario's own. `move_swarm` has no headings of its own.

    Raises:
        StressbotError: WRONG_COUNT, LIMIT_EXCEEDED, UNKNOWN_ROBOT, DUPLICATE_GOAL, NOT_FINITE, UNSUPPORTED, or OUT_OF_RANGE for a
            goal, tolerance or clearance that cannot be meant.
    """
    size = extent(scene, starts)
    check_positive("tolerance", request.tolerance)
    for field in ("tolerance", "min_clearance"):
        if getattr(request, field, 0.0) > size:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                field,
                f"is {getattr(request, field):g} m, larger than all that the robots lie in ({size:.3g} m): lengths are in metres",
            )
    count, stages = len(request.robots), _stages(request)
    given = getattr(request, "goal_heading", ())
    if stages > MOST_STAGES:
        raise StressbotError(ErrorCode.LIMIT_EXCEEDED, "goal_x", f"has {stages} stages: give at most {MOST_STAGES}")
    for field, times in (("goal_x", stages), ("goal_y", stages), *([("goal_heading", 1)] if len(given) else [])):
        if len(getattr(request, field)) != times * count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT,
                field,
                f"has {len(getattr(request, field))} entries for {count} robots"
                + (f" and {times} stages: give one each for each stage" if times > 1 else ": give one each"),
            )
    parked = {_parked(robot, f"parked[{index}]", scene) for index, robot in enumerate(getattr(request, "parked", ()))}
    if count == 0:
        parked |= set(scene.parked)
        free = range(scene.swarm.n) if request.assign else scene.exchangeable
        places, headings, rows = np.stack([*scene.waypoints, scene.goals]), scene.goal_headings.copy(), sorted(parked)
        places[:, rows], headings[rows] = starts[rows, :2], FREE
        return Goals(places[-1], headings, tuple(row for row in free if row not in parked), tuple(rows), places[:-1])
    places, headings = np.repeat(starts[None, :, :2], stages, axis=0), np.full(len(starts), FREE)
    named = set()
    for index, robot in enumerate(request.robots):
        row = scene.row(robot, f"robots[{index}]")
        if row in named:
            raise StressbotError(ErrorCode.DUPLICATE_GOAL, f"robots[{index}]", f"is {robot} again: give each robot one goal")
        if row in parked:
            raise StressbotError(ErrorCode.DUPLICATE_GOAL, f"robots[{index}]", f"is {robot}, which is parked: it has no goal")
        named.add(row)
        for stage, axis in np.ndindex(stages, 2):
            field, entry = ("goal_x", "goal_y")[axis], stage * count + index
            value = getattr(request, field)[entry]
            if not np.isfinite(value):
                raise StressbotError(ErrorCode.NOT_FINITE, f"{field}[{entry}]", f"is {value}: give a finite number")
            away = abs(value - scene.unit * starts[row, axis])
            if scene.environment.workspace is None and away > FAR * size:
                raise StressbotError(
                    ErrorCode.OUT_OF_RANGE,
                    f"{field}[{entry}]",
                    f"is {value:g} m, {away:.3g} m from robot {robot} in a swarm of {size:.3g} m: coordinates are in metres",
                )
            places[stage, row, axis] = value / scene.unit
        if len(given) and not np.isnan(given[index]):
            check_coordinates(f"goal_heading[{index}]", given[index])
            headings[row] = given[index]
    free = tuple(sorted(named)) if request.assign else ()
    return Goals(places[-1], headings, free, tuple(sorted(parked)), places[:-1])


def _stages(request: Request) -> int:
    count = len(request.robots)
    return max(len(request.goal_x) // count, 1) if count else 1


def _parked(robot: int, field: str, scene: Scene) -> int:
    row = scene.row(robot, field)
    if any(row in pair for pair in scene.contacts):
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            field,
            f"is {robot}, which has a contact in the scenario: who is parked is an obstacle, from which all keep the same gap",
        )
    return row


def extent(scene: Scene, starts: np.ndarray) -> float:
    """Return the diagonal, m, of the walls, or of the box around starts, the scenario's goals and obstacles."""
    walls, swarm = scene.environment.workspace, scene.swarm
    if walls is not None:
        return scene.unit * float(np.hypot(walls.x_max - walls.x_min, walls.y_max - walls.y_min))
    around = [starts[:, :2], scene.goals]
    for obstacle in scene.environment.obstacles:
        if isinstance(obstacle, Circle):
            around += [obstacle.center[None] - obstacle.radius, obstacle.center[None] + obstacle.radius]
        else:
            around.append(obstacle.vertices)
    box = np.ptp(np.vstack(around), axis=0)
    least = max(_TURNS * float(swarm.turning_radius.max()), 2.0 * float(swarm.body_radius.max()))
    return scene.unit * max(float(np.hypot(*box)), least)


def check_measured(scene: Scene, starts: np.ndarray) -> None:
    """Raise OUT_OF_RANGE if a robot was measured where none can be, NOT_FINITE if nowhere."""
    for row in np.flatnonzero(~np.all(np.abs(starts) <= LARGEST, axis=1))[:1]:
        x, y, heading = starts[row] * (scene.unit, scene.unit, 1.0)
        code = ErrorCode.OUT_OF_RANGE if np.all(np.isfinite(starts[row])) else ErrorCode.NOT_FINITE
        raise StressbotError(
            code, "swarm_poses", f"has robot {scene.ids[row]} at x {x:g} m, y {y:g} m, heading {heading:g} rad: see to the tracker"
        )


def named_for_request(
    error: StressbotError, scene: Scene, request: Request, exchangeable: tuple[int, ...]
) -> StressbotError:
    """Return an error of the library with the request's fields, ids of robots, and metres."""
    message = in_words(error.message, scene, exchangeable)
    if match := re.fullmatch(r"goals\[(\d+)\]|robots\[(\d+)\]\.goal", error.field):
        row = int(match[2]) if match[2] else exchangeable[int(match[1])]
        robot = int(scene.ids[row])
        if robot in request.robots:
            index = list(request.robots).index(robot)
            last = (_stages(request) - 1) * len(request.robots) + index
            is_heading = error.code in (ErrorCode.INFEASIBLE, ErrorCode.UNSUPPORTED)
            field = f"goal_heading[{index}]" if is_heading else f"goal_x[{last}], goal_y[{last}]"
            return StressbotError(error.code, field, f"the goal of robot {robot} {message}")
        if robot in (parked := list(getattr(request, "parked", ()))):
            return StressbotError(error.code, f"parked[{parked.index(robot)}]", f"robot {robot} {message}")
        return StressbotError(error.code, f"goal of robot {robot}", message)
    if match := re.fullmatch(r"robots\[(\d+)\]\.waypoints\[(\d+)\]", error.field):
        robot, stage = int(scene.ids[int(match[1])]), int(match[2])
        if robot in request.robots:
            index = stage * len(request.robots) + list(request.robots).index(robot)
            return StressbotError(error.code, f"goal_x[{index}], goal_y[{index}]", f"the waypoint of robot {robot} {message}")
        return StressbotError(error.code, f"waypoint {stage + 1} of robot {robot}", message)
    if match := re.fullmatch(r"robots\[(\d+)\](\.start)?", error.field):
        robot = f"robot {scene.ids[int(match[1])]}"
        return StressbotError(error.code, f"measured pose of {robot}" if match[2] else robot, message)
    return StressbotError(error.code, error.field, message)


def in_words(text: str, scene: Scene, exchangeable: tuple[int, ...] = ()) -> str:
    """Return a sentence of the library with ids in place of numbers of robots, and metres in place of units."""
    text = renamed(text, lambda number: str(scene.ids[number - 1]) if number <= len(scene.ids) else None)
    text = re.sub(r"\bgoals\[(\d+)\]", lambda match: f"the goal of robot {scene.ids[exchangeable[int(match[1])]]}", text)
    return _LENGTH.sub(lambda match: f"{float(match[1]) * scene.unit:.6g} m", text)
