"""`sequential`: disjoint subgroups one after the other, each with a tree of its own (the paper's IC4)."""

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.headings import check_headings_for_rot, turn_to_goals
from stressbot_planner.planners.limit import Limit
from stressbot_planner.planners.motion import Motion, World
from stressbot_planner.planners.trees.subgroup_tree import SubgroupTree
from stressbot_planner.planners.trees.tree import check_tolerance
from stressbot_planner.primitives.subgroups import cover
from stressbot_planner.problem.definition import Problem

TREES = 5
"""Grown for each subgroup; the shortest way is taken."""

TREES_SHARE = 0.1
"""Of the limit that all trees but the first ones may take: of its tries, or if they are not limited, of its time."""

PATIENCE = 100
"""Attempts of one tree before other subgroups are given the way."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised.

    A subgroup that finds no way, because another stands in it, comes again after the others. The details tell which
    robots moved for how many primitives each. A try is an attempt to extend a tree.

    Raises:
        StressbotError: as `parallel`.
    """
    check_tolerance(problem)
    check_headings_for_rot(problem)
    limit = Limit(settings)
    world = World(problem)
    waiting = cover(problem.swarm, settings.order)
    count = len(waiting)

    motion, nodes, patience, stuck = Motion(world, problem.starts), 0, PATIENCE, False
    done: list[tuple[tuple[int, ...], int]] = []
    while waiting:
        still_waiting = []
        for subgroup in waiting:
            best: Motion | None = None
            for trial in range(TREES):
                if motion.too_long or limit.over(TREES_SHARE if trial else 1.0):
                    break
                tree = SubgroupTree(world, motion.poses, [subgroup], rng)
                goal = tree.run(patience if tree.reachable or stuck else 0, limit)
                nodes += len(tree)
                if goal is None:
                    break
                way = tree.way_to(goal)
                if best is None or way.path < best.path:
                    best = way
            if best is None:
                still_waiting.append(subgroup)
            else:
                motion.append(best)
                done.append((subgroup.robots, len(best.primitives)))
        stuck = len(still_waiting) == len(waiting)
        patience *= 2 if stuck else 1
        waiting = still_waiting
        if waiting and (limit.over() or motion.too_long):
            within = f"{motion.activations} activations" if motion.too_long else limit
            robots = ", ".join(str(robot) for subgroup in waiting for robot in subgroup.robots)
            reason = (
                f"no plan found within {within}; {count - len(waiting)} of {count} subgroups are at their goals "
                f"after {nodes} nodes, not robots {robots}"
            )
            return Outcome(tuple(motion.primitives), reason, details={"nodes": nodes, "subgroups": done})
    reason = turn_to_goals(motion, rng, limit)
    return Outcome(tuple(motion.primitives), reason, details={"nodes": nodes, "subgroups": done})
