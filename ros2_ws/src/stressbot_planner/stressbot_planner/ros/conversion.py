"""Messages from and to the library's values: SI units outside, scenario units inside.

Large arrays go through `array.array`, which rclpy copies whole.
"""

from array import array
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import atan2, inf, isfinite, pi
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion
from stressbot_msgs.bounds import excess
from stressbot_msgs.described import AMBIGUOUS, TOPIC, Described
from stressbot_msgs.msg import (
    ElectricalDescription,
    MotionPlan,
    Obstacle,
    SwarmDescription,
    SwarmPoses,
    VoltageSequence,
)
from stressbot_msgs.msg import Primitive as PrimitiveMsg

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.kalman_filters import Calibration
from stressbot_planner.execution.worker import Report
from stressbot_planner.model.allocation import by_level
from stressbot_planner.model.electrical import Electrical, Pulses
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm, check_positive, fastest, frozen_array
from stressbot_planner.primitives.expansion import Activate, Extract, Isolate, Orient, Primitive, Subgroup, Translate, Turn, TurnAll
from stressbot_planner.problem.definition import Problem
from stressbot_planner.sequencing import VoltageProgram
from stressbot_planner.system.fields import FREE

FRAME = "substrate"


@dataclass(frozen=True, eq=False)
class Scene:
    """What `swarm_description` tells, in scenario units. Row k of the arrays is the robot with id ids[k].

    Attributes:
        name: of the scenario.
        swarm_id: digest of the description.
        unit: metres per scenario unit.
        ids: robot ids, shape (n,).
        starts: poses after `reset`, shape (n, 3), units and rad.
        goals: the scenario's own goals, shape (n, 2), units.
        goal_headings: headings there, shape (n,), rad, NaN where they are free.
        exchangeable: rows of robots that may take each other's goals, as in `Problem`.
        parked: rows of robots that stay where they are, as in `Problem`.
        contacts: pairs of rows of robots that may touch, as in `Problem`.
        waypoints: places on the way to the scenario's own goals, as in `Problem`, shape (s, n, 2), units.
        calibration: what was measured of the robots, in units; None: nothing.
    """

    name: str
    swarm_id: str
    unit: float
    ids: np.ndarray
    swarm: Swarm
    environment: Environment
    electrical: Electrical
    starts: np.ndarray
    goals: np.ndarray
    goal_headings: np.ndarray
    exchangeable: tuple[int, ...]
    parked: tuple[int, ...]
    waypoints: np.ndarray
    contacts: tuple[tuple[int, int], ...]
    calibration: Calibration | None

    @cached_property
    def _row_of_id(self) -> dict[int, int]:
        return {int(robot): row for row, robot in enumerate(self.ids)}

    def row(self, robot: int, field: str) -> int:
        """Return the row of a robot id.

        Raises:
            StressbotError: UNKNOWN_ROBOT.
        """
        row = self._row_of_id.get(int(robot))
        if row is None:
            raise StressbotError(ErrorCode.UNKNOWN_ROBOT, field, f"is {robot}: the swarm has {self.known_ids()}")
        return row

    def pulsed_at(self, frequency: float) -> "Scene":
        """Return the same swarm when it gets pulses of another frequency, Hz, and steps remain as long; 0: as described.

        Raises:
            StressbotError: UNSUPPORTED if the drive is constant; NOT_FINITE, OUT_OF_RANGE if robots cannot follow.
        """
        if frequency == 0.0:
            return self
        drive = self.electrical.drive
        if drive is None:
            raise StressbotError(ErrorCode.UNSUPPORTED, "frequency", f"is {frequency:g} Hz, and the drive is constant: give 0")
        electrical = replace(self.electrical, drive=replace(drive, frequency=frequency))
        swarm = replace(self.swarm, speed=self.swarm.speed * (frequency / drive.frequency))
        return replace(self, electrical=electrical, swarm=swarm)

    def known_ids(self) -> str:
        """Return the ids as text, shortened."""
        ids = self.ids.tolist()
        if ids == list(range(ids[0], ids[0] + len(ids))):
            return f"robots {ids[0]} to {ids[-1]}"
        return "robots " + ", ".join(map(str, ids[:20])) + (", …" if len(ids) > 20 else "")


# The swarm


def check_size(message: Any) -> None:
    """Refuse a message or a request that holds more than any of ours.

    Raises:
        StressbotError: LIMIT_EXCEEDED, naming the field.
    """
    if (problem := excess(message)) is not None:
        raise StressbotError(ErrorCode.LIMIT_EXCEEDED, *problem)


def scene_of(described: Described) -> Scene:
    """Return the swarm of the one driver that is alive.

    Raises:
        StressbotError: AMBIGUOUS_SWARM if there is more than one; NO_SWARM if there is none, or its description is refused.
    """
    if described.is_ambiguous:
        raise StressbotError(ErrorCode.AMBIGUOUS_SWARM, TOPIC, AMBIGUOUS)
    if described.description is None:
        raise StressbotError(ErrorCode.NO_SWARM, TOPIC, "has no driver that is alive: start the driver, then plan again")
    try:
        return scene_from_description(described.description)
    except StressbotError as error:
        raise StressbotError(ErrorCode.NO_SWARM, TOPIC, f"is refused: {error}") from error


def scene_from_description(message: SwarmDescription) -> Scene:
    """Return the scene that a driver describes.

    Raises:
        StressbotError: the description contradicts itself.
    """
    check_size(message)
    check_positive("length_unit", message.length_unit)
    unit, n = message.length_unit, len(message.ids)
    per_robot = {"codewords": 1, "speed": 1, "turning_radius": 1, "body_radius": 1, "start": 3, "goal": 2}
    for field, count in ((name, n * size) for name, size in per_robot.items()):
        if len(getattr(message, field)) != count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, field, f"has {len(getattr(message, field))} entries: {n} robots need {count}"
            )
    if len(set(message.ids)) != n:
        raise StressbotError(ErrorCode.WRONG_COUNT, "ids", "name a robot twice")
    speed, pace = fastest(np.asarray(message.speed) / unit)
    swarm = Swarm(
        speed,
        np.asarray(message.turning_radius) / unit,
        np.asarray(message.body_radius) / unit,
        tuple(message.codewords),
        pace,
    )
    if swarm.m != message.group_count:
        raise StressbotError(ErrorCode.WRONG_COUNT, "group_count", f"is {message.group_count}, the codewords make {swarm.m}")
    if len(message.workspace) not in (0, 4):
        raise StressbotError(ErrorCode.WRONG_COUNT, "workspace", f"has {len(message.workspace)} entries: give 4, or none")
    workspace = Workspace(*(value / unit for value in message.workspace)) if len(message.workspace) else None
    environment = Environment(workspace, tuple(_obstacle(item, unit) for item in message.obstacles))
    row_of_id = {int(robot): row for row, robot in enumerate(message.ids)}
    if len(message.goal_heading) not in (0, n):
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "goal_heading", f"has {len(message.goal_heading)} entries: {n} robots need {n}, or none"
        )
    if n and len(message.waypoint) % (2 * n):
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "waypoint", f"has {len(message.waypoint)} entries: {n} robots need {2 * n} for each stage"
        )
    if len(message.contact) % 2:
        raise StressbotError(ErrorCode.WRONG_COUNT, "contact", f"has {len(message.contact)} entries: give two ids for each pair")
    for field in ("assign", "parked", "contact"):
        for robot in getattr(message, field):
            if robot not in row_of_id:
                raise StressbotError(ErrorCode.UNKNOWN_ROBOT, field, f"names robot {robot}, which is none of the ids")
    electrical = _electrical(message.electrical, swarm.m)
    if electrical.pull_downs and swarm.codewords != by_level(electrical.pull_downs):
        raise StressbotError(ErrorCode.INVALID_CODEWORD, "codewords", "are not those that electrical.pull_downs select")
    return Scene(
        name=message.name,
        swarm_id=message.swarm_id,
        unit=unit,
        ids=frozen_array(message.ids, dtype=np.int64),
        swarm=swarm,
        environment=environment,
        electrical=electrical,
        starts=frozen_array(_poses(message.start, unit)),
        goals=frozen_array(np.asarray(message.goal).reshape(-1, 2) / unit),
        goal_headings=frozen_array(message.goal_heading if len(message.goal_heading) else np.full(n, FREE)),
        exchangeable=tuple(sorted({row_of_id[robot] for robot in message.assign})),
        parked=tuple(sorted({row_of_id[robot] for robot in message.parked})),
        contacts=tuple(
            (row_of_id[one], row_of_id[other]) for one, other in zip(message.contact[::2], message.contact[1::2], strict=True)
        ),
        waypoints=frozen_array(np.asarray(message.waypoint).reshape(-1, n, 2) / unit),
        calibration=_calibration(message, n),
    )


def _calibration(message: SwarmDescription, n: int) -> Calibration | None:
    """Return None where there was none: all four fields are empty."""
    scale = {"heading_bias": 1.0, "heading_bias_sigma": 1.0}
    scale |= {"speed_sigma": message.length_unit, "turning_radius_sigma": message.length_unit}
    counts = {name: len(getattr(message, name)) for name in scale}
    if not any(counts.values()):
        return None
    for name, count in counts.items():
        if count != n:
            raise StressbotError(ErrorCode.WRONG_COUNT, name, f"has {count} entries: {n} robots need {n}")
    return Calibration(**{name: frozen_array(np.asarray(getattr(message, name)) / unit) for name, unit in scale.items()})


def _obstacle(message: Obstacle, unit: float) -> Circle | Polygon:
    if len(message.x) != len(message.y):
        raise StressbotError(ErrorCode.WRONG_COUNT, "obstacles", f"have one with {len(message.x)} x and {len(message.y)} y")
    corners = np.column_stack([message.x, message.y]) / unit
    if message.kind == Obstacle.CIRCLE and len(corners) == 1:
        return Circle(corners[0], message.radius / unit)
    if message.kind == Obstacle.POLYGON and len(corners) >= 3:
        return Polygon(corners)
    raise StressbotError(ErrorCode.OUT_OF_RANGE, "obstacles", f"have one of kind {message.kind} with {len(corners)} points")


def _electrical(message: ElectricalDescription, m: int) -> Electrical:
    length = message.code_length
    if length == 0 or len(message.codes) != m * length:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "electrical.codes", f"has {len(message.codes)} symbols: {m} groups need {m} times {length}"
        )
    codes = [int(symbol) for symbol in message.codes]
    values = {name: getattr(message, name) for name in Electrical.__dataclass_fields__ if name not in ("codes", "drive")}
    values["symbol_levels"] = tuple(message.symbol_levels)
    values["thresholds"] = tuple(message.thresholds)
    values["pull_downs"] = tuple(message.pull_downs)
    if message.frequency:
        values["drive"] = Pulses(**{name: getattr(message, name) for name in Pulses.__dataclass_fields__})
    return Electrical(codes=tuple(tuple(codes[i * length : (i + 1) * length]) for i in range(m)), **values)


def measured_poses(message: SwarmPoses, scene: Scene) -> np.ndarray:
    """Return poses (n, 3), units and rad, in the scene's order; NaN for robots that were not seen.

    Raises:
        StressbotError: UNKNOWN_ROBOT, WRONG_COUNT.
    """
    rows = slice(None)  # of everybody, as they come 50 times a second
    if not np.array_equal(message.ids, scene.ids):
        rows = [scene.row(robot, f"swarm_poses.ids[{index}]") for index, robot in enumerate(message.ids)]
    if not len(message.ids) == len(message.x) == len(message.y) == len(message.heading):
        raise StressbotError(ErrorCode.WRONG_COUNT, "swarm_poses", "must give one x, y and heading for each id")
    poses = np.full((scene.swarm.n, 3), np.nan)
    poses[rows] = np.column_stack([np.asarray(message.x) / scene.unit, np.asarray(message.y) / scene.unit, message.heading])
    return poses


def starts_from_poses(message: SwarmPoses, scene: Scene) -> np.ndarray:
    """Return poses (n, 3), units and rad, in the scene's order.

    Raises:
        StressbotError: as `measured_poses`; NO_SWARM if not every robot was seen, the message names those.
    """
    poses = measured_poses(message, scene)
    unseen = np.isnan(poses).any(axis=1)
    if unseen.any():
        missing = ", ".join(str(robot) for robot in scene.ids[unseen][:20]) + (", …" if unseen.sum() > 20 else "")
        raise StressbotError(
            ErrorCode.NO_SWARM,
            "swarm_poses",
            f"has no pose of robots {missing}: bring them into the tracker's view and ask again",
        )
    return poses


def _poses(values, unit: float) -> np.ndarray:
    return np.asarray(values).reshape(-1, 3) / (unit, unit, 1.0)


# Primitives

_KINDS: dict[type, int] = {
    Activate: PrimitiveMsg.ACTIVATE,
    Translate: PrimitiveMsg.TRANSLATE,
    Turn: PrimitiveMsg.TURN,
    TurnAll: PrimitiveMsg.TURN,
    Orient: PrimitiveMsg.ORIENT,
    Subgroup: PrimitiveMsg.SUBGROUP,
    Isolate: PrimitiveMsg.ISOLATE,
    Extract: PrimitiveMsg.EXTRACT,
}


def primitive_to_message(primitive: Primitive, scene: Scene) -> PrimitiveMsg:
    """Return the message of a primitive; a turn of all robots is a TURN of the all-rotate group."""
    message = PrimitiveMsg(kind=_KINDS[type(primitive)])
    message.group = scene.swarm.m if isinstance(primitive, TurnAll) else getattr(primitive, "group", 0)
    message.distance = scene.unit * (primitive.length if isinstance(primitive, Activate) else getattr(primitive, "distance", 0.0))
    message.angle = float(getattr(primitive, "angle", 0.0))
    excursion = getattr(primitive, "excursion", inf)
    message.excursion = scene.unit * excursion if isfinite(excursion) else 0.0
    robots = (primitive.robot,) if isinstance(primitive, Isolate) else getattr(primitive, "robots", ())
    message.robots = array("I", [int(scene.ids[robot - 1]) for robot in robots])
    message.angles = array("d", getattr(primitive, "angles", ()))
    message.inside = array("H", getattr(primitive, "inside", ()))
    message.outside = array("H", getattr(primitive, "outside", ()))
    return message


def primitive_from_message(message: PrimitiveMsg, scene: Scene) -> Primitive:
    """Return the primitive of a message; the inverse of `primitive_to_message`.

    Raises:
        StressbotError: INVALID_PLAN for an unknown kind; NOT_FINITE, OUT_OF_RANGE, UNKNOWN_ROBOT, WRONG_COUNT.
            Unknown groups are found when the primitive is expanded.
    """
    for field in ("distance", "angle", "excursion"):
        _check_finite(field, getattr(message, field))
    n, m = scene.swarm.n, scene.swarm.m
    for field, most in (("robots", n), ("angles", n), ("inside", m), ("outside", m)):
        if (count := len(getattr(message, field))) > most:  # before each of them is looked at
            raise StressbotError(ErrorCode.WRONG_COUNT, field, f"has {count} entries: give at most {most}")
    for index, angle in enumerate(message.angles):
        _check_finite(f"angles[{index}]", angle)
    if message.excursion < 0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "excursion", f"is {message.excursion}: give a length, or 0 for no limit")
    build = _BUILDERS.get(message.kind)
    if build is None:
        raise StressbotError(
            ErrorCode.INVALID_PLAN, "kind", f"is {message.kind}: use one of {', '.join(map(str, sorted(_BUILDERS)))}"
        )
    robots = tuple(scene.row(robot, f"robots[{index}]") + 1 for index, robot in enumerate(message.robots))
    return build(message, scene, robots, message.excursion / scene.unit if message.excursion else inf)


def _turn(message: PrimitiveMsg, scene: Scene, robots: tuple[int, ...], excursion: float) -> Primitive:
    if message.group == scene.swarm.m:
        return TurnAll(message.angle)
    return Turn(message.group, message.angle, excursion)


def _isolate(message: PrimitiveMsg, scene: Scene, robots: tuple[int, ...], excursion: float) -> Primitive:
    if len(robots) != 1:
        raise StressbotError(ErrorCode.WRONG_COUNT, "robots", f"has {len(robots)} entries: name the one that shall move")
    return Isolate(robots[0], message.distance / scene.unit, message.group, excursion)


_BUILDERS: dict[int, Callable[[PrimitiveMsg, Scene, tuple[int, ...], float], Primitive]] = {
    PrimitiveMsg.ACTIVATE: lambda message, scene, robots, excursion: Activate(message.group, message.distance / scene.unit),
    PrimitiveMsg.TRANSLATE: lambda message, scene, robots, excursion: Translate(
        message.group, message.distance / scene.unit, excursion
    ),
    PrimitiveMsg.TURN: _turn,
    PrimitiveMsg.ORIENT: lambda message, scene, robots, excursion: Orient(robots, tuple(message.angles), excursion),
    PrimitiveMsg.SUBGROUP: lambda message, scene, robots, excursion: Subgroup(
        message.group, message.distance / scene.unit, tuple(message.inside), tuple(message.outside), excursion
    ),
    PrimitiveMsg.ISOLATE: _isolate,
    PrimitiveMsg.EXTRACT: lambda message, scene, robots, excursion: Extract(
        robots, message.group, message.distance / scene.unit, excursion
    ),
}


def _check_finite(field: str, value: float) -> None:
    if not isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {value}: give a finite number")


# Plans and sequences


def plan_to_message(
    report: Report, starts: np.ndarray, scene: Scene, plan_id: str, planner: str, seed: int
) -> MotionPlan:
    """Return `motion_plan` of a report of success, without a stamp; starts as in `Problem`."""
    unit = scene.unit
    message = MotionPlan(
        plan_id=plan_id,
        swarm_id=scene.swarm_id,
        planner=planner,
        seed=seed,
        primitives=[primitive_to_message(primitive, scene) for primitive in report.primitives],
        start=_doubles(starts * (unit, unit, 1.0)),
        goal=_doubles(unit * report.goals),
        goal_heading=_doubles(report.goal_headings if np.isfinite(report.goal_headings).any() else np.empty(0)),
        predicted=_doubles(_wrapped(report.end) * (unit, unit, 1.0)),
        path_length=unit * report.path_length,
        execution_time=report.execution_time,
        selection_time=scene.electrical.selection_time * report.activations,
        min_clearance=unit * report.gap,
        goal_error=unit * report.goal_error,
    )
    message.header.frame_id = FRAME
    return message


def poses_from_plan(message: MotionPlan, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the start and the predicted end of a plan, each (n, 3), units and rad."""
    return _poses(message.start, scene.unit), _poses(message.predicted, scene.unit)


def problem_of_plan(message: MotionPlan, problem: Problem, scene: Scene) -> Problem:
    """Return a scenario's problem with the goals that a plan assigns to its exchangeable robots.

    The scenario's own numbers are taken, which metres and back would round.
    """
    free = list(problem.exchangeable)
    if not free:
        return problem
    wanted = np.asarray(message.goal).reshape(-1, 2)[free] / scene.unit
    listed = problem.goals[free]
    goals = problem.goals.copy()
    goals[free] = listed[np.argmin(np.hypot(*(wanted[:, None] - listed).T), axis=0)]
    return replace(problem, goals=goals)


def sequence_to_message(program: VoltageProgram, plan_id: str, swarm_id: str) -> VoltageSequence:
    """Return `voltage_sequence`, without a stamp."""
    ends, pulses = array("I"), array("Q")
    ends.frombytes(program.epoch_ends.astype(np.uint32).tobytes())
    pulses.frombytes(program.pulses.tobytes())
    message = VoltageSequence(
        plan_id=plan_id,
        swarm_id=swarm_id,
        levels=_doubles(program.levels),
        dwells=_doubles(program.dwells),
        epoch_ends=ends,
        duration=program.duration,
        pulses=pulses,
        low_levels=_doubles(program.low_levels),
        duty=program.duty,
        alternating=program.alternating,
    )
    message.header.frame_id = FRAME
    return message


def program_from_message(message: VoltageSequence) -> VoltageProgram:
    """Return the volts of a `voltage_sequence`."""
    trains = message.pulses, message.low_levels, message.duty, message.alternating
    return VoltageProgram(message.levels, message.dwells, message.epoch_ends, *trains)


def heading_of(q: Quaternion) -> float:
    """Return the heading of an orientation, rad, in [-pi, pi]."""
    return atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def _doubles(values: np.ndarray) -> array:
    flat = array("d")
    flat.frombytes(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return flat


def _wrapped(poses: np.ndarray) -> np.ndarray:
    """Return poses with headings in (-pi, pi]."""
    poses = np.array(poses)
    poses[:, 2] -= 2 * pi * np.ceil((poses[:, 2] - pi) / (2 * pi))
    return poses
