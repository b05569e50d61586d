"""Lengths of a fixed group order with which every robot ends where it should: the Jacobian of end positions, and Gauss-Newton.

    find t > 0 with p_j(t) = aim_j for every robot j,   theta_j(t) = heading_j modulo 2 pi for those with goal headings

by steps of least norm, relative to the lengths, that keep these positive: feasibility restoration, from near by or from afar.
"""

import numpy as np

from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.system.kernels import kernel

MOST_STEPS = 10
"""Gauss-Newton steps from near by."""

STALE_JACOBIAN = 0.1
"""A step that leaves a larger share of what is missed is the last one with the same Jacobian."""

REGULARISATION = 1e-12
"""Of rows of unit length."""

TO_ZERO = 0.9
"""Share of the way to where a length would vanish that a step takes at most."""


@kernel()
def end_jacobian(slides, turning_length, start, t, scale):
    """Return where the robots end, and the Jacobian of x_1, y_1, x_2, … there.

    A slide adds its direction; a turn swings all that comes after it about the robot's place: (1/c_j) R (p_end - p_k).

    Args:
        slides: shape (K, n), see `kinematics.trajectory`.
        turning_length: c_j, shape (n,).
        start: poses, shape (n, 3).
        t: lengths, shape (K,), units.
        scale: what each column is multiplied by, shape (K,): t for derivatives relative to t, 1 for plain ones.

    Returns:
        Positions (n, 2), units, and derivatives with respect to t, times scale, shape (2n, K).
    """
    count, n = slides.shape
    ends = np.empty((n, 2))
    rows = np.empty((2 * n, count))
    at_x, at_y = np.empty(count), np.empty(count)
    for j in range(n):
        x, y, heading = start[j]
        cosine, sine = np.cos(heading), np.sin(heading)
        along_x, along_y = rows[2 * j], rows[2 * j + 1]
        for k in range(count):
            at_x[k], at_y[k] = x, y
            if slides[k, j]:
                along = scale[k] * slides[k, j]
                along_x[k], along_y[k] = along * cosine, along * sine
                slid = t[k] * slides[k, j]
                x += slid * cosine
                y += slid * sine
            else:
                heading += t[k] / turning_length[j]
                if heading > 2.0 * np.pi:
                    heading -= 2.0 * np.pi * np.floor(heading / (2.0 * np.pi))
                cosine, sine = np.cos(heading), np.sin(heading)
        for k in range(count):
            if not slides[k, j]:
                turn = scale[k] / turning_length[j]
                along_x[k], along_y[k] = turn * (at_y[k] - y), turn * (x - at_x[k])
        ends[j, 0], ends[j, 1] = x, y
    return ends, rows


@kernel()
def goal_misses(slides, turning_length, start, aims, headings, t):
    """Return by how much the goals are missed: x_1, y_1, x_2, … and then an arc for each goal heading, units.

    The arc is what the robot has yet to turn back, by less than half a turn either way, times c_j: the winding is the nearest.

    Args:
        slides, turning_length, start, t: see `end_jacobian`.
        aims: shape (n, 2), units.
        headings: rad, shape (n,), NaN where they are free.
    """
    end = trajectory(slides, turning_length, start, t)[-1]
    return _misses(end[:, :2], end[:, 2], turning_length, aims, headings)


@kernel()
def _misses(ends, end_headings, turning_length, aims, headings):
    headed = np.flatnonzero(~np.isnan(headings))
    places = (ends - aims).ravel()
    if len(headed) == 0:
        return places
    misses = np.empty(len(places) + len(headed))
    misses[: len(places)] = places
    for i, j in enumerate(headed):
        angle = end_headings[j] - headings[j]
        misses[len(places) + i] = turning_length[j] * (angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))
    return misses


@kernel()
def goal_equations(slides, turning_length, start, aims, headings, t, scale):
    """Return `goal_misses` (r,), and their derivatives with respect to t, times scale, shape (r, K)."""
    ends, places = end_jacobian(slides, turning_length, start, t, scale)
    headed = np.flatnonzero(~np.isnan(headings))
    if len(headed) == 0:
        return (ends - aims).ravel(), places
    end_headings = start[:, 2].copy()
    rows = np.zeros((len(places) + len(headed), len(t)))
    rows[: len(places)] = places
    for i, j in enumerate(headed):
        arc = 0.0
        for k in range(len(t)):
            if not slides[k, j]:
                rows[len(places) + i, k] = scale[k]
                arc += t[k]
        end_headings[j] += arc / turning_length[j]
    return _misses(ends, end_headings, turning_length, aims, headings), rows


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
        square[i, i] += REGULARISATION
    return unit, factors, square


@kernel()
def least_norm_step(rows, miss, damping):
    """Return the step (K,) of least norm that undoes misses (r,) to first order; NaN where numbers have overflowed.

    With damping it is a Levenberg-Marquardt step: the least of |rows step + miss|^2 + damping size |step|^2, with the mean squared
    norm of a row for size.

    Args:
        rows: Jacobian, shape (r, K).
        miss: shape (r,).
        damping: 0 or more.
    """
    unit, factors, square = equilibrated(rows)
    size = (rows * rows).sum() / len(rows)
    if not np.isfinite(square.sum() + miss.sum() + size):
        return np.full(rows.shape[1], np.nan)
    for i in range(len(square)):
        square[i, i] += damping * size * factors[i] ** 2
    return -np.dot(np.linalg.solve(square, factors * miss), unit)


@kernel()
def share_of_step(steepest):
    """Return how much of a step may be taken whose steepest change of a length, relative to that, is so large."""
    return min(1.0, TO_ZERO / max(steepest, 1e-12))


@kernel()
def restore_goals(slides, turning_length, start, aims, headings, t, precision):
    """Make Gauss-Newton steps of least norm relative to t until all robots end where they aim, from near by.

    Each must halve what is missed. Derivatives are used again as long as they serve.

    Args:
        slides, turning_length, start, t: see `end_jacobian`.
        aims, headings: see `goal_misses`.
        precision: largest miss that is none, units.

    Returns:
        Lengths (K,), and whether the robots are there.
    """
    miss, scaled = goal_equations(slides, turning_length, start, aims, headings, t, t)
    before, fresh = np.inf, True
    unit, factors, inverse = scaled, np.zeros(len(miss)), np.zeros((1, 1))
    for _ in range(MOST_STEPS):
        error = np.abs(miss).max()
        if error < precision:
            return t, True
        if not error <= 0.5 * before or np.isinf(error):
            return t, False
        if not fresh and error > STALE_JACOBIAN * before:
            miss, scaled = goal_equations(slides, turning_length, start, aims, headings, t, t)
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
        t = t * (1.0 + share_of_step(steepest) * step)
        before = error
        miss = goal_misses(slides, turning_length, start, aims, headings, t)
    return t, False


@kernel()
def step_to_goals(slides, turning_length, start, aims, headings, t, precision):
    """Make one such step from afar, by which no length more than doubles; return lengths (K,) and the miss before it.

    The miss is infinite where there is no such step. Where it is below precision, none is made.
    """
    miss, scaled = goal_equations(slides, turning_length, start, aims, headings, t, t)
    error = np.abs(miss).max()
    if error < precision:
        return t, error
    step = least_norm_step(scaled, miss, 0.0)
    largest = np.abs(step).max()
    if not np.isfinite(largest):
        return t, np.inf
    return t * (1.0 + share_of_step(largest) * step), error
