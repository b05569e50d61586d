"""Minimise a linear cost of durations over a fixed group order, with every robot at its goal and bodies apart.

    minimise    c . t - mu sum log t + (rho / 2) sum max(0, margin - gap)^2
    subject to  position of each robot at the end = its goal

for a falling mu and a rising rho: an interior-point method whose iterates all keep the goals exactly. Each step is a
Newton step with exact second derivatives in the null space of the goal constraints, in variables scaled by t; then
the goals are restored by Gauss-Newton steps of least scaled norm. Bodies may overlap while rho is small, so that
robots can pass through each other and through obstacles to a better side before the gaps close.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, qr, solve

from stressbot_planner.collision import Shapes
from stressbot_planner.kinematics import trajectory
from stressbot_planner.planners.sensitivity import (
    Functionals,
    goal_functionals,
    near_gaps,
    rows_of,
    weighted_hessian,
)
from stressbot_planner.problem import Problem

GOAL_PRECISION = 1e-9
"""Relative to the turning radius: two orders below what counts as exact."""

MAX_ITERATIONS = 240
_MU_FALL, _RHO_RISE = 0.3, 5.0
_MU_END, _RHO_START, _RHO_END, _RHO_LAST = 2e-5, 1e-5, 1.0, 1e1
"""Relative to the cost of the first guess; rho also to the square of the body radius. Rho ends at the last value only
where bodies still overlap."""


@dataclass(frozen=True, eq=False)
class Order:
    """A fixed order of K group activations and what their lengths cost.

    Attributes:
        groups: shape (K,), 1..m.
        slides: which robots slide in each activation, shape (K, n).
        cost: c, per unit length, shape (K,).
    """

    groups: np.ndarray
    slides: np.ndarray
    cost: np.ndarray

    def subset(self, keep: np.ndarray) -> "Order":
        """Return the order without some activations; keep is a mask of shape (K,)."""
        return Order(self.groups[keep], self.slides[keep], self.cost[keep])


class _Point(NamedTuple):
    """Durations with every robot at its goal, and what was computed there."""

    t: np.ndarray
    poses: np.ndarray
    gaps: np.ndarray
    near: Functionals

    def value(self, cost: np.ndarray, mu: float, rho: float, margin: float) -> float:
        return cost @ self.t - mu * np.sum(np.log(self.t)) + 0.5 * rho * np.sum((margin - self.gaps) ** 2)


class CentralPath:
    """The problem of one group order, ready to be solved from any first guess."""

    def __init__(self, problem: Problem, shapes: Shapes, order: Order, margin: float):
        self.problem, self.shapes, self.order, self.margin = problem, shapes, order, margin
        self.radius = problem.swarm.turning_radius
        self.precision = GOAL_PRECISION * float(self.radius.mean())

    def solve(self, guess: np.ndarray, out_of_time: Callable[[], bool]) -> np.ndarray | None:
        """Return lengths t > 0, shape (K,), with every robot at its goal; None if the guess leads nowhere.

        Gaps may be left below zero where the bodies could not be kept apart: the caller checks.
        """
        cost = self.order.cost
        total = float(cost @ guess)
        t = self.restore(np.maximum(guess, 1e-2 * guess.mean()), patient=True)
        if t is None:
            return None
        mu, mu_end = total / len(t), _MU_END * total
        stiffness = total / float(self.problem.swarm.body_radius.mean()) ** 2
        rho, rho_end, rho_last = _RHO_START * stiffness, _RHO_END * stiffness, _RHO_LAST * stiffness
        here = self._evaluate(t)
        dual = mu / here.t
        shift = 0.0
        for _ in range(MAX_ITERATIONS):
            if out_of_time():
                return None
            step, gradient, shift = self._newton_step(here, dual, mu, rho, shift)
            decrease = -float(gradient @ step)
            there = None
            converged = decrease < 0.015 * mu * len(step)
            if not converged:
                there, length = self._search(here, step, decrease, mu, rho)
            if there is None:
                if mu <= mu_end:
                    if rho >= rho_last or here.gaps.size == 0 or here.gaps.min() > 0.1 * self.margin:
                        break
                    rho *= _RHO_RISE
                    continue
                mu, rho = max(mu * _MU_FALL, mu_end), min(rho * _RHO_RISE, rho_end)
                dual = np.clip(dual, mu / here.t / 1e2, mu / here.t * 1e2) if converged else mu / here.t
                continue
            dual_step = mu / here.t - dual - dual / here.t * step
            dual = dual + min(1.0, _to_boundary(dual, dual_step)) * dual_step
            here = there
            dual = np.clip(dual, mu / here.t / 1e3, mu / here.t * 1e3)
        return here.t

    def restore(self, t: np.ndarray, patient: bool = False) -> np.ndarray | None:
        """Return durations near t that put every robot at its goal, or None.

        Gauss-Newton steps of least norm relative to t, so that positive durations stay positive. A patient
        restoration starts from afar and accepts slow progress.
        """
        before = np.inf
        for _ in range(60 if patient else 6):
            poses = self._trajectory(t)
            miss = self._miss(poses)
            error = np.abs(miss).max()
            if error < self.precision:
                return t
            if not patient and error > 0.5 * before:
                return None
            before = error
            scaled = self._goal_rows(poses) * t
            try:
                step = -t * (scaled.T @ solve(_regular(scaled @ scaled.T), miss, assume_a="pos", check_finite=False))
            except LinAlgError:
                return None
            if not np.all(np.isfinite(step)):
                return None
            t = t + min(1.0, _to_boundary(t, step, 0.9)) * step
        return None

    def _trajectory(self, t: np.ndarray) -> np.ndarray:
        return trajectory(self.order.slides, self.radius, self.problem.starts, t)

    def _miss(self, poses: np.ndarray) -> np.ndarray:
        return (poses[-1, :, :2] - self.problem.goals).ravel()

    def _goal_rows(self, poses: np.ndarray) -> np.ndarray:
        functionals = goal_functionals(poses)
        return rows_of(len(functionals.row), functionals, self.order.slides, self.radius, poses)

    def _evaluate(self, t: np.ndarray) -> _Point:
        poses = self._trajectory(t)
        gaps, near = near_gaps(
            self.margin, self.order.slides, poses, t, self.problem.swarm.body_radius, self.shapes
        )
        return _Point(t, poses, gaps, near)

    def _newton_step(self, here: _Point, dual: np.ndarray, mu: float, rho: float, last_shift: float):
        """Return (step, gradient, shift): the Newton step in the null space of the goals.

        The Hessian, indefinite away from a minimum, is shifted until it is positive definite there.
        """
        t, slides, poses = here.t, self.order.slides, here.poses
        goals = goal_functionals(poses)
        rows = rows_of(2 * self.problem.swarm.n, goals, slides, self.radius, poses)
        gap_rows = rows_of(len(here.gaps), here.near, slides, self.radius, poses)
        push = -rho * (self.margin - here.gaps)
        gradient = self.order.cost - mu / t + gap_rows.T @ push
        scaled_rows, scaled_gradient = rows * t, gradient * t
        basis, triangle = qr(scaled_rows.T, check_finite=False)
        rank = len(rows)
        range_space, null_space = basis[:, :rank], basis[:, rank:]
        multipliers = np.linalg.lstsq(triangle[:rank], range_space.T @ scaled_gradient, rcond=1e-12)[0]
        hessian = weighted_hessian(-multipliers, goals, slides, self.radius, poses)
        if len(here.gaps):
            hessian += weighted_hessian(push, here.near, slides, self.radius, poses)
            hessian += rho * (gap_rows.T @ gap_rows)
        hessian *= t[:, None] * t
        hessian[np.diag_indices_from(hessian)] += dual * t
        reduced = null_space.T @ hessian @ null_space
        shift = 0.0
        diagonal = np.diag_indices_from(reduced)
        unshifted = reduced[diagonal]
        while True:
            reduced[diagonal] = unshifted + shift
            try:
                factor = cho_factor(reduced, check_finite=False)
                break
            except LinAlgError:
                shift = max(1e-2 * mu, last_shift / 3) if shift == 0.0 else 4.0 * shift
        scaled_step = -null_space @ cho_solve(factor, null_space.T @ scaled_gradient, check_finite=False)
        return t * scaled_step, gradient, shift

    def _search(self, here: _Point, step: np.ndarray, decrease: float, mu: float, rho: float):
        """Return (point, length) of a step short enough to decrease the value, (None, 0) if there is none."""
        cost, margin = self.order.cost, self.margin
        value = here.value(cost, mu, rho, margin)
        length = min(1.0, _to_boundary(here.t, step))
        for _ in range(10):
            t = self.restore(here.t + length * step)
            if t is not None:
                there = self._evaluate(t)
                if there.value(cost, mu, rho, margin) < value - 1e-4 * length * decrease:
                    return there, length
            length *= 0.4
        return None, 0.0


def _to_boundary(values: np.ndarray, step: np.ndarray, share: float = 0.95) -> float:
    """Return how much of step positive values can take and keep 1 - share of themselves."""
    steepest = float(np.max(-step / values))
    return share / steepest if steepest > 0 else np.inf


def _regular(matrix: np.ndarray) -> np.ndarray:
    matrix[np.diag_indices_from(matrix)] += 1e-12 * np.trace(matrix) / len(matrix)
    return matrix
