"""Scenarios to measure on, as text of scenario files: the paper's six robots, and random swarms of any size.

Text, so that whoever reads a result can run it again with `stressbot plan`, and so that the driver can replay it.
"""

from collections.abc import Sequence

import numpy as np
import yaml

STARTS_Y = (2.0, 5.2, 8.4, 11.6, 14.8, 18.0)
GOALS_Y = (11.6, 18.0, 5.2, 2.0, 8.4, 14.8)
WIDTH = 12.0
"""Along x from the paper's starts to its goals."""

DISC_RADIUS, BODY_RADIUS, TURNING_RADIUS = 1.5, 0.3, 1.0
"""The paper names none of the three: they are this project's own choice."""

AREA_PER_ROBOT = 400.0 / 6
"""The paper's density: six robots in [0, 20]²."""

AREA_PER_DISC = 40.0
"""For discs beyond the paper's density: a random scatter of them and the robots fits easily."""

LENGTH_UNIT = 1.0e-4
"""m per unit, likewise."""

SPACING = 3.2
"""Least distance between two starts, and between two goals, of a random swarm: that of the paper's starts."""

GAP = 0.5
"""Least gap of a random start or goal to discs and walls, and of discs to each other."""


def paper(discs: bool) -> str:
    """Return the paper's six robots, in the open plane or with two discs and walls (then 2 further along x)."""
    shift = 2.0 if discs else 0.0
    starts = [[shift, y, 0.0] for y in STARTS_Y]
    goals = [[shift + WIDTH, y] for y in GOALS_Y]
    if not discs:
        return _text("paper-six", starts, goals)
    return _text("paper-six-two-discs", starts, goals, side=20.0, discs=[[8.0, 6.0], [8.0, 14.0]])


def random(n: int, discs: bool, seed: int) -> str:
    """Return n robots at the paper's density, with n / 3 discs and walls, or the same robots in the open plane."""
    return _scattered(n, n // 3, discs, seed, f"random-{n}{'-discs' if discs else ''}-{seed}")


def field(n: int, obstacles: int | None, seed: int) -> str:
    """Return n robots among so many discs, between walls; None: in the open plane.

    Of more discs than the paper's density has, each makes the square larger by `AREA_PER_DISC`.
    """
    return _scattered(n, obstacles or 0, obstacles is not None, seed, f"random-{n}-robots-{obstacles or 0}-discs-{seed}")


def _scattered(n: int, count: int, walls: bool, seed: int, name: str) -> str:
    rng = np.random.default_rng([seed, n])
    side = float(np.sqrt(AREA_PER_ROBOT * n + AREA_PER_DISC * max(0, count - n // 3)))
    centers = _scatter(rng, count, side, DISC_RADIUS + GAP, 2 * DISC_RADIUS + GAP, np.empty((0, 2)))
    starts = _scatter(rng, n, side, BODY_RADIUS + GAP, SPACING, centers)
    goals = _scatter(rng, n, side, BODY_RADIUS + GAP, SPACING, centers)
    headings = rng.uniform(-np.pi, np.pi, n)
    poses = np.column_stack([starts, headings]).tolist()
    return _text(name, poses, goals.tolist(), side if walls else None, centers.tolist() if walls else ())


def pulsed(text: str) -> str:
    """Return a scenario of this module with a drive of pulses."""
    return text + "electrical: {drive: pulses}\n"


def band(seed: int) -> str:
    """Return 14 robots in 15 x 15 units that have to cross a band of seven discs, all places and headings random.

    Bodies have a radius of 0.2, turning radii are 0.5. Discs of radius 0.7 leave two bodies' widths between them; starts on one
    side and goals on the other side are 1.2 apart. Which start belongs to which goal is random as well.
    """
    rng = np.random.default_rng([seed, 14])
    discs = _scatter_in_box(rng, 7, (4.5, 1.1), (10.5, 13.9), 2.2)
    starts = _scatter_in_box(rng, 14, (0.7, 0.7), (3.3, 14.3), 1.2)
    goals = _scatter_in_box(rng, 14, (11.7, 0.7), (14.3, 14.3), 1.2)
    poses = np.column_stack([starts, rng.uniform(-np.pi, np.pi, 14)])
    return yaml.safe_dump({
        "name": f"band-{seed}",
        "length_unit": LENGTH_UNIT,
        "workspace": {"x": [0, 15], "y": [0, 15]},
        "obstacles": [{"circle": {"center": center, "radius": 0.7}} for center in discs.tolist()],
        "swarm": {"speed": 1.0, "turning_radius": 0.5, "body_radius": 0.2},
        "robots": [{"start": pose, "goal": goal} for pose, goal in zip(poses.tolist(), goals.tolist(), strict=True)],
    })


def _scatter_in_box(rng: np.random.Generator, count: int, low: tuple, high: tuple, spacing: float) -> np.ndarray:
    """Return points in a box, spacing apart, shape (count, 2); begins anew where no room is left."""
    while True:
        points = np.empty((0, 2))
        for point in rng.uniform(low, high, (5000, 2)):
            if len(points) == count:
                return points
            if _distance(point, points) >= spacing:
                points = np.vstack([points, point])


def _scatter(rng, count: int, side: float, margin: float, spacing: float, discs: np.ndarray) -> np.ndarray:
    """Return points in a square, shape (count, 2): margin away from its sides and from discs, spacing from each other."""
    points = np.empty((0, 2))
    while len(points) < count:
        point = rng.uniform(margin, side - margin, 2)
        if _distance(point, points) >= spacing and _distance(point, discs) >= DISC_RADIUS + margin:
            points = np.vstack([points, point])
    return points


def _distance(point: np.ndarray, others: np.ndarray) -> float:
    return float(np.hypot(*(others - point).T).min()) if len(others) else np.inf


def _text(name: str, starts: list, goals: list, side: float | None = None, discs: Sequence = ()) -> str:
    data: dict = {"name": name, "length_unit": LENGTH_UNIT}
    if side is not None:
        data["workspace"] = {"x": [0.0, side], "y": [0.0, side]}
        data["obstacles"] = [{"circle": {"center": center, "radius": DISC_RADIUS}} for center in discs]
    data["swarm"] = {"speed": 1.0, "turning_radius": TURNING_RADIUS, "body_radius": BODY_RADIUS, "groups": "binary"}
    data["robots"] = [{"start": start, "goal": goal} for start, goal in zip(starts, goals, strict=True)]
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=200)
