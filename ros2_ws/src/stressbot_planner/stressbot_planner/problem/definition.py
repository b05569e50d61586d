"""A motion planning problem: from poses to positions, among obstacles and each other."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stressbot_planner.collision.clearance import environment_clearances, touching_slack
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import LARGEST, Remade, Swarm, check_coordinates, check_positive, frozen_array
from stressbot_planner.problem.bounds import LowerBounds, lower_bounds
from stressbot_planner.system.fields import FrozenArray

EXACT = 1e-6
"""Goal radius, units, that counts as exact."""


@dataclass(frozen=True, eq=False)
class Problem(Remade):
    """Positions to reach; headings at the goal are free (paper, section "Motion Planning").

    Attributes:
        swarm: the robots.
        environment: walls and obstacles.
        starts: poses x, y, heading, shape (n, 3), units and rad.
        goals: positions, shape (n, 2), units.
        tolerance: radius around a goal that counts as reached, units.
        exchangeable: rows, ascending, of robots that may take each other's goals. Planners take goals as they stand;
            `assignment.assigned` exchanges them before.

    Raises:
        StressbotError: starts or goals that no plan could have; the field is named as in the scenario file.
    """

    swarm: Swarm
    environment: Environment
    starts: FrozenArray
    goals: FrozenArray
    tolerance: float = EXACT
    exchangeable: tuple[int, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "starts", frozen_array(self.starts))
        object.__setattr__(self, "goals", frozen_array(self.goals))
        check_positive("tolerance", self.tolerance)
        for name, values, shape in (("start", self.starts, (self.swarm.n, 3)), ("goal", self.goals, (self.swarm.n, 2))):
            if values.shape != shape:
                raise StressbotError(
                    ErrorCode.WRONG_COUNT, name, f"has shape {values.shape}: give one row per robot, shape {shape}"
                )
            for k in np.flatnonzero(~np.all(np.abs(values) <= LARGEST, axis=1))[:1]:
                check_coordinates(self._field(name, k), values[k])
        self._check_places("start", self.starts[:, :2], ErrorCode.STARTS_OVERLAP)
        self._check_places("goal", self.goals, ErrorCode.GOALS_TOO_CLOSE)

    @cached_property
    def slack(self) -> float:
        """By how much a gap may be below zero, units: then bodies touch (see `collision.touching_slack`)."""
        return touching_slack(self.swarm.body_radius, self.environment, np.vstack([self.starts[:, :2], self.goals]))

    @cached_property
    def lower_bounds(self) -> LowerBounds:
        """Linear-program bounds on path length and driving time."""
        return lower_bounds(self.swarm, self.starts, self.goals, self.tolerance)

    def goal_error(self, positions: np.ndarray) -> float:
        """Return the largest distance of positions (n, 2) from the goals, units."""
        return float(np.max(np.hypot(*(positions - self.goals).T)))

    def _check_places(self, name: str, positions: np.ndarray, too_close: ErrorCode) -> None:
        radius = self.swarm.body_radius
        for j in range(1, len(positions)):  # row by row: there may be millions of overlapping pairs
            gaps = np.hypot(*(positions[:j] - positions[j]).T) - radius[:j] - radius[j]
            i = int(np.argmin(gaps))
            if gaps[i] >= -self.slack:
                continue
            raise StressbotError(
                too_close,
                self._field(name, j),
                f"is {np.hypot(*(positions[i] - positions[j])):.4g} units from {self._other(name, i)}: "
                f"the two bodies need {radius[i] + radius[j]:.4g} units, {-gaps[i]:.2g} units more",
            )
        walls, obstacles = Environment(self.environment.workspace), Environment(None, self.environment.obstacles)
        for code, environment in ((ErrorCode.OUTSIDE_WORKSPACE, walls), (ErrorCode.INSIDE_OBSTACLE, obstacles)):
            for k, found in enumerate(environment_clearances(self.swarm, environment, positions)):
                if found.gap < -self.slack:
                    raise StressbotError(
                        code,
                        self._field(name, k),
                        f"at x {positions[k][0]:.6g} units, y {positions[k][1]:.6g} units puts a body of radius {radius[k]:.4g} "
                        f"units by {-found.gap:.4g} units into {found.other}: move the {name} or the {found.other.split('[')[0]}",
                    )

    def _field(self, name: str, row: int) -> str:
        if name == "goal" and row in self.exchangeable:
            return f"goals[{self.exchangeable.index(row)}]"
        return f"robots[{row}].{name}"

    def _other(self, name: str, row: int) -> str:
        field = self._field(name, row)
        return field if field.startswith("goals") else f"the {name} of robot {row + 1}"
