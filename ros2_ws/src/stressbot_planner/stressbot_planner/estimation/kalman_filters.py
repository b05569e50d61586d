"""Kalman filters: what is known of each robot while a plan is driven, and how far it may drift.

Three numbers of each robot are estimated from the poses before and after every activation, each by itself, as the mean of
a normal distribution that starts from what is assumed of any robot: how far it slides, how fast it turns, both in
relation to the description, and its heading bias, the angle from the measured heading to the direction that it slides in.
A robot's heading also jumps when an activation begins. While it slides nothing else changes its heading, so that slides show the
size of the jumps.
"""

from dataclasses import dataclass, replace

import numpy as np

from stressbot_planner.model.angles import wrapped
from stressbot_planner.model.swarm import Swarm


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration has measured of each robot, shape (n,) each; NaN where it has not. Sigmas are standard deviations.

    Attributes:
        heading_bias, heading_bias_sigma: rad.
        speed_sigma: of the described speeds, units/s.
        turning_radius_sigma: of the described turning radii, units.
    """

    heading_bias: np.ndarray
    heading_bias_sigma: np.ndarray
    speed_sigma: np.ndarray
    turning_radius_sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class Prior:
    """What is assumed of robots before they move: standard deviations, and the mean of the bias.

    The first four may be one number for all robots, or one each, shape (n,).

    Attributes:
        speed_error: relative, of speeds.
        turning_error: relative, of turning rates.
        bias: mean of the heading bias, rad.
        heading_bias: its standard deviation, rad.
        heading_noise: rad, jump of the heading in each activation.
        position_noise: of measured positions, relative to `Swarm.girth`.
        orientation_noise: of measured headings, rad.
    """

    speed_error: float | np.ndarray = 0.05
    turning_error: float | np.ndarray = 0.05
    bias: float | np.ndarray = 0.0
    heading_bias: float | np.ndarray = np.radians(6.0)
    heading_noise: float = np.radians(2.0)
    position_noise: float = 0.03
    orientation_noise: float = np.radians(0.5)

    def calibrated(self, swarm: Swarm, measured: Calibration) -> "Prior":
        """Return what is assumed of robots that were measured.

        The interval of a turning radius r = v/ω was made of those of v and ω, so that the relative variance of ω is the
        difference of those of r and v.
        """
        speed = measured.speed_sigma / (swarm.speed * swarm.pace)
        turning = np.sqrt(np.maximum((measured.turning_radius_sigma / swarm.turning_radius) ** 2 - speed**2, 0.0))
        found = {
            "speed_error": speed,
            "turning_error": turning,
            "bias": measured.heading_bias,
            "heading_bias": measured.heading_bias_sigma,
        }
        return replace(self, **{name: np.where(np.isnan(new), getattr(self, name), new) for name, new in found.items()})


_NOISE_WEIGHT = 12
"""Jumps that the assumed heading noise counts for."""

_SMALLEST_SLIDE = 0.2
"""Of `Swarm.girth`: an activation that would move a robot less than that tells nothing about it."""

_MOVED = 0.5
"""Of the way it should have gone: a robot that went less far did not slide."""

_LEAST_SPREAD = 0.002
"""No estimate is taken for more precise than that (relative, or rad)."""

MISSED, STRAYED = 3, 2
"""So many slides in a row without a motion: the robot is stuck. So many turns in a row with one: it runs away."""


class KalmanFilters:
    """Estimates for each robot of a swarm.

    Attributes:
        slide, turn, bias: factors and rad, means, shape (n,).
        slide_variance, turn_variance, bias_variance: shape (n,).
        missed, strayed: slides without a motion in a row, and motions where it should have turned, shape (n,).
    """

    def __init__(self, swarm: Swarm, prior: Prior):
        n = swarm.n
        self._swarm, self._prior = swarm, prior
        self.position_noise = prior.position_noise * float(swarm.girth.mean())  # units
        self.slide, self.turn, self.bias = np.ones(n), np.ones(n), np.full(n, prior.bias)
        self.slide_variance, self.turn_variance, self.bias_variance = (
            np.full(n, np.maximum(sigma, _LEAST_SPREAD) ** 2)
            for sigma in (prior.speed_error, prior.turning_error, prior.heading_bias)
        )
        self.missed, self.strayed = np.zeros(n, dtype=int), np.zeros(n, dtype=int)
        self._jumps = [_NOISE_WEIGHT, _NOISE_WEIGHT * prior.heading_noise**2]

    @property
    def heading_noise(self) -> float:
        """Standard deviation of a heading's jump, rad."""
        return float(np.sqrt(self._jumps[1] / self._jumps[0]))

    @property
    def slides(self) -> np.ndarray:
        """How far each robot slides in an activation of length 1, shape (m, n)."""
        return self._swarm.slides * self.slide

    @property
    def turning_length(self) -> np.ndarray:
        """Length of an activation in which a robot that does not slide turns by 1 rad, shape (n,)."""
        return self._swarm.turning_length / self.turn

    def directions(self, poses: np.ndarray) -> np.ndarray:
        """Return poses (n, 3) with the direction in which each robot slides in place of its heading."""
        return poses + np.column_stack([np.zeros((len(poses), 2)), self.bias])

    def advance(self, poses: np.ndarray, group: int, length: float) -> np.ndarray:
        """Return measured poses (n, 3) as they are expected after an activation."""
        slides = self.slides[group - 1]
        direction = poses[:, 2] + self.bias
        step = length * slides
        turned = np.where(slides > 0, 0.0, length / self.turning_length)
        return poses + np.column_stack([step * np.cos(direction), step * np.sin(direction), turned])

    def learn(self, group: int, length: float, before: np.ndarray, after: np.ndarray) -> None:
        """Take in what one activation did; poses are NaN where a robot was not seen."""
        described, prior = self._swarm.slides[group - 1] * length, self._prior
        for j in np.flatnonzero(np.isfinite(before[:, 0]) & np.isfinite(after[:, 0])).tolist():
            step = after[j, :2] - before[j, :2]
            distance = float(np.hypot(*step))
            noise = np.sqrt(2) * self.position_noise
            way = length * self._swarm.pace[j]
            if way < max(_SMALLEST_SLIDE * self._swarm.girth[j], 8 * noise):
                continue
            slid = distance > _MOVED * way
            if described[j] > 0:
                self.missed[j] = 0 if slid else self.missed[j] + 1
                if slid:
                    self._update("slide", j, distance / described[j], (noise / described[j]) ** 2)
                    beside = wrapped(np.arctan2(step[1], step[0]) - after[j, 2])
                    self._update("bias", j, beside, (noise / distance) ** 2 + prior.orientation_noise**2)
                    self._jumps[0] += 1
                    self._jumps[1] += wrapped(after[j, 2] - before[j, 2]) ** 2
                continue
            self.strayed[j] = self.strayed[j] + 1 if slid else 0
            expected = length / self._swarm.turning_length[j]
            spread = self.heading_noise**2 + 2 * prior.orientation_noise**2
            off = wrapped(after[j, 2] - before[j, 2] - expected * self.turn[j])
            # a turn that was missed, or could have been any number of whole turns, tells nothing
            if abs(off) < 4 * np.sqrt(spread + self.turn_variance[j] * expected**2) and self.turn_variance[j] * expected**2 < 0.5:
                self._update("turn", j, self.turn[j] + off / expected, spread / expected**2)

    def _update(self, name: str, j: int, value: float, variance: float) -> None:
        mean, variances = getattr(self, name), getattr(self, f"{name}_variance")
        gain = variances[j] / (variances[j] + variance + _LEAST_SPREAD**2)
        mean[j] += gain * (value - mean[j])
        variances[j] = max((1 - gain) * variances[j], _LEAST_SPREAD**2)

    def drift(self, groups: np.ndarray, poses: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return the standard deviation of each robot's position after each activation, units, shape (K, n).

        A jump of the heading in activation l swings all that follows about p_l; a wrong bias swings the whole way; a wrong turning
        rate swings it at each turn; a wrong speed stretches it. To first order the variances add up:

            sigma² sum_l |p_k - p_l|² + (var_bias + var_slide) |p_k - p_0|² + var_turn |sum_l a_l (p_k - p_l)|²,

        a_l the angle turned in activation l.

        Args:
            groups: shape (K,), 1..m.
            poses: at every knot, shape (K + 1, n, 3).
            lengths: shape (K,).
        """
        turning = ~self._swarm.membership[groups - 1]
        angle = np.where(turning, lengths[:, None] / self.turning_length, 0.0)
        result = np.empty((len(groups), poses.shape[1]))
        for k in range(1, len(groups) + 1):
            way = poses[k, :, :2] - poses[:k, :, :2]
            squares = (way**2).sum(axis=2)
            turned = ((angle[:k, :, None] * way).sum(axis=0) ** 2).sum(axis=1)
            result[k - 1] = np.sqrt(
                self.heading_noise**2 * squares.sum(axis=0)
                + (self.bias_variance + self.slide_variance) * squares[0]
                + self.turn_variance * turned
                + 2 * self.position_noise**2
            )
        return result
