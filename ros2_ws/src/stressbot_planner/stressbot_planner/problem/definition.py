"""A motion planning problem: from poses to positions, and some headings, among obstacles and each other."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stressbot_planner.collision.clearance import NO_CREDIT, environment_clearances, touching_slack
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.angles import wrapped
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import LARGEST, Remade, Swarm, check_coordinates, check_positive, frozen_array
from stressbot_planner.problem.bounds import LowerBounds, bounds_of_stages, group_lengths, in_all
from stressbot_planner.problem.headings import EXACT_HEADING, dependent
from stressbot_planner.problem.parking import check_parked
from stressbot_planner.problem.turning import Rows, turning_rows
from stressbot_planner.system.fields import FREE, NO_ENTRIES, FrozenArray

EXACT = 1e-6
"""Goal radius, units, that counts as exact."""


@dataclass(frozen=True, eq=False)
class Problem(Remade):
    """Positions to reach; headings at the goal are free (paper, section "Motion Planning"), but for those that are given.

    Attributes:
        swarm: the robots.
        environment: walls and obstacles.
        starts: poses x, y, heading, shape (n, 3), units and rad.
        goals: positions, shape (n, 2), units.
        tolerance: radius around a goal that counts as reached, units.
        exchangeable: rows, ascending, of robots that may take each other's goals. Planners take goals as they stand;
            `assignment.assigned` exchanges them before.
        goal_headings: rad, shape (n,), NaN where the heading at the goal is free.
        heading_tolerance: difference from them that counts as none, rad.
        waypoints: positions where all robots are at a time before they go to their goals, in each of s stages, shape (s, n, 2),
            units.
        contacts: pairs of rows of robots that may touch, whatever gap others keep.
        contact_depth: by which they may overlap, units: no step is shorter than one.
        parked: rows, ascending, of robots that stay where they start, their goal: none of their groups is activated.

    Raises:
        StressbotError: starts or goals that no plan could have; the field is named as in the scenario file.
    """

    swarm: Swarm
    environment: Environment
    starts: FrozenArray
    goals: FrozenArray
    tolerance: float = EXACT
    exchangeable: tuple[int, ...] = ()
    goal_headings: FrozenArray = FREE
    heading_tolerance: float = EXACT_HEADING
    parked: tuple[int, ...] = ()
    waypoints: FrozenArray = NO_ENTRIES
    contacts: tuple[tuple[int, int], ...] = ()
    contact_depth: float = 0.0

    def __post_init__(self):
        object.__setattr__(self, "starts", frozen_array(self.starts))
        object.__setattr__(self, "goals", frozen_array(self.goals))
        waypoints = np.array(self.waypoints, dtype=float)
        waypoints = waypoints if waypoints.size else np.empty((0, self.swarm.n, 2))
        object.__setattr__(self, "waypoints", frozen_array(waypoints))
        check_positive("tolerance", self.tolerance)
        places = self.swarm.n, 2
        stages = [(f"waypoints[{stage}]", values, places) for stage, values in enumerate(self.waypoints)]
        for name, values, shape in (("start", self.starts, (self.swarm.n, 3)), *stages, ("goal", self.goals, places)):
            if values.shape != shape:
                raise StressbotError(
                    ErrorCode.WRONG_COUNT, name, f"has shape {values.shape}: give one row per robot, shape {shape}"
                )
            for k in np.flatnonzero(~np.all(np.abs(values) <= LARGEST, axis=1))[:1]:
                check_coordinates(self._field(name, k), values[k])
        self._check_headings()
        self._check_parked()
        self._check_contacts()
        self._check_places("start", self.starts[:, :2], ErrorCode.STARTS_OVERLAP)
        for name, values, _ in stages:
            self._check_places(name, values, ErrorCode.GOALS_TOO_CLOSE)
        self._check_places("goal", self.goals, ErrorCode.GOALS_TOO_CLOSE)

    @cached_property
    def slack(self) -> float:
        """By how much a gap may be below zero, units: then bodies touch (see `collision.touching_slack`)."""
        return touching_slack(self.swarm.body_radius, self.environment, np.vstack(self.places))

    @cached_property
    def lower_bounds(self) -> LowerBounds:
        """Linear-program bounds on path length and driving time: of goals in stages, their sums."""
        return in_all(self._stages)

    @cached_property
    def turning_time(self) -> float:
        """Bound on driving time, s, by a linear program that knows what robots have to turn to their first goals, too.

        Infinite if they cannot.
        """
        swarm, (start, first, *_) = self.swarm, self.places
        lengths = group_lengths(swarm, start, first, np.ones(swarm.m), self.tolerance, self.parked, self.turning_rows(swarm))
        return float(lengths.sum()) / swarm.speed + sum(bounds.execution_time for bounds in self._stages[1:])

    def turning_rows(self, swarm: Swarm) -> Rows:
        """Return what robots have to turn at least, if they have the codewords of a swarm.

        Of those that may go to each other's goals only where they look.
        """
        goals = np.array(self.places[1])
        goals[list(self.exchangeable)] = np.nan
        headings = np.broadcast_to(np.nan if len(self.waypoints) else self.goal_headings, self.swarm.n)
        return turning_rows(swarm, self.starts, goals, self.tolerance, headings, self.heading_tolerance)

    @property
    def places(self) -> list[np.ndarray]:
        """Where robots are at the start and after each stage, each of shape (n, 2)."""
        return [self.starts[:, :2], *self.waypoints, self.goals]

    @cached_property
    def _stages(self) -> list[LowerBounds]:
        return bounds_of_stages(self.swarm, self.places, self.tolerance, self.parked)

    def goal_error(self, positions: np.ndarray) -> float:
        """Return the largest distance of positions (n, 2) from the goals, units."""
        return float(np.max(np.hypot(*(positions - self.goals).T)))

    @cached_property
    def headed(self) -> np.ndarray:
        """Rows of robots with goal headings, ascending."""
        return np.flatnonzero(~np.isnan(self.goal_headings))

    @property
    def conditions(self) -> int:
        """Number of equations that the lengths of a plan have to meet at its end."""
        return 2 * self.swarm.n + len(self.headed)

    def heading_error(self, headings: np.ndarray) -> float:
        """Return the largest difference of headings (n,) from those at the goals, rad; 0 where all are free."""
        return float(np.abs(wrapped(headings - self.goal_headings)[self.headed]).max(initial=0.0))

    def is_solved_at(self, poses: np.ndarray) -> bool:
        """Return whether robots at poses (n, 3) are at their goals, and look where they should."""
        is_there = self.goal_error(poses[:, :2]) <= self.tolerance
        return is_there and self.heading_error(poses[:, 2]) <= self.heading_tolerance

    def _check_headings(self) -> None:
        n = self.swarm.n
        headings = np.asarray(self.goal_headings, dtype=float)
        if headings.shape not in ((), (n,)):
            raise StressbotError(
                ErrorCode.WRONG_COUNT, "goal", f"has {headings.size} headings for {n} robots: give one each, NaN where it is free"
            )
        object.__setattr__(self, "goal_headings", frozen_array(np.broadcast_to(headings, (n,))))
        check_positive("heading_tolerance", self.heading_tolerance)
        for row in self.headed:
            check_coordinates(self._field("goal", row), self.goal_headings[row])
            if row in self.exchangeable:
                raise StressbotError(
                    ErrorCode.UNSUPPORTED,
                    f"robots[{row}].goal",
                    f"has a heading, and robot {row + 1} may take another goal: leave out the heading, or give it its own goal",
                )
        if found := dependent(self.swarm, self.headed.tolist()):
            row, others = found
            names = ", ".join(str(other + 1) for other in others)
            raise StressbotError(
                ErrorCode.INFEASIBLE,
                f"robots[{row}].goal",
                f"has a heading that follows from the one{'s' if len(others) > 1 else ''} of robot{'s' if len(others) > 1 else ''} "
                f"{names}: headings follow from how long each of the {self.swarm.m} groups is driven; leave out this one, or "
                "one of those",
            )

    def _check_parked(self) -> None:
        for row in self.parked:
            places = np.vstack([self.waypoints[:, row], self.goals[row]])
            if row in self.exchangeable or row in self.headed or np.any(places != self.starts[row, :2]):
                raise StressbotError(
                    ErrorCode.UNSUPPORTED, f"robots[{row}].goal", f"is not where robot {row + 1} starts, which is parked: give one"
                )
        check_parked(self.swarm, self.parked)

    def _check_contacts(self) -> None:
        if not 0 <= self.contact_depth < np.inf:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, "contact_depth", f"is {self.contact_depth}: give a number of 0 or more")
        for index, pair in enumerate(self.contacts):
            if len(set(pair)) < 2 or not all(0 <= row < self.swarm.n for row in pair):
                raise StressbotError(
                    ErrorCode.OUT_OF_RANGE,
                    f"contacts[{index}]",
                    f"is {', '.join(str(row + 1) for row in pair)}: name two of robots 1 to {self.swarm.n}",
                )
            for row in sorted(set(pair) & set(self.parked)):
                raise StressbotError(
                    ErrorCode.UNSUPPORTED,
                    f"contacts[{index}]",
                    f"names robot {row + 1}, which is parked: an obstacle, from which all keep the same gap; leave the pair out",
                )

    def credit(self, gap: float) -> np.ndarray:
        """Return what gaps of robots in contact count as larger, see `collision.clearance_of`, if all keep a gap, units."""
        if not self.contacts:
            return NO_CREDIT
        credit = np.zeros((self.swarm.n, self.swarm.n))
        for pair in self.contacts:
            credit[pair] = credit[pair[::-1]] = gap
        return credit

    def credit_at_ends(self, gap: float) -> np.ndarray:
        """Return that of robots that come no closer than touching, or than they start."""
        credit, radius = self.credit(gap), self.swarm.body_radius
        for i, j in self.contacts:
            now = float(np.hypot(*(self.starts[i, :2] - self.starts[j, :2])) - radius[i] - radius[j])
            credit[i, j] = credit[j, i] = gap + max(0.0, -now)
        return credit

    def _check_places(self, name: str, positions: np.ndarray, too_close: ErrorCode) -> None:
        radius = self.swarm.body_radius
        credit = self.credit(self.contact_depth if name == "start" else 0.0)
        for j in range(1, len(positions)):  # row by row: there may be millions of overlapping pairs
            gaps = np.hypot(*(positions[:j] - positions[j]).T) - radius[:j] - radius[j]
            if self.contacts:
                gaps += credit[:j, j]
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
                        f"units by {-found.gap:.4g} units into {found.other}: move the {_word(name)} or the {_word(found.other)}",
                    )

    def _field(self, name: str, row: int) -> str:
        if name == "goal" and row in self.exchangeable:
            return f"goals[{self.exchangeable.index(row)}]"
        return f"robots[{row}].{name}"

    def _other(self, name: str, row: int) -> str:
        field = self._field(name, row)
        return field if field.startswith("goals") else f"the {_word(name)} of robot {row + 1}"


def _word(field: str) -> str:
    """Return what an entry of a field is called: waypoint for `waypoints[1]`."""
    return field.split("[")[0].removesuffix("s") if "[" in field else field
