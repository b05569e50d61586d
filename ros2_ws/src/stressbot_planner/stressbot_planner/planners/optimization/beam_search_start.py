"""First plans from beam search: sequences that bring a swarm near its goals and touch nothing, and their repair.

The beam search gains a share of the cost-to-go with each move, so that it comes near soon and gets there never. From near its
goals collision repair needs only small changes of all durations to have every robot there.
"""

from collections.abc import Callable, Iterator

import numpy as np

from stressbot_planner.beam_search.cost_to_go import distance_maps
from stressbot_planner.beam_search.look_ahead import look_ahead
from stressbot_planner.beam_search.situation import Situation
from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners.optimization.search import Search
from stressbot_planner.problem.definition import Problem

FIRST_COST_TO_GO, FALL = 12.0, 0.7
"""Largest way left of the first sequence, in turning radii, and the share that is left in each one after it."""

STALL_SHARE, STALL_LOOKS = 0.9, 500
"""It ends where so many looks ahead do not bring the sum of squares of the ways left below this share."""


def repair_beam_search(search: Search) -> None:
    """Follow the beam search until the goals are near, and repair the rest of the way, until that is a plan."""
    for groups, lengths in approaches(search.problem, search.shapes, search.settings.min_clearance, search.rng, search.done):
        search.count()
        search.only_beam_search = search.repair(search.order(groups), lengths, search.ends(groups, lengths))
        if search.repaired:
            break


def approaches(
    problem: Problem, shapes: Shapes, least_gap: float, rng: np.random.Generator, out_of_time: Callable[[], bool]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield groups (K,) and lengths (K,), units: beginnings of one sequence, each of which ends nearer to the goals.

    It goes on until robots are in each other's way for too long, or time is over.
    """
    swarm = problem.swarm
    maps = distance_maps(shapes, swarm.body_radius, problem.starts[:, :2], problem.goals)
    robots = swarm.slides, swarm.turning_length, np.zeros(swarm.n), swarm.body_radius
    situation = Situation.of(*robots, least_gap, problem.slack, least_gap > 0, shapes, maps)
    wanted = FIRST_COST_TO_GO * float(swarm.turning_radius.mean())
    poses, groups, lengths = problem.starts, [], []
    least, since = np.inf, 0
    while since < STALL_LOOKS and not out_of_time():
        for move in look_ahead(situation, poses, rng):
            step = np.array([swarm.m, move.group]), np.array([move.turn, move.length])
            poses = replay(swarm, poses, *step)[-1]
            groups.append(step[0])
            lengths.append(step[1])
        ways = maps.ways_left(poses[:, :2])
        left, since = float(ways @ ways), since + 1
        if left < STALL_SHARE * least:
            least, since = left, 0
        if groups and ways.max() <= wanted:
            yield np.concatenate(groups), np.concatenate(lengths)
            wanted = FALL * min(wanted, float(ways.max()))
