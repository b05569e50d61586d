"""Windows: a few activations whose durations are found together, to bring a swarm nearer to its goals, safely.

Of random orders of groups, each with durations t from a random guess:

    minimise    1/2 sum max(0, way_j - enough)^2 + rho/2 sum max(0, room + growth s - gap)^2 + price sum t

over t = s^2 by Levenberg-Marquardt steps. The way_j that a robot has left at the end is that of its map of cost-to-go; gaps are
those of bodies that grow along each slide, by the cones of what is not known of their headings and speeds (`Situation`).
Activations that have become short are left out, and the descent goes on without them. What is clear from the beginning on counts,
by the exact check of slides. The best window has the largest logarithm of the value gained, for what it costs in driving and
in activations.

All members of a group slide whatever their headings are, so that a window of a dozen activations gains far more than a dozen
chosen one after the other: what one slide spoils the next ones mend.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.beam_search.cost_to_go import way_left
from stressbot_planner.beam_search.situation import Situation, moved, slide_is_clear, value_of
from stressbot_planner.planners.optimization.gaps import shape_gap
from stressbot_planner.system.kernels import kernel

ACTIVATIONS = 12
"""Of a window, before short ones are left out."""

GUESSES, FEWEST, MANY = 40, 4, 14
"""Random orders tried for up to MANY robots, and for any number: each takes n^2 as long."""

GUESSED = (0.2, 1.6)
"""Durations of a guess, turning lengths."""

PRICE = 1 / 600
"""Of driving for one turning length, in shares of the value now."""

SELECTION, LOOK = 2.4, 1.0
"""What an activation and a window cost beside driving, turning lengths."""

STIFFNESS = (2.0, 60.0)
"""Rho, in relation to the root of the value over n and the room: bodies may pass through each other first."""

STEPS, LAST_STEPS, ATTEMPTS = 20, 10, 6
"""Levenberg-Marquardt steps with each rho, and without short activations; attempts at a step."""

SHORT, SHORTEST = 0.4, 0.064
"""Of the mean duration: activations that are shorter than the first are left out, after the last steps than the second."""

CLEAR = 4
"""So many activations have to be clear from the beginning on, or all."""

ENOUGH = 0.5
"""Of the way left that is as good as none: where descents aim."""

_STALL = 1e-3
_LEAST = 1e-8
"""Durations, turning lengths; damping, of the mean diagonal."""


class Window(NamedTuple):
    """Groups (K,), 1..m, and lengths (K,), > 0, of activations."""

    groups: np.ndarray
    lengths: np.ndarray


NO_WINDOW = Window(np.empty(0, dtype=np.int64), np.empty(0))


def best_window(
    situation: Situation, poses: np.ndarray, known: Window, rng: np.random.Generator, ripe: float, room: float
) -> Window:
    """Return safe activations that bring robots at poses (n, 3) nearer to their goals; `NO_WINDOW` if none were found.

    Args:
        situation: the robots, and what surrounds them.
        poses: directions in which the robots slide in place of their headings.
        known: what is left of the window before, of at most `ACTIVATIONS`. It is tried as it is, and as the beginning of a guess.
        rng: for orders and guesses.
        ripe: largest way left, units, below which a position is as good as it need be.
        room: that descents leave between bodies beside what is safe, units, > 0.
    """
    groups = len(situation.slides)
    count = int(np.clip(GUESSES * (MANY / len(poses)) ** 2, FEWEST, GUESSES)) + 1
    orders = np.argsort(rng.random((count, ACTIVATIONS // groups + 1, groups)), axis=2).reshape(count, -1)[:, :ACTIVATIONS]
    guesses = float(situation.turning_length.mean()) * rng.uniform(*GUESSED, orders.shape)
    orders[0] = np.append(known.groups - 1, orders[0])[:ACTIVATIONS]
    guesses[0] = np.append(known.lengths, guesses[0])[:ACTIVATIONS]
    start = np.array(poses, dtype=float, order="C")  # see `Situation.of`
    found, lengths = _best(situation, start, known.groups - 1, np.array(known.lengths), orders, guesses, ripe, room)
    return Window(found + 1, lengths)


@kernel(nogil=True)
def _best(situation, start, known, known_lengths, orders, guesses, ripe, room):
    """Return groups (from 0) and lengths of the best window, empty if none gains."""
    unit = situation.turning_length.mean()
    now = max(value_of(situation, start, 0.0), 1e-300)
    best = 0.0
    groups, lengths = known[:0], known_lengths[:0]
    for c in range(-1, len(orders)):
        if c < 0:
            order, t = known, known_lengths
        else:
            order, t = _improved(situation, start, orders[c], guesses[c], now, ripe, room)
        until, end = _clear(situation, start, order, t)
        if until == 0 or c >= 0 and until < min(len(order), CLEAR):
            continue
        left = max(value_of(situation, end, ripe), 0.1 * ripe * ripe) / now
        gain = np.log(left) / (t[:until].sum() + (SELECTION * until + LOOK) * unit)
        if gain < best:
            best, groups, lengths = gain, order[:until], t[:until]
    return groups, lengths


@kernel()
def _improved(situation, start, order, guess, now, ripe, room):
    """Return an order without its short activations, and its durations."""
    price = PRICE * now / situation.turning_length.mean()
    stiffness = np.sqrt(now / len(start)) / room
    t = guess
    for rho in STIFFNESS:
        t = _descended(situation, start, order, t, rho * stiffness, price, ENOUGH * ripe, room, STEPS)
    kept, merged = np.empty_like(order), np.empty_like(t)
    count, mean = 0, t.mean()
    for k in range(len(t)):
        if t[k] <= SHORT * mean:
            continue
        if count > 0 and kept[count - 1] == order[k]:
            merged[count - 1] += t[k]
        else:
            kept[count], merged[count] = order[k], t[k]
            count += 1
    order, t = kept[:count], merged[:count]
    if count < len(guess):
        t = _descended(situation, start, order, t, STIFFNESS[-1] * stiffness, price, ENOUGH * ripe, room, LAST_STEPS)
    real = t > SHORTEST * mean
    return order[real], t[real]


@kernel()
def _clear(situation, start, order, t):
    """Return how many activations from the first on are safe, and the poses after them."""
    poses, sliding = start, situation.slides.shape[0] - 1
    for k in range(len(order)):
        if order[k] == sliding:
            poses = moved(situation, poses, t[k], 0, 0.0)
        elif slide_is_clear(situation, poses, order[k], t[k]):
            poses = moved(situation, poses, 0.0, order[k], t[k])
        else:
            return k, poses
    return len(order), poses


@kernel()
def _descended(situation, start, order, t, rho, price, enough, room, steps):
    """Return durations after so many steps from t, or fewer."""
    count = len(order)
    square, slope = np.zeros((count, count)), np.zeros(count)
    poses = _trajectory(situation, start, order, t)
    value = _evaluated(situation, order, t, poses, rho, price, enough, room, square, slope, True)
    damping, least = -1.0, _LEAST * situation.turning_length.mean()
    for _ in range(steps):
        double = 2.0 * np.sqrt(t)
        scaled = square * np.outer(double, double)
        scale = np.trace(scaled) / count
        if not 0.0 < scale < np.inf:
            break
        damping = max(damping, _LEAST * scale) if damping > 0.0 else 1e-2 * scale
        before, t_there, poses_there = value, t, poses
        for attempt in range(ATTEMPTS):
            damped = scaled.copy()
            for k in range(count):
                damped[k, k] += damping + 2.0 * price
            s = np.sqrt(t) + np.linalg.solve(damped, slope * double)
            t_there = np.maximum(s * s, least)
            poses_there = _trajectory(situation, start, order, t_there)
            value = _evaluated(situation, order, t_there, poses_there, rho, price, enough, room, square, slope, False)
            if value < before:
                damping *= 0.3 if attempt == 0 else 1.0
                break
            damping *= 5.0
        if not value < before:
            break
        t, poses = t_there, poses_there
        if before - value < _STALL * before:
            break
        _evaluated(situation, order, t, poses, rho, price, enough, room, square, slope, True)
    return t


@kernel()
def _trajectory(situation, start, order, t):
    """Return the poses at every knot, shape (K + 1, n, 3)."""
    n = start.shape[0]
    poses = np.empty((len(order) + 1, n, 3))
    poses[0] = start
    for k in range(len(order)):
        for j in range(n):
            x, y, heading = poses[k, j, 0], poses[k, j, 1], poses[k, j, 2]
            slide = situation.slides[order[k], j] * t[k]
            if slide > 0.0:
                poses[k + 1, j] = x + slide * np.cos(heading), y + slide * np.sin(heading), heading
            else:
                poses[k + 1, j] = x, y, heading + t[k] / situation.turning_length[j]
    return poses


@kernel()
def _evaluated(situation, order, t, poses, rho, price, enough, room, square, slope, derive):
    """Return what is minimised; put the Gauss-Newton Hessian (K, K) and minus the gradient (K,) by t into square and slope."""
    count, n = len(order), poses.shape[1]
    row = np.zeros(count)
    value = price * t.sum()
    if derive:
        square[:] = 0.0
        slope[:] = -price
    for j in range(n):
        x, y = poses[count, j, 0], poses[count, j, 1]
        way, gx, gy = way_left(j, x, y, situation.low, situation.size, situation.excess, situation.goals)
        if way <= enough:
            continue
        value += 0.5 * (way - enough) ** 2
        if derive:
            row[:] = 0.0
            _add_motion(row, situation, order, poses, count, j, gx, gy, x, y)
            _add_square(square, slope, row, count, 1.0, enough - way)
    circles, polygons = len(situation.circles), len(situation.edge_ends)
    least = situation.least + room
    for k in range(count):
        slides = situation.slides[order[k]]
        for i in range(n):
            if slides[i] == 0.0:
                continue
            x, y, heading = poses[k, i, 0], poses[k, i, 1], poses[k, i, 2]
            ux, uy, slid, cone = np.cos(heading), np.sin(heading), slides[i] * t[k], situation.cone[i]
            for o in range(circles + polygons + 4):
                if o < circles:
                    dx, dy = x - situation.circles[o, 0], y - situation.circles[o, 1]
                    far = situation.circles[o, 2] + situation.body[i] + least + (1.0 + cone) * slid
                    if dx * dx + dy * dy > far * far:
                        continue
                    s, nx, ny, distance = _closest(dx, dy, ux, uy, cone, slid)
                    gap = distance - situation.circles[o, 2]
                else:
                    kind, index = (1, o - circles) if o < circles + polygons else (2, o - circles - polygons)
                    if kind == 2 and np.isinf(situation.walls[index]):
                        continue
                    gap, s, nx, ny = shape_gap(
                        kind, index, x, y, ux, uy, slid, situation.circles, situation.edges, situation.edge_ends, situation.walls
                    )
                short = least + cone * s - gap + situation.body[i]
                if short <= 0.0:
                    continue
                value += 0.5 * rho * short * short
                if derive:
                    row[:] = 0.0
                    _add_motion(row, situation, order, poses, k, i, nx, ny, x + s * ux, y + s * uy)
                    if s >= slid:
                        row[k] += slides[i] * (nx * ux + ny * uy - cone)
                    _add_square(square, slope, row, k + 1, rho, short)
        for i in range(n):
            for j in range(i):
                bodies = situation.body[i] + situation.body[j]
                if slides[i] == 0.0 and slides[j] == 0.0 or bodies == 0.0 and not situation.points_too:
                    continue
                growth = slides[i] * situation.cone[i] + slides[j] * situation.cone[j]
                dx, dy = poses[k, i, 0] - poses[k, j, 0], poses[k, i, 1] - poses[k, j, 1]
                far = bodies + least + (slides[i] + slides[j] + growth) * t[k]
                if dx * dx + dy * dy > far * far:
                    continue
                uix, uiy = slides[i] * np.cos(poses[k, i, 2]), slides[i] * np.sin(poses[k, i, 2])
                ujx, ujy = slides[j] * np.cos(poses[k, j, 2]), slides[j] * np.sin(poses[k, j, 2])
                s, nx, ny, distance = _closest(dx, dy, uix - ujx, uiy - ujy, growth, t[k])
                short = bodies + least + growth * s - distance
                if short <= 0.0:
                    continue
                value += 0.5 * rho * short * short
                if derive:
                    row[:] = 0.0
                    xi, yi, xj, yj = poses[k, i, 0], poses[k, i, 1], poses[k, j, 0], poses[k, j, 1]
                    _add_motion(row, situation, order, poses, k, i, nx, ny, xi + s * uix, yi + s * uiy)
                    _add_motion(row, situation, order, poses, k, j, -nx, -ny, xj + s * ujx, yj + s * ujy)
                    if s >= t[k]:
                        row[k] += nx * (uix - ujx) + ny * (uiy - ujy) - growth
                    _add_square(square, slope, row, k + 1, rho, short)
    return value


@kernel()
def _closest(dx, dy, u, v, growth, length):
    """Return where s <= length makes |d + s v| - growth s smallest, the unit vector along d + s v there, and its length.

    With v > growth that is h growth / (v sqrt(v^2 - growth^2)) behind the closest approach, h being the distance there.
    """
    square = u * u + v * v
    s = length
    if square > growth * growth:
        along = (dx * u + dy * v) / square
        beside = np.sqrt(max(dx * dx + dy * dy - along * along * square, 0.0))
        s = min(max(growth * beside / np.sqrt(square * (square - growth * growth)) - along, 0.0), length)
    x, y = dx + s * u, dy + s * v
    distance = np.sqrt(x * x + y * y)
    return s, x / max(distance, 1e-300), y / max(distance, 1e-300), distance


@kernel()
def _add_motion(row, situation, order, poses, count, j, nx, ny, x, y):
    """Add to a row the derivatives by the first `count` durations of the way along (nx, ny) of a robot that they bring to x, y."""
    for k in range(count):
        slide = situation.slides[order[k], j]
        if slide > 0.0:
            row[k] += slide * (nx * np.cos(poses[k, j, 2]) + ny * np.sin(poses[k, j, 2]))
        else:
            row[k] += (ny * (x - poses[k, j, 0]) - nx * (y - poses[k, j, 1])) / situation.turning_length[j]


@kernel()
def _add_square(square, slope, row, count, weight, missing):
    """Add the square of a row whose first `count` entries are not 0, and what it misses."""
    for a in range(count):
        slope[a] += weight * row[a] * missing
        for b in range(count):
            square[a, b] += weight * row[a] * row[b]
