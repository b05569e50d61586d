"""`rrt_rotation`: a tree whose moves turn robots toward the sample by Rot, then slide a group (EC1)."""

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.trees.subgroup_tree import grow
from stressbot_planner.planners.trees.tree import check_tolerance
from stressbot_planner.primitives.subgroups import subgroups
from stressbot_planner.problem.definition import Problem


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised.

    With an order r the moves are those of all brackets up to r: the problem M(n, r). Without one, of the groups.

    Raises:
        StressbotError: the tolerance is too small for a tree, headings at goals are of robots of different turning radii, or the
            order is out of range.
    """
    check_tolerance(problem)
    moving = [group for order in range(1, (settings.order or 1) + 1) for group in subgroups(problem.swarm, order)]
    return grow(problem, moving, settings, rng)
