"""Gaps that are too small along a fixed group order, as functionals of the durations (see `derivatives`)."""

import numpy as np

from stressbot_planner.collision.clearance import NO_CREDIT, inside_polygon, moving_points_gap
from stressbot_planner.planners.optimization.derivatives import Functionals
from stressbot_planner.system.kernels import kernel


def near_gaps(
    reach, slides, poses, t, body, shapes, meetings=False, points_too=False, credit=NO_CREDIT
) -> tuple[np.ndarray, Functionals]:
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
        credit: by which gaps of two robots count as larger, see `collision.clearance_of`.

    Returns:
        Gaps (g,), and their functionals with one row a gap.
    """
    capacity = 8 * len(t)
    while True:
        found, used, *arrays = _near_gaps(
            capacity, reach, meetings, points_too, credit, slides, poses, t, body, *shapes.kernel_arguments
        )
        if used <= capacity:
            gaps, row, robot, knot, point, weight = arrays
            return gaps[:found], Functionals(row[:used], robot[:used], knot[:used], point[:used], weight[:used])
        capacity = 2 * used


_SKIN, _SKIN_OF_SLIDES = 6.0, 8.0
"""Pairs are looked at that come within reach while robots move by this many largest body radii, or mean lengths of activations,
until one has."""


@kernel()
def _near_gaps(capacity, reach, meetings, points_too, credit, slides, poses, t, body, circles, edges, edge_ends, walls):
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
            if credit.shape[0] > 0:
                bodies -= credit[i, j]
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
