"""`parallel`: a tree over all robots whose moves are those of disjoint subgroups (the paper's IC3)."""

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.trees.subgroup_tree import grow
from stressbot_planner.planners.trees.tree import check_tolerance
from stressbot_planner.primitives.subgroups import cover
from stressbot_planner.problem.definition import Problem


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised.

    Raises:
        StressbotError: the tolerance is too small for a tree, headings at goals are of robots of different turning radii, or no
            disjoint subgroups of the order cover the swarm.
    """
    check_tolerance(problem)
    subgroups = cover(problem.swarm, settings.order)
    return grow(problem, subgroups, settings, rng)
