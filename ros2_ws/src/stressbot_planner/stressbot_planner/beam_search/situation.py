"""What does not change while one looks a few activations ahead, and what they lead to: safe slides, poses, ways left.

Slides are checked exactly with bodies that grow by the cone kappa s along the slide: what their headings and speeds are unsure of.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stressbot_planner.beam_search.cost_to_go import DistanceMaps, way_left
from stressbot_planner.collision.clearance import Shapes, kept_gap, polygon_gap
from stressbot_planner.system.kernels import kernel

NEAR, CROWDED = 3.0, 0.02
"""Each pair closer than NEAR of the larger body radius makes the sum of squares this share larger, when it touches."""


class Situation(NamedTuple):
    """Robots as they slide and turn, how sure one is of them, and what surrounds them.

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


@kernel()
def value_of(situation, poses, ripe):
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
def moved(situation, poses, turn, group, length):
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
def slide_is_clear(situation, poses, group, length):
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
