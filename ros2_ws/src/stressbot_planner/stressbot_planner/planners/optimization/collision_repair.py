"""Collision repair: overlapping bodies are parted by Levenberg-Marquardt steps, with every robot at its goal.

    minimise    1/2 sum max(0, margin - gap)^2    over s, with durations t = s^2
    subject to  position of each robot at the end = its goal, heading = that at its goal if it has one

A square cannot become negative, and a step across zero is a reflection, so that no step is cut short by a duration that
would vanish. No cost is looked at: this finds some plan quickly, `central_path` a good one.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from stressbot_planner.planners.optimization.central_path import CentralPath, Point
from stressbot_planner.planners.optimization.derivatives import jacobian

STEPS = 200
"""At most so many from one place."""

LOOK_BACK, TOO_SLOW = 12, 160
"""A descent is given up where, at the rate of so many last steps, it would take more than so many to half of one contact."""

MOST_ENTRIES = 10**8
"""Of the derivatives of gaps, 0.8 GB. With more of them too many bodies overlap."""

BLOCK, MOST_BLOCKS = 300, 12
"""Columns of the derivatives that are multiplied at once, at least; in how many blocks at most."""

_PERTURBATION = 0.05
"""Size of random changes of all durations, relative."""

_SHORTEST = 1e-3
"""Least s."""


def repair(path: CentralPath, guess: np.ndarray, rng: np.random.Generator, perturbations: int = 0) -> np.ndarray | None:
    """Return durations (K,) with all goals kept and all gaps positive, or None.

    Args:
        path: the problem of one group order.
        guess: first durations, shape (K,), units.
        rng: for the perturbations.
        perturbations: random changes of all durations, tried one after the other where a descent ends with bodies overlapping.
    """
    here = _descend(path, guess)
    for _ in range(perturbations):
        if here is None or _is_clear(path, here) or path.out_of_time():
            break
        there = _descend(path, here.t * np.exp(_PERTURBATION * rng.standard_normal(len(here.t))))
        if there is not None and there.overlap(path.margin) < here.overlap(path.margin):
            here = there
    return here.t if here is not None and _is_clear(path, here) else None


def _is_clear(path: CentralPath, here: Point) -> bool:
    return len(here.gaps) == 0 or bool(here.gaps.min() > path.least_gap)


def _descend(path: CentralPath, guess: np.ndarray) -> Point | None:
    """Go down with one gap a meeting of two robots, which goes far, then with one an activation, which goes to the end.

    Returns None if the goals cannot be reached.
    """
    t = path.restore(np.maximum(guess, 1e-2 * guess.mean()), patient=True)
    if t is None:
        return None
    return _descend_by(path, _descend_by(path, t, True).t, False)


def _descend_by(path: CentralPath, t: np.ndarray, meetings: bool) -> Point:
    here = path.evaluate(t, meetings)
    damping, values = None, [here.overlap(path.margin)]
    for _ in range(STEPS):
        if _is_clear(path, here) or path.out_of_time() or len(here.gaps) * len(t) > MOST_ENTRIES:
            break
        if len(values) > LOOK_BACK and _is_too_slow(values, path.margin - path.least_gap):
            break
        step_of, scale = _step_function(path, here)
        damping = 1e-3 * scale if damping is None else damping
        there, first = None, damping
        for _ in range(12):
            step = step_of(damping)
            if path.out_of_time():
                return here
            if step is not None:
                s = np.maximum(np.abs(np.sqrt(here.t) + step), _SHORTEST)
                restored = path.restore(s * s)
                if restored is not None:
                    there = path.evaluate(restored, meetings)
                    if there.overlap(path.margin) < values[-1]:
                        break
            there = None
            damping *= 5.0
        if there is None:
            break
        here = there
        values.append(here.overlap(path.margin))
        if damping == first:
            damping *= 0.25
    return here


def _is_too_slow(values: list[float], contact: float) -> bool:
    """Return whether overlaps shrink too slowly to come down to half of one `contact`, units."""
    rate = np.log(values[-1 - LOOK_BACK] / values[-1]) / LOOK_BACK
    return bool(np.log(values[-1] / (0.25 * contact**2)) > TOO_SLOW * rate)


def _step_function(path: CentralPath, here: Point) -> tuple[Callable[[float], np.ndarray | None], float]:
    """Return the step in s as a function of the damping nu, and the scale of nu.

    The step minimises |gaps + G step - margin|^2 + nu |step|^2 subject to J step = 0, with G and J the derivatives of gaps
    and goals with respect to s; by the smaller of the two systems that it leads to.
    """
    double = 2.0 * np.sqrt(here.t)
    rows, sizes, last = _rows(path, here)
    rows *= double
    aims = len(rows) - len(sizes)
    goals, gaps = rows[:aims], rows[aims:]
    short = path.margin - sizes
    scale = float(np.einsum("ij,ij->", gaps, gaps)) / len(gaps) + 1e-12
    if len(rows) < len(here.t):
        square = _square(rows, last)
        wanted = np.concatenate([np.zeros(aims), short])
        exact = np.full(aims, 1e-10 * np.trace(square) / len(square))

        def by_rows(damping: float) -> np.ndarray | None:
            damped = square.copy()
            np.einsum("kk->k", damped)[:] += np.concatenate([exact, np.full(len(gaps), damping)])
            try:
                return rows.T @ _solved(damped, wanted)
            except LinAlgError:
                return None

        return by_rows, scale
    square, slope = gaps.T @ gaps, gaps.T @ short

    def by_columns(damping: float) -> np.ndarray | None:
        damped = square.copy()
        np.einsum("kk->k", damped)[:] += damping
        try:
            solved = _solved(damped, np.column_stack([slope, goals.T]))
            reduced = goals @ solved[:, 1:]
            np.einsum("kk->k", reduced)[:] += 1e-12 * np.trace(reduced) / len(reduced)
            return solved[:, 0] - solved[:, 1:] @ _solved(reduced, goals @ solved[:, 0])
        except LinAlgError:
            return None

    return by_columns, scale


def _rows(path: CentralPath, here: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return derivatives of goals and gaps (2n + g, K), the gaps (g,), and on how many durations each row depends.

    Gaps are in the order of falling numbers of durations.
    """
    near, slides, found = here.near, path.order.slides, len(here.gaps)
    aims = path.problem.conditions
    last = np.empty(found, dtype=np.int64)
    last[near.row] = near.knot
    order = np.argsort(-last, kind="stable")
    place = np.empty(found, dtype=np.int64)
    place[order] = aims + np.arange(found)
    rows = jacobian(aims + found, near._replace(row=place[near.row]), slides, path.turning_length, here.poses)
    _, rows[:aims] = path.equations(here.t, np.ones_like(here.t))
    return rows, here.gaps[order], np.concatenate([np.full(aims, len(here.t)), last[order]])


def _square(rows: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return rows @ rows.T for rows that are zero from column last (falling) on: a third of the work."""
    square = np.zeros((len(rows), len(rows)))
    edges = np.linspace(0, rows.shape[1], 1 + min(1 + rows.shape[1] // BLOCK, MOST_BLOCKS)).astype(int)
    for begin, end in pairwise(edges.tolist()):
        count = np.searchsorted(-last, -begin)
        block = rows[:count, begin:end]
        square[:count, :count] += block @ block.T
    return square


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    return cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False)
