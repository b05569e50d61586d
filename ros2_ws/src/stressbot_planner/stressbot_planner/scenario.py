"""Reading and checking scenario files; the format is the JSON schema that stressbot_msgs ships."""

import json
import math
import re
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import jsonschema
import numpy as np
import yaml

from stressbot_planner.allocation import allocate
from stressbot_planner.electrical import Electrical, default_codes
from stressbot_planner.environment import Circle, Environment, Obstacle, Polygon, Workspace
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.problem import EXACT, Problem
from stressbot_planner.swarm import Swarm, fastest

ASSIGN = "assign"
"""Goal of a robot that takes one of `goals`."""

MAX_ROBOTS = 10_000
"""Pair arrays of more robots would not fit into the memory of a laboratory's machine (8 n² bytes)."""

MAX_BYTES = 16_000_000
"""Ten times what so many robots need."""

MAX_DEPTH = 20
"""Levels of nesting; a scenario needs 5. Far more would end the YAML library, and with it the process."""


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
    try:
        with Path(path).open("rb") as stream:
            content = stream.read(MAX_BYTES + 1)
        text = content.decode("utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or ("is not UTF-8 text" if isinstance(error, UnicodeError) else str(error))
        raise StressbotError(ErrorCode.UNREADABLE_FILE, f"scenario file {path}", reason) from error
    if len(content) > MAX_BYTES:
        raise StressbotError(ErrorCode.MALFORMED_FILE, f"scenario file {path}", f"has more than {MAX_BYTES} bytes: is it one?")
    return parse(text, tolerance)


def parse(text: str, tolerance: float = EXACT) -> Scenario:
    """Build a scenario from the text of a scenario file; raises as `load` does."""
    try:
        _check_structure(text)
        data = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}" if mark else "scenario file"
        raise StressbotError(
            ErrorCode.MALFORMED_FILE, where, f"{getattr(error, 'problem', None) or 'is not YAML'}: is the file complete?"
        ) from error
    except (ValueError, TypeError) as error:  # a date that does not exist, thousands of digits
        raise StressbotError(ErrorCode.MALFORMED_FILE, "scenario file", f"cannot be read as YAML ({error})") from error
    if not isinstance(data, dict):
        raise StressbotError(ErrorCode.MALFORMED_FILE, "scenario file", "must be a mapping with name, swarm and robots")
    _check_robot_count(data.get("robots"))
    _check_codeword_types(data.get("swarm"))
    check_schema(data)
    return _build(data, tolerance)


def _check_structure(text: str) -> None:
    """Refuse what unfolds or nests without end, and tags, before anything is built of it."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if getattr(event, "tag", None):  # what PyYAML does not expect there ends in any exception
            raise StressbotError(
                ErrorCode.MALFORMED_FILE, f"line {event.start_mark.line + 1}", f"has the tag {event.tag!r}: leave it out"
            )
        if isinstance(event, yaml.AliasEvent) or depth > MAX_DEPTH:
            what = f"nests deeper than {MAX_DEPTH} levels" if depth > MAX_DEPTH else "is an alias: write the value out"
            raise StressbotError(ErrorCode.MALFORMED_FILE, f"line {event.start_mark.line + 1}", what)


def _build(data: dict, tolerance: float) -> Scenario:
    n = len(data["robots"])
    swarm_data = data["swarm"]
    groups = swarm_data.get("groups", "binary")
    for field, values in (("groups", groups), *((key, swarm_data[key]) for key in ("speed", "turning_radius", "body_radius"))):
        if isinstance(values, list) and len(values) != n:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, f"swarm.{field}", f"has {len(values)} entries for {n} robots: give one per robot"
            )
    _check_calibration(data.get("calibration", {}), n)
    speed, pace = fastest(np.broadcast_to(swarm_data["speed"], n))
    radius = np.broadcast_to(swarm_data["turning_radius"], n)
    codewords = allocate(groups, (radius / pace).tolist()) if isinstance(groups, str) else tuple(groups)
    swarm = Swarm(speed, radius, swarm_data["body_radius"], codewords, pace)
    goals, exchangeable = _goals(data)
    problem = Problem(
        swarm=swarm,
        environment=_environment(data),
        starts=[robot["start"] for robot in data["robots"]],
        goals=goals,
        tolerance=tolerance,
        exchangeable=exchangeable,
    )
    return Scenario(data["name"], float(data.get("length_unit", 1e-4)), problem, _electrical(data, swarm.m))


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


def _goals(data: dict) -> tuple[list, tuple[int, ...]]:
    """Return a goal for each robot, those of `goals` in the order listed, and the rows of robots that take these."""
    robots, listed = data["robots"], data.get("goals")
    exchangeable = tuple(k for k, robot in enumerate(robots) if robot["goal"] == ASSIGN)
    if exchangeable and listed is None:
        raise StressbotError(ErrorCode.MISSING_FIELD, "goals", f"is missing: list {len(exchangeable)} for robots with goal: assign")
    if len(listed or ()) != len(exchangeable):
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "goals",
            f"has {len(listed)} entries for {len(exchangeable)} robots with goal: assign: give as many as there are such robots",
        )
    goals = [robot["goal"] for robot in robots]
    for row, goal in zip(exchangeable, listed or (), strict=True):
        goals[row] = goal
    return goals, exchangeable


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


def _electrical(data: dict, m: int) -> Electrical:
    values = {
        key: value if key == "codes" else tuple(map(float, value)) if isinstance(value, list) else float(value)
        for key, value in (schema_defaults("electrical") | data.get("electrical", {})).items()
    }
    levels = (values["rest_level"], *values["symbol_levels"], values["reset_level"], values["drive_level"])
    values.setdefault("thresholds", tuple((a + b) / 2 for a, b in zip(levels, levels[1:], strict=False)))
    given = values.get("codes", default_codes(m, len(values["symbol_levels"])))
    values["codes"] = tuple(tuple(int(symbol) for symbol in code) for code in given)
    if len(values["codes"]) != m:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "electrical.codes", f"has {len(values['codes'])} entries: give one for each of {m} groups"
        )
    return Electrical(**values)


@cache
def _schema() -> dict:
    return json.loads((resources.files("stressbot_msgs") / "scenario.schema.json").read_text())


def schema_defaults(section: str) -> dict:
    """Return the default values that the schema gives for a section."""
    properties = _schema()["properties"][section]["properties"]
    return {key: value["default"] for key, value in properties.items() if "default" in value}


@cache
def _validator() -> jsonschema.protocols.Validator:
    def is_number(_, value):
        return isinstance(value, int | float) and not isinstance(value, bool) and _is_finite(value)

    base = jsonschema.Draft202012Validator
    types = base.TYPE_CHECKER.redefine("number", is_number)
    return jsonschema.validators.extend(base, type_checker=types)(_schema())


def _is_finite(value: float) -> bool:
    return value.bit_length() < 1024 if isinstance(value, int) else math.isfinite(value)


_CODES = {
    "required": ErrorCode.MISSING_FIELD,
    "additionalProperties": ErrorCode.UNKNOWN_FIELD,
    "minItems": ErrorCode.WRONG_COUNT,
    "maxItems": ErrorCode.WRONG_COUNT,
    "minProperties": ErrorCode.MISSING_FIELD,
    "maxProperties": ErrorCode.UNKNOWN_FIELD,
}


def check_schema(data: dict) -> None:
    """Raise the first thing in which data departs from the scenario schema."""
    error = next(iter(_validator().iter_errors(data)), None)
    if error is None:
        return
    while error.context:
        other = {inner.schema_path[0] for inner in error.context if inner.validator == "type" and not inner.path}
        meant = [inner for inner in error.context if inner.schema_path[0] not in other]
        if not meant:
            break
        error = max(meant, key=lambda e: (len(e.absolute_path), e.validator != "type"))
    field = _field(error.absolute_path) or "scenario file"
    value = error.instance
    shown = repr(value) if len(repr(value)) <= 40 else type(value).__name__
    if error.validator in ("type", "oneOf"):
        if isinstance(value, int | float) and not _is_finite(value):
            size = value if isinstance(value, float) else "too large for a double"
            raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {size}: give a finite number")
        wanted = f"a {error.validator_value}" if error.validator == "type" else error.schema["description"]
        raise StressbotError(ErrorCode.WRONG_TYPE, field, f"is {shown}: give {wanted}")
    code = _CODES.get(error.validator, ErrorCode.OUT_OF_RANGE)
    if error.validator in ("exclusiveMinimum", "minimum"):
        bound = "greater than" if error.validator == "exclusiveMinimum" else "at least"
        raise StressbotError(code, field, f"is {value}: give a number {bound} {error.validator_value}")
    if error.validator == "enum":
        meaning = error.parent.schema.get("description") if error.parent else None
        raise StressbotError(code, field, f"is {shown}: give {meaning or ' or '.join(map(str, error.validator_value))}")
    if error.validator == "required":
        missing = next(key for key in error.validator_value if key not in value)
        prefix = f"{_field(error.absolute_path)}." if error.absolute_path else ""
        raise StressbotError(code, prefix + missing, "is missing: add it")
    if error.validator == "additionalProperties":
        known = error.schema["properties"]
        unknown = next(str(key) or "''" for key in value if key not in known)
        prefix = f"{_field(error.absolute_path)}." if error.absolute_path else ""
        raise StressbotError(code, prefix + unknown, f"is unknown here: use one of {', '.join(known)}")
    raise StressbotError(code, field, error.message)


def _field(path) -> str:
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _check_robot_count(robots) -> None:
    if robots == []:
        raise StressbotError(ErrorCode.NO_ROBOTS, "robots", "is empty: list at least one robot")
    if isinstance(robots, list) and len(robots) > MAX_ROBOTS:
        raise StressbotError(
            ErrorCode.TOO_MANY_ROBOTS, "robots", f"lists {len(robots)} robots: at most {MAX_ROBOTS} can be planned for"
        )


def _check_codeword_types(swarm) -> None:
    groups = swarm.get("groups") if isinstance(swarm, dict) else None
    for index, word in enumerate(groups if isinstance(groups, list) else ()):
        if not isinstance(word, str):
            raise StressbotError(
                ErrorCode.INVALID_CODEWORD, f"swarm.groups[{index}]", f"is {word!r}: put codewords in quotes, as in \"0110\""
            )


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """YAML 1.2 floats (1e-4 is a number, which YAML 1.1 reads as text) and no duplicate keys."""

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            if isinstance(key.value, str) and key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"'{key.value}' stands twice", key.start_mark)
            if isinstance(key.value, str):
                seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)$"),
    list("-+.0123456789"),
)
