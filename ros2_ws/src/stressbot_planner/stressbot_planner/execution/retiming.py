"""New durations for the rest of a plan, so that robots which are not where they should be still come to their goals.

    find t > 0 near t_0 with p_j(t) = goal_j for every robot j

by damped Gauss-Newton steps of least norm relative to t_0 (see `goal_reaching`), for robots of any speed and turning radius. It
takes about a millisecond, as the order of the groups stays. It does not look at clearances: the caller checks them.
"""

import numpy as np

from stressbot_planner.model.goal_reaching import end_jacobian, least_norm_step, share_of_step
from stressbot_planner.model.kinematics import trajectory

_ITERATIONS = 40
_PRECISE = 1e-6
"""Of the mean turning radius: a smaller miss is none."""

_FLOOR = 0.1
"""Of the mean duration: activations that are shorter than that may change as if they were that long."""

_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1.0
"""It falls tenfold with each step that brings robots nearer, and grows a hundredfold with each other."""


def retime(
    slides: np.ndarray, turning_length: np.ndarray, starts: np.ndarray, goals: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return durations (K,) near t, all > 0, and the poses at every knot, shape (K + 1, n, 3).

    With fewer than 2 n useful activations the goals are met as well as they can be, in the sense of least squares.

    Args:
        slides: distance that a robot slides for each unit of t, shape (K, n); where 0 it turns.
        turning_length: t in which it turns by 1 rad, shape (n,).
        starts: poses, shape (n, 3).
        goals: shape (n, 2).
        t: durations to begin with, shape (K,), > 0.
    """
    scale = t + _FLOOR * t.mean()
    ends, rows = end_jacobian(slides, turning_length, starts, t, scale)
    miss = (ends - goals).ravel()
    damping = _LEAST_DAMPING
    for _ in range(_ITERATIONS):
        if np.abs(miss).max() < _PRECISE * turning_length.mean():
            break
        step = scale * least_norm_step(rows, miss, damping)
        new_t = t + share_of_step(np.max(-step / t)) * step
        ends, new_rows = end_jacobian(slides, turning_length, starts, new_t, scale)
        new_miss = (ends - goals).ravel()
        if new_miss @ new_miss < miss @ miss:
            t, rows, miss, damping = new_t, new_rows, new_miss, max(damping / 10, _LEAST_DAMPING)
        elif damping < _MOST_DAMPING:
            damping *= 100
        else:
            break
    return t, trajectory(slides, turning_length, starts, t)
