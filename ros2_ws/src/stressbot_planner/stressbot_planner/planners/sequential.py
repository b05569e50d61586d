"""`sequential`: disjoint subgroups one after the other, each with a tree of its own (the paper's IC4)."""

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.motion import Motion, World
from stressbot_planner.planners.subgroup_tree import SubgroupTree
from stressbot_planner.planners.tree import check_tolerance
from stressbot_planner.problem import Problem
from stressbot_planner.subgroups import default_order, disjoint_cover

TREES = 5
"""Grown for each subgroup; the shortest way is taken."""

TREES_SHARE = 0.1
"""Of the time limit that all trees but the first ones may take."""

PATIENCE = 100
"""Attempts of one tree before other subgroups are given the way."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised.

    A subgroup that finds no way, because another stands in it, comes again after the others. The details tell which
    robots moved for how many primitives each.

    Raises:
        StressbotError: as `parallel`.
    """
    check_tolerance(problem)
    begin = settings.clock()
    world = World(problem)
    waiting = disjoint_cover(problem.swarm, settings.order or default_order(problem.swarm))
    count = len(waiting)

    def out_of_time(share: float = 1.0) -> bool:
        return settings.clock() - begin > share * settings.time_limit

    motion, nodes, patience, stuck = Motion(world, problem.starts), 0, PATIENCE, False
    done: list[tuple[tuple[int, ...], int]] = []
    while waiting:
        still_waiting = []
        for subgroup in waiting:
            best: Motion | None = None
            for trial in range(TREES):
                if motion.too_long or out_of_time(TREES_SHARE if trial else 1.0):
                    break
                tree = SubgroupTree(world, motion.poses, [subgroup], rng)
                goal = tree.run(patience if tree.reachable or stuck else 0, out_of_time)
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
        if waiting and (out_of_time() or motion.too_long):
            limit = f"{motion.activations} activations" if motion.too_long else f"{settings.time_limit:g} s"
            robots = ", ".join(str(robot) for subgroup in waiting for robot in subgroup.robots)
            reason = (
                f"no plan found within {limit}; {count - len(waiting)} of {count} subgroups are at their goals "
                f"after {nodes} nodes, not robots {robots}"
            )
            return Outcome(tuple(motion.primitives), reason, details={"nodes": nodes, "subgroups": done})
    return Outcome(tuple(motion.primitives), details={"nodes": nodes, "subgroups": done})
