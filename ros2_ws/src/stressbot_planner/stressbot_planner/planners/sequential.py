"""`sequential`: disjoint subgroups one after the other, each with a tree of its own (the paper's IC4)."""

import numpy as np

from stressbot_planner.kinematics import path_length
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.steering import SubgroupSteering
from stressbot_planner.planners.tree import Growth, check_tolerance
from stressbot_planner.primitives import Primitive, expand
from stressbot_planner.problem import Problem
from stressbot_planner.subgroups import default_order, disjoint_cover

TREES = 3
"""Grown for each subgroup; the shortest way is taken."""

PATIENCE = 400
"""Nodes of one tree before other subgroups are given the way."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised.

    A subgroup that finds no way, because another stands in it, comes again after the others.

    Raises:
        StressbotError: as `parallel`.
    """
    check_tolerance(problem)
    deadline = settings.clock() + settings.time_limit
    waiting = disjoint_cover(problem.swarm, settings.order or default_order(problem.swarm))
    poses = problem.starts
    done: tuple[Primitive, ...] = ()
    nodes, patience = 0, PATIENCE
    while waiting:
        still_waiting = []
        for subgroup in waiting:
            ways = []
            for _ in range(TREES):
                growth = Growth(
                    problem, poses, np.array(subgroup.robots) - 1, SubgroupSteering(problem.swarm, [subgroup]), rng
                )
                goal = growth.run(
                    lambda tree=growth.tree, most=patience: len(tree) > most or settings.clock() > deadline
                )
                nodes += len(growth.tree)
                if goal is None:
                    break
                ways.append((growth.tree.primitives_to(goal), growth.tree.poses[goal]))
            if ways:
                primitives, poses = min(ways, key=lambda way: path_length(problem.swarm, *expand(problem.swarm, way[0])))
                done += primitives
            else:
                still_waiting.append(subgroup)
        if len(still_waiting) == len(waiting):
            patience *= 2
        waiting = still_waiting
        if waiting and settings.clock() > deadline:
            robots = ", ".join(str(robot) for subgroup in waiting for robot in subgroup.robots)
            reason = f"no way found within {settings.time_limit:g} s; not at their goals: robots {robots}"
            return Outcome(done, reason, details={"nodes": nodes})
    return Outcome(done, details={"nodes": nodes})
