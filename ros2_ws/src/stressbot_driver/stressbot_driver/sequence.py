"""A voltage sequence as an immutable value, and the check that it passes before the first volt."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from stressbot_driver.errors import ErrorCode, StressbotError

LONGEST_ID = 200
"""Characters of a plan's name; every status repeats it."""

MOST_SEGMENTS = 20_000_000
"""A guard against messages that eat the memory (0.5 GB); no plan is near it."""


MOST_PULSES = 2**53
"""Of a train; more cannot be told apart as doubles."""

_NO_COUNTS, _NO_LEVELS = np.zeros(0, dtype=np.uint64), np.zeros(0)


@dataclass(frozen=True)
class Train:
    """`count` pulses: `high` [V] for `high_dwell` [s], then `low` for `low_dwell`. If alternating, every other one negated."""

    high: float
    low: float
    high_dwell: float
    low_dwell: float
    count: int
    alternating: bool

    @property
    def period(self) -> float:
        """[s] from pulse to pulse."""
        return self.high_dwell + self.low_dwell

    @property
    def duration(self) -> float:
        """[s] of all pulses."""
        return self.count * self.period

    @property
    def pattern(self) -> list[tuple[float, float]]:
        """Levels [V] and dwells [s] that are repeated: of one pulse, of two if they alternate."""
        pulse = [(self.high, self.high_dwell), (self.low, self.low_dwell)]
        return pulse + [(-level, dwell) for level, dwell in pulse] if self.alternating else pulse

    @property
    def repeats(self) -> int:
        """How often the pattern is begun: it ends half way where an odd number of pulses alternates."""
        return -(-self.count // 2) if self.alternating else self.count


@dataclass(frozen=True, eq=False)
class VoltageSequence:
    """Segments that last `dwells[k]` [s]; epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1.

    Segment k holds `levels[k]`; where `pulses[k]` is not 0 it is a train of so many pulses instead, each at `levels[k]` for its
    `duty` and then at `low_levels[k]`. Without trains `pulses` and `low_levels` may be empty.
    """

    plan_id: str
    swarm_id: str
    levels: np.ndarray  # [V] (N,)
    dwells: np.ndarray  # [s] (N,)
    epoch_ends: np.ndarray  # (E,) int
    duration: float  # [s] sum of the dwells
    stamp: int = 0  # [ns] since 1970, when the poses were measured from which it was planned; 0: unknown
    pulses: np.ndarray = field(default_factory=_NO_COUNTS.copy)  # (N,) unsigned, or (0,)
    low_levels: np.ndarray = field(default_factory=_NO_LEVELS.copy)  # [V] (N,) or (0,)
    duty: float = 0.0  # share of a pulse at its high level
    alternating: bool = False  # every other pulse of a train has the other sign

    @property
    def trains(self) -> np.ndarray:
        """Whether each segment is a train, (N,) bool."""
        return self.pulses > 0 if len(self.pulses) else np.zeros(len(self.levels), dtype=bool)

    def train(self, k: int) -> Train | None:
        """Segment k as a train; None: it holds its level."""
        return self._train(k) if len(self.pulses) and self.pulses[k] else None

    def numbered_trains(self) -> Iterator[tuple[int, Train]]:
        """Segments that are trains, in order: their numbers, and the trains."""
        for k in np.flatnonzero(self.pulses).tolist():
            yield k, self._train(k)

    def _train(self, k: int) -> Train:
        count = int(self.pulses[k])
        period = float(self.dwells[k]) / count
        high_dwell, high, low = self.duty * period, float(self.levels[k]), float(self.low_levels[k])
        return Train(high, low, high_dwell, period - high_dwell, count, self.alternating)


@dataclass(frozen=True)
class Limits:
    """What may be put on the substrate."""

    min_level: float  # [V]
    max_level: float  # [V]
    min_dwell: float = 0.0  # [s] shortest segment; every dwell must be positive besides
    max_duration: float = math.inf  # [s]
    max_segments: int = MOST_SEGMENTS
    max_slew_rate: float = math.inf  # [V/s] a step takes its height / this, and must be over within its dwell
    max_duty: float = 1.0  # time above drive_above / duration
    max_frequency: float = math.inf  # [Hz] of pulses
    max_charge: float = math.inf  # [V s] the integral of the volts, at the end of any segment, either sign
    capacitance: float = 0.0  # [F] of the load
    max_power: float = math.inf  # [W] capacitance x swing^2 x frequency, of a train
    drive_above: float = math.inf  # [V] robots move
    rest_level: float = 0.0  # [V] before the first segment


def check_sequence(sequence: VoltageSequence, swarm_id: str, limits: Limits) -> None:
    """Check a sequence whole: nothing is clipped or repaired.

    Raises StressbotError: MISSING_FIELD, WRONG_SWARM, INVALID_SEQUENCE, WRONG_COUNT, NOT_FINITE, OUT_OF_RANGE or
    LIMIT_EXCEEDED.
    """
    levels, dwells, ends = sequence.levels, sequence.dwells, sequence.epoch_ends
    if len(sequence.plan_id) > LONGEST_ID:
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED, "plan_id", f"has {len(sequence.plan_id)} characters, the most is {LONGEST_ID}: shorten it"
        )
    if not sequence.plan_id:
        raise StressbotError(ErrorCode.MISSING_FIELD, "plan_id", "is empty: name the plan that the sequence realises")
    if sequence.swarm_id != swarm_id:
        raise StressbotError(
            ErrorCode.WRONG_SWARM,
            "swarm_id",
            f"the sequence is for swarm {sequence.swarm_id!r}, on this bench lies {swarm_id!r}: plan again for this one",
        )
    if len(levels) == 0:
        raise StressbotError(ErrorCode.INVALID_SEQUENCE, "levels", "there are none: send at least one segment")
    if len(dwells) != len(levels):
        raise StressbotError(ErrorCode.WRONG_COUNT, "dwells", f"{len(dwells)} dwells for {len(levels)} levels: give one per level")
    _check_counts(sequence)
    for name, values in (("levels", levels), ("dwells", dwells), ("low_levels", sequence.low_levels)):
        bad = ~np.isfinite(values)
        if bad.any():
            index = int(np.argmax(bad))
            raise StressbotError(ErrorCode.NOT_FINITE, f"{name}[{index}]", f"is {values[index]}: send finite numbers")
    _refuse(dwells <= 0.0, ErrorCode.OUT_OF_RANGE, "dwells", dwells, "s: must be positive")
    _refuse(levels < limits.min_level, ErrorCode.LIMIT_EXCEEDED, "levels", levels, f"V: below min_level ({limits.min_level:g} V)")
    _refuse(levels > limits.max_level, ErrorCode.LIMIT_EXCEEDED, "levels", levels, f"V: above max_level ({limits.max_level:g} V)")
    _refuse(dwells < limits.min_dwell, ErrorCode.LIMIT_EXCEEDED, "dwells", dwells, f"s: the least is {limits.min_dwell:g} s")
    if sequence.trains.any():
        _check_trains(sequence, limits)
    if len(levels) > limits.max_segments:
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED, "levels", f"{len(levels)} segments, the backend takes {limits.max_segments}: send less"
        )
    with np.errstate(over="ignore"):
        total = float(np.sum(dwells))
    if not math.isfinite(total) or not math.isfinite(sequence.duration):
        raise StressbotError(ErrorCode.NOT_FINITE, "duration", "the dwells must add up to a finite time: send shorter ones")
    if total > limits.max_duration:
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED, "duration", f"is {total:g} s, the most is {limits.max_duration:g} s: send less"
        )
    if abs(sequence.duration - total) > 1e-6 * max(1.0, total):
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE,
            "duration",
            f"is {sequence.duration!r} s but the dwells add up to {total!r} s: send their sum",
        )
    _check_slew(sequence, limits)
    _check_charge(sequence, limits)
    duty = float(np.sum(_driven(sequence, limits.drive_above))) / total
    if duty > limits.max_duty:
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED,
            "levels",
            f"robots are driven for {duty:.4f} of the time, max_duty is {limits.max_duty:g}: send longer rests",
        )
    if len(ends) == 0 or ends[0] < 1 or (np.diff(ends) <= 0).any() or ends[-1] != len(levels):
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE,
            "epoch_ends",
            f"must ascend from at least 1 and end at the number of segments ({len(levels)})",
        )


def _check_counts(sequence: VoltageSequence) -> None:
    counts, lows = sequence.pulses, sequence.low_levels
    if len(counts) not in (0, len(sequence.levels)):
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "pulses", f"{len(counts)} numbers for {len(sequence.levels)} levels: give one per level, or none"
        )
    if len(lows) != len(counts):
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "low_levels", f"{len(lows)} low levels for {len(counts)} numbers of pulses: give one each"
        )
    _refuse((counts == 0) & (lows != 0.0), ErrorCode.INVALID_SEQUENCE, "low_levels", lows, "V, of a train of no pulses: send some")
    _refuse(counts > MOST_PULSES, ErrorCode.LIMIT_EXCEEDED, "pulses", counts, "pulses: more than 2^53 cannot be counted")
    if sequence.trains.any() and not 0.0 < sequence.duty < 1.0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "duty", f"is {sequence.duty!r}: must lie between 0 and 1")


def _check_trains(sequence: VoltageSequence, limits: Limits) -> None:
    """Levels of both signs, times of both parts, frequency and power. The numbers are finite."""
    levels, lows, trains = sequence.levels, sequence.low_levels, sequence.trains
    between = (levels * lows >= 0.0) & (np.abs(lows) < np.abs(levels))
    _refuse(trains & ~between, ErrorCode.OUT_OF_RANGE, "low_levels", lows, "V: must lie between 0 V and its high level")
    outside = (np.minimum(lows, -levels) < limits.min_level) | (np.maximum(lows, -levels) > limits.max_level)
    outside &= sequence.alternating & (sequence.pulses > 1)
    outside |= (lows < limits.min_level) | (lows > limits.max_level)
    allowed = f"{limits.min_level:g} V to {limits.max_level:g} V"
    _refuse(trains & outside, ErrorCode.LIMIT_EXCEEDED, "levels", levels, f"V: its train goes beyond the limits of {allowed}")
    period = np.where(trains, sequence.dwells / np.maximum(sequence.pulses, 1), np.inf)
    shorter = min(sequence.duty, 1.0 - sequence.duty) * period
    _refuse(
        trains & ~(shorter >= max(limits.min_dwell, np.finfo(float).tiny)),
        ErrorCode.LIMIT_EXCEEDED,
        "dwells",
        sequence.dwells,
        f"s: a part of each of its pulses is shorter than {limits.min_dwell:g} s, the least: send pulses of a lower frequency",
    )
    rate = np.where(trains, 1.0 / np.maximum(period, np.finfo(float).tiny), 0.0)
    _refuse(rate > limits.max_frequency, ErrorCode.LIMIT_EXCEEDED, "pulses", rate, f"Hz: the most is {limits.max_frequency:g} Hz")
    swing = _swing(sequence)
    slow = trains & (swing / limits.max_slew_rate > shorter)
    _refuse(
        slow,
        ErrorCode.LIMIT_EXCEEDED,
        "dwells",
        shorter,
        f"s in the shorter part of a pulse: its level is not reached in it at the largest slew rate, {limits.max_slew_rate:g} V/s",
    )
    power = np.where(trains, limits.capacitance * swing**2 * rate, 0.0)
    _refuse(
        power > limits.max_power,
        ErrorCode.LIMIT_EXCEEDED,
        "pulses",
        power,
        f"W, by {limits.capacitance:g} F x swing^2 x frequency: the most is {limits.max_power:g} W, so lower level or frequency",
    )


def _check_charge(sequence: VoltageSequence, limits: Limits) -> None:
    """What insulators collect: the integral of the volts."""
    if limits.max_charge == math.inf:
        return
    gathered = np.cumsum(_charge(sequence))
    _refuse(
        np.abs(gathered) > limits.max_charge,
        ErrorCode.LIMIT_EXCEEDED,
        "levels",
        gathered,
        f"V s, summed up to here: max_charge is {limits.max_charge:g} V s; send pulses of alternating polarity, or less",
    )


def _charge(sequence: VoltageSequence) -> np.ndarray:
    """[V s] (N,) integral of the volts over each segment."""
    held = sequence.levels * sequence.dwells
    if not sequence.trains.any():
        return held
    mean = sequence.duty * sequence.levels + (1.0 - sequence.duty) * sequence.low_levels
    left = (sequence.pulses % 2) / np.maximum(sequence.pulses, 1) if sequence.alternating else 1.0  # of an odd number: one pulse
    return np.where(sequence.trains, mean * sequence.dwells * left, held)


def _driven(sequence: VoltageSequence, above: float) -> np.ndarray:
    """[s] (N,) that each segment spends above a level, of either sign where signs alternate."""
    size = np.abs if sequence.alternating else np.asarray
    high = size(sequence.levels) > above
    if not sequence.trains.any():
        return np.where(high, sequence.dwells, 0.0)
    low = size(sequence.low_levels) > above
    share = np.where(sequence.trains & ~low, sequence.duty, 1.0)
    return np.where(high, share * sequence.dwells, 0.0)


def _swing(sequence: VoltageSequence) -> np.ndarray:
    """[V] (N,) the largest step within each train, 0 where a level is held."""
    if not sequence.trains.any():
        return np.zeros(len(sequence.levels))
    size = np.abs(sequence.levels)
    return np.where(sequence.trains, size + np.abs(sequence.low_levels) * (1 if sequence.alternating else -1), 0.0)


def _last_levels(sequence: VoltageSequence) -> np.ndarray:
    """[V] (N,) at which each segment ends."""
    if not sequence.trains.any():
        return sequence.levels
    turned = sequence.alternating & (sequence.pulses % 2 == 0)
    return np.where(sequence.trains, np.where(turned, -1.0, 1.0) * sequence.low_levels, sequence.levels)


def _check_slew(sequence: VoltageSequence, limits: Limits) -> None:
    """Each level must be reached before the next one is asked for."""
    if limits.max_slew_rate == math.inf:
        return
    before = np.concatenate([[limits.rest_level], _last_levels(sequence)[:-1]])
    steps = np.abs(sequence.levels - before)
    times = sequence.dwells
    if sequence.trains.any():
        times = np.where(sequence.trains, sequence.duty * times / np.maximum(sequence.pulses, 1), times)
    late = steps / limits.max_slew_rate > times
    if late.any():
        index = int(np.argmax(late))
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED,
            f"dwells[{index}]",
            f"is {times[index]:g} s: the step of {steps[index]:g} V before it takes "
            f"{steps[index] / limits.max_slew_rate:g} s at the largest slew rate of {limits.max_slew_rate:g} V/s: hold it longer",
        )


def _refuse(bad: np.ndarray, code: ErrorCode, name: str, values: np.ndarray, message: str) -> None:
    if bad.any():
        index = int(np.argmax(bad))
        raise StressbotError(code, f"{name}[{index}]", f"is {values[index]:g} {message}")
