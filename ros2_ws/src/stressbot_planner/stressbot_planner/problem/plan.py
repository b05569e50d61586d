"""Plans and results: immutable values that say what they cost, or why there is none."""

from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from stressbot_planner.collision.clearance import Clearance, Shapes, clearance_of
from stressbot_planner.errors import ErrorCode
from stressbot_planner.model.kinematics import execution_time, path_length, replay
from stressbot_planner.model.swarm import frozen_array
from stressbot_planner.primitives.expansion import Primitive, expand
from stressbot_planner.problem.definition import Problem


class Arrival(NamedTuple):
    """Of all robots at their waypoints of one stage.

    Attributes:
        activations: number of those before it.
        time: driving time before it, s.
        error: largest distance of a robot from its waypoint, units.
        is_there: whether that is within the tolerance.
    """

    activations: int
    time: float
    error: float
    is_there: bool


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
        poses = replay(self.problem.swarm, self.problem.starts, self.groups, self.lengths)
        poses.flags.writeable = False
        return poses

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

    @property
    def heading_error(self) -> float:
        """Largest difference of a robot's heading from that at its goal at the end, rad; 0 where all are free."""
        return self.problem.heading_error(self.poses[-1, :, 2])

    @cached_property
    def arrivals(self) -> tuple[Arrival, ...]:
        """When all robots are at their waypoints first, stage by stage; of a stage that they miss, when they are nearest."""
        found, begin = [], 0
        for waypoints in self.problem.waypoints:
            away = self.poses[begin:, :, :2] - waypoints
            errors = np.hypot(away[:, :, 0], away[:, :, 1]).max(axis=1)
            there = errors <= self.problem.tolerance + self.problem.slack
            nearest = int(np.argmax(there) if there.any() else np.argmin(errors))
            begin += nearest
            time = execution_time(self.problem.swarm, self.lengths[:begin])
            found.append(Arrival(begin, time, float(errors[nearest]), bool(there.any())))
        return tuple(found)

    @property
    def straying(self) -> list[int]:
        """Parked robots, by number, that slide all the same."""
        driven = np.any(self.problem.swarm.membership[self.groups[self.lengths > 0] - 1], axis=0)
        return [row + 1 for row in self.problem.parked if driven[row]]

    @cached_property
    def clearance(self) -> Clearance:
        """Smallest gap along the whole motion."""
        return clearance_of(self.problem.swarm, Shapes.of(self.problem.environment), self.poses, self.groups, self.lengths)

    @property
    def valid(self) -> bool:
        """Whether no bodies overlap at any time and every robot ends within tolerance of its goal, but for round-off."""
        is_there = self.goal_error <= self.problem.tolerance + self.problem.slack
        is_turned = self.heading_error <= self.problem.heading_tolerance
        return self.keeps(0.0) and is_there and is_turned and not self.straying and all(one.is_there for one in self.arrivals)

    @cached_property
    def clearance_of_others(self) -> Clearance:
        """Smallest gap along the whole motion, those of robots in contact left out."""
        problem = self.problem
        if not problem.contacts:
            return self.clearance
        shapes = Shapes.of(problem.environment)
        return clearance_of(problem.swarm, shapes, self.poses, self.groups, self.lengths, problem.credit(np.inf))

    @property
    def account(self) -> str:
        """What is checked, in words: clearance, and how far robots are from what they shall do."""
        words = f"clearance {self.clearance}, goal error {self.goal_error:.3g} units (tolerance {self.problem.tolerance:.3g} units)"
        if self.problem.contacts:
            words += f", without contacts {self.clearance_of_others}"
        if len(self.problem.headed):
            words += f", heading error {self.heading_error:.3g} rad"
        words += "".join(
            f", waypoint {stage} missed by {one.error:.3g} units" for stage, one in enumerate(self.arrivals, 1) if not one.is_there
        )
        return words + "".join(f", robot {robot} is parked and slides" for robot in self.straying)

    def keeps(self, gap: float) -> bool:
        """Return whether all gaps are at least gap, but for round-off: bodies may touch those that are larger by it.

        Robots in contact overlap by no more than `contact_depth`.
        """
        least = -self.problem.contact_depth if self.problem.contacts else gap
        return self.clearance.gap >= least - self.problem.slack and self.clearance_of_others.gap >= gap - self.problem.slack


@dataclass(frozen=True, eq=False, kw_only=True)
class _Attempt:
    planner: str
    seed: int
    planning_time: float
    history: tuple[tuple[float, float, float], ...] = ()
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved(_Attempt):
    """A planner has found a valid plan.

    Attributes:
        planner: its name.
        seed: of its random generator.
        plan: the best one.
        planning_time: s.
        history: improvements, as (seconds, path length, execution time).
        details: figures of this planner (iterations, nodes, …).
        success, code, reason: True, NONE and empty, see `Failed`.
    """

    plan: Plan
    success: ClassVar[Literal[True]] = True
    code: ClassVar[ErrorCode] = ErrorCode.NONE
    reason: ClassVar[str] = ""

    def _repr_html_(self) -> str:
        """Figures as a table, for notebooks."""
        return _table(self, {}, self.plan)


@dataclass(frozen=True, eq=False, kw_only=True)
class Failed(_Attempt):
    """A planner has found no valid plan.

    Attributes:
        plan: the closest attempt, or None.
        success: False.
        code: NO_PLAN_FOUND or INFEASIBLE.
        reason: why there is no valid plan.

    The others are those of `Solved`.
    """

    plan: Plan | None
    code: ErrorCode
    reason: str
    success: ClassVar[Literal[False]] = False

    def _repr_html_(self) -> str:
        """Figures of the closest attempt as a table, for notebooks."""
        return _table(self, {"no plan": self.reason}, self.plan)


Result = Solved | Failed
"""What a planner returns."""


def _table(attempt: _Attempt, more: dict[str, str], plan: Plan | None) -> str:
    rows = {"planner": attempt.planner, "planning time": f"{attempt.planning_time:.2f} s"} | more
    if plan is not None:
        bounds = plan.problem.lower_bounds
        rows |= {
            "path": f"{plan.path_length:.2f} units (at least {bounds.path_length:.2f})",
            "driving": f"{plan.execution_time:.2f} s (at least {bounds.execution_time:.2f})",
            "activations": str(len(plan.groups)),
            "clearance": str(plan.clearance),
            "goal error": f"{plan.goal_error:.2g} units",
        }
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
    return f"<table>{''.join(cells)}</table>"
