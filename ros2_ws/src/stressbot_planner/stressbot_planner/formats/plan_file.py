"""Plan files: JSON in and out. See docs/plan-file.md."""

import json
from dataclasses import MISSING, dataclass, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
from stressbot_msgs.scenario_text import read_regular
from stressbot_msgs.wording import quoted

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.primitives.expansion import Primitive
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan, Result
from stressbot_planner.sequencing import expand_bounded
from stressbot_planner.system import files

MAX_BYTES = 256_000_000
"""Of a plan file: millions of activations."""

LONGEST_NAME = 200
"""Characters of a planner's name."""


def primitive_to_dict(primitive: Primitive) -> dict[str, Any]:
    """Return a primitive as plain data; an unlimited excursion is left out."""
    data: dict[str, Any] = {"kind": type(primitive).__name__}
    for name, value in vars(primitive).items():
        if name == "excursion" and np.isinf(value):
            continue
        data[name] = list(value) if isinstance(value, tuple) else value
    return data


def plan_file(result: Result, scenario: str, selection_time: float) -> dict[str, Any]:
    """Return the content of a plan file.

    Args:
        result: of a planner.
        scenario: name of the scenario.
        selection_time: time that the selection of one group takes, s.
    """
    plan = result.plan
    data: dict[str, Any] = {
        "scenario": scenario,
        "planner": result.planner,
        "seed": result.seed,
        "success": result.success,
        "reason": result.reason,
        "planning_time": result.planning_time,
    }
    if plan is not None:
        if plan.problem.exchangeable:
            data["goals"] = plan.problem.goals.tolist()
        groups, lengths = plan.groups.tolist(), plan.lengths.tolist()
        gap = plan.clearance.gap
        data |= {
            "primitives": [primitive_to_dict(primitive) for primitive in plan.primitives],
            "activations": [list(pair) for pair in zip(groups, lengths, strict=True)],
            "path_length": plan.path_length,
            "execution_time": plan.execution_time,
            "selection_time": selection_time * len(groups),
            "min_clearance": gap if np.isfinite(gap) else None,
            "min_clearance_at": str(plan.clearance),
            "goal_error": plan.goal_error,
            "tolerance": plan.problem.tolerance,
            **_headings(plan),
            **_stages(plan),
            **_contacts(plan),
            "lower_bounds": plan.problem.lower_bounds._asdict(),
        }
    else:
        data |= {"primitives": [], "activations": []}
    if result.history:
        data["history"] = [list(entry) for entry in result.history]
    if result.details:
        data["details"] = result.details
    return data


def _headings(plan: Plan) -> dict[str, float]:
    if not len(plan.problem.headed):
        return {}
    return {"heading_error": plan.heading_error, "heading_tolerance": plan.problem.heading_tolerance}


def _stages(plan: Plan) -> dict[str, list[dict[str, Any]]]:
    if not len(plan.problem.waypoints):
        return {}
    names = ("activations", "time", "error")
    return {"waypoints": [{name: getattr(arrival, name) for name in names} for arrival in plan.arrivals]}


def _contacts(plan: Plan) -> dict[str, float | None]:
    if not plan.problem.contacts:
        return {}
    gap = plan.clearance_of_others.gap
    return {"min_clearance_of_others": gap if np.isfinite(gap) else None}


def plan_text(data: dict[str, Any]) -> str:
    """Return the text of a plan file."""
    return json.dumps(data, indent=1, allow_nan=False, default=lambda value: value.tolist()) + "\n"  # what is numpy's


def write_plan_file(path: Path, data: dict[str, Any]) -> None:
    """Write a plan file.

    Raises:
        StressbotError: UNREADABLE_FILE if it cannot be written.
    """
    files.write_text(path, plan_text(data))


@dataclass(frozen=True, eq=False)
class StoredPlan:
    """What a plan file holds. Figures are not taken over: they follow from the primitives.

    Attributes:
        planner: its name.
        seed: of its random generator.
        success: whether the planner called the plan valid.
        plan: from the problem's starts; of a failure, the closest attempt.
    """

    planner: str
    seed: int
    success: bool
    plan: Plan


def read_plan_file(path: str | Path, problem: Problem, scenario: str) -> StoredPlan:
    """Read a plan file that was made for a problem.

    Args:
        path: of the file.
        problem: that of the scenario; the plan's has the goals that the file assigns to exchangeable robots, and the tolerance
            that the plan was made with.
        scenario: name of the scenario.

    Raises:
        StressbotError: with the field and what to change: the file cannot be read, departs from the format, belongs to
            another scenario, or its activations are not those of its primitives.
    """
    try:
        content = read_regular(path, MAX_BYTES)
        text = content.decode("utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or ("is not UTF-8 text" if isinstance(error, UnicodeError) else str(error))
        raise StressbotError(ErrorCode.UNREADABLE_FILE, f"plan file {path}", reason) from error
    if len(content) > MAX_BYTES:
        raise StressbotError(ErrorCode.MALFORMED_FILE, f"plan file {path}", f"has more than {MAX_BYTES} bytes: is it one?")
    try:
        data = json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        where = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else "plan file"
        reason = error.msg if isinstance(error, json.JSONDecodeError) else "holds something that is not JSON"
        raise StressbotError(ErrorCode.MALFORMED_FILE, where, f"{reason}: is the file complete?") from error
    if not isinstance(data, dict):
        raise StressbotError(ErrorCode.MALFORMED_FILE, "plan file", "must be an object with scenario, primitives, …")
    return _stored_plan(data, problem, scenario)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        twice = next(key for k, (key, _) in enumerate(pairs) if key in dict(pairs[:k]))
        raise StressbotError(ErrorCode.MALFORMED_FILE, "plan file", f"has the key {quoted(twice)} twice: keep one")
    return data


def _stored_plan(data: dict[str, Any], problem: Problem, scenario: str) -> StoredPlan:
    wanted = {"scenario": str, "planner": str, "seed": int, "success": bool, "primitives": list, "activations": list}
    for key, kind in wanted.items():
        if key not in data:
            raise StressbotError(ErrorCode.MISSING_FIELD, key, "is missing: add it")
        _check_type(key, data[key], kind)
    if not data["planner"].isprintable() or len(data["planner"]) > LONGEST_NAME:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "planner", f"is {quoted(data['planner'])}: give at most {LONGEST_NAME} printable characters"
        )
    if data["scenario"] != scenario:
        raise StressbotError(
            ErrorCode.WRONG_SWARM, "scenario", f"is '{data['scenario']}', not '{scenario}': give the scenario of this plan"
        )
    if "goals" in data:
        problem = replace(problem, goals=_goals(data["goals"], problem))
    for name in ("tolerance", "heading_tolerance"):
        if name in data:
            _check_type(name, data[name], float)
            if data[name] <= 0:
                raise StressbotError(ErrorCode.OUT_OF_RANGE, name, f"is {data[name]}: give more than 0")
            problem = replace(problem, **{name: float(data[name])})
    primitives = [_primitive(f"primitives[{index}]", item) for index, item in enumerate(data["primitives"])]
    expand_bounded(problem.swarm, primitives)
    plan = Plan(problem, tuple(primitives))
    groups, lengths = _activations(data["activations"], problem.swarm.m)
    if not np.array_equal(groups, plan.groups) or not np.allclose(lengths, plan.lengths, rtol=1e-9, atol=1e-12):
        raise StressbotError(
            ErrorCode.INVALID_PLAN, "activations", "are not those that the primitives expand to: make the plan again"
        )
    return StoredPlan(data["planner"], data["seed"], data["success"], plan)


def _goals(items: Any, problem: Problem) -> np.ndarray:
    """Return the goals (n, 2) of a plan file, which are the problem's, exchanged among exchangeable robots."""
    _check_type("goals", items, list)
    if len(items) != problem.swarm.n:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "goals", f"has {len(items)} entries for {problem.swarm.n} robots: give one each"
        )
    for index, item in enumerate(items):
        _check_type(f"goals[{index}]", item, list)
        if len(item) != 2:
            raise StressbotError(ErrorCode.WRONG_COUNT, f"goals[{index}]", f"has {len(item)} entries: give x and y")
        for axis, value in enumerate(item):
            _check_type(f"goals[{index}][{axis}]", value, float)
    goals = np.array(items, dtype=float)
    free = list(problem.exchangeable)
    kept = np.delete(goals, free, axis=0), np.delete(problem.goals, free, axis=0)
    if not np.array_equal(*kept) or sorted(goals[free].tolist()) != sorted(problem.goals[free].tolist()):
        raise StressbotError(
            ErrorCode.INVALID_PLAN,
            "goals",
            "are not those of the scenario, exchanged among robots with goal: assign: make the plan again",
        )
    return goals


def _activations(items: list, m: int) -> tuple[np.ndarray, np.ndarray]:
    for index, item in enumerate(items):
        place = f"activations[{index}]"
        _check_type(place, item, list)
        if len(item) != 2:
            raise StressbotError(ErrorCode.WRONG_COUNT, place, f"has {len(item)} entries: give group and length")
        _check_type(f"{place}[0]", item[0], int)
        _check_type(f"{place}[1]", item[1], float)
        if not 1 <= item[0] <= m:
            raise StressbotError(ErrorCode.UNKNOWN_GROUP, f"{place}[0]", f"is {item[0]}: use 1 to {m}")
        if item[1] < 0:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, f"{place}[1]", f"is {item[1]}: give 0 or more")
    return np.array([item[0] for item in items], dtype=np.int64), np.array([item[1] for item in items], dtype=float)


_KINDS = {kind.__name__: kind for kind in get_args(Primitive)}


def _primitive(place: str, item: Any) -> Primitive:
    """Return a primitive from plain data, the inverse of `primitive_to_dict`."""
    _check_type(place, item, dict)
    name = item.get("kind")
    if not isinstance(name, str) or name not in _KINDS:
        raise StressbotError(ErrorCode.INVALID_PLAN, f"{place}.kind", f"is {name!r}: use one of {', '.join(_KINDS)}")
    known = {entry.name: entry for entry in fields(_KINDS[name])}
    unknown = next((key for key in item if key not in known and key != "kind"), None)
    if unknown is not None:
        raise StressbotError(ErrorCode.UNKNOWN_FIELD, f"{place}.{unknown}", f"is unknown here: use one of {', '.join(known)}")
    values = {}
    for key, entry in known.items():
        if key not in item:
            if entry.default is MISSING:
                raise StressbotError(ErrorCode.MISSING_FIELD, f"{place}.{key}", "is missing: add it")
            continue
        if get_origin(entry.type) is tuple:
            _check_type(f"{place}.{key}", item[key], list)
            for position, value in enumerate(item[key]):
                _check_type(f"{place}.{key}[{position}]", value, get_args(entry.type)[0])
            values[key] = tuple(item[key])
        else:
            kind: Any = entry.type  # no module of primitives postpones its annotations
            _check_type(f"{place}.{key}", item[key], kind)
            values[key] = item[key]
    return _KINDS[name](**values)


_TYPE_NAMES = {str: "string", int: "whole number", float: "number", bool: "true or false", list: "list", dict: "object"}


def _check_type(place: str, value: Any, kind: type) -> None:
    right = isinstance(value, (int, float) if kind is float else kind) and (kind is bool or not isinstance(value, bool))
    if not right:
        shown = repr(value) if len(repr(value)) <= 40 else type(value).__name__
        raise StressbotError(ErrorCode.WRONG_TYPE, place, f"is {shown}: give a {_TYPE_NAMES[kind]}")
    if isinstance(value, int) and value.bit_length() > 62 or isinstance(value, float) and not isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, place, f"is {float('inf') if isinstance(value, int) else value}: "
                             "give a finite number")
