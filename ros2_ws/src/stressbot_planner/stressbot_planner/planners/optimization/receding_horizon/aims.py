"""Where robots aim in a window: a share of what remains of each one's shortest path; and how urgent each of them is."""

import numpy as np

from stressbot_planner.beam_search.cost_to_go import DistanceMaps, distance_maps, way_left
from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.system.kernels import kernel

SPACING, INFLATED = 1.2, 0.35
"""Aims are two bodies and this far apart; paths keep so far from obstacles where they can, in turning lengths."""

FINE = 1.0
"""Spacing of the nodes of maps, relative to the smallest inflated body: aims need no more."""

LEAST_URGENCY = 0.2
"""Of a robot with all the time that there is."""

STEP, PUSHES = 0.3, 300
"""Along a path, turning lengths; rounds in which aims that lie close to each other are pushed apart."""


class ShortestPaths:
    """Of each robot alone from anywhere to its goal, straight in the open plane; lengths in turning lengths."""

    def __init__(self, shapes: Shapes | None, body: np.ndarray, starts: np.ndarray, goals: np.ndarray):
        """Take obstacles (None: open plane), radii (n,), starts (n, 2) and goals (n, 2)."""
        self.body, self.goals = body, goals
        self._maps: DistanceMaps | None = None
        if shapes is not None:
            inflated = body + INFLATED
            self._maps = distance_maps(shapes, inflated, starts, goals, FINE)
            # nothing tells a way that is blocked for the inflated body but its length
            across = float(np.hypot(*(self._maps.size * (np.array(self._maps.excess.shape[1:]) - 1))))
            blocked = self._maps.ways_left(starts) >= across
            if blocked.any():
                self._maps = distance_maps(shapes, np.where(blocked, body, inflated), starts, goals, FINE)

    def left(self, places: np.ndarray) -> np.ndarray:
        """Return how far each robot has to go from places (n, 2), shape (n,)."""
        return np.hypot(*(self.goals - places).T) if self._maps is None else self._maps.ways_left(places)

    def aims(self, places: np.ndarray, share: float) -> np.ndarray:
        """Return the places (n, 2) that lie this share further along the paths, spread out."""
        if self._maps is None:
            aims = places + share * (self.goals - places)
        else:
            aims = self.goals.copy() if share >= 1.0 else _along(places, share * self.left(places), *self._maps)
        return spread(aims, 2 * float(self.body.max()) + SPACING)


def urgency_of(ways: np.ndarray, available: np.ndarray) -> np.ndarray:
    """Return the weights (n,), of mean square 1, of robots with so far to go (n,) whose groups slide so far (n,).

    Who needs all that its groups are to slide is urgent, who has slack may lag behind.
    """
    urgency = np.maximum(ways / np.maximum(available, 1e-9), LEAST_URGENCY)
    return urgency / np.sqrt(np.mean(urgency**2))


def spread(points: np.ndarray, distance: float) -> np.ndarray:
    """Return points (n, 2) that are pushed apart until they are about so far from each other."""
    points = points.copy()
    for _ in range(PUSHES):
        apart = points[:, None] - points[None]
        away = np.hypot(apart[..., 0], apart[..., 1])
        np.fill_diagonal(away, distance)
        close = away < distance
        if not close.any():
            break
        push = np.where(close, (1.02 * distance - away) / np.maximum(away, 1e-6 * distance), 0.0)
        points += 0.25 * (push[..., None] * apart).sum(axis=1)
    return points


@kernel()
def _along(places, ways, low, size, excess, goals):
    """Return where robots come to that go so far down their maps, shape (n, 2)."""
    reached = places.copy()
    for j in range(len(places)):
        x, y, left = places[j, 0], places[j, 1], ways[j]
        while left > 1e-9:
            way, gx, gy = way_left(j, x, y, low, size, excess, goals)
            slope = np.hypot(gx, gy)
            step = min(left, STEP, np.hypot(x - goals[j, 0], y - goals[j, 1]))
            if way < 1e-9 or slope < 1e-9 or step < 1e-9:
                break
            x -= step * gx / slope
            y -= step * gy / slope
            left -= step
        reached[j] = x, y
    return reached
