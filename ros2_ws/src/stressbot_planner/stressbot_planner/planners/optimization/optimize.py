"""`optimize`: durations over a group order, minimised under "every robot at its goal, no bodies overlap". Anytime.

The paper's numerical optimisation, grown up: exact derivatives, clearances, many starts. First it looks for any plan:
`untangle` from random group orders; where that fails, or takes long, from where steering has brought the swarm near its goals;
and where nobody gets past anybody `pure_control`. Then it solves some random orders by the central path, and from then on changes
the best plan: a random stretch of it gets other groups and lengths, and the whole is molten (mu back up, bodies soft) and solved
again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from stressbot_planner.collision.clearance import Shapes, clearance_of, gap_at_rest
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.kinematics import execution_time, path_length, replay
from stressbot_planner.planners import Outcome, Progress, Settings, prepare, pure_control
from stressbot_planner.planners.cost import CLOSE_TO_BOUND, Cost
from stressbot_planner.planners.optimization.approach import approaches
from stressbot_planner.planners.optimization.central_path import CentralPath, Order
from stressbot_planner.planners.optimization.receding_horizon import RecedingHorizon
from stressbot_planner.planners.optimization.untangle import untangle
from stressbot_planner.primitives.expansion import Primitive, as_primitives
from stressbot_planner.problem.bounds import group_lengths
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan

ACTIVATIONS_PER_ROBOT, AMONG_OBSTACLES = 12, 17
"""K / n: six times as many as goals need, so that gaps can be kept too; with more there are more ways around obstacles."""

STARTS = 3
"""Random orders solved before the best plan is changed, two more for each one that becomes a plan."""

GENEROUS = 30, 50
"""K / n of guesses that are untangled among obstacles where the usual ones fail; of many robots only the first."""

GENEROUS_SPARE = 2.2
"""The first of them are this much longer than the bound, and none is longer."""

ROUGH = 1.2
"""A best plan with more activations than this, in relation to usual guesses, takes too long to be changed."""

QUICK_STARTS = 6
"""Random orders untangled, before the swarm is steered."""

ALONE, ALONE_TIME = 0.4, 100.0
"""`pure_control` is asked last: so many s before the end for 126 robots (by the power of 3.3 of their number), and half a second
more; at most in this share of the time limit."""

UNTANGLED = 0.6
"""Share of the time before that in which random orders are untangled. In the rest the swarm is steered."""

STEERING_TIME = 15.0
"""s that it takes to steer 62 robots at least; it grows with the fourth power. Where there is less, nobody is steered."""

MOST_ALONE = 150
"""For more robots `pure_control` finds no plan that is short enough to be of use."""

FEW, FEW_TIME, EACH_ITS_GROUP = 6, 0.25, 2
"""So few robots `pure_control` moves in milliseconds: it is asked after quick starts, for at most this share of the time limit,
but after steering where the first plan ends the search. Of two, each in a group of its own, its plans are the shortest: it is
asked at once."""

WARM = 0.3
"""Share of the time limit in which a warm start is mended."""

KICKS = 2
"""Of a sequence that ends near the goals, where untangling fails. Another random order is worth more than a kick."""

LARGE = 31
"""More robots than this are only untangled: a step of the central path would take seconds."""

MANY, MANY_MEETINGS = 20, 400
"""More robots than this among obstacles, or more meetings of two in a first guess in the open plane, are a crowd: it follows a
receding horizon first, since orders to be untangled take long."""

A_LARGE_SWARM, A_MEETING, MOST = 5, 8, 8000
"""K of a large swarm: 5 n for the goals, eight more for each meeting of two robots in the first guess, up to 8000."""

BETWEEN = 3
"""One in so many tries is a random order untangled, where these do not take too long."""

STREWN, STREWN_LENGTH = 2, 0.3
"""A plan that nearly fits is tried so often with further activations, up to so long relative to its mean."""

PATIENCE = 60
"""So do this many changes in a row that gain nothing, or tries without a shorter plan where all have too many activations."""

_SPARE = 1.6
"""First guesses are this much longer than the bound: short ones end short, long ones find ways around."""

_SPARE_OF_DOUBLED, _SPARE_OF_LARGE = 0.5, 2.1
"""So much is added for each doubling from 42 robots on: the more they are, the fewer of them head for their goals at once. And
the least of a large swarm."""

_SHORTER, _LONGER = 0.93, 1.1
"""What the next guess that is untangled is multiplied with, after a plan is found or not."""

_STRETCH = (0.05, 0.6)
"""Length of the stretch of a plan that is changed, relative."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the best of the valid plans found, for any turning radii and speeds.

    A try is a group order untangled or solved, new or changed. `pure_control`, where it is asked, has as many tries of its own.

    Raises:
        StressbotError: bodies at starts or goals are closer than the least clearance asked for.
    """
    _check_ends(problem, settings.min_clearance)
    if problem.goal_error(problem.starts[:, :2]) <= problem.tolerance:
        return Outcome(())
    return _Search(problem, settings, rng).run()


def warm_up(problem: Problem) -> None:
    """Load what is asked only where random orders fail."""
    prepare("pure_control")
    shapes, rng = Shapes.of(problem.environment), np.random.default_rng(0)
    next(approaches(problem, shapes, 0.0, rng, lambda: False))
    looks = iter(range(50))
    RecedingHorizon(problem, shapes, 0.1, 0.0, np.ones(problem.swarm.m), rng, lambda: next(looks, None) is None).attempt()


def _check_ends(problem: Problem, least_gap: float) -> None:
    if least_gap == 0.0:
        return
    shapes = Shapes.of(problem.environment)
    for name, places in (("start", problem.starts[:, :2]), ("goal", problem.goals)):
        poses = np.column_stack([places, np.zeros(len(places))])[None]
        found = clearance_of(problem.swarm, shapes, poses, np.empty(0, dtype=np.int64), np.empty(0))
        if found.gap < least_gap - problem.slack:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                "min_clearance",
                f"is {least_gap:g} units, but a {name} leaves only {found}: ask for less, or move the {name}",
            )


@dataclass
class _Best:
    """The best plan so far, and of the attempts that are no plans the closest."""

    value: float = np.inf
    primitives: tuple[Primitive, ...] | None = None
    groups: np.ndarray | None = None
    lengths: np.ndarray | None = None
    history: list[tuple[float, float, float]] = field(default_factory=list)
    nearest: tuple[Primitive, ...] | None = None
    nearest_gap: float = -np.inf
    fewest: int = 0


class _Search:
    """One search by one process."""

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator):
        self.problem, self.settings, self.rng = problem, settings, rng
        self.begin, self.latest = settings.clock(), settings.time_limit
        self.shapes = Shapes.of(problem.environment)
        self.least_gap = self._least_gap()
        self.margin = settings.min_clearance + float(problem.swarm.girth.min()) / 3
        self.cost = Cost(problem, settings)
        self.best = _Best()
        self.bound_lengths = group_lengths(problem.swarm, problem.starts, problem.goals, self.cost.of_group)
        self.used = np.flatnonzero((problem.swarm.group_sizes > 0) | (np.arange(problem.swarm.m) == problem.swarm.m - 1))
        """Groups that are worth an activation, from 0."""
        self.is_open = problem.environment.is_open_plane
        self.large = problem.swarm.n > LARGE
        per_robot = ACTIVATIONS_PER_ROBOT if self.is_open else AMONG_OBSTACLES
        self.usual_count = max(per_robot * problem.swarm.n, 30)
        self.spare = GENEROUS_SPARE
        if self.large and self.is_open:
            self.spare = max(_SPARE + _SPARE_OF_DOUBLED * np.log2(problem.swarm.n / 42), _SPARE_OF_LARGE)
        self.meetings = self._meetings() if self.large and self.is_open else 0
        self.many = self.meetings > MANY_MEETINGS if self.is_open else problem.swarm.n > MANY
        self.first_guesses = self._first_guesses()
        self.horizon = None
        if self.many:
            self.horizon = RecedingHorizon(
                problem, self.shapes, self.margin, self.least_gap, self.cost.of_group, rng, self._out_of_time
            )
        self.tries = self.valid = self.since_better = self.starts = self.valid_starts = 0
        self.untangled = self.steered = False
        """Whether the last order untangled became a plan; whether only steering has led to one."""

    def run(self) -> Outcome:
        """Look for a plan, then for better ones, until time is over or nothing is to be gained."""
        self.latest = self._until(WARM)
        self._warm_start()
        self.latest = self.settings.time_limit
        if not self._done():
            self._first_plan()
        while not self._done():
            if self.many and (self.tries % BETWEEN or self.large and not self.is_open):
                self._attempt_horizon()
                continue
            rough = self.steered or self.best.groups is None or len(self.best.groups) > ROUGH * self.usual_count
            only = self.large or self.many or self.best.groups is None
            if only or rough and self.tries % 2:
                self._untangle(*next(self.first_guesses))
            elif rough or self.valid_starts < STARTS and self.starts < STARTS + 2 * self.valid_starts:
                self.starts += 1
                self.valid_starts += self._try(*self._guess(self.usual_count, _SPARE))
            else:
                self._try(*self._changed(), self._ends(self.best.groups, self.best.lengths))
        return self._outcome()

    def _done(self) -> bool:
        if self._out_of_time() or self._tried_out():
            return True
        if self.best.primitives is None:  # all plans may be too long
            return self.best.fewest > 0 and self.since_better >= PATIENCE
        return self.settings.first or self.best.value <= CLOSE_TO_BOUND or self.since_better >= PATIENCE

    def _out_of_time(self) -> bool:
        return self._elapsed() > self.latest

    def _until(self, share: float) -> float:
        """Return the end of a share of the time; of all of it where tries are limited: nothing is to depend on the clock then."""
        return self.settings.time_limit * (share if self.settings.max_tries is None else 1.0)

    def _tried_out(self) -> bool:
        most = self.settings.max_tries
        return most is not None and self.tries >= most

    def _elapsed(self) -> float:
        return self.settings.clock() - self.begin

    def _least_gap(self) -> float:
        """Return the gap that plans stay above: the clearance asked for, or a little less where starts or goals leave no more."""
        asked, slack = self.settings.min_clearance, self.problem.slack
        ends = self.problem.starts[:, :2], self.problem.goals
        least = min(gap_at_rest(self.problem.swarm, self.shapes, places) for places in ends)
        return asked if least > asked + slack else min(asked - 0.5 * slack, least - 0.01 * slack)

    def _path(self, order: Order, ends: np.ndarray | None = None) -> CentralPath:
        return CentralPath(self.problem, self.shapes, order, self.margin, self.least_gap, ends, self._out_of_time)

    def _order(self, groups: np.ndarray) -> Order:
        return Order(groups, self.problem.swarm.slides[groups - 1], self.cost.of_group[groups - 1])

    # Ways to a plan

    def _warm_start(self) -> None:
        """Mend the plan that nearly fits: by other durations, then with further activations strewn in."""
        if self.settings.warm_start is None:
            return
        groups, lengths = map(np.asarray, self.settings.warm_start)
        groups = groups.astype(np.int64)
        if not np.any(lengths):
            return
        lengths = np.maximum(lengths, 1e-3 * lengths.mean())
        order, ends = self._order(groups), self._ends(groups, lengths)
        if len(groups) > 2 * self.problem.swarm.n:
            restored = self._path(order, ends).restore(lengths, patient=True)
            if restored is not None and self._keep(order, restored) or self._part(order, lengths, ends):
                return
        for _ in range(STREWN):
            if self._done() or self._part(*self._strewn(groups, lengths), ends):
                return

    def _strewn(self, groups: np.ndarray, lengths: np.ndarray) -> tuple[Order, np.ndarray]:
        """Return a sequence with as many short activations strewn in, or as many as goals need."""
        count = max(len(groups), 2 * self.problem.swarm.n)
        at = self.rng.integers(0, len(groups) + 1, count)
        more = self.rng.permutation(np.resize(self.used + 1, count))
        short = lengths.mean() * self.rng.uniform(0.0, STREWN_LENGTH, count)
        return self._order(np.insert(groups, at, more)), np.insert(lengths, at, short)

    def _first_plan(self) -> None:
        """Look for a plan: from some random orders, then by steering; by that first for many robots, and after a warm start."""
        limit, n = self.settings.time_limit, self.problem.swarm.n
        alone = self.problem.swarm.alike and n <= MOST_ALONE
        before = limit - alone * min(ALONE * limit, 0.5 + ALONE_TIME * (n / 126) ** 3.3)
        long_enough = (1 - UNTANGLED) * before > STEERING_TIME * (n / 62) ** 4
        steers = not (self.large or self.many) and (long_enough or self.settings.max_tries is not None)
        ways = [(UNTANGLED * before / limit if steers else before / limit, self._untangle_some)]
        if steers:
            ways.append((before / limit, self._steer))
        if self.many:
            ways = [(before / limit, self._look_ahead)]
        if alone and n <= FEW:
            place = 0 if n <= EACH_ITS_GROUP else len(ways) if self.settings.first else 1
            ways.insert(place, (1.0, lambda: self._ask_pure_control(self._until(FEW_TIME))))
        for share, way in ways:
            self.latest = self._until(share)
            if not self._done():
                way()
        self.latest = limit
        if alone and self.best.primitives is None and not self._out_of_time():
            self._ask_pure_control(limit)

    def _untangle_some(self) -> None:
        for _ in range(0 if self.settings.warm_start else QUICK_STARTS):
            if not self._done() and self.best.groups is None:
                self._untangle(*next(self.first_guesses))

    def _look_ahead(self) -> None:
        """Follow the receding horizon until it comes to a plan."""
        while not self._done() and self.best.groups is None:
            self._attempt_horizon()

    def _attempt_horizon(self) -> None:
        self._count()
        found = self.horizon.attempt()
        if found is not None:
            self.valid += self._keep(self._order(found[0]), found[1])

    def _steer(self) -> None:
        """Steer until the goals are near, and untangle the rest of the way."""
        if self.best.groups is not None:
            return
        for groups, lengths in approaches(self.problem, self.shapes, self.settings.min_clearance, self.rng, self._done):
            self._untangle(self._order(groups), lengths, self._ends(groups, lengths))
            self.steered = self.untangled
            if self.untangled:
                break

    def _ask_pure_control(self, most: float) -> None:
        """Ask for a plan within so many s."""
        limit = max(min(most, self.latest - self._elapsed()), 1e-3)
        settings = replace(self.settings, time_limit=limit, on_progress=None)
        primitives = pure_control.plan(self.problem, settings, self.rng.spawn(1)[0]).primitives
        if primitives is not None:
            found = Plan(self.problem, primitives)
            if found.valid and found.keeps(self.settings.min_clearance):
                self._offer(primitives, found.groups, found.lengths)

    def _untangle(self, order: Order, guess: np.ndarray, ends: np.ndarray | None = None) -> bool:
        """Untangle an order from a guess and keep the plan if it is the best; return whether it is a plan."""
        self._count()
        return self._part(order, guess, ends)

    def _count(self) -> None:
        self.tries += 1
        self.since_better += 1
        self._tell()

    def _tell(self) -> None:
        if self.settings.on_progress:
            best = self.best.history[-1][1:] if self.best.history else ()
            self.settings.on_progress(Progress(self.tries, *best))

    def _part(self, order: Order, guess: np.ndarray, ends: np.ndarray | None) -> bool:
        """Do what `_untangle` does, without counting it as a try."""
        lengths = untangle(self._path(order, ends), guess, self.rng, 0 if ends is None else KICKS)
        self.untangled = lengths is not None and self._keep(order, lengths)
        self.steered &= not self.untangled
        return self.untangled

    def _try(self, order: Order, guess: np.ndarray, ends: np.ndarray | None = None) -> bool:
        """Solve an order from a guess, with first aims near ends (n, 2), and keep the plan if it is the best.

        Returns:
            Whether it is a plan.
        """
        self._count()
        known = np.inf if self.best.groups is None else self.best.value
        lengths = self._path(order, ends).solve(guess, known)
        valid = lengths is not None and self._keep(order, lengths)
        self.valid += valid
        return valid

    def _meetings(self) -> int:
        """Return how often two robots meet in a first guess."""
        order, guess = self._guess(A_LARGE_SWARM * self.problem.swarm.n, self.spare)
        return len(self._path(order).evaluate(guess, meetings=True).gaps)

    def _first_guesses(self) -> Iterator[tuple[Order, np.ndarray]]:
        """Yield guesses to be untangled, without end; longer ones where that failed, shorter ones where it did not."""
        n = self.problem.swarm.n
        counts, most = [per_robot * n for per_robot in GENEROUS[: 1 if self.many else 2]], GENEROUS_SPARE
        if self.is_open:
            counts, most = [], np.inf
        if self.is_open and self.large:
            counts = [max(A_LARGE_SWARM * n, min(A_LARGE_SWARM * n + A_MEETING * self.meetings, MOST))]
        while True:
            if not (self.large or self.many):
                yield self._guess(self.usual_count, _SPARE)
            for count in counts:
                yield self._guess(count, self.spare)
                self.spare = min(self.spare * (_SHORTER if self.untangled else _LONGER), most)

    def _guess(self, count: int, spare: float) -> tuple[Order, np.ndarray]:
        """Return a random group order of about so many activations, with the group lengths of the lower bound times spare."""
        swarm, used = self.problem.swarm, self.used
        lengths = self.bound_lengths.copy()
        whole_turn = 2 * np.pi * float(swarm.turning_length.mean())
        lengths[-1] = whole_turn / spare
        lengths = np.maximum(lengths, 0.05 * lengths.max())
        cycles = int(max(min(count, self.settings.max_epochs or np.inf) // len(used), 1))
        groups = np.tile(self.rng.permutation(used), cycles) + 1
        guess = spare * lengths[groups - 1] / cycles * self.rng.uniform(0.5, 1.5, len(groups))
        if len(set(swarm.codewords)) < swarm.n:  # only turning tells robots of one codeword apart
            turns = groups == swarm.m
            guess[turns] = self.rng.uniform(0, whole_turn, turns.sum())
        return self._order(groups), guess

    def _changed(self) -> tuple[Order, np.ndarray]:
        """Return the best plan with other groups and lengths in a random stretch."""
        groups, lengths = self.best.groups.copy(), self.best.lengths.copy()
        count = len(groups)
        size = min(max(int(self.rng.uniform(*_STRETCH) * count), 4), count)
        first = self.rng.integers(0, count - size + 1)
        used = self.rng.permutation(np.unique(self.best.groups))
        stretch = slice(first, first + size)
        lengths[stretch] = lengths[stretch].mean() * self.rng.uniform(0.3, 1.7, size)
        groups[stretch] = np.resize(used, size)
        return self._order(groups), lengths

    # Plans found

    def _keep(self, order: Order, lengths: np.ndarray) -> bool:
        """Offer a plan with few activations; return whether it is valid."""
        gap = self._gap(order.groups, lengths)
        if gap <= self.least_gap:
            if gap > self.best.nearest_gap:
                self.best.nearest, self.best.nearest_gap = as_primitives(order.groups, lengths), gap
            return False
        groups, pruned = self._prune(order, lengths)
        if self._offer(as_primitives(groups, pruned), groups, pruned) or self.best.groups is None:
            # what is changed later on keeps its activations: those that are short now may grow
            self.best.groups, self.best.lengths = order.groups, lengths
        return True

    def _offer(self, primitives: tuple[Primitive, ...], groups: np.ndarray, lengths: np.ndarray) -> bool:
        """Take a valid plan if it is the best; return whether it is."""
        most = self.settings.max_epochs
        fewer = not self.best.fewest or len(groups) < self.best.fewest
        if fewer:
            self.best.fewest = len(groups)
        if most is not None and len(groups) > most:
            self.since_better *= not fewer
            return False
        value = self.cost.of(groups, lengths)
        if value >= self.best.value:
            return False
        if value < 0.9995 * self.best.value:
            self.since_better = 0
        self.best.value, self.best.primitives = value, primitives
        swarm = self.problem.swarm
        self.best.history.append((self._elapsed(), path_length(swarm, groups, lengths), execution_time(swarm, lengths)))
        self._tell()
        return True

    def _ends(self, groups: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        return replay(self.problem.swarm, self.problem.starts, groups, lengths)[-1, :, :2]

    def _gap(self, groups: np.ndarray, lengths: np.ndarray) -> float:
        poses = replay(self.problem.swarm, self.problem.starts, groups, lengths)
        return clearance_of(self.problem.swarm, self.shapes, poses, groups, lengths).gap

    def _prune(self, order: Order, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Leave out activations too short to matter, as many as goals, gaps and cost allow; each takes time to select."""
        best = (order.groups, lengths)
        value = self.cost.of(*best)
        ends = self._ends(*best)
        for share in (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3):
            keep = lengths > share * lengths.mean()
            if keep.sum() < 2 * self.problem.swarm.n or self._out_of_time():
                break
            shorter = order.subset(keep)
            restored = self._path(shorter, ends).restore(lengths[keep])
            if restored is None:
                break
            groups, restored = _joined(shorter.groups, restored)
            shorter_value = self.cost.of(groups, restored)
            if shorter_value > 1.0003 * value or self._gap(groups, restored) <= self.least_gap:
                break
            best, value = (groups, restored), shorter_value
        return best

    def _outcome(self) -> Outcome:
        best = self.best
        details = {"tries": self.tries, "valid_starts": self.valid}
        if best.primitives is not None:
            return Outcome(best.primitives, history=tuple(best.history), details=details)
        within = "" if self._tried_out() else f" within {self.settings.time_limit:g} s"
        reason = f"no collision-free plan from {self.tries} starts{within}"
        if best.fewest:
            most = self.settings.max_epochs
            reason = f"max_epochs is {most}, but the shortest plan found has {best.fewest} activations: allow more"
        elif best.nearest is not None:
            reason += f"; the closest one reaches the goals with a smallest gap of {best.nearest_gap:.3g} units"
        return Outcome(best.nearest, reason, details=details)


def _joined(groups: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a sequence with neighbouring activations of one group made one."""
    first = np.flatnonzero(np.r_[True, groups[1:] != groups[:-1]])
    return groups[first], np.add.reduceat(lengths, first)
