"""Jacobian and Hessian of positions and gaps with respect to the durations of a fixed group order, exact.

Along a fixed order the position of robot j at knot k (before activation k) is, with t_l the length of activation l,

    p_k = p_0 + sum over l < k, j in G_l of s_j t_l e(theta_l),    theta_l = theta_0 + sum over i < l, j not in G_i of t_i / c_j

with the pace s_j and the turning length c_j = r_j / s_j of `Swarm`.

For l < k a point q that robot j has at knot k, or a fixed length into activation k, changes by

    dq/dt_l = s_j e(theta_l)                    if j slides in l,
              (1/c_j) R (q - p_l)               if j turns in l (R turns by +90 degrees),

and its second derivatives, for l1 <= l2 < k, vanish unless j turns in l1; then they depend on l2 only:

    (s_j/c_j) R e(theta_l2) if j slides in l2,    -(1/c_j^2) (q - p_l2) if it turns in l2.

A *functional* is a weight times such a point. Goal errors and gaps are sums of one or two functionals, so that one
pair of kernels differentiates them all.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.system.kernels import kernel


class Functionals(NamedTuple):
    """Weights on points of robots, f of them; the functionals of one row are added up.

    Attributes:
        row: shape (f,).
        robot: shape (f,), from 0.
        knot: shape (f,); durations l < knot move the point.
        point: shape (f, 2), units.
        weight: shape (f, 2).
    """

    row: np.ndarray
    robot: np.ndarray
    knot: np.ndarray
    point: np.ndarray
    weight: np.ndarray


@kernel()
def jacobian(count, functionals, slides, turning_length, poses):
    """Return the derivatives of each row with respect to the durations, shape (count, K)."""
    row, robot, knot, point, weight = functionals
    steps, n = slides.shape
    result = np.zeros((count, steps))
    # dq/dt_l = w . (u_l, v_l) + c_l (w_y q_x - w_x q_y), without a branch
    known = np.zeros(n, dtype=np.bool_)
    u, v, c = np.empty((n, steps)), np.empty((n, steps)), np.empty((n, steps))
    for f in range(row.shape[0]):
        j = robot[f]
        if not known[j]:
            known[j] = True
            over_c = 1.0 / turning_length[j]
            for k in range(steps):
                if slides[k, j]:
                    u[j, k], v[j, k] = slides[k, j] * np.cos(poses[k, j, 2]), slides[k, j] * np.sin(poses[k, j, 2])
                    c[j, k] = 0.0
                else:
                    u[j, k], v[j, k], c[j, k] = over_c * poses[k, j, 1], -over_c * poses[k, j, 0], over_c
        wx, wy = weight[f]
        about = wy * point[f, 0] - wx * point[f, 1]
        into, uj, vj, cj = result[row[f]], u[j], v[j], c[j]
        for k in range(knot[f]):
            into[k] += wx * uj[k] + wy * vj[k] + about * cj[k]
    return result


@kernel()
def weighted_hessian(multipliers, functionals, more_multipliers, more_functionals, slides, turning_length, poses, t):
    """Return the second derivatives of the sum of multipliers (rows,) times rows, of two sets of functionals.

    They are relative to t: with respect to t_k and t_l, times t_k t_l; shape (K, K).
    """
    count, n = slides.shape
    # sums over the functionals of one robot that lie behind a knot: weight, and weight . point
    behind = np.zeros((n, count + 1, 3))
    _add_behind(behind, multipliers, functionals)
    _add_behind(behind, more_multipliers, more_functionals)
    of_later = np.zeros((count, n))
    turns = np.zeros((n, count))
    for j in range(n):
        over_c = 1.0 / turning_length[j]
        wx, wy, wq = 0.0, 0.0, 0.0
        for k in range(count - 1, -1, -1):
            wx += behind[j, k + 1, 0]
            wy += behind[j, k + 1, 1]
            wq += behind[j, k + 1, 2]
            if slides[k, j]:
                of_later[k, j] = t[k] * slides[k, j] * over_c * (wy * np.cos(poses[k, j, 2]) - wx * np.sin(poses[k, j, 2]))
            else:
                of_later[k, j] = -t[k] * over_c * over_c * (wq - wx * poses[k, j, 0] - wy * poses[k, j, 1])
                turns[j, k] = t[k]
    hessian = np.dot(of_later, turns)
    for k in range(count):
        for i in range(k):
            hessian[i, k] = hessian[k, i]
    return hessian


@kernel()
def _add_behind(behind, multipliers, functionals):
    row, robot, knot, point, weight = functionals
    for f in range(row.shape[0]):
        wx, wy = multipliers[row[f]] * weight[f, 0], multipliers[row[f]] * weight[f, 1]
        at = behind[robot[f], knot[f]]
        at[0] += wx
        at[1] += wy
        at[2] += wx * point[f, 0] + wy * point[f, 1]


def goal_functionals(poses: np.ndarray) -> Functionals:
    """Return the functionals of all final coordinates, rows x_1, y_1, x_2, …, for poses (K + 1, n, 3)."""
    n = poses.shape[1]
    robot = np.repeat(np.arange(n), 2)
    return Functionals(
        row=np.arange(2 * n),
        robot=robot,
        knot=np.full(2 * n, poses.shape[0] - 1),
        point=np.ascontiguousarray(poses[-1, robot, :2]),
        weight=np.tile(np.eye(2), (n, 1)),
    )
