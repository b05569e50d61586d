"""The two layouts of the benchmark of a learned switcher (docs/successor.md) as scenarios: 14 robots in 15 x 15 units.

Its distributions, but draws of our own: the generators of its simulator give other numbers for the same seed.
"""

from collections.abc import Callable

import numpy as np
import yaml

SIDE = 15.0
ROBOTS, DISCS = 14, 7
BODY, DISC = 0.2, 0.7
SPEED, TURNING_RADIUS = 0.5, 0.5
"""units/s and units: at most 1 rad/s."""

LENGTH_UNIT = 1.0e-4
"""m, ours."""

MARGIN = 1.0
"""Between starts, goals or the corridor's discs and walls, units."""

START_SPACING, START_GAP = 0.6, 0.5
"""Between centres of starts; between the centre of a start and a disc, the body's radius more in the corridor."""

GOAL_SPACING = 0.5
CORRIDOR_GAP = 1.0
"""Between discs of the corridor, surface to surface."""

ATTEMPTS = 1000
"""To find room for one thing, after which all of its kind begin anew."""

_LOW, _HIGH = MARGIN, SIDE - MARGIN
_NONE = np.empty((0, 2))


def corridor(seed: int) -> str:
    """Return robots that cross a band of discs from left to right."""
    rng = np.random.default_rng([seed, 1])
    discs = _scattered(rng, DISCS, (6.0, _LOW), (9.0, _HIGH), 2 * DISC + CORRIDOR_GAP)
    starts = _scattered(rng, ROBOTS, (_LOW, _LOW), (3.75, _HIGH), START_SPACING, discs, DISC + BODY + START_GAP)
    goals = _scattered(rng, ROBOTS, (11.25, _LOW), (_HIGH, _HIGH), GOAL_SPACING, discs, DISC + BODY)
    return _text(f"corridor-{seed}", rng, discs, starts, goals)


def scattered(seed: int) -> str:
    """Return robots, discs and goals anywhere; discs may reach over the sides of the square."""
    rng = np.random.default_rng([seed, 2])
    discs = _scattered(rng, DISCS, (0.0, 0.0), (SIDE, SIDE), 2 * DISC)
    starts = _scattered(rng, ROBOTS, (_LOW, _LOW), (_HIGH, _HIGH), START_SPACING, discs, DISC + START_GAP)
    goals = _scattered(rng, ROBOTS, (_LOW, _LOW), (_HIGH, _HIGH), GOAL_SPACING, discs, DISC + BODY)
    return _text(f"scattered-{seed}", rng, discs, starts, goals)


LAYOUTS: dict[str, Callable[[int], str]] = {"corridor": corridor, "scattered": scattered}


def _scattered(rng, count: int, low, high, spacing: float, discs=_NONE, away: float = 0.0) -> np.ndarray:
    """Return uniform points of a box, shape (count, 2): spacing from each other, so far away from centres of discs."""
    while True:
        points = _NONE
        for _ in range(count * ATTEMPTS):
            point = rng.uniform(low, high)
            if _distance(point, points) >= spacing and _distance(point, discs) >= away:
                points = np.vstack([points, point])
                if len(points) == count:
                    return points


def _distance(point: np.ndarray, others: np.ndarray) -> float:
    return float(np.hypot(*(others - point).T).min()) if len(others) else np.inf


def _text(name: str, rng, discs: np.ndarray, starts: np.ndarray, goals: np.ndarray) -> str:
    poses = np.column_stack([starts, rng.uniform(-np.pi, np.pi, ROBOTS)])
    return yaml.safe_dump({
        "name": name,
        "length_unit": LENGTH_UNIT,
        "workspace": {"x": [0.0, SIDE], "y": [0.0, SIDE]},
        "obstacles": [{"circle": {"center": center, "radius": DISC}} for center in discs.tolist()],
        "swarm": {"speed": SPEED, "turning_radius": TURNING_RADIUS, "body_radius": BODY, "groups": "binary"},
        "robots": [{"start": pose, "goal": goal} for pose, goal in zip(poses.tolist(), goals.tolist(), strict=True)],
    })
