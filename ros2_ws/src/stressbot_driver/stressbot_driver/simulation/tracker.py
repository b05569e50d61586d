"""A tracker that sees the simulated robots through noise, late, and not always all of them."""

from collections import deque

import numpy as np

from stressbot_driver.simulation.imperfections import Imperfections, measurement_stream
from stressbot_driver.simulation.substrate import Poses


class Tracker:
    """Makes measurements of true poses, each one independent of the motion."""

    def __init__(self, settings: Imperfections) -> None:
        self._settings = settings
        self._random = measurement_stream(settings)
        self._late: deque[tuple[float, Poses]] = deque()
        self._missing: np.ndarray | None = None  # measurements that each robot will still be missing from

    def measure(self, poses: Poses) -> Poses:
        """One measurement of the robots."""
        settings, count = self._settings, len(poses.ids)
        if self._missing is None:
            self._missing = np.zeros(count, dtype=np.int64)
        x, y, turn = self._random.standard_normal((3, count))
        lost = self._random.random(count) < settings.lost_probability
        self._missing = np.where((self._missing == 0) & lost, settings.lost_frames, self._missing)
        seen = self._missing == 0
        self._missing = np.maximum(self._missing - 1, 0)
        heading = poses.heading + settings.orientation_noise * turn
        if settings.orientation_noise:
            heading = heading - 2.0 * np.pi * np.ceil((heading - np.pi) / (2.0 * np.pi))
        return Poses(
            ids=poses.ids[seen],
            x=(poses.x + settings.position_noise * x)[seen],
            y=(poses.y + settings.position_noise * y)[seen],
            heading=heading[seen],
        )

    def report(self, time: float, poses: Poses) -> list[tuple[float, Poses]]:
        """Measure at sequence time `time` [s]; what is known by then: (time of measurement, poses), the oldest first."""
        self._late.append((time, self.measure(poses)))
        known = []
        while self._late and self._late[0][0] <= time - self._settings.latency:
            known.append(self._late.popleft())
        return known

    def rest(self) -> list[tuple[float, Poses]]:
        """What was measured and not reported yet."""
        known = list(self._late)
        self._late.clear()
        return known
