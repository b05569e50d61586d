"""Feasibility restoration: durations near by, or from afar, with which every robot ends at its goal.

Gauss-Newton steps of least norm, relative to the durations, on the goal misses alone; their Jacobian is that of `derivatives`, for
ends of robots only, without a record of points.
"""

import numpy as np

from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.system.kernels import kernel

MOST_STEPS = 10
"""Gauss-Newton steps from near by."""

STALE_JACOBIAN = 0.1
"""A step that leaves a larger share of what is missed is the last one with the same Jacobian."""


@kernel()
def goal_misses(slides, turning_length, start, aims, t):
    """Return how far the robots end from where they aim, x_1, y_1, x_2, …, and its derivatives relative to t.

    Args:
        slides: shape (K, n), see `kinematics.trajectory`.
        turning_length: shape (n,).
        start: poses, shape (n, 3).
        aims: shape (n, 2).
        t: lengths, shape (K,), units.

    Returns:
        Misses (2n,), and their derivatives with respect to each t times that t, shape (2n, K).
    """
    count, n = slides.shape
    miss = np.empty(2 * n)
    rows = np.empty((2 * n, count))
    at_x, at_y = np.empty(count), np.empty(count)
    for j in range(n):
        x, y, heading = start[j]
        cosine, sine = np.cos(heading), np.sin(heading)
        along_x, along_y = rows[2 * j], rows[2 * j + 1]
        for k in range(count):
            at_x[k], at_y[k] = x, y
            if slides[k, j]:
                slid = t[k] * slides[k, j]
                along_x[k], along_y[k] = slid * cosine, slid * sine
                x += along_x[k]
                y += along_y[k]
            else:
                heading += t[k] / turning_length[j]
                if heading > 2.0 * np.pi:
                    heading -= 2.0 * np.pi * np.floor(heading / (2.0 * np.pi))
                cosine, sine = np.cos(heading), np.sin(heading)
        for k in range(count):
            if not slides[k, j]:
                turned = t[k] / turning_length[j]
                along_x[k], along_y[k] = turned * (at_y[k] - y), turned * (x - at_x[k])
        miss[2 * j], miss[2 * j + 1] = x - aims[j, 0], y - aims[j, 1]
    return miss, rows


@kernel()
def restore_goals(slides, turning_length, start, aims, t, precision):
    """Make Gauss-Newton steps of least norm relative to t until all robots end where they aim, from near by.

    Each must halve what is missed. Derivatives are used again as long as they serve.

    Args:
        slides, turning_length, start, aims, t: see `goal_misses`.
        precision: largest miss that is none, units.

    Returns:
        Lengths (K,), and whether the robots are there.
    """
    miss, scaled = goal_misses(slides, turning_length, start, aims, t)
    before, fresh = np.inf, True
    unit, factors, inverse = scaled, np.zeros(len(miss)), np.zeros((1, 1))
    for _ in range(MOST_STEPS):
        error = np.abs(miss).max()
        if error < precision:
            return t, True
        if not error <= 0.5 * before or np.isinf(error):
            return t, False
        if not fresh and error > STALE_JACOBIAN * before:
            miss, scaled = goal_misses(slides, turning_length, start, aims, t)
            fresh = True
        if fresh:
            unit, factors, square = equilibrated(scaled)
            if not np.isfinite(square.sum()):
                return t, False
            inverse = np.ascontiguousarray(np.linalg.inv(square))
            fresh = False
        step = -np.dot(np.dot(inverse, factors * miss), unit)
        steepest = (-step).max()
        if not np.isfinite(steepest):
            return t, False
        t = t * (1.0 + min(1.0, 0.9 / max(steepest, 1e-12)) * step)
        before = error
        miss = (trajectory(slides, turning_length, start, t)[-1, :, :2] - aims).ravel()
    return t, False


@kernel()
def step_to_goals(slides, turning_length, start, aims, t, precision):
    """Make one such step from afar, by which no length more than doubles; return lengths (K,) and the miss before it.

    The miss is infinite where there is no such step. Where it is below precision, none is made.
    """
    miss, scaled = goal_misses(slides, turning_length, start, aims, t)
    error = np.abs(miss).max()
    if error < precision:
        return t, error
    unit, factors, square = equilibrated(scaled)
    if not np.isfinite(error + square.sum()):
        return t, np.inf
    step = -np.dot(np.linalg.solve(square, factors * miss), unit)
    largest = np.abs(step).max()
    if not np.isfinite(largest):
        return t, np.inf
    return t * (1.0 + min(1.0, 0.9 / max(largest, 1e-12)) * step), error


@kernel()
def equilibrated(rows):
    """Return (unit rows, the factors that make them so, and their products regularised), for steps of least norm.

    Steps solve (U U^T + 1e-12) y = D miss with U = D rows, of which no pivot can vanish: not where rows depend on each other, as
    with fewer activations than coordinates, nor where some are small or zero, as of robots that hardly move. In directions
    that the rows do not reach there is no step.

    Args:
        rows: shape (r, K).
    """
    factors = np.sqrt((rows * rows).sum(axis=1))
    for i in range(len(factors)):
        factors[i] = 1.0 / factors[i] if factors[i] > 1e-150 else 0.0
    unit = rows * factors.reshape(-1, 1)
    square = np.dot(unit, unit.T)
    for i in range(len(square)):
        square[i, i] += 1e-12
    return unit, factors, square
