"""Whole numbers of pulses for the activations of a plan, so that every robot still ends within a few steps of where it should.

Rounding each activation by itself leaves half a step of every slide, and half a step of every turn times the way left. Instead

    1. numbers are rounded so that those of one group add up to what they should, within half a pulse at any time: headings stay
       right but for a few steps, however long the plan is;
    2. activations get a pulse more or less, one or two at a time and always those that bring the robots nearer most, in the sense
       of least squares and by the derivatives of where they end, until none does. If one ends far off, other roundings are tried,
   and at last perturbations of the best (iterated local search).

K activations have 2 K^2 such pairs, in 2 n dimensions, so that a plan of tens of activations ends within some two steps and
no activation changes by more than some pulses: the plan goes where it went.
"""

from collections.abc import Sequence

import numpy as np

from stressbot_planner.model.goal_reaching import end_jacobian
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.model.swarm import Swarm

WHOLE = 1e-6
"""Pulses: numbers are whole that differ from whole ones by no more than this, and by rounding."""

MOST_ROBOTS, MOST_KNOTS = 1000, 20_000_000
"""Larger swarms, and plans with more poses of robots, are rounded by step 1 alone."""

_WINDOW, _LEAST_WINDOW, _LARGEST_WINDOW = 12, 100, 600
"""Number of last activations that step 2 may change: for each robot, and at least and at most in all."""

_CHANGE = 10.0
"""Pulses by which it changes an activation at most."""

_MOVES, _MOST_MOVES = 8, 300
"""Number of changes from one look at the derivatives to the next: for each robot, and at most in all."""

_LOOKS = 3

LEEWAY = 5.0
"""Steps of the fastest robots by which plans of whole pulses may miss their goals."""

ASIDE = 2.0
"""Steps by which bodies that touch at their goals had better stay away: most robots end nearer than that to where they should."""

_OFFSETS, _GOOD = (0.5, 0.3, 0.7, 0.1, 0.9), 3.0
"""What sums are rounded with, one after the other; and the largest miss of a robot, in steps, that ends these trials."""

_KICKS, _SHORT = 300, 50
"""How many perturbations follow (iterated local search) where a plan of at most so many activations still misses by more than
`LEEWAY`: few activations leave few choices. Of longer plans fewer, since each takes the square of their number."""

_KICK, _CHANCES, _SIGMA = (-2.0, -1.0, 0.0, 1.0, 2.0), (0.05, 0.1, 0.7, 0.1, 0.05), 0.5
"""Changes of each activation, pulses, and their probabilities. It is the largest miss that counts, so that misses get random
weights, too: sigma of their logarithms."""

_NOTHING = 1e-6
"""Gain, steps^2, that is none."""


def is_whole(pulses: np.ndarray) -> bool:
    """Return whether numbers of pulses (K,) are whole, but for rounding."""
    return bool(np.all(np.abs(pulses - np.rint(pulses)) <= WHOLE + 1e-12 * pulses))


def contact_depth(pulse_length: float | None) -> float:
    """Return by how much two robots that touch at their goals may overlap, units: each may end `LEEWAY` pulses from its own."""
    return 0.0 if pulse_length is None else 2 * LEEWAY * pulse_length


def whole(
    swarm: Swarm, starts: np.ndarray, groups: np.ndarray, lengths: np.ndarray, step: float, headed: Sequence[int] = ()
) -> np.ndarray:
    """Return whole numbers of pulses near a plan's, after which robots end about where it leads them, shape (K,), as doubles.

    What is whole already stays as it is.

    Args:
        swarm: the robots.
        starts: poses, shape (n, 3).
        groups: 1..m, shape (K,).
        lengths: units, >= 0, shape (K,).
        step: length of an activation of one pulse, units.
        headed: rows of robots whose headings are to be kept as well.
    """
    pulses = np.asarray(lengths, dtype=float) / step
    if is_whole(pulses):
        return np.rint(pulses)
    groups = np.asarray(groups, dtype=np.int64)
    if swarm.n > MOST_ROBOTS or swarm.n * len(groups) > MOST_KNOTS:
        return _summed(groups, pulses, _OFFSETS[0])
    first = max(0, len(groups) - min(max(_WINDOW * swarm.n, _LEAST_WINDOW), _LARGEST_WINDOW))
    before, after = slice(None, first), slice(first, None)
    slides, turning = swarm.slides, swarm.turning_length

    def end(start: np.ndarray, part: slice, numbers: np.ndarray) -> np.ndarray:
        return trajectory(slides[groups[part] - 1], turning, start, step * numbers[part])

    starts = np.asarray(starts, dtype=float)
    wanted = end(end(starts, before, pulses)[-1], after, pulses)[-1]
    watched = np.asarray(headed, dtype=np.int64)
    turns = (slides[groups[after] - 1][:, watched] == 0).T.astype(float)

    def off_by(middle: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, float]:
        """Return by how many steps robots end off, places and then arcs of headings; and how far the furthest is."""
        off = end(middle, after, numbers)[-1] - wanted
        places, arcs = off[:, :2] / step, (off[:, 2] * turning)[watched] / step
        return np.concatenate([places.ravel(), arcs]), float(max(np.hypot(*places.T).max(), np.abs(arcs).max(initial=0.0)))

    def settled(counts: np.ndarray, weights: np.ndarray) -> float:
        """Bring robots nearer by step 2, in place, with weights of the misses; return how far the furthest is off."""
        middle = end(starts, before, counts)[-1]
        off, miss = off_by(middle, counts)
        for _ in range(_LOOKS):
            _, effects = end_jacobian(slides[groups[after] - 1], turning, middle, step * counts[after], np.ones_like(counts[after]))
            effects = weights[:, None] * np.vstack([effects, turns])
            changed = _nearer(pulses[after], counts[after], weights * off, effects, _MOVES * swarm.n)
            if np.array_equal(changed, counts[after]):
                break
            counts[after] = changed
            off, miss = off_by(middle, counts)
        return miss

    best, found = np.inf, pulses
    alike = np.ones(2 * swarm.n + len(watched))
    for offset in _OFFSETS:
        counts = _summed(groups, pulses, offset)
        miss = settled(counts, alike)
        if miss < best:
            best, found = miss, counts
        if best <= _GOOD:
            break
    rng = np.random.default_rng(0)
    for _ in range(int(_KICKS * min(1.0, (_SHORT / len(groups)) ** 2))):
        if best <= LEEWAY:
            break
        counts = found + rng.choice(_KICK, len(groups), p=_CHANCES)
        counts = np.clip(counts, np.maximum(np.ceil(pulses - _CHANGE), 0.0), np.floor(pulses + _CHANGE))
        miss = settled(counts, np.exp(rng.normal(0.0, _SIGMA, len(alike))))
        if miss < best:
            best, found = miss, counts
    return found


def _summed(groups: np.ndarray, pulses: np.ndarray, offset: float) -> np.ndarray:
    """Return whole numbers whose sums over the activations of each group so far are those of the pulses plus offset, cut."""
    counts = np.empty(len(pulses))
    for group in np.unique(groups):
        rows = groups == group
        counts[rows] = np.diff(np.floor(np.cumsum(pulses[rows]) + offset), prepend=0.0)
    return counts


def _nearer(pulses: np.ndarray, counts: np.ndarray, off: np.ndarray, effects: np.ndarray, moves: int) -> np.ndarray:
    """Return step 2.

    Args:
        pulses: of the plan, shape (K,).
        counts: whole numbers, shape (K,).
        off: how far robots end from where they should, steps, shape (2 n + h,).
        effects: what a pulse more of each activation does to it, shape (2 n + h, K).
        moves: how many may be made.
    """
    counts, off = counts.copy(), off.copy()
    products = 2.0 * effects.T @ effects
    single = 0.5 * np.diag(products)
    for _ in range(min(moves, _MOST_MOVES)):
        along = 2.0 * effects.T @ off
        gains = {
            1.0: np.where(counts < pulses + _CHANGE, single + along, np.inf),
            -1.0: np.where(counts > np.maximum(pulses - _CHANGE, 0.0), single - along, np.inf),
        }
        best, chosen = -_NOTHING, ()
        for one, first in gains.items():
            k = int(np.argmin(first))
            if first[k] < best:
                best, chosen = first[k], ((k, one),)
            for other, second in gains.items():
                both = first[:, None] + second + one * other * products
                np.fill_diagonal(both, np.inf)
                i, j = divmod(int(np.argmin(both)), len(counts))
                if both[i, j] < best:
                    best, chosen = both[i, j], ((i, one), (j, other))
        if not chosen:
            break
        for k, change in chosen:
            counts[k] += change
            off += change * effects[:, k]
    return counts
