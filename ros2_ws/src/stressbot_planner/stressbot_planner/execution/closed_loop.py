"""Closed loop: driving robots that are not the model: drive a little, look, correct, until everybody is at the goal. No ROS.

A receding horizon: a window of a few activations is made from where the robots are (`windows`), with what has been learnt of each
(`kalman_filters`), and its first activation is driven. It has no plan, so that no drift can spoil one. Where it gets no nearer,
because robots are in each other's way, a planner makes a plan. Of that only the first activations are driven before the next look,
as many as keep the expected drift small; then the durations of the rest are found anew from where the robots are (`retiming`).
Where that does not work, because bodies would come too close or too few activations are left, windows go on.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from stressbot_planner.beam_search.cost_to_go import DistanceMaps, distance_maps
from stressbot_planner.beam_search.situation import Situation
from stressbot_planner.collision.clearance import Shapes, clearance_of, environment_clearances, is_clear, touching_slack
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.kalman_filters import MISSED, STRAYED, KalmanFilters, Prior
from stressbot_planner.execution.retiming import retime
from stressbot_planner.execution.windows import NO_WINDOW, Window, best_window
from stressbot_planner.model.environment import Environment, Workspace, standing
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.model.swarm import Swarm, fastest
from stressbot_planner.problem.definition import Problem

Remainder = tuple[np.ndarray, np.ndarray]
"""Groups (K,) and lengths (K,) of a plan, or of what is left of it."""


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """What a planner is asked for.

    Attributes:
        problem: from where the robots are.
        effort: 1, and more where that was not enough: how much longer than usual to try.
        max_epochs: most activations that it may have, since each adds noise; None: any number.
        seed: another for each call.
    """

    problem: Problem
    effort: int
    max_epochs: int | None
    seed: int


Solver = Callable[[PlanRequest], Remainder]
"""Raises StressbotError, with NO_PLAN_FOUND or INFEASIBLE if there is no plan."""

ATTEMPTS = ((1.0, 1, True), (0.5, 1, True), (0.0, 2, True), (0.5, 4, False), (0.0, 8, False))
"""Of each attempt at a new plan: share of PLAN_MARGIN, effort, and whether activations should be few."""

FEW_PER_ROBOT = 5
"""Activations for each robot in a plan of few."""

SIGMAS = 3.0
"""Standard deviations of their expected drift by which bodies are kept apart."""

LAST_SIGMAS = 1.0
"""The same, where no plan keeps more."""

PLAN_MARGIN = 0.5
"""Of the body radius: a new plan keeps bodies this much further apart, each its share, where there is room."""

SHARE_OF_GAP = 0.45
"""Of a robot's present gap to the nearest body or wall: its room. Plans inflate bodies by no more."""

DRIFT = 0.5
"""Of the tolerance: one standard deviation of drift that a robot may gather before it is looked at again."""

MISS = 0.4
"""Of the tolerance: a plan is good as long as no robot is expected to end further from its goal, drift left aside."""

LONGER = 1.1
"""Ratio of a retimed rest's path, or time beyond a turn of all, to that before; a larger one is given up for a new plan."""

PIECES = (1 / 64, 1 / 16, 1 / 4, 1 / 2, 1.0)
"""Of a slide, in which its clearance is looked at with the drift of their ends."""

SHORTENED = (1.0, 0.5, 0.25, 0.1, 0.04)
"""Shares of the first activation that are tried, if the whole of it may end in a touch."""

TRIVIAL = 1e-3
"""Of the mean turning radius: shorter activations are left out."""

NOTHING = 1e-9
"""Of the mean turning radius: shorter activations move nobody, and may take no time at all. None leaves the loop."""

WINDOW_SIGMAS = 4.0
"""Standard deviations of drift by which robots are kept apart in windows: they often go close to others."""

WINDOW_ROOM = 0.1
"""Of the mean girth: what descents leave between bodies beside that."""

PRECISE = 0.1
"""Of the tolerance: more of a window is driven before the next look, as long as one standard deviation of drift is below."""

RIPE = 0.6
"""Of the tolerance: to bring robots nearer to their goals than that is not worth an activation."""

NEARER, PATIENCE, STALLS = 0.9, 60, 4
"""Share to which the sum of squares of the ways left has to fall, looks within which it has to, or a planner is asked, and the
number of times in a row without a plan that end the motion."""

MOST_UNSEEN = 4
"""So many activations a robot may go unseen, its pose predicted, before all stop."""


_NOTHING = np.empty(0, dtype=np.int64), np.empty(0)


class State(Enum):
    """What to do next."""

    DRIVE = "drive"
    DONE = "done"
    FAILED = "failed"


class Origin(Enum):
    """Where the activations of a decision come from: a window, the rest of a plan, that with new durations, a new plan."""

    WINDOW = "window"
    CONTINUED = "continued"
    RETIMED = "retimed"
    PLANNED = "planned"


@dataclass(frozen=True, eq=False)
class Decision:
    """What to do next, and why.

    Attributes:
        state: DRIVE the activations, or nothing is left to do, or nothing can be done.
        groups, lengths: of the activations to drive now, shape (K,), lengths > 0 in those of the described swarm; K > 0 to DRIVE.
        origin: of the activations.
        error: of a failure; robots are named as `robots[k]`, k their row.
    """

    state: State
    groups: np.ndarray
    lengths: np.ndarray
    origin: Origin = Origin.CONTINUED
    error: StressbotError | None = None


class ClosedLoop:
    """The controller. `observe` every activation that was driven, then `decide`.

    Attributes:
        poses: as last measured or, for a robot out of sight, predicted, shape (n, 3).
        filters: `KalmanFilters` of the robots.
        stuck: robots that were found stuck and became obstacles, shape (n,), bool.
        plans, retimings: how many new plans were asked for, and how many driven ones were corrected.
    """

    def __init__(
        self,
        swarm: Swarm,
        environment: Environment,
        goals: np.ndarray,
        tolerance: float,
        measured: np.ndarray,
        solver: Solver,
        prior: Prior | None = None,
    ):
        """Take the swarm as described, goals (n, 2), the tolerance around them, units, and the poses (n, 3) of all robots."""
        self.swarm, self.environment = swarm, environment
        self.goals, self.tolerance = np.asarray(goals, dtype=float), tolerance
        self.poses = np.array(measured)
        self.filters = KalmanFilters(swarm, prior or Prior())
        self.stuck = np.zeros(swarm.n, dtype=bool)
        self.plans = self.retimings = 0
        self._solver = solver
        self._unseen = np.zeros(swarm.n, dtype=int)
        self._groups, self._lengths = _NOTHING
        self._ahead = NO_WINDOW
        self._rng = np.random.default_rng(0)
        self._maps: DistanceMaps | None = None
        self._best, self._since_best, self._stalls = np.inf, 0, 0

    @property
    def errors(self) -> np.ndarray:
        """Distance of each robot from its goal, units, shape (n,)."""
        return np.hypot(*(self.poses[:, :2] - self.goals).T)

    @property
    def moving(self) -> np.ndarray:
        """Rows of the robots that are not stuck."""
        return np.flatnonzero(~self.stuck)

    def observe(self, group: int, length: float, measured: np.ndarray) -> None:
        """Take in the poses (n, 3) after an activation; NaN where a robot was not seen."""
        seen = np.isfinite(measured[:, 0])
        before = np.where((self._unseen == 0)[:, None], self.poses, np.nan)
        self.filters.learn(group, length, before, measured)
        expected = self.filters.advance(self.poses, group, length)
        expected[self.stuck] = self.poses[self.stuck]
        self.poses = np.where(seen[:, None], measured, expected)
        self._unseen = np.where(seen, 0, self._unseen + 1)
        # What was driven is the beginning of the plan, perhaps a part of its first activation.
        if len(self._groups) and self._groups[0] == group:
            left = self._lengths[0] - length
            if left > self._trivial:
                self._lengths = np.concatenate([[left], self._lengths[1:]])
            else:
                self._groups, self._lengths = self._groups[1:], self._lengths[1:]

    def decide(self) -> Decision:
        """Return what to do now."""
        try:
            self._find_faults()
            moving = self.moving
            if np.all(self.errors[moving] <= self.tolerance - self.filters.position_noise):
                return Decision(State.DONE, *_NOTHING)
            view = _View(self)
            maps = self._maps
            if maps is None:
                view.problem(0.0)  # raises if a goal cannot be taken
                maps = self._maps = view.distance_maps()
            return self._retimed(view) or self._within_window(view, maps)
        except StressbotError as error:
            return Decision(State.FAILED, *_NOTHING, error=error)

    def _find_faults(self) -> None:
        strayed = np.flatnonzero(self.filters.strayed >= STRAYED)
        if strayed.size:
            raise StressbotError(
                ErrorCode.ROBOT_FAULTY,
                f"robots[{strayed[0]}]",
                "slides when it should turn: its arm is stuck up, or it answers to other groups; take it off the substrate",
            )
        lost = np.flatnonzero(self._unseen > MOST_UNSEEN)
        if lost.size:
            raise StressbotError(
                ErrorCode.ROBOT_LOST,
                f"robots[{lost[0]}]",
                f"was not seen for {MOST_UNSEEN} activations: bring it into the tracker's view",
            )
        stuck = (self.filters.missed >= MISSED) & ~self.stuck
        if stuck.any():
            self.stuck = self.stuck | stuck
            self._groups, self._lengths = _NOTHING
            self._maps, self._ahead, self._best, self._since_best = None, NO_WINDOW, np.inf, 0
            if self.stuck.all():
                raise StressbotError(ErrorCode.ROBOT_FAULTY, "robots", "do not move any more: is there a voltage on the substrate?")

    @property
    def _trivial(self) -> float:
        return TRIVIAL * float(self.swarm.turning_length.mean())

    @property
    def _nothing(self) -> float:
        return NOTHING * float(self.swarm.turning_length.mean())

    def _retimed(self, view: "_View") -> Decision | None:
        """Return how to go on with the rest of the plan, retimed if need be; None if there is none, or it is of no use any more."""
        groups, lengths = self._groups, self._lengths
        if not len(groups):
            return None
        poses = view.trajectory(groups, lengths)
        origin = Origin.CONTINUED
        if view.miss(poses) > 0.1 * MISS * self.tolerance:
            origin = Origin.RETIMED
            path, time = LONGER * view.path(groups, lengths), LONGER * lengths.sum()
            lengths, poses = view.retime(groups, lengths)
            longer = view.path(groups, lengths) > path + self.tolerance or lengths.sum() > time + view.turn
            if view.miss(poses) > MISS * self.tolerance or longer:
                return None
        if view.gap(groups, lengths, poses) < -view.slack:
            return None
        found = self._first(view, groups, lengths, poses, origin, SIGMAS)
        self.retimings += found is not None and origin is Origin.RETIMED
        return found

    def _within_window(self, view: "_View", maps: DistanceMaps) -> Decision:
        """Return what to drive of a window; where these have brought the swarm no nearer for long, the beginning of a new plan."""
        self._groups, self._lengths = _NOTHING
        left = view.way_left(maps)
        self._since_best += 1
        if left < NEARER * self._best:
            self._best, self._since_best, self._stalls = left, 0, 0
        if self._since_best > PATIENCE:
            self._best, self._since_best, self._ahead = np.inf, 0, NO_WINDOW
            try:
                return self._planned(view)
            except StressbotError as error:
                self._stalls += 1
                if error.code is not ErrorCode.NO_PLAN_FOUND or self._stalls == STALLS:
                    raise
        ripe = RIPE * max(self.tolerance - self.filters.position_noise, 0.1 * self.tolerance)
        room = WINDOW_ROOM * float(self.swarm.girth.mean())
        window = best_window(view.situation(maps), view.poses, self._ahead, self._rng, ripe, room)
        real = window.lengths >= self._trivial
        groups, lengths = window.groups[real], window.lengths[real]
        if not len(groups):  # nobody can slide: other headings may help
            self._ahead = NO_WINDOW
            turn = float(self._rng.uniform(0.0, view.turn))
            return Decision(State.DRIVE, np.array([self.swarm.m]), np.array([turn]), Origin.WINDOW)
        drift = view.drift(groups, view.trajectory(groups, lengths), lengths)
        count = 1
        while count < len(groups) and drift[count].max() <= PRECISE * self.tolerance:
            count += 1
        while count > 1 and not view.is_safe(groups[:count], lengths[:count], WINDOW_SIGMAS):
            count -= 1
        self._ahead = Window(groups[count:], lengths[count:])
        return Decision(State.DRIVE, groups[:count], lengths[:count], Origin.WINDOW)

    def _planned(self, view: "_View") -> Decision:
        """Return the beginning of a new plan."""
        last: StressbotError | None = None
        risky: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        for margin, effort, few in ATTEMPTS:
            self.plans += 1
            try:
                max_epochs = FEW_PER_ROBOT * len(self.moving) if few else None
                groups, lengths = self._solver(PlanRequest(view.problem(margin * PLAN_MARGIN), effort, max_epochs, self.plans))
                groups, lengths = groups[lengths > self._nothing], lengths[lengths > self._nothing]
            except StressbotError as error:
                if error.code not in (ErrorCode.NO_PLAN_FOUND, ErrorCode.INFEASIBLE):
                    raise
                last = error
                continue
            lengths = lengths / view.scale
            poses = view.trajectory(groups, lengths)
            if view.miss(poses) > 0.1 * MISS * self.tolerance:
                lengths, poses = view.retime(groups, lengths)
            if view.miss(poses) > MISS * self.tolerance or view.gap(groups, lengths, poses) < -view.slack:
                continue
            found = self._first(view, groups, lengths, poses, Origin.PLANNED, SIGMAS)
            if found is not None:
                return found
            risky = groups, lengths, poses
        if risky is not None:
            found = self._first(view, *risky, Origin.PLANNED, LAST_SIGMAS)
            if found is not None:
                return found
        raise last or StressbotError(
            ErrorCode.NO_PLAN_FOUND, "planner", "finds no way that keeps robots apart in spite of their drift"
        )

    def _first(
        self, view: "_View", groups: np.ndarray, lengths: np.ndarray, poses: np.ndarray, origin: Origin, sigmas: float
    ) -> Decision | None:
        """Keep a plan, and return as much of it as may be driven before the next look; None if nothing may."""
        real = lengths > self._nothing
        groups, lengths, poses = groups[real], lengths[real], poses[np.append(True, real)]
        if not len(groups):
            return None
        drift = view.drift(groups, poses, lengths)
        small = np.flatnonzero(~np.all(drift <= DRIFT * self.tolerance, axis=1))
        count = max(1, small[0] if small.size else len(groups))
        driven = lengths[:count]
        while count > 1 and not view.is_safe(groups[:count], driven, sigmas):
            count //= 2
            driven = lengths[:count]
        if count == 1:
            whole = min(1.0, DRIFT * self.tolerance / float(drift[0].max(initial=1e-12)))
            for share in np.multiply(SHORTENED, whole):
                driven = share * lengths[:1]
                if view.is_safe(groups[:1], driven, sigmas):
                    break
            else:
                return None
        keep = lengths > self._trivial
        keep[:count] = True
        self._groups, self._lengths = groups[keep], lengths[keep]
        return Decision(State.DRIVE, groups[:count], driven, origin)


class _View:
    """The robots that move, as they are believed to be at one moment: their directions, speeds, turning rates and gaps."""

    def __init__(self, loop: ClosedLoop):
        rows, filters, swarm = loop.moving, loop.filters, loop.swarm
        self._loop, self._rows = loop, rows
        self.poses = filters.directions(loop.poses)[rows]
        self.goals = loop.goals[rows]
        self.turning_length = np.ascontiguousarray(filters.turning_length[rows])
        self.turn = 2 * np.pi * float(self.turning_length.mean())
        self._slides = np.ascontiguousarray(filters.slides[:, rows])
        speed, pace = fastest(swarm.speed * swarm.pace[rows] * filters.slide[rows])
        self.scale = speed / swarm.speed  # from lengths of the described swarm to those of the believed one
        words = tuple(swarm.codewords[row] for row in rows)
        self._believed = Swarm(speed, self.turning_length * pace * self.scale, swarm.body_radius[rows], words, pace)
        obstacles = standing(loop.poses[loop.stuck, :2], swarm.body_radius[loop.stuck], swarm.body_radius[rows])
        self._environment = Environment(loop.environment.workspace, (*loop.environment.obstacles, *obstacles))
        self._shapes = Shapes.of(self._environment)
        self.slack = touching_slack(swarm.body_radius, self._environment, np.vstack([self.poses[:, :2], self.goals]))
        self.room = SHARE_OF_GAP * np.maximum(self._gaps(self.poses[:, :2]), 0.0)

    def _gaps(self, places: np.ndarray) -> np.ndarray:
        """Return the gap of each body at rest to its nearest neighbour, units, shape (n,); points are none to each other."""
        body = self._believed.body_radius
        between = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) - body[:, None] - body
        between[(body[:, None] + body == 0) | np.eye(len(body), dtype=bool)] = np.inf
        around = [found.gap for found in environment_clearances(self._believed, self._environment, places)]
        return np.minimum(between.min(axis=1), around)

    def distance_maps(self) -> DistanceMaps:
        return distance_maps(self._shapes, self._believed.body_radius, self.poses[:, :2], self.goals)

    def way_left(self, maps: DistanceMaps) -> float:
        """Return the sum of squares of the ways left."""
        return float(np.sum(np.square(maps.ways_left(self.poses[:, :2]))))

    def situation(self, maps: DistanceMaps) -> Situation:
        """Return what windows know of slides: cones of their headings' jumps, and of what is not known yet."""
        filters = self._loop.filters
        variance = filters.heading_noise**2 + (filters.bias_variance + filters.slide_variance)[self._rows]
        cone, least = WINDOW_SIGMAS * np.sqrt(variance), WINDOW_SIGMAS * filters.position_noise
        robots = self._slides, self.turning_length, cone, self._believed.body_radius
        return Situation.of(*robots, least, self.slack, False, self._shapes, maps)

    def trajectory(self, groups: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        return trajectory(self._slides[groups - 1], self.turning_length, self.poses, lengths)

    def retime(self, groups: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return retime(self._slides[groups - 1], self.turning_length, self.poses, self.goals, lengths)

    def miss(self, poses: np.ndarray) -> float:
        return float(np.hypot(*(poses[-1, :, :2] - self.goals).T).max())

    def path(self, groups: np.ndarray, lengths: np.ndarray) -> float:
        return float(self._slides.sum(axis=1)[groups - 1] @ lengths)

    def gap(self, groups: np.ndarray, lengths: np.ndarray, poses: np.ndarray) -> float:
        return clearance_of(self._believed, self._shapes, poses, groups, self.scale * lengths).gap

    def drift(self, groups: np.ndarray, poses: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        full = np.zeros((len(poses), self._loop.swarm.n, 3))
        full[:, self._rows] = poses
        return self._loop.filters.drift(groups, full, lengths)[:, self._rows]

    def is_safe(self, groups: np.ndarray, lengths: np.ndarray, sigmas: float) -> bool:
        """Return whether bodies stay apart when each is inflated by some sigmas of its drift.

        Drift grows along a slide, so that each slide is looked at in pieces: from here a robot may leave a wall that it nearly
        touches, but not go along it. A robot that has not gone further than its room cannot have touched anything.
        """
        before = self.poses
        for k in range(len(groups)):
            driven = 0.0
            for share in PIECES:
                until = np.append(lengths[:k], share * lengths[k])
                poses = self.trajectory(groups[: k + 1], until)
                gone = (self._slides[groups[: k + 1] - 1] * until[:, None]).sum(axis=0)
                inflation = np.where(gone > self.room, sigmas * self.drift(groups[: k + 1], poses, until)[-1], 0.0)
                piece, length = np.stack([before, poses[-1]]), np.array([self.scale * (until[-1] - driven)])
                if not is_clear(self._believed, self._shapes, piece, groups[k : k + 1], length, -self.slack, inflation):
                    return False
                before, driven = poses[-1], until[-1]
        return True

    def problem(self, margin: float) -> Problem:
        """Return the rest of the way for a planner, bodies inflated by a share of their radius where there is room."""
        room = np.minimum(self.room, SHARE_OF_GAP * np.maximum(self._gaps(self.goals), 0.0))
        swarm = self._believed
        body = swarm.body_radius + np.minimum(margin * swarm.body_radius, room)
        inflated = Swarm(swarm.speed, swarm.turning_radius, body, swarm.codewords, swarm.pace)
        try:
            return Problem(inflated, self._environment, self.poses, self.goals)
        except StressbotError as error:
            # the planner counts the robots that move
            field = re.sub(r"(?<=robots\[)\d+", lambda match: str(self._rows[int(match[0])]), error.field)
            raise StressbotError(error.code, field, error.message) from error


def warm_up() -> None:
    """Load and compile what windows need, so that the first comes as quickly as the next."""
    poses = np.array([[1.0, 1.0, 0.0], [1.0, 2.0, 0.0]])
    environment = Environment(Workspace(0.0, 4.0, 0.0, 4.0))

    def solver(wanted: PlanRequest) -> Remainder:
        raise StressbotError(ErrorCode.NO_PLAN_FOUND, "planner", "is not asked for two robots in an empty square")

    loop = ClosedLoop(Swarm(1.0, 1.0, 0.1, ("01", "10")), environment, poses[:, :2] + 1.0, 0.01, poses, solver)
    for _ in range(3):
        decision = loop.decide()
        if decision.error is not None:
            raise decision.error
        for group, length in zip(decision.groups.tolist(), decision.lengths.tolist(), strict=True):
            loop.observe(group, length, loop.filters.advance(loop.poses, group, length))
