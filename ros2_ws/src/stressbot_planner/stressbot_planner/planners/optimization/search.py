"""What the stages of `optimize` share: the problem, the limits, the counts of tries, and the incumbent (the best plan so far)."""

from dataclasses import dataclass, field

import numpy as np

from stressbot_planner.collision.clearance import Shapes, clearance_of, gap_at_rest
from stressbot_planner.model.kinematics import execution_time, path_length, replay
from stressbot_planner.planners import Outcome, Progress, Settings
from stressbot_planner.planners.cost import CLOSE_TO_BOUND, Cost
from stressbot_planner.planners.optimization.central_path import CentralPath, Order
from stressbot_planner.planners.optimization.collision_repair import repair
from stressbot_planner.primitives.expansion import Primitive, as_primitives
from stressbot_planner.problem.definition import Problem

STALL = 60
"""Tries in a row without a better plan that end a search, or without a shorter one where all have too many activations."""

PERTURBATIONS = 2
"""Of a sequence that ends near the goals, where its repair fails. Another random order is worth more than a third."""

BETTER = 0.9995
"""Share of the best value below which a plan counts as better."""

PRUNED_SHARES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3)
"""Of the mean length: activations shorter than that are left out, as long as the plan stays valid and gets no dearer."""


@dataclass
class Incumbent:
    """The best plan so far, and of the attempts that are no plans the closest.

    Attributes:
        value: by `Cost`.
        primitives: of the best plan with no more activations than allowed; None: there is none yet.
        base: groups and lengths that are changed to find a better one, with activations that were pruned from the plan.
        history: improvements, as (seconds, path length, execution time).
        nearest, nearest_gap: the attempt with the largest smallest gap, units.
        fewest: activations of the shortest valid plan, allowed or not; 0: none was found.
    """

    value: float = np.inf
    primitives: tuple[Primitive, ...] | None = None
    base: tuple[np.ndarray, np.ndarray] | None = None
    history: list[tuple[float, float, float]] = field(default_factory=list)
    nearest: tuple[Primitive, ...] | None = None
    nearest_gap: float = -np.inf
    fewest: int = 0


class Search:
    """One search by one process.

    Attributes:
        credit: of robots in contact, by which their gaps count as larger, units, see `collision.clearance_of`.
        margin, least_gap: gaps below the one are too small for the optimiser, those above the other are valid, units.
        latest: s after its begin when the stage at work has to end.
        tries, valid, since_better: how many there were, became plans, and have come since the last better plan.
        repaired: whether the last order that was repaired became a plan.
        only_beam_search: whether nothing but beam search has led to a plan.
    """

    def __init__(self, problem: Problem, settings: Settings, rng: np.random.Generator):
        self.problem, self.settings, self.rng = problem, settings, rng
        self.begin, self.latest = settings.clock(), settings.time_limit
        self.shapes = Shapes.of(problem.environment)
        self.credit = problem.credit_at_ends(settings.min_clearance)
        self.least_gap = self._least_gap()
        self.margin = settings.min_clearance + float(problem.swarm.girth.min()) / 3
        self.cost = Cost(problem, settings)
        self.best = Incumbent()
        self.tries = self.valid = self.since_better = 0
        self.repaired = self.only_beam_search = False

    def done(self) -> bool:
        """Return whether time or tries are used up, or nothing more is to be gained."""
        if self.out_of_time() or self.tried_out():
            return True
        if self.best.primitives is None:  # all plans may be too long
            return self.best.fewest > 0 and self.since_better >= STALL
        return self.settings.first or self.best.value <= CLOSE_TO_BOUND or self.since_better >= STALL

    def out_of_time(self) -> bool:
        return self.elapsed() > self.latest

    def until(self, share: float) -> float:
        """Return the end of a share of the time; of all of it where tries are limited: nothing is to depend on the clock then."""
        return self.settings.time_limit * (share if self.settings.max_tries is None else 1.0)

    def tried_out(self) -> bool:
        most = self.settings.max_tries
        return most is not None and self.tries >= most

    def elapsed(self) -> float:
        return self.settings.clock() - self.begin

    def count(self) -> None:
        """Count a try, and tell who listens."""
        self.tries += 1
        self.since_better += 1
        self._tell()

    def order(self, groups: np.ndarray) -> Order:
        return Order(groups, self.problem.swarm.slides[groups - 1], self.cost.of_group[groups - 1])

    def path(self, order: Order, ends: np.ndarray | None = None) -> CentralPath:
        return CentralPath(self.problem, self.shapes, order, self.margin, self.least_gap, ends, self.out_of_time, self.credit)

    def ends(self, groups: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return where robots end, shape (n, 2), units."""
        return replay(self.problem.swarm, self.problem.starts, groups, lengths)[-1, :, :2]

    def repair(self, order: Order, guess: np.ndarray, ends: np.ndarray | None = None) -> bool:
        """Repair the collisions of an order from a guess and keep the plan if it is the best; return whether it is a plan.

        A guess that ends near the goals, at `ends` (n, 2), is worth perturbations.
        """
        lengths = repair(self.path(order, ends), guess, self.rng, 0 if ends is None else PERTURBATIONS)
        self.repaired = lengths is not None and self.keep(order, lengths)
        self.only_beam_search &= not self.repaired
        return self.repaired

    def solve(self, order: Order, guess: np.ndarray, ends: np.ndarray | None = None) -> bool:
        """Solve an order by the central path from a guess, with first aims near ends (n, 2); return whether it is a plan."""
        known = np.inf if self.best.base is None else self.best.value
        lengths = self.path(order, ends).solve(guess, known)
        valid = lengths is not None and self.keep(order, lengths)
        self.valid += valid
        return valid

    def keep(self, order: Order, lengths: np.ndarray) -> bool:
        """Offer a plan with few activations; return whether it is valid."""
        gap = self._gap(order.groups, lengths)
        if gap <= self.least_gap:
            if gap > self.best.nearest_gap:
                self.best.nearest, self.best.nearest_gap = as_primitives(order.groups, lengths), gap
            return False
        groups, pruned = self._prune(order, lengths)
        if self.offer(as_primitives(groups, pruned), groups, pruned) or self.best.base is None:
            # what is changed later on keeps its activations: those that are short now may grow
            self.best.base = order.groups, lengths
        return True

    def offer(self, primitives: tuple[Primitive, ...], groups: np.ndarray, lengths: np.ndarray) -> bool:
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
        if value < BETTER * self.best.value:
            self.since_better = 0
        self.best.value, self.best.primitives = value, primitives
        swarm = self.problem.swarm
        self.best.history.append((self.elapsed(), path_length(swarm, groups, lengths), execution_time(swarm, lengths)))
        self._tell()
        return True

    def outcome(self) -> Outcome:
        """Return the incumbent, or why there is none."""
        best = self.best
        details = {"tries": self.tries, "valid_starts": self.valid}
        if best.primitives is not None:
            return Outcome(best.primitives, history=tuple(best.history), details=details)
        within = "" if self.tried_out() else f" within {self.settings.time_limit:g} s"
        reason = f"no collision-free plan from {self.tries} starts{within}"
        if best.fewest:
            most = self.settings.max_epochs
            reason = f"max_epochs is {most}, but the shortest plan found has {best.fewest} activations: allow more"
        elif best.nearest is not None:
            reason += f"; the closest one reaches the goals with a smallest gap of {best.nearest_gap:.3g} units"
        return Outcome(best.nearest, reason, details=details)

    def _least_gap(self) -> float:
        """Return the gap that plans stay above: the clearance asked for, or a little less where starts or goals leave no more."""
        asked, slack = self.settings.min_clearance, self.problem.slack
        ends = self.problem.starts[:, :2], self.problem.goals
        least = min(gap_at_rest(self.problem.swarm, self.shapes, places, self.credit) for places in ends)
        return asked if least > asked + slack else min(asked - 0.5 * slack, least - 0.01 * slack)

    def _tell(self) -> None:
        if self.settings.on_progress:
            best = self.best.history[-1][1:] if self.best.history else ()
            self.settings.on_progress(Progress(self.tries, *best))

    def _gap(self, groups: np.ndarray, lengths: np.ndarray) -> float:
        poses = replay(self.problem.swarm, self.problem.starts, groups, lengths)
        return clearance_of(self.problem.swarm, self.shapes, poses, groups, lengths, self.credit).gap

    def _prune(self, order: Order, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Leave out activations too short to matter, as many as goals, gaps and cost allow; each takes time to select."""
        best = (order.groups, lengths)
        value = self.cost.of(*best)
        ends = self.ends(*best)
        for share in PRUNED_SHARES:
            keep = lengths > share * lengths.mean()
            if keep.sum() < self.problem.conditions or self.out_of_time():
                break
            shorter = order.subset(keep)
            restored = self.path(shorter, ends).restore(lengths[keep])
            if restored is None:
                break
            groups, restored = _joined(shorter.groups, restored)
            shorter_value = self.cost.of(groups, restored)
            if shorter_value > 1.0003 * value or self._gap(groups, restored) <= self.least_gap:
                break
            best, value = (groups, restored), shorter_value
        return best


def _joined(groups: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a sequence with neighbouring activations of one group made one."""
    first = np.flatnonzero(np.r_[True, groups[1:] != groups[:-1]])
    return groups[first], np.add.reduceat(lengths, first)
