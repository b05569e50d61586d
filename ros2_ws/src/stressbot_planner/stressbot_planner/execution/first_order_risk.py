"""Risk to first order: how likely a plan that is driven blindly ends in a collision or beside its goals.

Places are linear in small errors of the robots. With q a point on the way of robot j, R a turn by +90 degrees, and p_i where
it was as activation i began,

    speed wrong by e (a share)      dq = e (q - p_0) + e sum (t_i / c_j) R (q - p_i)    over activations in which it turned
    turning radius by e (a share)   dq = -e sum (t_i / c_j) R (q - p_i)
    heading bias b                  dq = b R (q - p_0)
    heading jump v_i                dq = v_i R (q - p_i)                                as each activation begins

so that covariances are sums along the plan, exact to first order, and robots are independent of each other. Where errors are
as large as bodies the truth bends away: `blind_drive` draws swarms and looks.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from stressbot_planner.collision.clearance import Shapes, environment_clearances
from stressbot_planner.execution.blind_drive import Noise
from stressbot_planner.planners.optimization.gaps import near_gaps
from stressbot_planner.problem.plan import Plan

_SIGMAS = 6.0
"""Bodies farther from each other than this many standard deviations do not meet."""

_NODES = 200
"""Of the quadrature over a goal's disc."""

_STEP = 1e-6
"""By which places are moved to see how a gap to obstacles changes, in largest coordinates."""


@dataclass(frozen=True, eq=False)
class FirstOrderRisk:
    """Probabilities that a plan goes wrong.

    Attributes:
        covariances: of where robots end, shape (n, 2, 2), units^2.
        outside: probability of each robot to end further from its goal than the tolerance, shape (n,).
        misses: that any does.
        collides: that bodies meet anything on the way or at the end. Of two robots, and of one robot and all that stands around,
            the most dangerous place counts, and pairs are taken as independent.
    """

    covariances: np.ndarray
    outside: np.ndarray
    misses: float
    collides: float


def first_order_risk(plan: Plan, noise: Noise, tolerance: float) -> FirstOrderRisk:
    """Return the risk of a plan.

    Args:
        plan: to be driven.
        noise: what robots are wrong by.
        tolerance: radius around a goal that counts as reached, units.
    """
    problem = plan.problem
    n, ends = problem.swarm.n, np.ascontiguousarray(plan.poses[-1, :, :2])
    covariances = covariances_at(plan, noise, np.arange(n), np.full(n, len(plan.groups)), ends)
    outside = np.array([
        1.0 - probability_within(miss, covariance, tolerance)
        for miss, covariance in zip(ends - problem.goals, covariances, strict=True)
    ])
    return FirstOrderRisk(covariances, outside, float(1 - np.prod(1 - outside)), _collides(plan, noise, covariances))


def covariances_at(plan: Plan, noise: Noise, robot: np.ndarray, knot: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the covariances of some robots' places, shape (f, 2, 2), units^2.

    Args:
        plan, noise: as above.
        robot: rows, shape (f,).
        knot: the activation, from 0, in which a robot is there; K at the end. Shape (f,).
        point: where it is, on its way in this activation, shape (f, 2), units.
    """
    swarm, poses = plan.problem.swarm, plan.poses
    places = poses[:, :, :2] - poses[0, :, :2]  # from the start, where digits are
    turned = np.where(swarm.slides[plan.groups - 1] > 0, 0.0, plan.lengths[:, None] / swarm.turning_length)
    angle = _summed(turned)[knot, robot]
    about = _summed(turned[..., None] * places[:-1])[knot, robot]
    q = point - poses[0, robot, :2]
    swung = _left(angle[:, None] * q - about)
    columns = [noise.speed_error * (q + swung), -noise.radius_error * swung, noise.heading_bias * _left(q)]
    covariance = np.einsum("efi,efj->fij", columns, columns)
    if noise.heading_noise:
        count = knot[:, None, None] + 1.0
        first = np.cumsum(places, axis=0)[knot, robot]
        second = np.cumsum(places[..., :, None] * places[..., None, :], axis=0)[knot, robot]
        cross = q[:, :, None] * first[:, None, :]
        moment = count * q[:, :, None] * q[:, None, :] - cross - np.swapaxes(cross, 1, 2) + second
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        covariance = covariance + noise.heading_noise**2 * (turn @ moment @ turn.T)
    return covariance


def probability_within(mean: np.ndarray, covariance: np.ndarray, radius: float) -> float:
    """Return the probability of a normal vector with this mean (2,) and covariance (2, 2) to be no longer than radius."""
    variances, axes = np.linalg.eigh(covariance)
    sigma = np.sqrt(np.maximum(variances, 0.0))
    along, across = (float(value) for value in (axes.T @ mean)[::-1])
    wide, narrow = float(sigma[1]), float(sigma[0])
    if wide <= 1e-9 * radius:
        return float(np.hypot(along, across) <= radius)
    low, high = max(-radius, along - 9 * wide), min(radius, along + 9 * wide)
    if low >= high:
        return 0.0
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    # angles in place of lengths: the ends of the disc are steep
    begin, end = np.arcsin(low / radius), np.arcsin(high / radius)
    angles = 0.5 * (end - begin) * nodes + 0.5 * (end + begin)
    x, half = radius * np.sin(angles), radius * np.cos(angles)
    narrow = max(narrow, 1e-12 * radius)
    inside = ndtr((half - across) / narrow) - ndtr((-half - across) / narrow)
    density = np.exp(-0.5 * ((x - along) / wide) ** 2) / (wide * np.sqrt(2 * np.pi))
    return float(np.clip(0.5 * (end - begin) * weights @ (density * inside * half), 0.0, 1.0))


def _collides(plan: Plan, noise: Noise, at_end: np.ndarray) -> float:
    problem = plan.problem
    swarm, n = problem.swarm, problem.swarm.n
    reach = _SIGMAS * np.sqrt(2 * _largest_variance(plan, noise))
    slides = swarm.slides[plan.groups - 1]
    worst: dict[tuple[int, int], float] = {}

    def take(robot: int, other: int, gap: float, variance: float) -> None:
        likely = float(ndtr(-gap / np.sqrt(variance))) if variance > 0 else float(gap < -problem.slack)
        worst[robot, other] = max(worst.get((robot, other), 0.0), likely)

    if len(plan.groups):
        gaps, near = near_gaps(reach, slides, plan.poses, plan.lengths, swarm.body_radius, Shapes.of(problem.environment))
        covariances = covariances_at(plan, noise, near.robot, near.knot, near.point)
        variances = np.zeros(len(gaps))
        np.add.at(variances, near.row, np.einsum("fi,fij,fj->f", near.weight, covariances, near.weight))
        who = np.full((len(gaps), 2), -1)
        np.maximum.at(who[:, 0], near.row, near.robot)
        np.maximum.at(who[:, 1], near.row, np.where(near.robot < who[near.row, 0], near.robot, -1))
        for (robot, other), gap, variance in zip(who.tolist(), gaps.tolist(), variances.tolist(), strict=True):
            take(robot, other, gap, variance)
    ends = plan.poses[-1, :, :2]
    for i in range(n):
        for j in range(i):
            if bodies := swarm.body_radius[i] + swarm.body_radius[j]:
                between = ends[i] - ends[j]
                distance = float(np.hypot(*between))
                normal = between / distance
                take(i, j, distance - bodies, float(normal @ (at_end[i] + at_end[j]) @ normal))
    step = _STEP * max(1.0, float(np.abs(ends).max()))
    at, *moved = ([found.gap for found in environment_clearances(swarm, problem.environment, ends + shift)]
                  for shift in (np.zeros(2), np.array([step, 0.0]), np.array([0.0, step])))
    for i in np.flatnonzero(np.isfinite(at)).tolist():
        slope = np.array([(side[i] - at[i]) / step for side in moved])
        take(i, -1, at[i], float(slope @ at_end[i] @ slope))
    return float(1 - np.prod([1 - likely for likely in worst.values()]))


def _largest_variance(plan: Plan, noise: Noise) -> float:
    count, n = len(plan.groups) + 1, plan.problem.swarm.n
    robot, knot = np.tile(np.arange(n), count), np.repeat(np.arange(count), n)
    found = covariances_at(plan, noise, robot, knot, plan.poses[:, :, :2].reshape(-1, 2))
    return float(np.trace(found, axis1=1, axis2=2).max())


def _summed(values: np.ndarray) -> np.ndarray:
    """Return sums of what came before each knot, with a row more."""
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def _left(vectors: np.ndarray) -> np.ndarray:
    return np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)
