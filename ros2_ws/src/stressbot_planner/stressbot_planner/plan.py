"""Plans and results: immutable values that say what they cost, or why there is none."""

import json
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from stressbot_planner.collision import Clearance, clearance
from stressbot_planner.errors import ErrorCode
from stressbot_planner.kinematics import execution_time, path_length, replay
from stressbot_planner.primitives import Primitive, expand
from stressbot_planner.problem import Problem
from stressbot_planner.swarm import frozen_array


@dataclass(frozen=True, eq=False)
class Plan:
    """Primitives from a problem's starts; everything else follows from them in closed form."""

    problem: Problem
    primitives: tuple[Primitive, ...]

    @cached_property
    def _activations(self) -> tuple[np.ndarray, np.ndarray]:
        groups, lengths = expand(self.problem.swarm, self.primitives)
        return frozen_array(groups, dtype=np.int64), frozen_array(lengths)

    @property
    def groups(self) -> np.ndarray:
        """Group of each activation, shape (K,), 1..m."""
        return self._activations[0]

    @property
    def lengths(self) -> np.ndarray:
        """Length of each activation, shape (K,), units."""
        return self._activations[1]

    @cached_property
    def poses(self) -> np.ndarray:
        """Poses before the first and after each activation, shape (K + 1, n, 3)."""
        return frozen_array(replay(self.problem.swarm, self.problem.starts, self.groups, self.lengths))

    @property
    def path_length(self) -> float:
        """Distance that robots slide, summed over robots, units."""
        return path_length(self.problem.swarm, self.groups, self.lengths)

    @property
    def execution_time(self) -> float:
        """Driving time, s, without the selection of groups."""
        return execution_time(self.problem.swarm, self.lengths)

    @property
    def goal_error(self) -> float:
        """Largest distance of a robot from its goal at the end, units."""
        return self.problem.goal_error(self.poses[-1, :, :2])

    @cached_property
    def clearance(self) -> Clearance:
        """Smallest gap along the whole motion."""
        return clearance(
            self.problem.swarm, self.problem.environment, self.problem.starts, self.groups, self.lengths
        )

    @property
    def valid(self) -> bool:
        """Whether no bodies overlap at any time and every robot ends within tolerance of its goal."""
        return self.clearance.gap >= 0 and self.goal_error <= self.problem.tolerance


@dataclass(frozen=True, eq=False)
class Result:
    """What a planner returns.

    Attributes:
        planner: its name.
        seed: of its random generator.
        plan: the best plan; if not `success`, the closest attempt, or None.
        success: whether the plan is valid.
        code: NONE, NO_PLAN_FOUND or INFEASIBLE.
        reason: why there is no valid plan; empty on success.
        planning_time: s.
        history: improvements, as (seconds, path length, execution time).
        details: figures of this planner (iterations, nodes, …).
    """

    planner: str
    seed: int
    plan: Plan | None
    success: bool
    code: ErrorCode
    reason: str
    planning_time: float
    history: tuple[tuple[float, float, float], ...] = ()
    details: dict[str, Any] = field(default_factory=dict)


def primitive_to_dict(primitive: Primitive) -> dict[str, Any]:
    """Return a primitive as plain data; an unlimited excursion is left out."""
    data = {"kind": type(primitive).__name__}
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
            "lower_bounds": plan.problem.lower_bounds._asdict(),
        }
    else:
        data |= {"primitives": [], "activations": []}
    if result.history:
        data["history"] = [list(entry) for entry in result.history]
    if result.details:
        data["details"] = result.details
    return data


def write_plan_file(path, data: dict[str, Any]) -> None:
    """Write a plan file as JSON."""
    with open(path, "w", encoding="utf-8") as stream:
        json.dump(data, stream, indent=1, allow_nan=False)
        stream.write("\n")
