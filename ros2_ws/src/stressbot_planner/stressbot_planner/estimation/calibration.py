"""Calibration: what each robot is really like, by least squares from measured poses along known activations.

Within one activation a robot either slides on a straight line or turns on the spot, both linearly in the time driven:

    slides:  (x, y)(τ) = (x, y)(0) + τ v_j (cos(θ + β_j), sin(θ + β_j)),  θ constant
    turns:   θ(τ) = θ(0) + τ ω_j,                                         ω_j = v_j / r_j

So every activation is fitted by itself, with a start of its own: jumps between activations, turns gone wrong before and
poses missed in between do no harm. A robot's estimate is the mean of its slopes, weighted by S = Σ (τ - mean τ)². The
noise of a slope is estimated from the scatter of slopes about their robot's mean, pooled over all robots.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
from scipy.stats import t as student

from stressbot_planner.model.angles import wrapped
from stressbot_planner.model.swarm import Swarm

LEAST_FRAMES = 4
"""Poses of a robot in an activation, below which that activation tells nothing about it."""

CONFIDENCE = 0.95
_INSTANT = 1e-9
"""s; times this close are the same."""

_HALF = 0.5
"""Of the nominal rate: a robot that slides or turns faster than that is called sliding or turning."""


@dataclass(frozen=True, eq=False)
class Record:
    """One activation as a tracker saw it.

    Attributes:
        group: that was selected, 1..m.
        times: s driven since the activation began, ascending, shape (F,).
        poses: x, y (units), heading (rad, wrapped), shape (F, n, 3); NaN where a robot was not seen.
    """

    group: int
    times: np.ndarray
    poses: np.ndarray


@dataclass(frozen=True)
class Interval:
    """A value ± half of its confidence interval; infinite if there was too little to tell."""

    value: float
    half_width: float

    def scaled(self, factor: float) -> "Interval":
        """Return the same in another unit."""
        return Interval(factor * self.value, factor * self.half_width)

    def __str__(self):
        return f"{self.value:.4f} ± {self.half_width:.4f}" if np.isfinite(self.half_width) else f"{self.value:.4f} ± ?"


class Fault(StrEnum):
    """How a robot fails to answer to its groups."""

    NONE = ""
    NOT_SEEN = "not seen"
    STANDS_STILL = "stands still"
    ALWAYS_TURNS = "always turns"
    ALWAYS_SLIDES = "always slides"
    OTHER_GROUPS = "answers to other groups"


@dataclass(frozen=True, eq=False)
class Estimate:
    """One robot; values that nothing was seen of are None.

    Attributes:
        robot: its number, from 1.
        speed: v_j, units/s.
        turning_rate: ω_j, rad/s.
        turning_radius: r_j = v_j / ω_j, units.
        heading_bias: β_j, angle from its measured heading to the direction that it slides in, rad.
        trials: how often each group was selected while the robot was seen, shape (m,).
        slid: in how many of them the robot slid, shape (m,).
        answers: whether it slides in a group, by majority; as described where it was not tried, shape (m,).
        fault: how it departs from its codeword.
    """

    robot: int
    speed: Interval | None
    turning_rate: Interval | None
    turning_radius: Interval | None
    heading_bias: Interval | None
    trials: np.ndarray
    slid: np.ndarray
    answers: np.ndarray
    fault: Fault

    @property
    def codeword(self) -> str:
        """The groups that the robot answers to, as a bit string of length m - 1."""
        return "".join("1" if answer else "0" for answer in self.answers[:-1])

    @property
    def missed(self) -> int:
        """In how many trials it did not do what it does in most trials of that group."""
        return int(np.where(self.answers, self.trials - self.slid, self.slid).sum())


@dataclass(frozen=True, eq=False)
class _Slope:
    """Of one robot in one activation: rate (units/s or rad/s), weight S (s²), and where it went (rad) beside its heading."""

    group: int
    slides: bool
    turns: bool
    rate: float
    weight: float
    beside: float


def estimate(swarm: Swarm, records: Sequence[Record], confidence: float = CONFIDENCE) -> tuple[Estimate, ...]:
    """Return an estimate for each robot.

    Args:
        swarm: as it is described; tells slides from turns, and codewords that are kept from those that are not.
        records: activations, in any order.
        confidence: of the intervals.
    """
    slopes = [[_slope(swarm, j, record) for record in records] for j in range(swarm.n)]
    slopes = [[slope for slope in mine if slope is not None] for mine in slopes]
    speeds = _pooled([[(s.rate, s.weight) for s in mine if s.slides] for mine in slopes], confidence)
    rates = _pooled([[(s.rate, s.weight) for s in mine if s.turns] for mine in slopes], confidence)
    # Angles beside the heading are averaged about one of them, so that none lies across the cut at pi.
    first = [next((s.beside for s in mine if s.slides), 0.0) for mine in slopes]
    biases = _pooled(
        [
            [(a + wrapped(s.beside - a), s.weight) for s in mine if s.slides]
            for mine, a in zip(slopes, first, strict=True)
        ],
        confidence,
    )
    return tuple(_estimate(swarm, j, slopes[j], speeds[j], rates[j], biases[j]) for j in range(swarm.n))


def cut(groups: Iterable[int], begins: np.ndarray, ends: np.ndarray, times: np.ndarray, poses: np.ndarray) -> list[Record]:
    """Return the record of each activation from poses that were measured all along.

    Args:
        groups: of the activations, 1..m, K of them.
        begins, ends: of their drives, s, shape (K,).
        times: of the measurements, s, on the same clock, shape (F,).
        poses: shape (F, n, 3), NaN where a robot was not seen.
    """
    order = np.argsort(times, kind="stable")
    times, poses = times[order], poses[order]
    records = []
    for group, begin, end in zip(groups, begins, ends, strict=True):
        # Not at the very beginning: whether the robot's heading has jumped by then is anybody's guess.
        inside = slice(np.searchsorted(times, begin + _INSTANT, "right"), np.searchsorted(times, end + _INSTANT, "right"))
        records.append(Record(int(group), times[inside] - begin, poses[inside]))
    return records


def rest_poses(frames: Sequence[np.ndarray]) -> np.ndarray:
    """Return the mean of poses (n, 3) measured at rest, NaN where a robot was in none of the frames."""
    poses = np.asarray(frames)
    seen = np.isfinite(poses[:, :, 0])
    count = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
    filled = np.where(seen[:, :, None], poses, 0.0)
    direction = (seen * np.exp(1j * filled[:, :, 2])).sum(axis=0)
    return np.column_stack([filled[:, :, :2].sum(axis=0) / count[:, None], np.where(np.isnan(count), np.nan, np.angle(direction))])


def look_alikes(estimates: Sequence[Estimate]) -> list[tuple[int, int]]:
    """Return pairs of robots that slide in the same groups, and turn alike as far as the intervals tell.

    Measured turning rates are never quite equal, so that a reader of the values alone would take them for different.
    """
    moving = [
        (found, found.turning_rate) for found in estimates if found.answers[:-1].any() and found.turning_rate is not None
    ]
    return [
        (one.robot, two.robot)
        for (one, rate), (two, other) in combinations(moving, 2)
        if one.codeword == two.codeword and abs(rate.value - other.value) <= rate.half_width + other.half_width
    ]


def _slope(swarm: Swarm, j: int, record: Record) -> _Slope | None:
    seen = np.isfinite(record.poses[:, j, 0])
    if seen.sum() < LEAST_FRAMES:
        return None
    tau, pose = record.times[seen], record.poses[seen, j]
    centred = tau - tau.mean()
    weight = float(centred @ centred)
    if weight <= 0.0:
        return None
    velocity = centred @ pose[:, :2] / weight
    speed = float(np.hypot(*velocity))
    if speed > _HALF * swarm.speed * swarm.pace[j]:
        heading = np.angle(np.mean(np.exp(1j * pose[:, 2])))
        beside = wrapped(np.arctan2(velocity[1], velocity[0]) - heading)
        return _Slope(record.group, True, False, speed, weight, beside)
    nominal = swarm.speed / swarm.turning_length[j]
    # The robot has turned by about the nominal rate since it was last seen: of all whole turns more or less, that one.
    steps = np.diff(tau) * nominal + wrapped(np.diff(pose[:, 2]) - np.diff(tau) * nominal)
    rate = float(centred @ np.concatenate([[0.0], np.cumsum(steps)]) / weight)
    return _Slope(record.group, False, rate > _HALF * nominal, rate, weight, 0.0)


def _pooled(samples: list[list[tuple[float, float]]], confidence: float) -> list[Interval | None]:
    """Return the weighted mean of each list of (value, weight), with an interval from the scatter in all lists."""
    means, squares, freedom = [], 0.0, 0
    for mine in samples:
        if not mine:
            means.append(None)
            continue
        values, weights = np.array(mine).T
        mean = float(values @ weights / weights.sum())
        means.append((mean, float(weights.sum())))
        squares += float(weights @ (values - mean) ** 2)
        freedom += len(mine) - 1
    if freedom == 0:
        return [None if entry is None else Interval(entry[0], np.inf) for entry in means]
    half = float(student.ppf(0.5 + confidence / 2, freedom)) * np.sqrt(squares / freedom)
    return [None if entry is None else Interval(entry[0], float(half / np.sqrt(entry[1]))) for entry in means]


def _estimate(
    swarm: Swarm, j: int, slopes: list[_Slope], speed: Interval | None, rate: Interval | None, bias: Interval | None
) -> Estimate:
    trials, slid = np.zeros(swarm.m, dtype=int), np.zeros(swarm.m, dtype=int)
    for slope in slopes:
        trials[slope.group - 1] += 1
        slid[slope.group - 1] += slope.slides
    described = swarm.membership[:, j]
    answers = np.where(2 * slid == trials, described, 2 * slid > trials)
    radius = None
    if speed is not None and rate is not None:
        value = speed.value / rate.value
        relative = np.hypot(speed.half_width / speed.value, rate.half_width / rate.value)
        radius = Interval(value, float(value * relative))
    turns = sum(slope.turns for slope in slopes)
    return Estimate(j + 1, speed, rate, radius, bias, trials, slid, answers, _fault(described, answers, trials, turns))


def _fault(described: np.ndarray, answers: np.ndarray, trials: np.ndarray, turns: int) -> Fault:
    if not trials.any():
        return Fault.NOT_SEEN
    if answers[-1]:
        return Fault.ALWAYS_SLIDES
    if not answers[trials > 0].any():
        if not turns:
            return Fault.STANDS_STILL
        if described[trials > 0].any():
            return Fault.ALWAYS_TURNS
    return Fault.NONE if np.array_equal(answers, described) else Fault.OTHER_GROUPS
