"""From scenario files to problems. Their text is read, and its limits are held, by `stressbot_msgs.scenario_text`."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from stressbot_msgs import scenario_text

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import BY_LEVEL, allocate, by_level
from stressbot_planner.model.electrical import CHECKED, Electrical, Pulses, checked_codes, control_levels, default_codes, midpoints
from stressbot_planner.model.environment import Circle, Environment, Obstacle, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm, fastest
from stressbot_planner.model.whole_pulses import contact_depth
from stressbot_planner.problem.definition import EXACT, Problem
from stressbot_planner.system.fields import FREE

ASSIGN, PARKED = "assign", "parked"
"""Goals of a robot that takes one of `goals`, and of one that stays where it starts."""

SLOWEST = 1e-6
"""Speed of the slowest robot in relation to the fastest; solvers of linear programs drop coefficients below 1e-9."""

STEP = 12e-9
"""m; of the fastest robot, unless step or frequency is given."""

PULSES = {"low_level": 110.0, "duty": 0.5, "polarity": "unipolar", "response": 1e-5}
"""What `drive: pulses` means; see docs/electrical.md."""

COMMON = 1e-6
"""Frequencies that differ by less, relative, are one."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A named problem with its electrical interface.

    Attributes:
        name: of the scenario.
        length_unit: metres per unit.
        problem: starts, goals, swarm and environment, in units.
        electrical: volts, dwells and codes.
    """

    name: str
    length_unit: float
    problem: Problem
    electrical: Electrical

    @property
    def swarm(self) -> Swarm:
        """The robots."""
        return self.problem.swarm


def load(path: str | Path, tolerance: float = EXACT) -> Scenario:
    """Read a scenario file.

    Raises:
        StressbotError: with the field and what to change.
    """
    return _build(scenario_text.read(path), tolerance)


def parse(text: str, tolerance: float = EXACT) -> Scenario:
    """Build a scenario from the text of a scenario file; raises as `load` does."""
    return _build(scenario_text.parse(text), tolerance)


def text(content: dict[str, Any]) -> str:
    """Return the text of a scenario file that reads as this content."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=130, allow_unicode=True)


def with_codewords(path: str | Path, codewords: Sequence[str]) -> str:
    """Return the text of a scenario file with these codewords, and everything else as it is, but for comments.

    Raises:
        StressbotError: as `load` does.
    """
    content = scenario_text.read(path)
    return text(content | {"swarm": content["swarm"] | {"groups": list(codewords)}})


class _Dumper(yaml.SafeDumper):
    """No aliases, which readers refuse, and quotes around whatever begins like a number."""

    def ignore_aliases(self, data):
        return True


_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"[-+]?\.?[0-9]"), list("-+.0123456789"))


def _build(data: dict, tolerance: float) -> Scenario:
    n = len(data["robots"])
    swarm_data = data["swarm"]
    groups = swarm_data.get("groups", "binary")
    for field, values in (*((key, swarm_data[key]) for key in ("speed", "turning_radius", "body_radius")), ("groups", groups)):
        if isinstance(values, list) and len(values) != n:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, f"swarm.{field}", f"has {len(values)} entries for {n} robots: give one per robot"
            )
    goals, exchangeable, headings = _goals(data)
    _check_calibration(data.get("calibration", {}), n)
    speed, pace = fastest(np.broadcast_to(swarm_data["speed"], n))
    if pace.min() < SLOWEST:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "swarm.speed", f"is {pace.min():.2g} of the largest for one robot: give at least {SLOWEST:g}"
        )
    radius = np.broadcast_to(swarm_data["turning_radius"], n)
    pull_downs = _pull_downs(data.get("electrical", {}), groups, n)
    if pull_downs:
        codewords = by_level(pull_downs)
    elif isinstance(groups, str):
        codewords = allocate(groups, (radius / (speed * pace)).tolist())
    else:
        codewords = tuple(groups)
    swarm = Swarm(speed, radius, swarm_data["body_radius"], codewords, pace)
    environment = _environment(data)
    electrical = _electrical(data, swarm, pull_downs)
    problem = Problem(
        swarm=swarm,
        environment=environment,
        starts=[robot["start"] for robot in data["robots"]],
        goals=goals,
        tolerance=tolerance,
        exchangeable=exchangeable,
        goal_headings=headings,
        waypoints=_waypoints(data["robots"]),
        contacts=tuple((one - 1, other - 1) for one, other in data.get("contacts", ())),
        parked=tuple(k for k, robot in enumerate(data["robots"]) if robot["goal"] == PARKED),
    )
    if problem.contacts:  # of what moves by steps; places in files are exact
        problem = replace(problem, contact_depth=contact_depth(electrical.pulse_length(swarm.speed)))
    return Scenario(data["name"], float(data.get("length_unit", 1e-4)), problem, electrical)


def _check_calibration(calibration: dict, n: int) -> None:
    """What it measured is for the closed loop, which hears of it from the driver."""
    named = set()
    for index, entry in enumerate(calibration.get("robots", ())):
        number = entry.get("now")
        if number is not None and (number > n or number in named):
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                f"calibration.robots[{index}].now",
                f"is {number}: this file has robots 1 to {n}, and each was measured once",
            )
        named.add(number)


def _goals(data: dict) -> tuple[list, tuple[int, ...], list[float]]:
    """Return a place for each robot, those of `goals` in the order listed, the rows of robots that take these, and headings."""
    robots, listed = data["robots"], data.get("goals", [])
    exchangeable = tuple(k for k, robot in enumerate(robots) if robot["goal"] == ASSIGN)
    if exchangeable and "goals" not in data:
        raise StressbotError(ErrorCode.MISSING_FIELD, "goals", f"is missing: list {len(exchangeable)} for robots with goal: assign")
    if len(listed) != len(exchangeable):
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "goals",
            f"has {len(listed)} entries for {len(exchangeable)} robots with goal: assign: give as many as there are such robots",
        )
    goals = [robot["start"][:2] if robot["goal"] == PARKED else robot["goal"] for robot in robots]
    for row, goal in zip(exchangeable, listed, strict=True):
        goals[row] = goal
    return [goal[:2] for goal in goals], exchangeable, [goal[2] if len(goal) > 2 else FREE for goal in goals]


def _waypoints(robots: list[dict]) -> list[list]:
    """Return the places of all robots stage by stage: those of robots without waypoints are their starts."""
    counts = {k: len(robot["waypoints"]) for k, robot in enumerate(robots) if "waypoints" in robot}
    count = next(iter(counts.values()), 0)
    for k, given in counts.items():
        if given != count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT,
                f"robots[{k}].waypoints",
                f"has {given} entries, and robots[{next(iter(counts))}].waypoints {count}: give one for each stage, or none",
            )
    each = [robot.get("waypoints", [robot["start"][:2]] * count) for robot in robots]
    return [[places[stage] for places in each] for stage in range(count)]


def _environment(data: dict) -> Environment:
    workspace = None
    if "workspace" in data:
        bounds = data["workspace"]
        workspace = Workspace(*map(float, bounds["x"]), *map(float, bounds["y"]))
    return Environment(workspace, tuple(_obstacle(index, item) for index, item in enumerate(data.get("obstacles", ()))))


def _obstacle(index: int, item: dict) -> Obstacle:
    try:
        if "circle" in item:
            return Circle(item["circle"]["center"], float(item["circle"]["radius"]))
        return Polygon(item["polygon"])
    except StressbotError as error:
        raise StressbotError(error.code, f"obstacles[{index}].{error.field}", error.message) from error


def _pull_downs(given: dict, groups: str | list, n: int) -> tuple[float, ...]:
    """Return the levels, V, at which the arms of robots come down, if each has its own; () if not."""
    listed = given.get("pull_down")
    if not isinstance(listed, list):
        if groups == BY_LEVEL:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, "electrical.pull_down", "is one level, and groups are by_level: list a level for each robot"
            )
        return ()
    if len(listed) != n:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "electrical.pull_down", f"has {len(listed)} entries for {n} robots: give one number, or {n}"
        )
    if groups != BY_LEVEL and tuple(groups) != by_level(listed):
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "swarm.groups", f"are not what the levels of electrical.pull_down select: write {BY_LEVEL}"
        )
    for name in ("symbol_levels", "codes"):
        if name in given:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                f"electrical.{name}",
                "follow from pull_down, which lists a level for each robot: leave them out",
            )
    return tuple(map(float, listed))


def _electrical(data: dict, swarm: Swarm, pull_downs: tuple[float, ...]) -> Electrical:
    given = scenario_text.defaults("electrical") | data.get("electrical", {})
    drive = _drive(given.pop("drive"), swarm, float(data.get("length_unit", 1e-4)))
    if pull_downs:
        levels = control_levels(pull_downs, float(given["drive_level"]))
        codes = [[index] for index in range(len(levels))]
        given |= {"pull_down": min(pull_downs), "symbol_levels": list(levels), "codes": codes}
    values: dict[str, Any] = {
        key: value if key == "codes" else tuple(map(float, value)) if isinstance(value, list) else float(value)
        for key, value in given.items()
    }
    low = () if drive is None else (drive.low_level,)
    symbols = () if pull_downs else values["symbol_levels"]
    levels = (values["rest_level"], *symbols, values["reset_level"], *low, values["drive_level"])
    values.setdefault("thresholds", midpoints(levels))
    level_count = len(values["symbol_levels"])
    shortest = default_codes(swarm.m, level_count)
    codes = values.get("codes", shortest)
    if codes == CHECKED:
        codes = checked_codes(shortest, level_count)
    values["codes"] = tuple(tuple(int(symbol) for symbol in code) for code in codes)
    electrical = Electrical(**values, drive=drive, pull_downs=pull_downs)
    if len(electrical.codes) != swarm.m:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "electrical.codes", f"has {len(electrical.codes)} entries: give one for each of {swarm.m} groups"
        )
    return electrical


def _drive(given: str | dict, swarm: Swarm, length_unit: float) -> Pulses | None:
    """Return None for a constant drive; frequency x step = speed for every robot."""
    if given == "constant":
        return None
    values = PULSES | (given if isinstance(given, dict) else {})
    speeds = swarm.speed * swarm.pace
    steps = values.get("step_length")
    if isinstance(steps, list) and len(steps) != swarm.n:
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "electrical.drive.step_length",
            f"has {len(steps)} entries for {swarm.n} robots: give one number, or one per robot",
        )
    if steps is None:
        frequency = float(values.get("frequency", swarm.speed * length_unit / STEP))
    else:
        each = speeds / np.asarray(steps, dtype=float)
        frequency = float(values.get("frequency", each[0]))
        wrong = np.abs(each - frequency) > COMMON * frequency
        if wrong.any():
            row = int(np.argmax(wrong))
            raise StressbotError(
                ErrorCode.NO_COMMON_FREQUENCY,
                "electrical.drive.step_length",
                f"takes {each[row]:g} Hz for the speed of robot {row + 1}, not {frequency:g} Hz: speed = step_length x frequency, "
                "with one frequency for all",
            )
    return Pulses(
        low_level=float(values["low_level"]),
        frequency=frequency,
        duty=float(values["duty"]),
        alternating=values["polarity"] == "alternating",
        response=float(values["response"]),
    )
