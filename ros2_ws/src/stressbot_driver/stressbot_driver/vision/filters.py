"""Kalman filters: where each robot is, by what drives should have done to it and by what pictures show.

Poses x, y, θ with covariances. Of a robot that slides by s and of one that turns by a,

    (x, y) += s (cos θ, sin θ),   θ += a,

each with noise in proportion: along and across the slide, and of the turn; and a jump of the heading when a drive begins.
"""

import numpy as np

from stressbot_driver.vision.planar import wrapped

ALONG, ACROSS, TURNING = 0.06, 0.12, 0.06
"""Standard deviations of a slide, along and across (a bias of the heading), and of a turn; relative."""

LATE = 0.04
"""s by which the sequence time of a picture may be wrong: the driver says its own now and then, and stamps are what they are."""

JUMP = np.radians(2.5)
"""Standard deviation of what the heading jumps by when a drive begins, rad."""

REST = (0.02, 0.002)
"""Pixels, and rad, in root of a second: what robots at rest are thought to move."""


class PoseFilters:
    """One filter a track, all in arrays.

    Attributes:
        poses: shape (k, 3), m, m, rad; headings may be beyond pi.
        covariance: shape (k, 3, 3).
    """

    def __init__(self, pixel: float) -> None:
        """`pixel`: m."""
        self.poses, self.covariance = np.empty((0, 3)), np.empty((0, 3, 3))
        self._pixel = pixel

    def add(self, poses: np.ndarray, covariance: np.ndarray) -> None:
        """Begin tracks at poses, shape (k, 3), with covariances, shape (k, 3, 3)."""
        self.poses = np.concatenate([self.poses, poses])
        self.covariance = np.concatenate([self.covariance, covariance])

    def keep(self, rows: np.ndarray) -> None:
        """Forget all other tracks."""
        self.poses, self.covariance = self.poses[rows], self.covariance[rows]

    def rest(self, seconds: float) -> None:
        """Let time pass."""
        place, turn = self._pixel * REST[0], REST[1]
        self.covariance = self.covariance + seconds * np.diag([place**2, place**2, turn**2])

    def wander(self, rows: np.ndarray, distance: np.ndarray, angle: np.ndarray) -> None:
        """Tracks move in a way that is not known: by up to so many m and rad, shapes of the rows."""
        noise = np.zeros((len(rows), 3, 3))
        noise[:, 0, 0] = noise[:, 1, 1] = distance**2
        noise[:, 2, 2] = angle**2
        self.covariance[rows] += noise

    def drive(self, slides: np.ndarray, turns: np.ndarray, seconds: float, begins: bool) -> None:
        """Tracks slide by m, shape (k,), and turn by rad, shape (k,), one of which is 0, in so many seconds of a drive.

        `begins`: they were at rest before.
        """
        cos, sin = np.cos(self.poses[:, 2]), np.sin(self.poses[:, 2])
        self.poses = self.poses + np.column_stack([slides * cos, slides * sin, turns])
        motion = np.tile(np.eye(3), (len(slides), 1, 1))
        motion[:, 0, 2], motion[:, 1, 2] = -slides * sin, slides * cos
        turn = np.zeros((len(slides), 3, 3))
        turn[:, :2, :2] = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
        turn[:, 2, 2] = 1.0
        moved = (slides != 0.0) | (turns != 0.0)
        along, turning = np.hypot((ALONG, TURNING), LATE / seconds)
        parts = np.column_stack([along * slides, ACROSS * slides, np.hypot(turning * turns, JUMP * begins * moved)])
        noise = turn * (parts**2)[:, None, :] @ turn.transpose(0, 2, 1)
        self.covariance = motion @ self.covariance @ motion.transpose(0, 2, 1) + noise

    def distance(self, rows: np.ndarray, measured: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return squared Mahalanobis distances of measured poses (k, 3) with covariances (k, 3, 3), shape (k,)."""
        difference = self._difference(rows, measured)
        return np.einsum("ki,ki->k", difference, np.linalg.solve(self.covariance[rows] + covariance, difference[..., None])[..., 0])

    def update(self, rows: np.ndarray, measured: np.ndarray, covariance: np.ndarray) -> None:
        """Take in measured poses (k, 3) with covariances (k, 3, 3)."""
        difference = self._difference(rows, measured)
        prior = self.covariance[rows]
        gain = prior @ np.linalg.inv(prior + covariance)
        self.poses[rows] += (gain @ difference[..., None])[..., 0]
        kept = np.eye(3) - gain
        self.covariance[rows] = kept @ prior @ kept.transpose(0, 2, 1) + gain @ covariance @ gain.transpose(0, 2, 1)

    def _difference(self, rows: np.ndarray, measured: np.ndarray) -> np.ndarray:
        difference = measured - self.poses[rows]
        difference[:, 2] = wrapped(difference[:, 2])
        return difference
