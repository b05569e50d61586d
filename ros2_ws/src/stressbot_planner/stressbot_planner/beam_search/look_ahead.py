"""A few activations that bring a swarm nearer to its goals, safely: a beam search from where the robots are.

No plan to the end. What is made small is the sum of squares of the ways left (`distance_maps`). A *move* turns all robots by an
angle and then lets one group slide. For each group there is one angle at which that gains most: the slopes of the ways of its
members, as complex numbers, add up to a number whose argument it is. With random headings seven members gain about as much as
three would alone, so that each such move takes a tenth off the sum, far from the goals and near them. Random moves before make
other headings, where those that there are do not help.

Slides are checked exactly with bodies that grow by the cone kappa s along the slide: what their headings and speeds are unsure of.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stressbot_planner.beam_search.cost_to_go import DistanceMaps, way_left
from stressbot_planner.collision.clearance import Shapes, kept_gap, polygon_gap
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

NEAR, CROWDED = 3.0, 0.02
"""Each pair closer than NEAR of the larger body radius makes the sum of squares this share larger, when it touches."""


class Move(NamedTuple):
    """Turn all robots by an activation of G_m, then slide one group; lengths in those of the swarm."""

    turn: float
    group: int
    length: float


class Situation(NamedTuple):
    """What does not change while one looks ahead.

    Attributes:
        slides: how far each robot slides in a length of 1, shape (m, n).
        turning_length: shape (n,).
        cone: kappa, growth of each body for each unit that it slides, shape (n,).
        body: radii, shape (n,).
        least: gap that bodies keep, or the one that they have if it is smaller (see `collision.kept_gap`), units.
        slack: see `Problem.slack`.
        points_too: whether two points keep that gap.
        circles, edges, edge_ends, walls: see `collision.Shapes`.
        low, size, excess, goals: see `DistanceMaps`.
    """

    slides: np.ndarray
    turning_length: np.ndarray
    cone: np.ndarray
    body: np.ndarray
    least: float
    slack: float
    points_too: bool
    circles: np.ndarray
    edges: np.ndarray
    edge_ends: np.ndarray
    walls: np.ndarray
    low: np.ndarray
    size: float
    excess: np.ndarray
    goals: np.ndarray

    @classmethod
    def of(
        cls, slides: ArrayLike, turning_length: ArrayLike, cone: ArrayLike, body: ArrayLike, least: float, slack: float,
        points_too: bool, shapes: Shapes, maps: DistanceMaps,
    ) -> "Situation":
        """Return a situation of arrays of one kind, copies: loops are compiled for each kind that they meet, in seconds."""
        def copied(values: ArrayLike) -> np.ndarray:
            return np.array(values, dtype=float, order="C")

        return cls(
            copied(slides), copied(turning_length), copied(cone), copied(body), float(least), float(slack), bool(points_too),
            *shapes.kernel_arguments, *maps,
        )


def look_ahead(
    situation: Situation, poses: np.ndarray, known: list[Move], rng: np.random.Generator, ripe: float
) -> list[Move]:
    """Return safe moves that bring robots at poses (n, 3) near to their goals; empty if not even the first of any is safe.

    Args:
        situation: the robots, and what surrounds them.
        poses: directions in which the robots slide in place of their headings.
        known: moves that were found before; they are returned if nothing better is found now.
        rng: for random moves.
        ripe: largest way left, units, below which a position is as good as it need be.
    """
    draws = rng.random((DEPTH, width_for(len(poses)), RANDOM, 3))
    poses = np.array(poses, dtype=float, order="C")  # see `Situation.of`
    turns, groups, lengths, value = _beam(situation, poses, draws, ripe)
    if known:
        before = tuple(np.array(column) for column in zip(*known, strict=True))
        if _followed(situation, poses, before[0], before[1] - 1, before[2], ripe) <= value:
            return known
    return [Move(*entry) for entry in zip(turns.tolist(), (groups + 1).tolist(), lengths.tolist(), strict=True)]


def width_for(n: int) -> int:
    """Return how many positions of n robots are kept after each move: less of large swarms, where each takes n^2 as long."""
    return int(np.clip(WIDTH * (_MANY / n) ** 2, 8, WIDTH))


def is_clear_move(situation: Situation, poses: np.ndarray, move: Move) -> bool:
    """Return whether a move is safe for robots at poses (n, 3)."""
    turned = _moved(situation, np.array(poses, dtype=float, order="C"), move.turn, move.group - 1, 0.0)
    return bool(_slide_is_clear(situation, turned, move.group - 1, move.length))


@kernel()
def _followed(situation, start, turns, groups, lengths, ripe):
    """Return the aged value where moves lead, infinite if one is not safe."""
    poses = start
    for k in range(len(turns)):
        if not _slide_is_clear(situation, _moved(situation, poses, turns[k], groups[k], 0.0), groups[k], lengths[k]):
            return np.inf
        poses = _moved(situation, poses, turns[k], groups[k], lengths[k])
    return (_value(situation, poses, ripe) + 1e-12) * AGEING ** -len(turns)


@kernel()
def _value(situation, poses, ripe):
    """Return the sum of squares of the ways left, made larger where bodies are close; 0 if all ways are ripe."""
    n = poses.shape[0]
    total, largest = 0.0, 0.0
    for j in range(n):
        way = way_left(j, poses[j, 0], poses[j, 1], situation.low, situation.size, situation.excess, situation.goals)[0]
        total += way * way
        largest = max(largest, way)
    if largest <= ripe:
        return 0.0
    crowd = 0.0
    for i in range(n):
        for j in range(i):
            dx, dy = poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]
            near = NEAR * max(situation.body[i], situation.body[j])
            if near == 0.0:
                continue
            gap = np.sqrt(dx * dx + dy * dy) - situation.body[i] - situation.body[j]
            if gap < near:
                crowd += (1.0 - gap / near) ** 2
    return total * (1.0 + CROWDED * crowd)


@kernel()
def _cone_is_clear(dx, dy, vx, vy, bodies, least, slack, growth, length):
    """Return whether |(dx, dy) + s (vx, vy)| >= bodies + least + growth s for all s in [0, length], or what they have now."""
    radius = bodies + kept_gap(least, np.sqrt(dx * dx + dy * dy) - bodies, slack)
    square = vx * vx + vy * vy - growth * growth
    slope = dx * vx + dy * vy - radius * growth
    s = length
    if square > 0.0:
        s = min(max(-slope / square, 0.0), length)
    for at in (s, length):
        x, y = dx + at * vx, dy + at * vy
        if np.sqrt(x * x + y * y) < radius + growth * at:
            return False
    return True


@kernel()
def _slide_is_clear(situation, poses, group, length):
    """Return whether robots that slide from poses keep apart from all others and the environment, wherever in their cones."""
    slides, body, cone, n = situation.slides[group], situation.body, situation.cone, poses.shape[0]
    for i in range(n):
        if slides[i] == 0.0:
            continue
        x, y = poses[i, 0], poses[i, 1]
        ux, uy = slides[i] * np.cos(poses[i, 2]), slides[i] * np.sin(poses[i, 2])
        mine = slides[i] * cone[i]
        reach = slides[i] * length + mine * length + body[i] + situation.least
        for c in range(situation.circles.shape[0]):
            dx, dy, bodies = x - situation.circles[c, 0], y - situation.circles[c, 1], body[i] + situation.circles[c, 2]
            if not _cone_is_clear(dx, dy, ux, uy, bodies, situation.least, situation.slack, mine, length):
                return False
        for end in range(2):
            for axis in range(2):
                sign = 1.0 - 2.0 * end
                now = sign * (poses[i, axis] - situation.walls[2 * axis + end]) - body[i]
                rate = sign * (ux if axis == 0 else uy) - mine
                if now + rate * length < kept_gap(situation.least, now, situation.slack) and rate < 0.0:
                    return False
        first = 0
        for p in range(situation.edge_ends.shape[0]):
            edges = situation.edges[first : situation.edge_ends[p]]
            first = situation.edge_ends[p]
            before = 0.0
            least = body[i] + kept_gap(situation.least, polygon_gap(x, y, ux, uy, 0.0, edges)[0] - body[i], situation.slack)
            for share in (0.015625, 0.0625, 0.25, 0.5, 1.0):
                until = share * length
                gap = polygon_gap(x + before * ux, y + before * uy, ux, uy, until - before, edges)[0]
                if gap < least + mine * until:
                    return False
                before = until
        for j in range(n):
            bodies = body[i] + body[j]
            if j == i or (slides[j] > 0.0 and j > i) or (bodies == 0.0 and not situation.points_too):
                continue
            dx, dy = x - poses[j, 0], y - poses[j, 1]
            if dx * dx + dy * dy > (reach + body[j] + slides[j] * (1.0 + cone[j]) * length) ** 2:
                continue
            vx = ux - slides[j] * np.cos(poses[j, 2])
            vy = uy - slides[j] * np.sin(poses[j, 2])
            if not _cone_is_clear(dx, dy, vx, vy, bodies, situation.least, situation.slack, mine + slides[j] * cone[j], length):
                return False
    return True


@kernel()
def _moved(situation, poses, turn, group, length):
    """Return poses (n, 3) after a move."""
    n = poses.shape[0]
    after = poses.copy()
    for j in range(n):
        after[j, 2] += turn / situation.turning_length[j]
        if situation.slides[group, j] > 0.0:
            after[j, 0] += length * situation.slides[group, j] * np.cos(after[j, 2])
            after[j, 1] += length * situation.slides[group, j] * np.sin(after[j, 2])
        else:
            after[j, 2] += length / situation.turning_length[j]
    return after


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
def _beam(situation, start, draws, ripe):
    """Return turns, groups (from 0), lengths of the best moves found, each (d,), and the aged value that they lead to."""
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
                turned = _moved(situation, nodes[node], turn, group, 0.0)
                if length > SHORTEST * mean_turning and _slide_is_clear(situation, turned, group, length):
                    values[at] = _value(situation, _moved(situation, nodes[node], turn, group, length), ripe)
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
            following[count] = _moved(situation, nodes[parent], moves[at, 0], int(moves[at, 1]), moves[at, 2])
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
    return turns, groups, lengths, best
