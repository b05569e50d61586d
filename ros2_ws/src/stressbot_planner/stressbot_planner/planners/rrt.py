"""`rrt`: the original tree of the paper (EC1), one group at a time in the space of all poses."""

from collections.abc import Iterator

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.tree import Growth, Moves, check_tolerance, outcome_of
from stressbot_planner.primitives import TURN, Activate
from stressbot_planner.problem import Problem
from stressbot_planner.swarm import Swarm

TRIES = 20
"""Activations tried for each extension."""

REACH = 5.0
"""Longest activation, in turning radii; G_m turns by up to 2 pi."""

HEADING_WEIGHT = 1.0
"""Turning radii that a unit vector of heading counts as: without it the tree does not care where robots look."""


class ActivationSteering:
    """Random activations of single groups."""

    def __init__(self, swarm: Swarm, rng: np.random.Generator):
        self.rng = rng
        radius = float(swarm.turning_radius.mean())
        self.reach = np.full(swarm.m, REACH * radius)
        self.reach[-1] = TURN * radius

    def __call__(self, poses: np.ndarray, targets: np.ndarray) -> Iterator[Moves]:
        """Yield one list of moves."""
        groups = self.rng.integers(len(self.reach), size=TRIES)
        lengths = self.rng.uniform(0, self.reach[groups])
        yield [(Activate(int(group) + 1, float(length)),) for group, length in zip(groups, lengths, strict=True)]


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised. Takes any turning radii.

    Raises:
        StressbotError: the tolerance is too small for a tree.
    """
    check_tolerance(problem)
    deadline = settings.clock() + settings.time_limit
    growth = Growth(
        problem,
        problem.starts,
        np.arange(problem.swarm.n),
        ActivationSteering(problem.swarm, rng),
        rng,
        heading_weight=HEADING_WEIGHT * float(problem.swarm.turning_radius.mean()),
    )
    return outcome_of(growth, growth.run(lambda: settings.clock() > deadline), settings)
