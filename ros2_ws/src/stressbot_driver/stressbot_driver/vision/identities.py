"""Who is who: robots are known by where they started, and by which groups they slide in.

After each activation that a track was seen before and after, every robot gets a log-likelihood of having been it, relative to that
of a thing that moves by chance. Tracks take robots by one assignment of the largest sum. A track is known if without its robot the
best sum would be lower by `SURE`, and stays so until another assignment is better by as much.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment

from stressbot_driver.vision.planar import wrapped

SURE = 9.0
"""Of the sum of log-likelihoods."""

STARTED = 20.0
"""Log-likelihood of a robot at its start, where starts are known."""

CONSISTENT, WORST, MOST = 3.0, -8.0, 60.0
"""Log-likelihoods: of an activation as it should be at best, of one that was not at least (symbols are misread), and of all."""

SLIDES, TURNS = 0.1, 0.1
"""Standard deviations of how far robots slide and turn, relative."""

CROOKED = np.radians(8.0)
"""Standard deviation of the direction and of jumps of the heading, rad."""

_IMPOSSIBLE = -1e4


class Identities:
    """Log-likelihoods of tracks and robots, and what follows.

    Attributes:
        score: shape (tracks, robots).
    """

    def __init__(self, membership: np.ndarray, speed: np.ndarray, turning_rate: np.ndarray) -> None:
        """`membership`: shape (n, m - 1), bool; `speed`: m/s, `turning_rate`: rad/s, shape (n,)."""
        self._membership, self._speed, self._rate = membership, speed, turning_rate
        self.score = np.empty((0, len(speed)))

    def add(self, count: int) -> None:
        """Begin tracks of which nothing is known."""
        self.score = np.concatenate([self.score, np.zeros((count, self.score.shape[1]))])

    def keep(self, rows: np.ndarray) -> None:
        """Forget all other tracks."""
        self.score = self.score[rows]

    def start(self, track: int, robot: int) -> None:
        """A track was found where a robot starts."""
        self.score[track] = -MOST
        self.score[track, robot] = STARTED

    def forget(self, track: int) -> None:
        """Nothing is known of a track any more."""
        self.score[track] = 0.0

    def learn(
        self, rows: np.ndarray, before: np.ndarray, after: np.ndarray, group: int, seconds: float, spread: float
    ) -> np.ndarray:
        """Take in what an activation did to tracks.

        Args:
            rows: the tracks that were seen before and after it.
            before: poses (k, 3).
            after: poses (k, 3).
            group: that was selected.
            seconds: for which it drove.
            spread: standard deviation of a measured place, m.

        Returns:
            Which of them slid tail first, shape (k,): heads were taken for tails.
        """
        away, turned = after[:, :2] - before[:, :2], wrapped(after[:, 2] - before[:, 2])
        cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
        along, across = cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]
        slide, turn = self._speed * seconds, self._rate * seconds
        far = np.hypot(spread, SLIDES * slide)
        side = np.hypot(spread, CROOKED * slide)
        angle = np.hypot(CROOKED, TURNS * turn)
        forward = ((along[:, None] - slide) / far) ** 2 + (across[:, None] / side) ** 2 + (turned[:, None] / CROOKED) ** 2
        backward = ((along[:, None] + slide) / far) ** 2 + (across[:, None] / side) ** 2 + (turned[:, None] / CROOKED) ** 2
        spun = (along**2 + across**2)[:, None] / spread**2 + (wrapped(turned[:, None] - turn) / angle) ** 2
        slides = self._membership[:, group - 1] if group <= self._membership.shape[1] else np.zeros(len(slide), dtype=bool)
        fit = np.where(slides, np.minimum(forward, backward), spun)
        self.score[rows] += np.maximum(CONSISTENT - 0.5 * fit, WORST)
        # So that what was thought for long can still be wrong, and what was never seen does not count.
        self.score[rows] = np.clip(self.score[rows], self.score[rows].max(axis=1, keepdims=True) - MOST, MOST)
        best = np.take_along_axis(backward, np.argmin(backward, axis=1)[:, None], axis=1)[:, 0]
        telling = float(slide.min()) > 4.0 * spread
        return telling & (best < 9.0) & (best < forward.min(axis=1)) & (best < spun.min(axis=1))

    def known(self, rows: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return the robot of each of some tracks, shape (k,); -1 where that is not sure.

        Args:
            rows: the tracks.
            before: what was known of each. That holds until other robots of all tracks together are surely better: a robot whose
                arm is stuck moves as it should not, but does not become another one.
        """
        score = self.score[rows]
        tracks, robots = score.shape
        result = np.full(tracks, -1)
        if not tracks:
            return result
        nobody = np.where((before >= 0)[:, None], _IMPOSSIBLE, 0.0) * np.ones((tracks, tracks))
        value = np.concatenate([score, nobody], axis=1)

        def best(changed: np.ndarray) -> tuple[np.ndarray, float]:
            rows, columns = linear_sum_assignment(-changed)
            return columns, float(changed[rows, columns].sum())

        columns, total = best(value)
        for track, robot in enumerate(before.tolist()):
            if robot >= 0 and columns[track] == robot:
                result[track] = robot
            elif robot >= 0:
                other = value.copy()
                other[track, robot] += 1e3
                if total - (best(other)[1] - 1e3) < SURE:
                    result[track] = robot
        for track, robot in enumerate(columns.tolist()):
            if before[track] < 0 and robot < robots and robot not in result and value[track, robot] >= SURE:
                other = value.copy()
                other[track, robot] = _IMPOSSIBLE
                if total - best(other)[1] >= SURE:
                    result[track] = robot
        return result
