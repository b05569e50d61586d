"""Where robots are along a fixed group order, which gaps are too small there, and how goals and gaps respond to the durations.

The same values and derivatives as in `derivatives`, for crowds: headings as unit vectors, turned by one complex number for each
activation and turning length; one gap a *meeting*, the activations in a row during which two bodies stay within reach; pairs
tested by the boxes of a cycle of activations; derivatives with respect to s, where t = s^2, in single precision.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.planners.optimization.gaps import shape_gap
from stressbot_planner.system.kernels import kernel

NOBODY = -1


class Trajectory(NamedTuple):
    """Places and unit headings at every knot, each of shape (n, K + 1)."""

    x: np.ndarray
    y: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray


class Gaps(NamedTuple):
    """Gaps below the reach that was asked for, g of them.

    Attributes:
        size: units, shape (g,).
        knot: durations before it move the gap, shape (g,).
        robots: who meets, from 0; the second is `NOBODY` for an obstacle or wall, shape (g, 2).
        points: where the two are, x, y, x, y, shape (g, 4).
        normal: unit vector from the second to the first, shape (g, 2).
    """

    size: np.ndarray
    knot: np.ndarray
    robots: np.ndarray
    points: np.ndarray
    normal: np.ndarray


@kernel(fastmath=True)
def trajectory_of(slides, turning_lengths, kind, start, t):
    """Return x, y, cosine, sine of a `Trajectory`.

    Args:
        slides: distance that a robot slides for each unit of t, shape (n, K); where 0 it turns.
        turning_lengths: the different lengths in which robots turn by 1 rad, shape (u,).
        kind: which of them is each robot's, shape (n,).
        start: poses, shape (n, 3).
        t: lengths, shape (K,).
    """
    n, count = slides.shape
    x, y = np.empty((n, count + 1)), np.empty((n, count + 1))
    cosine, sine = np.empty((n, count + 1)), np.empty((n, count + 1))
    turn_cosine, turn_sine = np.empty((len(turning_lengths), count)), np.empty((len(turning_lengths), count))
    for u in range(len(turning_lengths)):
        for k in range(count):
            angle = t[k] / turning_lengths[u]
            turn_cosine[u, k], turn_sine[u, k] = np.cos(angle), np.sin(angle)
    for j in range(n):
        px, py, a, b = start[j, 0], start[j, 1], np.cos(start[j, 2]), np.sin(start[j, 2])
        x[j, 0], y[j, 0], cosine[j, 0], sine[j, 0] = px, py, a, b
        c, s = turn_cosine[kind[j]], turn_sine[kind[j]]
        for k in range(count):
            if slides[j, k] > 0.0:
                px += slides[j, k] * t[k] * a
                py += slides[j, k] * t[k] * b
            else:
                a, b = a * c[k] - b * s[k], a * s[k] + b * c[k]
            x[j, k + 1], y[j, k + 1], cosine[j, k + 1], sine[j, k + 1] = px, py, a, b
    return x, y, cosine, sine


def boxes_of(shapes: Shapes) -> np.ndarray:
    """Return x_min, x_max, y_min, y_max of each circle, polygon and wall, (c + p + 4, 4); walls that are not there are empty."""
    circles = [(x - r, x + r, y - r, y + r) for x, y, r in shapes.circles]
    ends = [0, *shapes.edge_ends.tolist()]
    polygons = []
    for first, last in zip(ends, ends[1:], strict=False):
        corners = shapes.edges[first:last, :2]
        polygons.append((corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max()))
    inf = np.inf
    sides = [(-inf, 0, -inf, inf), (0, inf, -inf, inf), (-inf, inf, -inf, 0), (-inf, inf, 0, inf)]
    walls = []
    for w, side in enumerate(sides):
        at = shapes.walls[w]
        walls.append((inf, -inf, inf, -inf) if np.isinf(at) else tuple(at if edge == 0 else edge for edge in side))
    return np.array([*circles, *polygons, *walls], dtype=float).reshape(-1, 4)


@kernel()
def gaps_of(
    capacity, trajectory, slides, t, body, boxes, circles, edges, edge_ends, walls, reach, block, meetings
):
    """Return how many gaps there are below reach, and the first `capacity` of them as the arrays of `Gaps`.

    Args:
        trajectory: see `trajectory_of`; slides, t, as there.
        body: radii, shape (n,). Two points (of radius 0) never meet.
        boxes, circles, edges, edge_ends, walls: see `boxes_of` and `Shapes`.
        block: activations in one box.
        meetings: whether only the smallest gap of each meeting counts; else one gap an activation.
    """
    x, y, cosine, sine = trajectory
    n, count = slides.shape
    blocks = (count + block - 1) // block
    size, knot, robots = np.empty(capacity), np.empty(capacity, np.int64), np.empty((capacity, 2), np.int64)
    points, normal = np.empty((capacity, 4)), np.empty((capacity, 2))
    box, whole = np.empty((blocks, n, 4)), np.empty((n, 4))
    for j in range(n):
        room = 0.5 * reach + body[j]
        whole[j, 0], whole[j, 1], whole[j, 2], whole[j, 3] = np.inf, -np.inf, np.inf, -np.inf
        for b in range(blocks):
            here = box[b, j]
            here[0], here[1], here[2], here[3] = np.inf, -np.inf, np.inf, -np.inf
            for k in range(b * block, min((b + 1) * block, count) + 1):
                here[0], here[1] = min(here[0], x[j, k] - room), max(here[1], x[j, k] + room)
                here[2], here[3] = min(here[2], y[j, k] - room), max(here[3], y[j, k] + room)
            whole[j, 0], whole[j, 1] = min(whole[j, 0], here[0]), max(whole[j, 1], here[1])
            whole[j, 2], whole[j, 3] = min(whole[j, 2], here[2]), max(whole[j, 3], here[3])
    found = 0
    for j in range(n):
        for o in range(len(boxes)):
            if _apart(whole[j], boxes[o], 0.5 * reach):
                continue
            shape, index = 0, o
            if o >= len(circles):
                shape, index = 1, o - len(circles)
            if o >= len(circles) + len(edge_ends):
                shape, index = 2, o - len(circles) - len(edge_ends)
            at = NOBODY
            for b in range(blocks):
                if _apart(box[b, j], boxes[o], 0.5 * reach):
                    at = NOBODY
                    continue
                for k in range(b * block, min((b + 1) * block, count)):
                    if slides[j, k] == 0.0:
                        continue
                    slid = slides[j, k] * t[k]
                    a, c = cosine[j, k], sine[j, k]
                    gap, s, nx, ny = shape_gap(shape, index, x[j, k], y[j, k], a, c, slid, circles, edges, edge_ends, walls)
                    gap -= body[j]
                    if gap >= reach:
                        at = NOBODY
                        continue
                    if not meetings or at < 0:
                        at = found
                        found += 1
                    elif at < capacity and gap >= size[at]:
                        continue
                    if at < capacity:
                        size[at], knot[at] = gap, k + 1 if s >= slid else k
                        robots[at, 0], robots[at, 1] = j, NOBODY
                        points[at, 0], points[at, 1] = x[j, k] + s * a, y[j, k] + s * c
                        points[at, 2], points[at, 3] = 0.0, 0.0
                        normal[at, 0], normal[at, 1] = nx, ny
    for i in range(n):
        for j in range(i):
            bodies = body[i] + body[j]
            if bodies == 0.0 or _apart(whole[i], whole[j], 0.0):
                continue
            at = NOBODY
            for b in range(blocks):
                if _apart(box[b, i], box[b, j], 0.0):
                    at = NOBODY
                    continue
                for k in range(b * block, min((b + 1) * block, count)):
                    pi, pj = slides[i, k], slides[j, k]
                    if pi == 0.0 and pj == 0.0:
                        continue
                    dx, dy = x[i, k] - x[j, k], y[i, k] - y[j, k]
                    far = reach + bodies + (pi + pj) * t[k]
                    if dx > far or dx < -far or dy > far or dy < -far:
                        at = NOBODY
                        continue
                    u, v = pi * cosine[i, k] - pj * cosine[j, k], pi * sine[i, k] - pj * sine[j, k]
                    speed2 = u * u + v * v
                    s = 0.0
                    if speed2 > 0.0:
                        s = min(max(-(dx * u + dy * v) / speed2, 0.0), t[k])
                    ex, ey = dx + s * u, dy + s * v
                    distance = np.sqrt(ex * ex + ey * ey)
                    gap = distance - bodies
                    if gap >= reach:
                        at = NOBODY
                        continue
                    if not meetings or at < 0:
                        at = found
                        found += 1
                    elif at < capacity and gap >= size[at]:
                        continue
                    if at < capacity:
                        size[at], knot[at] = gap, k + 1 if s >= t[k] else k
                        robots[at, 0], robots[at, 1] = i, j
                        points[at, 0], points[at, 1] = x[i, k] + s * pi * cosine[i, k], y[i, k] + s * pi * sine[i, k]
                        points[at, 2], points[at, 3] = x[j, k] + s * pj * cosine[j, k], y[j, k] + s * pj * sine[j, k]
                        normal[at, 0], normal[at, 1] = ex / max(distance, 1e-12), ey / max(distance, 1e-12)
    return found, size, knot, robots, points, normal


@kernel()
def _apart(box, other, room):
    return (
        box[0] > other[1] + room or other[0] - room > box[1] or box[2] > other[3] + room or other[2] - room > box[3]
    )


@kernel(fastmath=True)
def crowd_jacobian(trajectory, slides, turning_length, t, aim_weights, gaps, gap_weights, total_weights):
    """Return weighted derivatives with respect to s, where t = s^2: of ends, gaps and a weighted total, (2n + g + 1, K).

    Single precision: who makes the last step exactly does not need more.

    Args:
        trajectory, slides, t: see `trajectory_of`.
        turning_length: shape (n,).
        aim_weights: of each robot's two rows, shape (n,).
        gaps: see `Gaps`.
        gap_weights: shape (g,).
        total_weights: of each duration in the last row, shape (K,).
    """
    x, y, cosine, sine = trajectory
    _, knot, robots, points, normal = gaps
    n, count = slides.shape
    g = len(knot)
    along_x = np.empty((n, count), np.float32)
    along_y = np.empty((n, count), np.float32)
    about = np.empty((n, count), np.float32)
    double = 2.0 * np.sqrt(t)
    for j in range(n):  # places relative to the robot's end: small numbers for single precision
        for k in range(count):
            if slides[j, k] > 0.0:
                along_x[j, k] = double[k] * slides[j, k] * cosine[j, k]
                along_y[j, k] = double[k] * slides[j, k] * sine[j, k]
                about[j, k] = 0.0
            else:
                turned = double[k] / turning_length[j]
                along_x[j, k], along_y[j, k] = turned * (y[j, k] - y[j, count]), -turned * (x[j, k] - x[j, count])
                about[j, k] = turned
    rows = np.zeros((2 * n + g + 1, count), np.float32)
    for j in range(n):
        w = np.float32(aim_weights[j])
        for k in range(count):
            rows[2 * j, k], rows[2 * j + 1, k] = w * along_x[j, k], w * along_y[j, k]
    for f in range(g):
        w, i, j = gap_weights[f], robots[f, 0], robots[f, 1]
        nx, ny = normal[f, 0], normal[f, 1]
        wx, wy = np.float32(w * nx), np.float32(w * ny)
        turn_i = np.float32(w * (ny * (points[f, 0] - x[i, count]) - nx * (points[f, 1] - y[i, count])))
        row = rows[2 * n + f]
        if j < 0:
            for k in range(knot[f]):
                row[k] = wx * along_x[i, k] + wy * along_y[i, k] + turn_i * about[i, k]
        else:
            turn_j = np.float32(-w * (ny * (points[f, 2] - x[j, count]) - nx * (points[f, 3] - y[j, count])))
            for k in range(knot[f]):
                row[k] = (
                    wx * (along_x[i, k] - along_x[j, k]) + wy * (along_y[i, k] - along_y[j, k])
                    + turn_i * about[i, k] + turn_j * about[j, k]
                )
    for k in range(count):
        rows[2 * n + g, k] = np.float32(total_weights[k] * double[k])
    return rows
