"""Random group orders as first guesses (multistart): how many activations, and how long.

Groups come in cycles of one random permutation, with the group lengths of the lower bound times a factor: short guesses end short,
long ones find ways around.
"""

from collections.abc import Iterator

import numpy as np

from stressbot_planner.planners.optimization.central_path import Order
from stressbot_planner.planners.optimization.search import Search
from stressbot_planner.problem.bounds import group_lengths

PER_ROBOT, PER_ROBOT_AMONG_OBSTACLES = 12, 17
"""K / n: six times as many as goals need, so that gaps can be kept too; with more there are more ways around obstacles."""

FACTOR = 1.6
"""Of the lengths of the bound."""

LONG_PER_ROBOT, LONG_FACTOR = (30, 50), 2.2
"""K / n of longer guesses that are repaired among obstacles where the usual ones fail (of a crowd only the first); and the factor
of the first of them, which is also their largest."""

SHORTER, LONGER = 0.93, 1.1
"""What the factor of the next longer guess is multiplied with, after one became a plan or did not."""

LARGE = 31
"""A large swarm has more robots than this."""

FACTOR_OF_LARGE, FACTOR_A_DOUBLING = 2.1, 0.5
"""The least factor of a large swarm in the open plane, and what is added to FACTOR for each doubling from 42 robots on: the more
they are, the fewer of them head for their goals at once."""

LARGE_PER_ROBOT, PER_MEETING, MOST = 5, 8, 8000
"""K of a large swarm in the open plane: so many a robot for the goals, and for each meeting of two in a guess; at most MOST."""


class RandomOrders:
    """Guesses for one search.

    Attributes:
        usual_count: K of a usual guess.
        large: whether the swarm is.
        meetings: how often two robots of a large swarm in the open plane meet in a first guess, else 0.
    """

    def __init__(self, search: Search):
        self._search = search
        problem = search.problem
        swarm = problem.swarm
        self._open = problem.environment.is_open_plane
        self._lengths = group_lengths(swarm, problem.starts, problem.goals, search.cost.of_group)
        self.used = np.flatnonzero((swarm.group_sizes > 0) | (np.arange(swarm.m) == swarm.m - 1))
        """Groups that are worth an activation, from 0."""
        self.large = swarm.n > LARGE
        self.usual_count = max((PER_ROBOT if self._open else PER_ROBOT_AMONG_OBSTACLES) * swarm.n, 30)
        self._factor, self.meetings = LONG_FACTOR, 0
        if self.large and self._open:
            self._factor = max(FACTOR + FACTOR_A_DOUBLING * np.log2(swarm.n / 42), FACTOR_OF_LARGE)
            order, guess = self._draw(LARGE_PER_ROBOT * swarm.n, self._factor)
            self.meetings = len(search.path(order).evaluate(guess, meetings=True).gaps)

    def usual(self) -> tuple[Order, np.ndarray]:
        """Return a usual guess."""
        return self._draw(self.usual_count, FACTOR)

    def to_repair(self, crowd: bool) -> Iterator[tuple[Order, np.ndarray]]:
        """Yield guesses to be repaired, without end: usual ones by turns with longer ones; in crowds and large swarms only these.

        They get longer where the last one failed and shorter where it did not.
        """
        n = self._search.problem.swarm.n
        counts, most = [per_robot * n for per_robot in LONG_PER_ROBOT[: 1 if crowd else 2]], LONG_FACTOR
        if self._open:
            counts, most = [], np.inf
        if self._open and self.large:
            counts = [max(LARGE_PER_ROBOT * n, min(LARGE_PER_ROBOT * n + PER_MEETING * self.meetings, MOST))]
        while True:
            if not (self.large or crowd):
                yield self.usual()
            for count in counts:
                yield self._draw(count, self._factor)
                self._factor = min(self._factor * (SHORTER if self._search.repaired else LONGER), most)

    def _draw(self, count: int, factor: float) -> tuple[Order, np.ndarray]:
        """Return a random group order of about so many activations, with the group lengths of the lower bound times the factor."""
        search, used = self._search, self.used
        swarm, rng = search.problem.swarm, search.rng
        lengths = self._lengths.copy()
        whole_turn = 2 * np.pi * float(swarm.turning_length.mean())
        lengths[-1] = whole_turn / factor
        lengths = np.maximum(lengths, 0.05 * lengths.max())
        cycles = int(max(min(count, search.settings.max_epochs or np.inf) // len(used), 1))
        groups = np.tile(rng.permutation(used), cycles) + 1
        guess = factor * lengths[groups - 1] / cycles * rng.uniform(0.5, 1.5, len(groups))
        if len(set(swarm.codewords)) < swarm.n:  # only turning tells robots of one codeword apart
            turns = groups == swarm.m
            guess[turns] = rng.uniform(0, whole_turn, turns.sum())
        return search.order(groups), guess
