"""Who is who: robots are known by where they started, and by which groups they slide in.

After each activation that a track was seen before and after, every robot gets a log-likelihood of having been it, relative to that
of a thing that moves by chance. Tracks take robots by one assignment of the largest sum. A track is known if without its robot the
best sum would be lower by `SURE`, and stays so until another assignment is better by as much.

A single activation is enough to doubt: where robots that are known did what they should not, and did it as if some of them had been
exchanged, nobody can be sure. One alone that does what it should not has failed, since none of the others did its part.
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


def reversed_poses(poses: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return the poses (k, 3) of the same outlines if their heads are their tails; `middle`: as `Identities.learn` has it."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = 2.0 * middle.T
    return poses + np.column_stack([cos * x - sin * y, sin * x + cos * y, np.full(len(poses), np.pi)])


def _likelihood(misfit: np.ndarray) -> np.ndarray:
    """Log-likelihoods of motions, by squared Mahalanobis distances from what they should be."""
    return np.maximum(CONSISTENT - 0.5 * misfit, WORST)


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

    def slides(self, group: int) -> np.ndarray:
        """Return which robots slide in a group, shape (n,); 0: a code of nobody."""
        inside = 1 <= group <= self._membership.shape[1]
        return self._membership[:, group - 1] if inside else np.zeros(len(self._speed), dtype=bool)

    def learn(
        self, rows: np.ndarray, before: np.ndarray, after: np.ndarray, middle: np.ndarray, group: int, seconds: float, spread: float
    ) -> np.ndarray:
        """Take in what an activation did to tracks.

        Args:
            rows: the tracks that were seen before and after it.
            before: poses (k, 3).
            after: poses (k, 3).
            middle: of each outline, from its pivot along and across the heading, m, shape (k, 2).
            group: that was selected.
            seconds: for which it drove.
            spread: standard deviation of a measured place, m.

        Returns:
            Of which of them the head was taken for the tail, shape (k,): they slid backwards, or turned about another pivot.
        """
        fit, reversed_ = self._misfits(before, after, middle, group, seconds, spread, 0.0)
        self.score[rows] += _likelihood(np.minimum(fit, reversed_))
        # So that what was thought for long can still be wrong, and what was never seen does not count.
        self.score[rows] = np.clip(self.score[rows], self.score[rows].max(axis=1, keepdims=True) - MOST, MOST)
        best = reversed_.min(axis=1)
        return (best < SURE) & (fit.min(axis=1) - best > SURE)

    def compare(
        self, robots: np.ndarray, before: np.ndarray, after: np.ndarray, middle: np.ndarray, group: int, seconds: float,
        spread: float, late: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compare tracks with what the robots should have done that they are taken for.

        Args:
            robots: of each track, shape (k,).
            before: poses (k, 3) before an activation.
            after: poses (k, 3) after some of it.
            middle: as `learn` has it.
            group: that was selected.
            seconds: for which it has driven.
            spread: standard deviation of a measured place, m.
            late: that of `seconds`.

        Returns:
            Which tracks did what another robot should, and which of them did it as if robots had been exchanged, shape (k,): all,
            where that was among each other; otherwise those that did what one should that is not among them.
        """
        none = np.zeros(len(robots), dtype=bool)
        if not len(robots):
            return none, none
        value = _likelihood(np.minimum(*self._misfits(before, after, middle, group, seconds, spread, late)))
        own = value[np.arange(len(robots)), robots]
        failed = value.max(axis=1) - own >= SURE
        rows, columns = linear_sum_assignment(-value[:, robots])
        if float(value[rows, robots[columns]].sum() - own.sum()) >= SURE:
            return failed, ~none
        rows, columns = linear_sum_assignment(-value)
        gain = value[rows, columns] - own
        return failed, (gain >= SURE) & (float(gain.sum()) >= SURE)

    def _misfits(
        self, before: np.ndarray, after: np.ndarray, middle: np.ndarray, group: int, seconds: float, spread: float, late: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Squared Mahalanobis distances (k, robots) of motions from what an activation does; the same if heads were tails."""
        slide, turn = self._speed * seconds, self._rate * seconds
        far = np.hypot(spread, np.hypot(SLIDES * seconds, late) * self._speed)
        side = np.hypot(spread, CROOKED * slide)
        angle = np.hypot(CROOKED, np.hypot(TURNS * seconds, late) * self._rate)

        def misfit(before: np.ndarray, after: np.ndarray) -> np.ndarray:
            away, turns = after[:, :2] - before[:, :2], wrapped(after[:, 2] - before[:, 2])[:, None]
            cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
            along, across = (cos * away[:, 0] + sin * away[:, 1])[:, None], (cos * away[:, 1] - sin * away[:, 0])[:, None]
            slid = ((along - slide) / far) ** 2 + (across / side) ** 2 + (turns / CROOKED) ** 2
            spun = (along**2 + across**2) / spread**2 + (wrapped(turns - turn) / angle) ** 2
            return np.where(self.slides(group), slid, spun)

        return misfit(before, after), misfit(reversed_poses(before, middle), reversed_poses(after, middle))

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
