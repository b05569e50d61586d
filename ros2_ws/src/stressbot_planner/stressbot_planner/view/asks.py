"""What a page may ask for, checked field by field: whatever else comes is refused in one line."""

import json
import math
from dataclasses import dataclass
from typing import Any

from stressbot_msgs.wording import quoted

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError

LARGEST_MESSAGE = 64 * 1024
"""Bytes; a larger one ends its connection."""

FARTHEST = 1e7
"""µm, ten metres: no goal is meant that lies farther out."""

LONGEST_TOKEN = 200

WORDS = ("stop", "plan", "cancel", "start", "reset", "move", "goal", "goals", "settings")

READ_ONLY = StressbotError(
    ErrorCode.UNSUPPORTED, "page", "is read-only: open the address with the token that stressbot view has printed"
)


@dataclass(frozen=True)
class Chosen:
    """What a plan and a closed loop are asked for with; all pages share them.

    Attributes:
        planner: its name.
        objective: path, time, or the weight of the time.
        tolerance: of a plan, µm; 0: exact.
        time_limit: to plan for, s.
        assign: whether robots may take each other's goals.
        near: of the closed loop, µm.
        patience: of the closed loop, s.
    """

    planner: str = "optimize"
    objective: str = "path"
    tolerance: float = 0.0
    time_limit: float = 5.0
    assign: bool = False
    near: float = 30.0
    patience: float = 600.0


@dataclass(frozen=True)
class Goal:
    """A robot's id and its goal, µm."""

    robot: int
    x: float
    y: float


def read(text: str | bytes) -> dict[str, Any]:
    """Return what a message holds.

    Raises:
        StressbotError: it is no JSON object.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise StressbotError(ErrorCode.MALFORMED_FILE, "message", 'is no JSON object: send one such as {"ask": "stop"}')
    return data


def word(data: dict[str, Any]) -> str:
    """Return what is asked for. Raises StressbotError unless it is one of WORDS."""
    asked = data.get("ask")
    if not isinstance(asked, str) or asked not in WORDS:
        raise StressbotError(ErrorCode.UNKNOWN_FIELD, "ask", f"is {_shown(asked)}: use one of {', '.join(WORDS)}")
    return asked


def token(data: dict[str, Any]) -> str:
    """Return the token of a greeting, empty for a guest. Raises StressbotError if it is no short text."""
    given = data.get("hello")
    if not isinstance(given, str) or len(given) > LONGEST_TOKEN:
        raise StressbotError(ErrorCode.MISSING_FIELD, "hello", 'must come first: {"hello": token}, {"hello": ""} of a guest')
    return given


def goal(data: dict[str, Any]) -> Goal:
    """Return a goal that is asked for. Raises StressbotError, naming the field."""
    robot = data.get("robot")
    if isinstance(robot, bool) or not isinstance(robot, int) or not 0 <= robot < 2**32:
        raise StressbotError(ErrorCode.WRONG_TYPE, "robot", f"is {_shown(robot)}: give the id of a robot")
    return Goal(robot, *(_number(data, name, -FARTHEST, FARTHEST) for name in ("x", "y")))


def settings(data: dict[str, Any]) -> Chosen:
    """Return settings that are asked for, all of them. Raises StressbotError, naming the field."""
    name, objective, assign = data.get("planner"), data.get("objective"), data.get("assign")
    if not isinstance(name, str):
        raise StressbotError(ErrorCode.WRONG_TYPE, "planner", f"is {_shown(name)}: give its name")
    planners.check_known(name)
    if not isinstance(objective, str):
        raise StressbotError(ErrorCode.WRONG_TYPE, "objective", f"is {_shown(objective)}: give path, time or a weight, as text")
    planners.time_weight(objective)
    if not isinstance(assign, bool):
        raise StressbotError(ErrorCode.WRONG_TYPE, "assign", f"is {_shown(assign)}: give true or false")
    return Chosen(
        name,
        objective,
        _number(data, "tolerance", 0.0, FARTHEST),
        _number(data, "time_limit", 0.01, planners.LONGEST_REQUEST),
        assign,
        _number(data, "near", 0.001, FARTHEST),
        _number(data, "patience", 1.0, 86400.0),
    )


def _number(data: dict[str, Any], name: str, low: float, high: float) -> float:
    value = data.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise StressbotError(ErrorCode.WRONG_TYPE, name, f"is {_shown(value)}: give a number")
    if not low <= value <= high:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, name, f"is {_shown(value)}: give {low:g} to {high:g}")
    return float(value)


def _shown(value: Any) -> str:
    return "missing" if value is None else quoted(str(value)) if isinstance(value, str | int | float) else "no such value"
