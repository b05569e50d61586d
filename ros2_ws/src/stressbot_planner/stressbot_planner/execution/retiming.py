"""New durations for the rest of a plan, so that robots which are not where they should be still come to their goals.

    find t > 0 near t_0 with p_j(t) = goal_j for every robot j

by damped Gauss-Newton steps of least norm relative to t_0, for robots of any speed and turning radius. It takes about a
millisecond, as the order of the groups stays. It does not look at clearances: the caller checks them.
"""

import numpy as np

from stressbot_planner.model.kinematics import end_derivatives, trajectory

_ITERATIONS = 40
_PRECISE = 1e-6
"""Of the mean turning radius: a smaller miss is none."""

_FLOOR = 0.1
"""Of the mean duration: activations that are shorter than that may change as if they were that long."""


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
    poses = trajectory(slides, turning_length, starts, t)
    miss = (poses[-1, :, :2] - goals).ravel()
    damping = 1e-9
    for _ in range(_ITERATIONS):
        if np.abs(miss).max() < _PRECISE * turning_length.mean():
            break
        rows = end_derivatives(slides, turning_length, poses) * scale
        normal = rows @ rows.T
        if not np.trace(normal) > 0.0:  # nobody can be moved: all that is left are turns
            break
        normal[np.diag_indices_from(normal)] += damping * np.trace(normal) / len(normal)
        step = -scale * (rows.T @ np.linalg.lstsq(normal, miss, rcond=None)[0])  # robots may be out of reach of all durations
        steepest = float(np.max(-step / t))
        length = min(1.0, 0.9 / steepest) if steepest > 0 else 1.0
        new_t = t + length * step
        new_poses = trajectory(slides, turning_length, starts, new_t)
        new_miss = (new_poses[-1, :, :2] - goals).ravel()
        if new_miss @ new_miss < miss @ miss:
            t, poses, miss, damping = new_t, new_poses, new_miss, max(damping / 10, 1e-9)
        elif damping < 1.0:
            damping *= 100
        else:
            break
    return t, poses
