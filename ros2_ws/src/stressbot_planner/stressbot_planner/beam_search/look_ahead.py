"""A few activations that bring a swarm nearer to its goals, safely: a beam search from where the robots are.

No plan to the end. What is made small is the sum of squares of the ways left (`distance_maps`). A *move* turns all robots by an
angle and then lets one group slide. For each group there is one angle at which that gains most: the slopes of the ways of its
members, as complex numbers, add up to a number whose argument it is. With random headings seven members gain about as much as
three would alone, so that each such move takes a tenth off the sum, far from the goals and near them. Random moves before make
other headings, where those that there are do not help.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.beam_search.cost_to_go import way_left
from stressbot_planner.beam_search.situation import Situation, moved, slide_is_clear, value_of
from stressbot_planner.system.kernels import kernel

DEPTH, WIDTH = 6, 200
"""Moves that are looked ahead, and positions of up to fourteen robots that are kept after each."""

_MANY = 14

RANDOM = 12
"""Random moves tried from each position, beside the best one of each group at some lengths."""

SHARES = (1.0, 0.5, 0.2)
"""Of the best slide that are tried."""

SHORTEST = 0.01
"""Of the mean turning length: shorter slides are not worth an activation."""

SIBLINGS = 8
"""Positions kept of one parent."""

AGEING = 0.998
"""A further move must bring the sum of squares below this share."""


class Move(NamedTuple):
    """Turn all robots by an activation of G_m, then slide one group; lengths in those of the swarm."""

    turn: float
    group: int
    length: float


def look_ahead(situation: Situation, poses: np.ndarray, rng: np.random.Generator) -> list[Move]:
    """Return safe moves that bring robots at poses (n, 3) near to their goals; empty if not even the first of any is safe."""
    draws = rng.random((DEPTH, width_for(len(poses)), RANDOM, 3))
    poses = np.array(poses, dtype=float, order="C")  # see `Situation.of`
    turns, groups, lengths = _beam(situation, poses, draws)
    return [Move(*entry) for entry in zip(turns.tolist(), (groups + 1).tolist(), lengths.tolist(), strict=True)]


def width_for(n: int) -> int:
    """Return how many positions of n robots are kept after each move: less of large swarms, where each takes n^2 as long."""
    return int(np.clip(WIDTH * (_MANY / n) ** 2, 8, WIDTH))


@kernel()
def _best_of_group(situation, poses, group, mean_turning_length):
    """Return (turn, length) that makes the sum of squares smallest, to second order."""
    real, imaginary, weight = 0.0, 0.0, 0.0
    for j in range(poses.shape[0]):
        pace = situation.slides[group, j]
        if pace == 0.0:
            continue
        way, gx, gy = way_left(j, poses[j, 0], poses[j, 1], situation.low, situation.size, situation.excess, situation.goals)
        cosine, sine = np.cos(poses[j, 2]), np.sin(poses[j, 2])
        # downhill in the robot's own frame
        real -= pace * way * (gx * cosine + gy * sine)
        imaginary -= pace * way * (gy * cosine - gx * sine)
        weight += pace * pace
    turn = np.arctan2(imaginary, real) % (2.0 * np.pi)
    return turn * mean_turning_length, np.hypot(real, imaginary) / max(weight, 1e-300)


@kernel(nogil=True)
def _beam(situation, start, draws):
    """Return turns, groups (from 0), lengths of the best moves found, each (d,)."""
    depth, width, tries, _ = draws.shape
    n, sliding = start.shape[0], situation.slides.shape[0] - 1
    mean_turning = situation.turning_length.mean()
    per_node = sliding * len(SHARES) + tries
    nodes = np.empty((width, n, 3))
    nodes[0] = start
    kept = 1
    longest = 4.0 * np.pi * mean_turning
    path = np.zeros((depth, width, 3))
    parents = np.zeros((depth, width), dtype=np.int64)
    best, best_depth, best_node = np.inf, -1, 0
    for d in range(depth):
        values = np.full(kept * per_node, np.inf)
        moves = np.empty((kept * per_node, 3))
        for node in range(kept):
            at = node * per_node
            for group in range(sliding):
                turn, length = _best_of_group(situation, nodes[node], group, mean_turning)
                for share in SHARES:
                    moves[at, 0], moves[at, 1], moves[at, 2] = turn, group, min(share * length, longest)
                    at += 1
            for r in range(tries):
                turn, which, size = draws[d, node, r]
                turn = 2.0 * np.pi * mean_turning * max(1.25 * turn - 0.25, 0.0)
                moves[at, 0], moves[at, 1] = turn, int(which * sliding)
                moves[at, 2] = 4.0 * mean_turning * np.exp(-4.0 * size)
                at += 1
            for at in range(node * per_node, (node + 1) * per_node):
                turn, group, length = moves[at, 0], int(moves[at, 1]), moves[at, 2]
                turned = moved(situation, nodes[node], turn, group, 0.0)
                if length > SHORTEST * mean_turning and slide_is_clear(situation, turned, group, length):
                    values[at] = value_of(situation, moved(situation, nodes[node], turn, group, length), 0.0)
        order = np.argsort(values)
        siblings = np.zeros(kept, dtype=np.int64)
        following = np.empty((width, n, 3))
        count = 0
        for at in order:
            if count == width or np.isinf(values[at]):
                break
            parent = at // per_node
            if siblings[parent] == SIBLINGS and d > 0:
                continue
            siblings[parent] += 1
            following[count] = moved(situation, nodes[parent], moves[at, 0], int(moves[at, 1]), moves[at, 2])
            path[d, count], parents[d, count] = moves[at], parent
            aged = (values[at] + 1e-12) * AGEING**-d
            if aged < best or best_depth < 0:
                best, best_depth, best_node = aged, d, count
            count += 1
        if count == 0:
            break
        nodes, kept = following, count
        if best <= 1e-9:
            break
    turns, groups, lengths = np.empty(best_depth + 1), np.empty(best_depth + 1, dtype=np.int64), np.empty(best_depth + 1)
    node = best_node
    for d in range(best_depth, -1, -1):
        turns[d], groups[d], lengths[d] = path[d, node, 0], int(path[d, node, 1]), path[d, node, 2]
        node = parents[d, node]
    return turns, groups, lengths
