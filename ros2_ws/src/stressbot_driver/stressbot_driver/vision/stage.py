"""The stage: a Kalman filter of how it drifts and turns, by what moves all robots alike.

Robots that no drive moves stand still, and those that turn do it about their pivots. Whatever moves these moves the substrate.
"""

import numpy as np

from stressbot_driver.vision.planar import turned

WALK, ACCELERATION = 0.1, 0.2
"""Pixels in root of a second, of the walk; pixels a second in root of a second, of its speed."""

TURNING = 0.2
"""Of these, at the edge of the picture: how much of it a stage that turns is thought to do."""

FIRST_SPEED = 1.0
"""Pixels a second: standard deviation of the speed at first."""


class StageFilter:
    """Where the stage is since the first picture.

    Attributes:
        state: x, y [m], turned about the picture's middle [rad], and these a second; shape (6,).
        covariance: shape (6, 6).
    """

    def __init__(self, center: tuple[float, float], pixel: float, radius: float) -> None:
        """`center`: of the picture on the substrate, m; `pixel`: m; `radius`: half of the picture, m."""
        self._center = np.array(center)
        self._unit = np.array([pixel, pixel, TURNING * pixel / radius])
        self.state = np.zeros(6)
        self.covariance = np.diag(np.concatenate([np.zeros(3), (FIRST_SPEED * self._unit) ** 2]))

    @property
    def offset(self) -> np.ndarray:
        """x, y [m] and angle [rad]."""
        return self.state[:3]

    def predict(self, seconds: float) -> None:
        """Let time pass."""
        motion = np.eye(6)
        motion[:3, 3:] = seconds * np.eye(3)
        self.state = motion @ self.state
        noise = np.concatenate([(WALK * self._unit) ** 2, (ACCELERATION * self._unit) ** 2]) * seconds
        self.covariance = motion @ self.covariance @ motion.T + np.diag(noise)

    def update(self, places: np.ndarray, seen: np.ndarray, covariance: np.ndarray) -> None:
        """Learn from robots that stand at places (k, 2) and are seen at others (k, 2), with covariances (k, 2, 2), m."""
        away = places - self._center
        rows = np.zeros((len(places), 2, 6))
        rows[:, 0, 0] = rows[:, 1, 1] = 1.0
        rows[:, 0, 2], rows[:, 1, 2] = -away[:, 1], away[:, 0]
        difference = seen - self.to_picture(np.column_stack([places, np.zeros(len(places))]))[:, :2]
        # in units of a pixel, so that the matrices are well scaled
        scale = np.concatenate([self._unit, self._unit])
        rows, difference = rows * scale / self._unit[0], difference / self._unit[0]
        noise = covariance / self._unit[0] ** 2
        size = np.sum(difference**2, axis=1)
        weight = 1.0 / np.maximum(1.0, size / (9.0 * max(float(np.median(size)), 1e-12)))  # one that moves by itself
        inverse = np.linalg.inv(noise) * weight[:, None, None]
        prior = np.linalg.inv(self.covariance / scale[:, None] / scale + 1e-12 * np.eye(6))
        information = prior + np.einsum("kai,kab,kbj->ij", rows, inverse, rows)
        posterior = np.linalg.inv(information)
        self.state = self.state + scale * (posterior @ np.einsum("kai,kab,kb->i", rows, inverse, difference))
        self.covariance = posterior * scale[:, None] * scale

    def to_picture(self, poses: np.ndarray) -> np.ndarray:
        """Return where the camera would have seen robots at poses (k, 3), had the stage not moved."""
        away = turned(poses[:, :2] - self._center, self.state[2])
        return np.column_stack([away + self._center + self.state[:2], poses[:, 2] + self.state[2]])

    def to_substrate(self, seen: np.ndarray) -> np.ndarray:
        """Return the poses (k, 3) of robots that are seen at others: the inverse."""
        away = turned(seen[:, :2] - self._center - self.state[:2], -self.state[2])
        return np.column_stack([away + self._center, seen[:, 2] - self.state[2]])
