"""Minimise a linear cost of durations over a fixed group order, with every robot at its goal and bodies apart.

    minimise    c . t - mu sum log t + (rho / 2) sum max(0, margin - gap)^2
    subject to  position of each robot at the end = its goal, heading = that at its goal if it has one

for a falling mu and a rising rho: an interior-point method whose iterates all keep the goals exactly. Each step is a
Newton step with exact second derivatives in the null space of the goal constraints, in variables scaled by t; then
the goals are restored by Gauss-Newton steps of least scaled norm. Bodies may overlap while rho is small, so that
robots can pass through each other and through obstacles to a better side before the gaps close.

Where goals are balls, each robot aims at a point of its ball: against the slope of the cost, which the multipliers of
the goal constraints tell, and moved there whenever mu falls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dsyr2k  # pyright: ignore[reportAttributeAccessIssue] - compiled, without stub
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs  # pyright: ignore[reportAttributeAccessIssue] - compiled, without stub

from stressbot_planner.collision.clearance import NO_CREDIT, Shapes
from stressbot_planner.model.goal_reaching import equilibrated, goal_equations, restore_goals, step_to_goals
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.planners.optimization.derivatives import Functionals, goal_functionals, jacobian, weighted_hessian
from stressbot_planner.planners.optimization.gaps import near_gaps
from stressbot_planner.problem.definition import EXACT, Problem
from stressbot_planner.problem.headings import EXACT_HEADING

GOAL_PRECISION, OF_TOLERANCE = 1e-9, 5e-4
"""Goals are met so well: relative to the turning radius, and to the tolerance where that asks for more. Goals that touch
something need more, see `Problem.slack`."""

OF_HEADING = 0.1
"""Goal headings are met to this share of `EXACT_HEADING`, and better where the goals ask for more."""

SCHEDULE = (
    (0.3, 3e-5), (0.1, 1e-4), (0.03, 1e-3), (0.01, 1e-2), (0.003, 1e-1), (0.001, 1e-1), (0.0003, 0.3)
)
"""Stages (mu, rho). Mu is relative to the mean cost of an activation, rho to the cost of the plan by the square of
`Swarm.girth`."""

LAST_RHOS = (1.0, 3.0, 10.0)
"""Further stages where bodies still overlap."""

PATIENT_STEPS = 200
"""Two hundred robots need about a hundred from a random guess, six need ten."""

STEPS = 12
"""At most so many Newton steps in a stage: the end of a stage need not be exact."""

SHIFTS = 60
"""Of the Hessian, each four times the last; beyond them numbers have overflowed."""

PROMISING = 1.02
"""A path whose cost cannot be expected to fall below the best known one by less than this is given up early."""


@dataclass(frozen=True, eq=False)
class Order:
    """A fixed order of K group activations and what their lengths cost.

    Attributes:
        groups: shape (K,), 1..m.
        slides: distance that each robot slides per unit of length, shape (K, n), see `Swarm.slides`.
        cost: c, per unit length, shape (K,).
    """

    groups: np.ndarray
    slides: np.ndarray
    cost: np.ndarray

    def subset(self, keep: np.ndarray) -> "Order":
        """Return the order without some activations; keep is a mask of shape (K,)."""
        return Order(self.groups[keep], self.slides[keep], self.cost[keep])


class Point(NamedTuple):
    """Durations with every robot at its goal, and what was computed there."""

    t: np.ndarray
    poses: np.ndarray
    gaps: np.ndarray
    near: Functionals

    def overlap(self, margin: float) -> float:
        """Return half the sum of squares of what the gaps lack; all that are below margin are known here."""
        return 0.5 * float(np.sum((margin - self.gaps) ** 2))

    def value(self, cost: np.ndarray, mu: float, rho: float, margin: float) -> float:
        return cost @ self.t - mu * np.sum(np.log(self.t)) + rho * self.overlap(margin)


class CentralPath:
    """The problem of one group order, ready to be solved from any first guess."""

    def __init__(
        self,
        problem: Problem,
        shapes: Shapes,
        order: Order,
        margin: float,
        least_gap: float = 0.0,
        ends: np.ndarray | None = None,
        out_of_time: Callable[[], bool] = lambda: False,
        credit: np.ndarray = NO_CREDIT,
    ):
        """Take gaps below margin as too small, and call bodies apart where all are above least_gap < margin, units.

        Only where that is positive two points are kept apart. Gaps of two robots count as larger by their entry of `credit`.

        Robots aim first at the places in their goal balls nearest to `ends`, shape (n, 2), or at the goals. All that takes
        long gives up when out_of_time says so.
        """
        self.problem, self.shapes, self.order, self.margin, self.least_gap = problem, shapes, order, margin, least_gap
        self.credit = credit
        self.turning_length = problem.swarm.turning_length
        self.precision = min(
            GOAL_PRECISION * float(problem.swarm.turning_radius.mean()), OF_TOLERANCE * problem.tolerance, 0.25 * problem.slack
        )
        if len(problem.headed):
            self.precision = min(self.precision, OF_HEADING * EXACT_HEADING * float(self.turning_length[problem.headed].min()))
        self.ball = (1.0 - 2 * OF_TOLERANCE) * problem.tolerance if problem.tolerance > EXACT else 0.0
        self.out_of_time = out_of_time
        self.aims = problem.goals
        if ends is not None and self.ball > 0.0:
            beyond = ends - problem.goals
            self.aims = problem.goals + beyond * np.minimum(1.0, self.ball / np.maximum(np.hypot(*beyond.T), 1e-12))[:, None]

    def solve(self, guess: np.ndarray, best: float = np.inf) -> np.ndarray | None:
        """Return lengths t > 0, shape (K,), with every robot at its goal.

        None if the guess leads nowhere, time is over, or the cost will hardly fall below that of the best known plan.
        Gaps may be left below zero where the bodies could not be kept apart: the caller checks.
        """
        cost = self.order.cost
        t = self.restore(np.maximum(guess, 1e-2 * guess.mean()), patient=True)
        if t is None:
            return None
        total = min(float(cost @ t), best)
        mean = total / len(t)
        stiffness = total / float(self.problem.swarm.girth.mean()) ** 2
        here = self.evaluate(t)
        dual = mean / here.t
        shift, multipliers = 0.0, None
        stages = [*SCHEDULE, *((SCHEDULE[-1][0], rho) for rho in LAST_RHOS)]
        apart = self.least_gap + 0.1 * (self.margin - self.least_gap)
        for stage, (mu, rho) in enumerate(stages):
            if stage >= len(SCHEDULE) and (here.gaps.size == 0 or here.gaps.min() > apart):
                break
            mu, rho = mu * mean, rho * stiffness
            dual = np.clip(dual, mu / here.t / 1e2, mu / here.t * 1e2)
            for _ in range(STEPS):
                if self.out_of_time():
                    return None
                newton = self._newton_step(here, dual, mu, rho, shift)
                if newton is None:
                    return None
                step, gradient, multipliers, shift = newton
                decrease = -float(gradient @ step)
                if decrease < 0.015 * mu * len(step):
                    break
                there = self._search(here, step, decrease, mu, rho)
                if there is None:
                    break
                dual_step = mu / here.t - dual - dual / here.t * step
                dual = dual + min(1.0, _to_boundary(dual, dual_step)) * dual_step
                here = there
                dual = np.clip(dual, mu / here.t / 1e3, mu / here.t * 1e3)
            if cost @ here.t - mu * len(t) > PROMISING * best:
                return None
            if self.ball > 0.0 and multipliers is not None:
                here = self._aim(here, multipliers)
        return here.t

    def _aim(self, here: Point, multipliers: np.ndarray) -> Point:
        """Let robots aim at points of their balls where the cost is smaller, if all can reach them from here."""
        slope = multipliers[: self.aims.size].reshape(-1, 2)
        steepness = np.hypot(*slope.T)[:, None]
        wanted = self.problem.goals - self.ball * slope / np.maximum(steepness, 1e-12 * steepness.max())
        before = self.aims
        for share in (1.0, 0.3):
            self.aims = before + share * (wanted - before)
            t = self.restore(here.t)
            if t is not None:
                return self.evaluate(t)
        self.aims = before
        return here

    def restore(self, t: np.ndarray, patient: bool = False) -> np.ndarray | None:
        """Return durations near t that put every robot at its goal, or None.

        Gauss-Newton steps of least norm relative to t, so that positive durations stay positive. A patient
        restoration starts from afar, in steps that no more than double a duration, and accepts slow progress.
        """
        motion = self.order.slides, self.turning_length, self.problem.starts, self.aims, self.problem.goal_headings
        for _ in range(PATIENT_STEPS if patient else 0):
            if self.out_of_time():
                return None
            t, error = step_to_goals(*motion, t, self.precision)
            if not np.isfinite(error):
                return None
            if error < self.precision:
                return t
        if patient:
            return None
        t, there = restore_goals(*motion, t, self.precision)
        return t if there else None

    def equations(self, t: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much the goals are missed, and the derivatives times scale (K,), see `goal_equations`."""
        problem = self.problem
        motion = self.order.slides, self.turning_length, problem.starts, self.aims, problem.goal_headings
        return goal_equations(*motion, t, scale)

    def evaluate(self, t: np.ndarray, meetings: bool = False) -> Point:
        """Return what follows from durations t; meetings: see `near_gaps`."""
        slides = self.order.slides
        poses = trajectory(slides, self.turning_length, self.problem.starts, t)
        body, points_too = self.problem.swarm.body_radius, self.least_gap > 0
        gaps, near = near_gaps(self.margin, slides, poses, t, body, self.shapes, meetings, points_too, self.credit)
        return Point(t, poses, gaps, near)

    def _newton_step(self, here: Point, dual: np.ndarray, mu: float, rho: float, last_shift: float):
        """Return (step, gradient, goals' multipliers, shift): the Newton step in the null space of the goals.

        The Hessian, indefinite away from a minimum, is shifted until it is positive definite there; None if no shift does.
        """
        t, slides, poses = here.t, self.order.slides, here.poses
        _, scaled_rows = self.equations(t, t)
        gap_rows = jacobian(len(here.gaps), here.near, slides, self.turning_length, poses)
        push = -rho * (self.margin - here.gaps)
        gradient = self.order.cost - mu / t + gap_rows.T @ push
        scaled_gradient = gradient * t
        unit_rows, factors, square = equilibrated(scaled_rows)
        triangle = dpotrf(square.T, lower=1, overwrite_a=1)[0]
        multipliers = factors * dpotrs(triangle, unit_rows @ scaled_gradient, lower=1)[0]
        of_places = -multipliers[: self.aims.size]  # headings are linear in t
        hessian = weighted_hessian(of_places, goal_functionals(poses), push, here.near, slides, self.turning_length, poses, t)
        if len(here.gaps):
            gap_rows *= np.sqrt(rho) * t
            hessian += gap_rows.T @ gap_rows
        diagonal = np.einsum("kk->k", hessian)
        diagonal += dual * t
        # with Q orthonormal rows that span the goals' and P = 1 - Q^T Q: P H P + s Q^T Q, whose inverse acts in the null space
        basis = dtrtrs(triangle, unit_rows, lower=1)[0]
        mixed = hessian @ basis.T
        inner = basis @ mixed
        np.einsum("kk->k", inner)[:] += np.abs(diagonal).mean()
        mixed -= 0.5 * basis.T @ inner
        hessian = dsyr2k(-1.0, mixed, basis.T, beta=1.0, c=hessian.T, lower=1, overwrite_c=1)
        shift = last_shift / 3 if last_shift > 1e-2 * mu else 0.0
        diagonal = np.einsum("kk->k", hessian)
        unshifted = diagonal.copy()
        for _ in range(SHIFTS):
            diagonal[:] = unshifted + shift
            factor, failed = dpotrf(hessian, lower=1, clean=0)
            if not failed:
                break
            shift = max(1e-2 * mu, 4.0 * shift)
        else:
            return None
        along = scaled_gradient - (basis @ scaled_gradient) @ basis
        return -t * dpotrs(factor, along, lower=1)[0], gradient, multipliers, shift

    def _search(self, here: Point, step: np.ndarray, decrease: float, mu: float, rho: float):
        """Return the point after a step short enough to decrease the value, None if there is none."""
        cost, margin = self.order.cost, self.margin
        value = here.value(cost, mu, rho, margin)
        length = min(1.0, _to_boundary(here.t, step))
        for _ in range(10):
            t = self.restore(here.t + length * step)
            if t is not None:
                there = self.evaluate(t)
                if there.value(cost, mu, rho, margin) < value - 1e-4 * length * decrease:
                    return there
            length *= 0.4
        return None


def _to_boundary(values: np.ndarray, step: np.ndarray, share: float = 0.95) -> float:
    """Return how much of step positive values can take and keep 1 - share of themselves."""
    steepest = float(np.max(-step / values))
    return share / steepest if steepest > 0 else np.inf
