"""The bench: which robots lie on which substrate, and how they answer to volts.

From the scenario file, whose text `stressbot_msgs.scenario_text` reads, for the driver's half of it. Lengths in the dataclasses are
metres; the checks speak of scenario units, as the file does.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from stressbot_msgs import scenario_text

from stressbot_driver import geometry
from stressbot_driver.codewords import (
    BY_LEVEL,
    CHECKED,
    allocate,
    by_level,
    check_codewords,
    check_headings,
    check_parked,
    checked_codes,
    control_levels,
    default_codes,
)
from stressbot_driver.errors import ErrorCode, StressbotError

DEFAULT_LENGTH_UNIT = 1.0e-4

SMALLEST_BODY = 1e-9  # radius, scenario units, of what is no point
SLOWEST = 1e-6  # speed of the slowest robot in relation to the fastest

# Assumptions all of them, with reasons in docs/electrical.md; the schema repeats the values for other readers.
ELECTRICAL_DEFAULTS: dict[str, Any] = {
    "rest_level": 0.0,
    "symbol_levels": [40.0, 60.0],
    "reset_level": 90.0,
    "drive_level": 140.0,
    "hysteresis": 4.0,
    "pull_down": 120.0,
    "release": 30.0,
    "reset_dwell": 0.01,
    "symbol_dwell": 0.01,
    "guard_dwell": 0.005,
    "min_dwell": 0.002,
    "min_level": 0.0,
    "max_level": 200.0,
    "drive": "constant",
}
PULSE_DEFAULTS: dict[str, Any] = {"low_level": 110.0, "duty": 0.5, "polarity": "unipolar", "response": 1e-5}
STEP = 12e-9  # [m] of the fastest robot, unless step or frequency is given
COMMON = 1e-6  # relative; frequencies that differ by less are one
SLOWEST_PULSES = 1e-3  # [Hz]
MOST_LEVELS = 256  # that select groups: a symbol is a byte


@dataclass(frozen=True)
class Pulses:
    """A drive in which each pulse moves every robot by one step, its speed / frequency."""

    low_level: float  # [V] between pulses; the high level is drive_level
    frequency: float  # [Hz]
    duty: float  # share of a period at the high level
    alternating: bool  # each pulse has the other sign than the one before
    response: float  # [s] shortest time at the high or the low level that a robot answers to


@dataclass(frozen=True, eq=False)
class Electrical:
    """How the swarm reads volts; fields as in `ElectricalDescription.msg`."""

    rest_level: float
    symbol_levels: np.ndarray  # [V] (L,); where levels select groups: those, as they are
    reset_level: float
    drive_level: float
    thresholds: np.ndarray  # [V] (L+2,), of pulses (L+3,), with L = 0 where levels select groups
    hysteresis: float
    pull_down: float
    pull_downs: np.ndarray  # [V] (n,) each robot's own, by which levels select groups; (0,): PFSMs do
    release: float
    reset_dwell: float
    symbol_dwell: float
    guard_dwell: float
    min_dwell: float
    codes: np.ndarray  # (m, K) symbols
    min_level: float
    max_level: float
    drive: Pulses | None  # None: a constant drive_level, in which robots move steadily


@dataclass(frozen=True, eq=False)
class Circle:
    center: np.ndarray  # [m] (2,)
    radius: float  # [m]


@dataclass(frozen=True, eq=False)
class Polygon:
    corners: np.ndarray  # [m] (k, 2), in order


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was measured of the robots; one row per robot, NaN where nothing was. Sigmas are standard deviations."""

    heading_bias: np.ndarray  # [rad] (n,) from the measured heading to the direction that the robot slides in
    heading_bias_sigma: np.ndarray  # [rad] (n,)
    speed_sigma: np.ndarray  # [m/s] (n,)
    turning_radius_sigma: np.ndarray  # [m] (n,)


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything that `swarm_description` tells, in SI units. Arrays have one row per robot and are read-only."""

    name: str
    swarm_id: str
    length_unit: float  # [m] per scenario unit
    ids: np.ndarray  # (n,) uint32
    speed: np.ndarray  # [m/s] (n,)
    turning_radius: np.ndarray  # [m] (n,)
    body_radius: np.ndarray  # [m] (n,)
    codewords: tuple[str, ...]
    start: np.ndarray  # [m, m, rad] (n, 3)
    goal: np.ndarray  # [m] (n, 2)
    goal_heading: np.ndarray  # [rad] (n,), NaN where it is free
    assign: np.ndarray  # ids of robots that may take each other's goals, uint32
    parked: np.ndarray  # ids of robots that stay where they start, uint32
    contact: np.ndarray  # (c, 2) ids of robots that may touch, uint32
    waypoint: np.ndarray  # [m] (s, n, 2) where all robots are in each of s stages before they go to their goals
    workspace: np.ndarray | None  # [m] x_min, x_max, y_min, y_max
    obstacles: tuple[Circle | Polygon, ...]
    electrical: Electrical
    calibration: Calibration | None

    @property
    def membership(self) -> np.ndarray:
        """(n, m-1) bool: whether a robot belongs to a group, G_1 first."""
        bits = np.frombuffer("".join(self.codewords).encode("ascii"), dtype=np.uint8)
        return (bits == ord("1")).reshape(len(self.codewords), -1)

    @property
    def group_count(self) -> int:
        """m, the all-rotate group included."""
        return len(self.codewords[0]) + 1


def load_bench(path: str | Path) -> Bench:
    """Read a scenario file. Raises StressbotError, whose message names the field and what to change."""
    return _build(scenario_text.read(path))


def parse_bench(text: str) -> Bench:
    """As `load_bench`, from YAML text."""
    return _build(scenario_text.parse(text))


def _build(content: dict[str, Any]) -> Bench:
    robots, swarm = content["robots"], content["swarm"]
    count = len(robots)
    unit = float(content.get("length_unit", DEFAULT_LENGTH_UNIT))
    speed, turning_radius, body_radius = (
        _per_robot(swarm[key], count, f"swarm.{key}") for key in ("speed", "turning_radius", "body_radius")
    )
    for r in body_radius[(body_radius > 0.0) & (body_radius < SMALLEST_BODY)][:1]:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "swarm.body_radius", f"is {r:g}: give 0, or {SMALLEST_BODY:g} or more")
    groups = swarm.get("groups", "binary")
    if isinstance(groups, list) and len(groups) != count:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "swarm.groups", f"{len(groups)} codewords for {count} robots: give one per robot"
        )
    start = _array([robot["start"] for robot in robots])
    goal, goal_heading, assign = _goals(content)
    calibration = _calibration(content["calibration"], count, unit) if "calibration" in content else None
    if (pace := speed / speed.max()).min() < SLOWEST:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "swarm.speed", f"{pace.min():.2g} of the largest is too little: give at least {SLOWEST:g} of it"
        )
    given = content.get("electrical", {})
    pull_downs = _pull_downs(given, groups, count)
    if len(pull_downs):
        codewords = check_codewords(by_level(pull_downs), turning_radius, speed)
    elif isinstance(groups, str):
        codewords = allocate(groups, turning_radius / speed)
    else:
        codewords = check_codewords(groups, turning_radius, speed)
    check_headings(codewords, goal_heading)
    parked = [index for index, robot in enumerate(robots) if robot["goal"] == "parked"]
    check_parked(codewords, turning_radius / speed, parked)
    walls = _walls(content.get("workspace"))
    obstacles = [_obstacle(entry, index) for index, entry in enumerate(content.get("obstacles", []))]
    electrical = _electrical(given, speed * unit, unit, len(codewords[0]) + 1, pull_downs)
    contact = content.get("contacts", [])
    for index, pair in enumerate(contact):
        if max(pair) > count or pair[0] == pair[1]:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, f"contacts[{index}]", f"is {pair}: name two different robots out of {count}"
            )
        if {pair[0] - 1, pair[1] - 1} & set(parked):
            raise StressbotError(
                ErrorCode.UNSUPPORTED, f"contacts[{index}]", f"{pair}: one is parked, and counts as an obstacle; leave the pair out"
            )
    waypoint = _waypoints(robots)
    for index in parked:
        if np.any(waypoint[:, index] != start[index, :2]):
            raise StressbotError(
                ErrorCode.UNSUPPORTED, f"robots[{index}].goal", "parks a robot that has waypoints elsewhere: leave those out"
            )
    stages = [(f"waypoints[{stage}]", xy) for stage, xy in enumerate(waypoint)]
    places = (("start", start[:, :2]), *stages, ("goal", goal))
    slack = geometry.touching_slack(body_radius, [xy for _, xy in places], walls, obstacles)
    for name, xy in places:
        _check_places(name, xy, body_radius, walls, obstacles, assign, slack)

    fields: dict[str, Any] = {
        "length_unit": unit,
        "ids": _frozen(np.arange(1, count + 1, dtype=np.uint32)),
        "speed": _frozen(speed * unit),
        "turning_radius": _frozen(turning_radius * unit),
        "body_radius": _frozen(body_radius * unit),
        "codewords": tuple(codewords),
        "start": _frozen(start * (unit, unit, 1.0)),
        "goal": _frozen(goal * unit),
        "goal_heading": _frozen(goal_heading),
        "assign": _frozen(assign),
        "parked": _frozen(np.array(parked, dtype=np.uint32) + np.uint32(1)),
        "contact": _frozen(np.array(contact, dtype=np.uint32).reshape(-1, 2)),
        "waypoint": _frozen(waypoint * unit),
        "workspace": None if walls is None else _frozen(walls * unit),
        "obstacles": tuple(_scaled(obstacle, unit) for obstacle in obstacles),
        "electrical": electrical,
        "calibration": calibration,
    }
    return Bench(name=content["name"], swarm_id=_digest(fields), **fields)


def _goals(content: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (n, 2), scenario units, those of `goals` in the order listed, headings (n,), and the ids of robots that take these."""
    robots, listed = content["robots"], content.get("goals", [])
    free = [index for index, robot in enumerate(robots) if robot["goal"] == "assign"]
    if free and "goals" not in content:
        raise StressbotError(ErrorCode.MISSING_FIELD, "goals", f"{len(free)} robots have goal: assign: list as many goals")
    if len(listed) != len(free):
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "goals", f"{len(listed)} goals for {len(free)} robots with goal: assign: give one each"
        )
    goals = [robot["start"][:2] if robot["goal"] == "parked" else robot["goal"] for robot in robots]
    for index, goal in zip(free, listed or [], strict=True):
        goals[index] = goal
    headings = _array([goal[2] if len(goal) > 2 else np.nan for goal in goals])
    return _array([goal[:2] for goal in goals]), headings, np.array(free, dtype=np.uint32) + np.uint32(1)


def _waypoints(robots: list[dict[str, Any]]) -> np.ndarray:
    """Places (s, n, 2), scenario units, in s stages; robots without waypoints are at their starts."""
    counts = {index: len(robot["waypoints"]) for index, robot in enumerate(robots) if "waypoints" in robot}
    count = next(iter(counts.values()), 0)
    for index, given in counts.items():
        if given != count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, f"robots[{index}].waypoints", f"{given} entries, others have {count}: one for each stage"
            )
    each = [robot.get("waypoints", [robot["start"][:2]] * count) for robot in robots]
    return _array(each).reshape(len(robots), count, 2).swapaxes(0, 1)


def _calibration(given: dict[str, Any], count: int, unit: float) -> Calibration:
    """Half widths of confidence intervals become standard deviations, as of a normal distribution."""
    bias, *sigmas = np.full((4, count), np.nan)
    quantile = NormalDist().inv_cdf(0.5 + 0.5 * given["confidence"])
    named = set()
    for index, entry in enumerate(given["robots"]):
        if "now" not in entry:
            continue
        row = entry["now"] - 1
        if row >= count or row in named:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                f"calibration.robots[{index}].now",
                f"is {row + 1}: this file has robots 1 to {count}, and each was measured once",
            )
        named.add(row)
        if "heading_bias" in entry:
            bias[row] = entry["heading_bias"][0]
        for values, key, scale in zip(sigmas, ("heading_bias", "speed", "turning_radius"), (1.0, unit, unit), strict=True):
            if key in entry:
                values[row] = entry[key][1] / quantile * scale
    return Calibration(*map(_frozen, (bias, *sigmas)))


def _check_places(
    name: str, xy: np.ndarray, radius: np.ndarray, walls: np.ndarray | None, obstacles: list, assign: np.ndarray, slack: float
) -> None:
    """Starts or goals, in scenario units, lie apart, inside the walls and outside the obstacles; they may touch."""

    def field(index: int) -> str:
        listed = np.flatnonzero(assign == index + 1)
        return f"goals[{listed[0]}]" if name == "goal" and len(listed) else f"robots[{index}].{name}"

    pair = geometry.first_overlap(xy, radius, slack)
    if pair is not None:
        first, second = pair
        gap = float(np.hypot(*(xy[first] - xy[second])))
        raise StressbotError(
            ErrorCode.STARTS_OVERLAP if name == "start" else ErrorCode.GOALS_TOO_CLOSE,
            field(second),
            f"is {gap:g} from {field(first)}, the bodies need {radius[first] + radius[second]:g}: move them apart",
        )
    if walls is not None:
        out = geometry.outside_walls(xy, radius, walls, slack)
        if out.any():
            index = int(np.argmax(out))
            raise StressbotError(
                ErrorCode.OUTSIDE_WORKSPACE,
                field(index),
                f"the body of radius {radius[index]:g} at {_point(xy[index])} reaches beyond the walls "
                f"x {walls[:2].tolist()}, y {walls[2:].tolist()}: move it inside",
            )
    hits = []
    for number, obstacle in enumerate(obstacles):
        if isinstance(obstacle, Circle):
            hit = geometry.inside_circle(xy, radius, obstacle.center, obstacle.radius, slack)
        else:
            hit = geometry.inside_polygon(xy, radius, obstacle.corners, slack)
        if hit.any():
            hits.append((int(np.argmax(hit)), number))
    if hits:
        index, number = min(hits)
        raise StressbotError(
            ErrorCode.INSIDE_OBSTACLE,
            field(index),
            f"the body of radius {radius[index]:g} at {_point(xy[index])} overlaps obstacles[{number}]: move it away",
        )


def _drive(given: str | dict[str, Any], speed: np.ndarray, unit: float) -> Pulses | None:
    """For robots of these speeds [m/s]: frequency x step = speed."""
    if given == "constant":
        return None
    values = {**PULSE_DEFAULTS, **(given if isinstance(given, dict) else {})}
    if "step_length" in values:
        needed = speed / (unit * _per_robot(values["step_length"], len(speed), "electrical.drive.step_length"))
        frequency = float(values.get("frequency", needed[0]))
        apart = np.abs(needed - frequency) > COMMON * frequency
        if apart.any():
            index = int(np.argmax(apart))
            raise StressbotError(
                ErrorCode.NO_COMMON_FREQUENCY,
                "electrical.drive.step_length",
                f"needs {needed[index]:g} Hz for the speed of robot {index + 1} and {frequency:g} Hz otherwise: "
                "let speed = step_length x frequency, with one frequency for all",
            )
    else:
        frequency = float(values.get("frequency", speed.max() / STEP))
    alternating = values["polarity"] == "alternating"
    return Pulses(float(values["low_level"]), frequency, float(values["duty"]), alternating, float(values["response"]))


def _check_pulses(drive: Pulses, values: dict[str, Any]) -> None:
    if not drive.low_level > values["release"]:
        raise _range("drive.low_level", f"is {drive.low_level:g} V: arms rise at release ({values['release']:g} V), give more")
    if drive.alternating and values["rest_level"] != 0.0:
        raise _range("rest_level", f"is {values['rest_level']:g} V: pulses of alternating polarity need rest at 0 V")
    if drive.alternating and not values["min_level"] <= -values["drive_level"]:
        raise _range("min_level", f"is {values['min_level']:g} V: alternating pulses reach -{values['drive_level']:g} V")
    if not drive.response <= values["min_dwell"]:
        raise _range("drive.response", f"is {drive.response:g} s: must not exceed min_dwell ({values['min_dwell']:g} s)")
    if not drive.frequency >= SLOWEST_PULSES:
        raise _range("drive.frequency", f"is {drive.frequency:g} Hz: the least is {SLOWEST_PULSES:g} Hz, shorten the step_length")
    shorter = min(drive.duty, 1.0 - drive.duty)
    if shorter / drive.frequency < drive.response:
        raise _range(
            "drive.frequency",
            f"is {drive.frequency:g} Hz: a pulse is high or low for only {shorter / drive.frequency:g} s and robots answer to "
            f"{drive.response:g} s; the most is {shorter / drive.response:g} Hz: lengthen the step_length, or lower the speed",
        )


def _pull_downs(given: dict[str, Any], groups: str | list, count: int) -> np.ndarray:
    """The levels [V] at which the arms of robots come down, if each has its own; (0,) if not."""
    listed = given.get("pull_down")
    if not isinstance(listed, list):
        if groups == BY_LEVEL:
            raise _range("pull_down", "is one level, and groups are by_level: list a level for each robot")
        return np.empty(0)
    pull_downs = _per_robot(listed, count, "electrical.pull_down")
    if groups != BY_LEVEL and list(groups) != by_level(pull_downs):
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "swarm.groups", f"are not what the levels of electrical.pull_down select: write {BY_LEVEL}"
        )
    for name in ("symbol_levels", "codes"):
        if name in given:
            raise _range(name, "follow from pull_down, which lists a level for each robot: leave them out")
    return pull_downs


def _electrical(
    given: dict[str, Any], speed: np.ndarray, unit: float, group_count: int, pull_downs: np.ndarray
) -> Electrical:
    values = {**ELECTRICAL_DEFAULTS, **given}
    drive = _drive(values["drive"], speed, unit)
    symbols = _array(values["symbol_levels"])
    if len(pull_downs):
        values["pull_down"], values["codes"] = float(pull_downs.min()), [[index] for index in range(group_count)]
        symbols = np.empty(0)
    low = {} if drive is None else {"drive.low_level": drive.low_level}
    ladder = np.array([values["rest_level"], *symbols, values["reset_level"], *low.values(), values["drive_level"]], dtype=float)
    names = ["rest_level", *(f"symbol_levels[{s}]" for s in range(len(symbols))), "reset_level", *low, "drive_level"]
    for k in range(1, len(ladder)):
        if not ladder[k] > ladder[k - 1]:
            raise _range(names[k], f"is {ladder[k]:g} V: must be above {names[k - 1]} ({ladder[k - 1]:g} V)")
    if not values["min_level"] <= ladder[0]:
        raise _range("min_level", f"is {values['min_level']:g} V: must not exceed rest_level ({ladder[0]:g} V)")
    if not values["max_level"] >= ladder[-1]:
        raise _range("max_level", f"is {values['max_level']:g} V: must reach drive_level ({ladder[-1]:g} V)")

    midpoints = 0.5 * (ladder[1:] + ladder[:-1])
    thresholds = _array(values["thresholds"]) if "thresholds" in values else midpoints
    if len(thresholds) != len(midpoints):
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "electrical.thresholds",
            f"{len(thresholds)} thresholds for {len(ladder)} levels: give {len(midpoints)}, one between neighbours",
        )
    half = 0.5 * float(values["hysteresis"])
    for k, threshold in enumerate(thresholds):
        if not (ladder[k] < threshold - half and threshold + half < ladder[k + 1]):
            name = "hysteresis" if threshold == midpoints[k] else f"thresholds[{k}]"
            raise _range(
                name,
                f"the threshold {threshold:g} V ± {half:g} V must lie between {names[k]} ({ladder[k]:g} V) "
                f"and {names[k + 1]} ({ladder[k + 1]:g} V)",
            )

    if not ladder[0] <= values["release"]:
        raise _range("release", f"is {values['release']:g} V: below rest_level ({ladder[0]:g} V) no arm would rise")
    if not values["release"] < values["pull_down"]:
        raise _range("pull_down", f"is {values['pull_down']:g} V: must be above release ({values['release']:g} V)")
    if len(pull_downs):
        symbols = _check_levels(pull_downs, values, drive)
    elif not values["pull_down"] <= ladder[-1]:
        raise _range("pull_down", f"is {values['pull_down']:g} V: above drive_level ({ladder[-1]:g} V) no arm would come down")
    if drive is not None:
        _check_pulses(drive, values)
    for name in ("reset_dwell", "symbol_dwell"):
        if values[name] < values["min_dwell"]:
            raise _range(name, f"is {values[name]:g} s: a PFSM ignores less than min_dwell ({values['min_dwell']:g} s)")

    shortest = default_codes(group_count, len(symbols))
    codes = values.get("codes", shortest)
    if codes == CHECKED:
        codes = checked_codes(shortest, len(symbols))
    _check_codes(codes, group_count, len(symbols))
    scalars = {name: float(values[name]) for name in ELECTRICAL_DEFAULTS if name not in ("symbol_levels", "drive")}
    return Electrical(
        symbol_levels=_frozen(symbols),
        pull_downs=_frozen(pull_downs),
        thresholds=_frozen(thresholds),
        codes=_frozen(np.array(codes, dtype=np.uint8)),
        drive=drive,
        **scalars,
    )


def _check_levels(pull_downs: np.ndarray, values: dict[str, Any], drive: Pulses | None) -> np.ndarray:
    """The levels [V] (m,) that select the groups, if there is room for them."""
    if drive is None:
        raise _range("drive", "is constant: robots whose arms come down at levels of their own need pulses")
    if not pull_downs.min() > values["drive_level"]:
        raise _range("pull_down", f"has {pull_downs.min():g} V: where each has its own, arms stay up at drive_level "
                     f"({values['drive_level']:g} V), give more")
    levels = control_levels(pull_downs, values["drive_level"])
    if len(levels) > MOST_LEVELS:
        raise _range("pull_down", f"has {len(levels) - 1} different levels: give at most {MOST_LEVELS - 1}")
    if not levels[-1] <= values["max_level"]:
        raise _range("max_level", f"is {values['max_level']:g} V: bringing all arms down takes {levels[-1]:g} V")
    if drive.alternating and not values["min_level"] <= -levels[-1]:
        raise _range("min_level", f"is {values['min_level']:g} V: bringing all arms down takes -{levels[-1]:g} V, too")
    return levels


def _check_codes(codes: list[list[int]], group_count: int, symbol_count: int) -> None:
    owner: dict[tuple, int] = {}
    for index, code in enumerate(codes):
        field = f"codes[{index}]"
        if len(code) != len(codes[0]):
            raise StressbotError(ErrorCode.WRONG_COUNT, f"electrical.{field}", "every code needs the same number of symbols")
        if max(code) >= symbol_count:
            raise _range(field, f"symbol {max(code):g} does not exist: {symbol_count} levels are symbols 0 to {symbol_count - 1}")
        if tuple(code) in owner:
            raise _range(field, f"equals codes[{owner[tuple(code)]}], so one code selects two groups: change one")
        owner[tuple(code)] = index
    if len(codes) != group_count:
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "electrical.codes",
            f"{len(codes)} codes for {group_count} groups: give one per group, the all-rotate group last",
        )


def _walls(workspace: dict[str, list] | None) -> np.ndarray | None:
    if workspace is None:
        return None
    for axis in ("x", "y"):
        low, high = workspace[axis]
        if not low < high:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, f"workspace.{axis}", f"is [{low:g}, {high:g}]: the first must be the smaller"
            )
    return _array([*workspace["x"], *workspace["y"]])


def _obstacle(entry: dict[str, Any], index: int) -> Circle | Polygon:
    if "circle" in entry:
        return Circle(center=_array(entry["circle"]["center"]), radius=float(entry["circle"]["radius"]))
    corners = _array(entry["polygon"])
    if not geometry.is_simple(corners):
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE,
            f"obstacles[{index}].polygon",
            f"its sides must be {geometry.SHORTEST_SIDE:g} long or longer, and meet only at corners: put the corners in order",
        )
    return Polygon(corners=corners)


def _scaled(obstacle: Circle | Polygon, unit: float) -> Circle | Polygon:
    if isinstance(obstacle, Circle):
        return Circle(center=_frozen(obstacle.center * unit), radius=obstacle.radius * unit)
    return Polygon(corners=_frozen(obstacle.corners * unit))


def _digest(fields: dict[str, Any]) -> str:
    """16 hex digits of the sha256 of the canonical content: equal benches, equal ids, on every machine."""

    def plain(value: Any) -> Any:
        if isinstance(value, (np.ndarray, tuple)):
            return [plain(item) for item in value] if isinstance(value, tuple) else value.tolist()
        if isinstance(value, (Electrical, Pulses, Circle, Polygon, Calibration)):
            return {key: plain(item) for key, item in vars(value).items()}
        return value

    text = json.dumps({key: plain(value) for key, value in fields.items()}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("utf-8")).hexdigest()[:16]


def _per_robot(value: float | list[float], count: int, field: str) -> np.ndarray:
    if isinstance(value, list):
        if len(value) != count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT,
                field,
                f"{len(value)} values for {count} robots: give one number for all, or one per robot",
            )
        return _array(value)
    return np.full(count, float(value))


def _range(name: str, message: str) -> StressbotError:
    return StressbotError(ErrorCode.OUT_OF_RANGE, f"electrical.{name}", message)


def _point(xy: np.ndarray) -> str:
    return f"({xy[0]:g}, {xy[1]:g})"


def _array(values: Any) -> np.ndarray:
    return np.array(values, dtype=float)


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
