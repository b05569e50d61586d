"""Robots near where they should be, and apart: nonlinear least squares over the durations of a fixed group order.

    minimise    1/2 a sum_j u_j^2 |aim_j - p_j|^2 + 1/2 sum_f w_f max(0, margin - gap_f)^2 + 1/2 a b (C - sum_k c_k t_k)^2
    over        t = s^2

by Levenberg-Marquardt steps, in single precision, by rows where those are fewer than the durations. All lengths are in turning
radii, so that the numbers mean the same for any swarm.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import spotrf, spotrs  # pyright: ignore[reportAttributeAccessIssue] - compiled, without stub

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners.optimization.receding_horizon.crowd_derivatives import (
    Gaps,
    Trajectory,
    boxes_of,
    crowd_jacobian,
    gaps_of,
    trajectory_of,
)
from stressbot_planner.system.kernels import kernel

SHORTEST = 1e-3
"""Least s."""

LEAST_DAMPING, DAMPING, MORE, LESS, ATTEMPTS = 3e-6, 1e-2, 5.0, 0.3, 7
"""Of the mean diagonal: the least damping and the first; how it grows after an attempt that fails, and shrinks after a
step whose first one does not; so many attempts at a step."""

STALL, STALLED_CLEAR, LOOK_BACK = 0.03, 0.1, 5
"""A descent ends where the last steps gained less than this share: of any, of those whose first part is clear already."""


@dataclass(frozen=True, eq=False)
class Crowd:
    """A swarm and its surroundings in mean turning radii, as the kernels take them."""

    slides: np.ndarray
    turning_length: np.ndarray
    turning_lengths: np.ndarray
    kind: np.ndarray
    body: np.ndarray
    shapes: Shapes
    boxes: np.ndarray
    unit: float

    @classmethod
    def of(cls, swarm: Swarm, shapes: Shapes) -> "Crowd":
        """Take lengths in mean turning lengths."""
        unit = float(swarm.turning_length.mean())
        lengths, kind = np.unique(swarm.turning_length / unit, return_inverse=True)
        scaled = Shapes(shapes.circles / unit, shapes.edges / unit, shapes.edge_ends, shapes.walls / unit, shapes.names)
        return cls(
            np.ascontiguousarray(swarm.slides.T), swarm.turning_length / unit, lengths, kind, swarm.body_radius / unit,
            scaled, boxes_of(scaled), unit,
        )

    @property
    def n(self) -> int:
        """Number of robots."""
        return self.slides.shape[0]

    @property
    def m(self) -> int:
        """Number of groups."""
        return self.slides.shape[1]

    def slides_of(self, groups: np.ndarray) -> np.ndarray:
        """Return the distance that each robot slides for each unit of length of activations (K,), shape (n, K)."""
        return np.ascontiguousarray(self.slides[:, groups - 1])

    def trajectory(self, slides: np.ndarray, start: np.ndarray, t: np.ndarray) -> Trajectory:
        """Return the trajectory from poses (n, 3) along lengths (K,)."""
        return Trajectory(*trajectory_of(slides, self.turning_lengths, self.kind, start, t))

    def gaps(self, trajectory: Trajectory, slides: np.ndarray, t: np.ndarray, reach: float, meetings: bool = True) -> Gaps:
        """Return the gaps below reach: one a meeting of two bodies, or one an activation."""
        capacity = 6 * len(t) + 400
        while True:
            found, *arrays = gaps_of(
                capacity, trajectory, slides, t, self.body, self.boxes, *self.shapes.kernel_arguments, reach, self.m, meetings
            )
            if found <= capacity:
                return Gaps(*(array[:found] for array in arrays))
            capacity = found + 100

    def clear_until(self, start: np.ndarray, groups: np.ndarray, t: np.ndarray, least_gap: float) -> int:
        """Return how many activations from the first on keep all gaps above least_gap."""
        slides = self.slides_of(groups)
        trajectory = self.trajectory(slides, start, t)
        gaps = self.gaps(trajectory, slides, t, np.nextafter(least_gap, np.inf), meetings=False)
        return int(gaps.knot.min()) if len(gaps.size) else len(t)


@dataclass(frozen=True, eq=False)
class SoftGoals:
    """One fixed order of K activations, and where its robots should end.

    Attributes:
        crowd: the robots.
        start: poses, shape (n, 3).
        slides: shape (n, K), see `Crowd.slides_of`.
        aims: shape (n, 2).
        urgency: u, how much each robot's aim weighs, shape (n,).
        price: c, of a unit of each length, shape (K,).
        total: C, wanted price of all.
        margin: gaps below it are too small.
        least_gap: gaps up to it are collisions.
        safe: activations that must be clear; later gaps weigh `behind`.
        behind: see `safe`.
    """

    crowd: Crowd
    start: np.ndarray
    slides: np.ndarray
    aims: np.ndarray
    urgency: np.ndarray
    price: np.ndarray
    total: float
    margin: float
    least_gap: float
    safe: int
    behind: float = 1.0

    def evaluate(self, t: np.ndarray, aim_weight: float, total_weight: float, meetings: bool) -> "CrowdPoint":
        """Return what follows from lengths t (K,)."""
        trajectory = self.crowd.trajectory(self.slides, self.start, t)
        gaps = self.crowd.gaps(trajectory, self.slides, t, self.margin, meetings)
        value, weights, misses = _value(
            trajectory.x, trajectory.y, gaps.size, gaps.knot, t, self.aims, self.urgency, self.price, self.total, self.margin,
            self.safe, self.behind, aim_weight, total_weight,
        )
        return CrowdPoint(t, trajectory, gaps, weights, misses, value)

    def rows(self, here: "CrowdPoint", aim_weight: float, total_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """Return weighted derivatives (2n + g + 1, K) with respect to s, and what is missing, shape (2n + g + 1,)."""
        root, total_root = np.sqrt(aim_weight), np.sqrt(aim_weight * total_weight)
        aim_weights, gap_weights = root * self.urgency, np.sqrt(here.weights)
        rows = crowd_jacobian(
            here.trajectory, self.slides, self.crowd.turning_length, here.t, aim_weights, here.gaps, gap_weights,
            total_root * self.price,
        )
        missing = np.concatenate([
            (aim_weights[:, None] * here.misses).ravel(),
            gap_weights * (self.margin - here.gaps.size),
            [total_root * (self.total - self.price @ here.t)],
        ])
        return rows, missing.astype(np.float32)


@kernel()
def _value(x, y, size, knot, t, aims, urgency, price, total, margin, safe, behind, aim_weight, total_weight):
    """Return what is minimised, the weights of gaps (g,), and what aims are missed by, shape (n, 2)."""
    n, count = x.shape[0], len(t)
    weights, misses = np.empty(len(size)), np.empty((n, 2))
    missed, short, priced = 0.0, 0.0, 0.0
    for j in range(n):
        misses[j, 0], misses[j, 1] = aims[j, 0] - x[j, count], aims[j, 1] - y[j, count]
        missed += urgency[j] ** 2 * (misses[j, 0] ** 2 + misses[j, 1] ** 2)
    for f in range(len(size)):
        weights[f] = 1.0 if knot[f] <= safe else behind
        short += weights[f] * (margin - size[f]) ** 2
    for k in range(count):
        priced += price[k] * t[k]
    return 0.5 * (aim_weight * missed + short + aim_weight * total_weight * (total - priced) ** 2), weights, misses


@dataclass(frozen=True, eq=False)
class CrowdPoint:
    """Lengths t (K,), and what was computed there."""

    t: np.ndarray
    trajectory: Trajectory
    gaps: Gaps
    weights: np.ndarray
    misses: np.ndarray
    value: float

    def is_clear(self, until: int, least_gap: float) -> bool:
        """Return whether all gaps of the activations before a knot are above least_gap."""
        return not np.any(self.gaps.size[self.gaps.knot <= until] <= least_gap)

    def clear_until(self, least_gap: float) -> int:
        """Return the first knot at which a gap is too small, K if there is none."""
        short = self.gaps.knot[self.gaps.size <= least_gap]
        return int(short.min()) if len(short) else len(self.t)


def levenberg_marquardt(
    problem: SoftGoals, t: np.ndarray, aim_weight: float, total_weight: float, steps: int,
    meetings: bool = True, solve: bool = False,
) -> CrowdPoint:
    """Descend from lengths t.

    Args:
        problem: what is minimised.
        t: shape (K,), > 0.
        aim_weight: a.
        total_weight: b, of the price.
        steps: at most so many.
        meetings: see `Crowd.gaps`.
        solve: go on while a residual of zero seems in reach, instead of until the first part is clear.
    """
    here = problem.evaluate(t, aim_weight, total_weight, meetings)
    values = [here.value]
    damping = None
    for _ in range(steps):
        rows, missing = problem.rows(here, aim_weight, total_weight)
        by_rows = len(rows) < len(here.t)
        square = rows @ rows.T if by_rows else rows.T @ rows
        right = missing if by_rows else rows.T @ missing
        scale = float(np.trace(square)) / len(square)
        if not scale > 0.0:
            break
        damping = DAMPING * scale if damping is None else damping
        there, first = None, True
        for _ in range(ATTEMPTS):
            damping = max(damping, LEAST_DAMPING * scale)
            damped = square.copy()
            damped.flat[:: len(damped) + 1] += np.float32(damping)
            factor, failed = spotrf(damped, lower=0, clean=0, overwrite_a=1)
            if not failed:
                solved = spotrs(factor, right, lower=0)[0]
                step = (rows.T @ solved if by_rows else solved).astype(float)
                s = np.maximum(np.abs(np.sqrt(here.t) + step), SHORTEST)
                there = problem.evaluate(s * s, aim_weight, total_weight, meetings)
                if there.value < here.value:
                    break
                there = None
            damping *= MORE
            first = False
        if there is None:
            break
        here = there
        damping *= LESS if first else 1.0
        values.append(here.value)
        if _is_over(problem, here, values, solve):
            break
    return here


SOLVED, HOPE, LOOK_BACK_OF_SOLVING = 1e-7, 0.15, 8
"""A residual below the first is none; one that shrinks by less than the second in so many steps will not vanish."""


def _is_over(problem: SoftGoals, here: CrowdPoint, values: list[float], solve: bool) -> bool:
    def stalls(share: float, steps: int) -> bool:
        return len(values) > steps and values[-steps] - values[-1] < share * values[-1]

    if solve:
        return here.value < SOLVED or stalls(HOPE, LOOK_BACK_OF_SOLVING)
    return stalls(STALL, LOOK_BACK) or stalls(STALLED_CLEAR, LOOK_BACK) and here.is_clear(problem.safe + 1, problem.least_gap)
