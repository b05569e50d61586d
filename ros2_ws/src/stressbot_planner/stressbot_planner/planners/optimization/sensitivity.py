"""How positions and gaps respond to the durations of a fixed group order: values and exact derivatives.

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

from stressbot_planner.collision.clearance import inside_polygon, moving_points_gap
from stressbot_planner.model.kinematics import trajectory
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
def rows_of(count, functionals, slides, turning_length, poses):
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


RESTORED_WITHIN = 10
"""Steps in which the goals are restored from near by."""

_STALE = 0.1
"""A step that leaves a larger share of what is missed is the last one with old derivatives."""


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
    for _ in range(RESTORED_WITHIN):
        error = np.abs(miss).max()
        if error < precision:
            return t, True
        if not error <= 0.5 * before or np.isinf(error):
            return t, False
        if not fresh and error > _STALE * before:
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
def approach_goals(slides, turning_length, start, aims, t, precision):
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


def near_gaps(reach, slides, poses, t, body, shapes, meetings=False, points_too=False) -> tuple[np.ndarray, Functionals]:
    """Return all gaps below reach, one of each pair and activation in which it moves; not those of the places where robots
    start and end, which no durations change.

    Args:
        reach: units.
        slides: distance slid per unit of t, shape (K, n), see `kinematics.trajectory`.
        poses: shape (K + 1, n, 3).
        t: lengths, shape (K,).
        body: radii, shape (n,).
        shapes: `collision.Shapes`.
        meetings: of two robots only the smallest gap while they stay within reach. One that passes through another is then
            pushed to a side, not back by the gaps before and forward by those behind the closest place.
        points_too: gaps between two points, who may pass each other, too.

    Returns:
        Gaps (g,), and their functionals with one row a gap.
    """
    capacity = 8 * len(t)
    while True:
        found, used, *arrays = _near_gaps(
            capacity, reach, meetings, points_too, slides, poses, t, body, *shapes.kernel_arguments
        )
        if used <= capacity:
            gaps, row, robot, knot, point, weight = arrays
            return gaps[:found], Functionals(row[:used], robot[:used], knot[:used], point[:used], weight[:used])
        capacity = 2 * used


_SKIN, _SKIN_OF_SLIDES = 6.0, 8.0
"""Pairs are looked at that come within reach while robots move by this many largest body radii, or mean lengths of activations,
until one has."""


@kernel()
def _near_gaps(capacity, reach, meetings, points_too, slides, poses, t, body, circles, edges, edge_ends, walls):
    count, n = slides.shape
    gaps = np.empty(capacity)
    row = np.empty(capacity, dtype=np.int64)
    robot = np.empty(capacity, dtype=np.int64)
    knot = np.empty(capacity, dtype=np.int64)
    point = np.empty((capacity, 2))
    weight = np.empty((capacity, 2))
    bare = circles.shape[0] == 0 and edge_ends.shape[0] == 0 and np.isinf(walls[1])
    found, used = 0, 0
    met = np.full((n, n) if meetings else (0, 0), -1)
    unit = np.empty((n, 2))
    place = np.empty((n, 2))
    skin = max(_SKIN * body.max(), _SKIN_OF_SLIDES * t.mean())
    moved = np.full(n, np.inf)
    pairs = np.empty((n * (n - 1) // 2, 2), dtype=np.int64)
    near_pairs = 0
    first, last = np.full(n, count), np.full(n, -1)
    for k in range(count):
        for i in range(n):
            if slides[k, i] and t[k] > 0.0:
                first[i], last[i] = min(first[i], k), k
    for k in range(count):
        length = t[k]
        if length <= 0.0:
            continue
        farthest = 0.0
        for i in range(n):
            place[i, 0], place[i, 1] = poses[k, i, 0], poses[k, i, 1]
            if slides[k, i]:
                unit[i, 0] = slides[k, i] * np.cos(poses[k, i, 2])
                unit[i, 1] = slides[k, i] * np.sin(poses[k, i, 2])
                moved[i] += slides[k, i] * length
                farthest = max(farthest, moved[i])
            else:
                unit[i, 0] = unit[i, 1] = 0.0
        if farthest > skin:
            for i in range(n):
                moved[i] = slides[k, i] * length
            near_pairs = _neighbours(pairs, met, place, body, points_too, reach + max(skin, slides[k].max() * length))
        for i in range(0 if bare else n):
            if not slides[k, i]:
                continue
            xi, yi, slid = place[i, 0], place[i, 1], slides[k, i] * length
            ux, uy = unit[i, 0] / slides[k, i], unit[i, 1] / slides[k, i]
            far = reach + body[i] + slid
            for kind in range(3):
                others = circles.shape[0] if kind == 0 else edge_ends.shape[0] if kind == 1 else 4
                if kind == 2 and min(xi - walls[0], walls[1] - xi, yi - walls[2], walls[3] - yi) > far:
                    continue
                for index in range(others):
                    if kind == 0:
                        near = far + circles[index, 2]
                        if abs(xi - circles[index, 0]) > near or abs(yi - circles[index, 1]) > near:
                            continue
                    gap, s, nx, ny = shape_gap(kind, index, xi, yi, ux, uy, slid, circles, edges, edge_ends, walls)
                    gap -= body[i]
                    if gap < reach and not (s <= 0.0 and k <= first[i] or s >= slid and k >= last[i]):
                        if used < capacity:
                            gaps[found] = gap
                            row[used], robot[used] = found, i
                            knot[used] = k + 1 if s >= slid else k
                            point[used, 0], point[used, 1] = xi + s * ux, yi + s * uy
                            weight[used, 0], weight[used, 1] = nx, ny
                        found += 1
                        used += 1
        for index in range(near_pairs):
            i, j = pairs[index]
            if not (slides[k, i] or slides[k, j]):
                continue
            dx, dy = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
            bodies = body[i] + body[j]
            far = reach + bodies + 2.0 * length
            if abs(dx) > far or abs(dy) > far:
                if meetings:
                    met[i, j] = -1
                continue
            distance, s = moving_points_gap(dx, dy, unit[i, 0] - unit[j, 0], unit[i, 1] - unit[j, 1], length)
            if distance - bodies >= reach:
                if meetings:
                    met[i, j] = -1
                continue
            if s <= 0.0 and k <= min(first[i], first[j]) or s >= length and k >= max(last[i], last[j]):
                continue
            at = used
            if meetings and met[i, j] >= 0:
                at = met[i, j]
                if at + 1 >= capacity or distance - bodies >= gaps[row[at]]:
                    continue
            else:
                if used + 1 < capacity:
                    row[used] = row[used + 1] = found
                if meetings:
                    met[i, j] = used
                found += 1
                used += 2
            if at + 1 < capacity:
                gaps[row[at]] = distance - bodies
                at_knot = k + 1 if s >= length else k
                nx = (dx + s * (unit[i, 0] - unit[j, 0])) / max(distance, 1e-12)
                ny = (dy + s * (unit[i, 1] - unit[j, 1])) / max(distance, 1e-12)
                for side in range(2):
                    who = i if side == 0 else j
                    sign = 1.0 if side == 0 else -1.0
                    robot[at + side], knot[at + side] = who, at_knot
                    point[at + side, 0] = place[who, 0] + s * unit[who, 0]
                    point[at + side, 1] = place[who, 1] + s * unit[who, 1]
                    weight[at + side, 0], weight[at + side, 1] = sign * nx, sign * ny
    return found, used, gaps, row, robot, knot, point, weight


@kernel()
def _neighbours(pairs, met, place, body, points_too, far):
    """Fill in which robots may meet while none of them moves by more than far; return how many pairs there are."""
    count = 0
    for i in range(place.shape[0]):
        for j in range(i):
            if body[i] + body[j] == 0.0 and not points_too:
                continue
            reach = 2.0 * far + body[i] + body[j]
            if abs(place[i, 0] - place[j, 0]) <= reach and abs(place[i, 1] - place[j, 1]) <= reach:
                pairs[count] = i, j
                count += 1
            elif met.shape[0] > 0:
                met[i, j] = -1
    return count


@kernel()
def shape_gap(kind, index, x, y, ux, uy, length, circles, edges, edge_ends, walls):
    """Return (distance of a sliding point from one shape, length where it occurs, outward normal)."""
    if kind == 0:
        cx, cy = circles[index, 0], circles[index, 1]
        distance, s = moving_points_gap(x - cx, y - cy, ux, uy, length)
        nx, ny = (x + s * ux - cx) / max(distance, 1e-12), (y + s * uy - cy) / max(distance, 1e-12)
        return distance - circles[index, 2], s, nx, ny
    if kind == 1:
        first = edge_ends[index - 1] if index > 0 else 0
        return _polygon_gap(x, y, ux, uy, length, edges[first : edge_ends[index]])
    nx = 1.0 if index == 0 else -1.0 if index == 1 else 0.0
    ny = 1.0 if index == 2 else -1.0 if index == 3 else 0.0
    sign = 1.0 if index % 2 == 0 else -1.0
    s = length if nx * ux + ny * uy < 0.0 else 0.0
    return (x + s * ux) * nx + (y + s * uy) * ny - sign * walls[index], s, nx, ny


@kernel()
def _polygon_gap(x, y, ux, uy, length, edges):
    """Return (signed distance, length where it occurs, outward normal) of a sliding point and a filled polygon.

    Outside it is exact: the closest approach is at an end or beside a corner. Inside, the depth is taken at those
    places and halfway between crossings, which is enough to be driven out.
    """
    corners = edges.shape[0]
    best, at, best_nx, best_ny = np.inf, 0.0, 1.0, 0.0
    crossing = np.empty(corners)
    crossings = 0
    for e in range(corners):
        ex, ey = edges[e, 2] - edges[e, 0], edges[e, 3] - edges[e, 1]
        cross = ux * ey - uy * ex
        if cross != 0.0:
            along = ((edges[e, 0] - x) * ey - (edges[e, 1] - y) * ex) / cross
            share = ((edges[e, 0] - x) * uy - (edges[e, 1] - y) * ux) / cross
            if 0.0 <= along <= length and 0.0 <= share <= 1.0:
                crossing[crossings] = along
                crossings += 1
    for candidate in range(2 + corners + crossings):
        if candidate < 2:
            s = candidate * length
        elif candidate < 2 + corners:
            e = candidate - 2
            s = min(max((edges[e, 0] - x) * ux + (edges[e, 1] - y) * uy, 0.0), length)
        else:
            first = crossing[candidate - 2 - corners]
            after = length
            for c in range(crossings):
                if first < crossing[c] < after:
                    after = crossing[c]
            s = 0.5 * (first + after)
        px, py = x + s * ux, y + s * uy
        distance, nx, ny = np.inf, 1.0, 0.0
        for e in range(corners):
            ex, ey = edges[e, 2] - edges[e, 0], edges[e, 3] - edges[e, 1]
            share = ((px - edges[e, 0]) * ex + (py - edges[e, 1]) * ey) / max(ex * ex + ey * ey, 1e-300)
            share = min(max(share, 0.0), 1.0)
            dx, dy = px - edges[e, 0] - share * ex, py - edges[e, 1] - share * ey
            gap = np.hypot(dx, dy)
            if gap < distance:
                distance, nx, ny = gap, dx / max(gap, 1e-12), dy / max(gap, 1e-12)
        if inside_polygon(px, py, edges):
            distance, nx, ny = -distance, -nx, -ny
        if distance < best:
            best, at, best_nx, best_ny = distance, s, nx, ny
    return best, at, best_nx, best_ny
