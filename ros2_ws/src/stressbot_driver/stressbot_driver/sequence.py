"""A voltage sequence as an immutable value, and the check that it passes before the first volt."""

import math
from dataclasses import dataclass

import numpy as np

from stressbot_driver.errors import BenchError, ErrorCode

LONGEST_ID = 200
"""Characters of a plan's name; every status repeats it."""

MOST_SEGMENTS = 20_000_000
"""A guard against messages that eat the memory (0.5 GB); no plan is near it."""


@dataclass(frozen=True, eq=False)
class VoltageSequence:
    """Hold `levels[k]` [V] for `dwells[k]` [s]; epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1."""

    plan_id: str
    swarm_id: str
    levels: np.ndarray  # [V] (N,)
    dwells: np.ndarray  # [s] (N,)
    epoch_ends: np.ndarray  # (E,) int
    duration: float  # [s] sum of the dwells
    stamp: int = 0  # [ns] since 1970, when the poses were measured from which it was planned; 0: unknown


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
    drive_above: float = math.inf  # [V] robots move
    rest_level: float = 0.0  # [V] before the first segment


def check_sequence(sequence: VoltageSequence, swarm_id: str, limits: Limits) -> None:
    """Check a sequence whole: nothing is clipped or repaired.

    Raises BenchError: MISSING_FIELD, WRONG_SWARM, INVALID_SEQUENCE, WRONG_COUNT, NOT_FINITE, OUT_OF_RANGE or
    LIMIT_EXCEEDED.
    """
    levels, dwells, ends = sequence.levels, sequence.dwells, sequence.epoch_ends
    if len(sequence.plan_id) > LONGEST_ID:
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED, "plan_id", f"has {len(sequence.plan_id)} characters, the most is {LONGEST_ID}: shorten it"
        )
    if not sequence.plan_id:
        raise BenchError(ErrorCode.MISSING_FIELD, "plan_id", "is empty: name the plan that the sequence realises")
    if sequence.swarm_id != swarm_id:
        raise BenchError(
            ErrorCode.WRONG_SWARM,
            "swarm_id",
            f"the sequence is for swarm {sequence.swarm_id!r}, on this bench lies {swarm_id!r}: plan again for this one",
        )
    if len(levels) == 0:
        raise BenchError(ErrorCode.INVALID_SEQUENCE, "levels", "there are none: send at least one segment")
    if len(dwells) != len(levels):
        raise BenchError(ErrorCode.WRONG_COUNT, "dwells", f"{len(dwells)} dwells for {len(levels)} levels: give one per level")
    for name, values in (("levels", levels), ("dwells", dwells)):
        bad = ~np.isfinite(values)
        if bad.any():
            index = int(np.argmax(bad))
            raise BenchError(ErrorCode.NOT_FINITE, f"{name}[{index}]", f"is {values[index]}: send finite numbers")
    _refuse(dwells <= 0.0, ErrorCode.OUT_OF_RANGE, "dwells", dwells, "s: must be positive")
    _refuse(levels < limits.min_level, ErrorCode.LIMIT_EXCEEDED, "levels", levels, f"V: below min_level ({limits.min_level:g} V)")
    _refuse(levels > limits.max_level, ErrorCode.LIMIT_EXCEEDED, "levels", levels, f"V: above max_level ({limits.max_level:g} V)")
    _refuse(dwells < limits.min_dwell, ErrorCode.LIMIT_EXCEEDED, "dwells", dwells, f"s: the least is {limits.min_dwell:g} s")
    if len(levels) > limits.max_segments:
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED, "levels", f"{len(levels)} segments, the backend takes {limits.max_segments}: send less"
        )
    with np.errstate(over="ignore"):
        total = float(np.sum(dwells))
    if not math.isfinite(total) or not math.isfinite(sequence.duration):
        raise BenchError(ErrorCode.NOT_FINITE, "duration", "the dwells must add up to a finite time: send shorter ones")
    if total > limits.max_duration:
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED, "duration", f"is {total:g} s, the most is {limits.max_duration:g} s: send less"
        )
    if abs(sequence.duration - total) > 1e-6 * max(1.0, total):
        raise BenchError(
            ErrorCode.INVALID_SEQUENCE,
            "duration",
            f"is {sequence.duration!r} s but the dwells add up to {total!r} s: send their sum",
        )
    _check_slew(sequence, limits)
    duty = float(np.sum(dwells[levels > limits.drive_above])) / total
    if duty > limits.max_duty:
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED,
            "levels",
            f"robots are driven for {duty:.4f} of the time, max_duty is {limits.max_duty:g}: send longer rests",
        )
    if len(ends) == 0 or ends[0] < 1 or (np.diff(ends) <= 0).any() or ends[-1] != len(levels):
        raise BenchError(
            ErrorCode.INVALID_SEQUENCE,
            "epoch_ends",
            f"must ascend from at least 1 and end at the number of segments ({len(levels)})",
        )


def _check_slew(sequence: VoltageSequence, limits: Limits) -> None:
    """Each level must be reached before the next one is asked for."""
    steps = np.abs(np.diff(sequence.levels, prepend=limits.rest_level))
    late = steps / limits.max_slew_rate > sequence.dwells
    if late.any():
        index = int(np.argmax(late))
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED,
            f"dwells[{index}]",
            f"is {sequence.dwells[index]:g} s: the step of {steps[index]:g} V before it takes "
            f"{steps[index] / limits.max_slew_rate:g} s at the largest slew rate of {limits.max_slew_rate:g} V/s: hold it longer",
        )


def _refuse(bad: np.ndarray, code: ErrorCode, name: str, values: np.ndarray, message: str) -> None:
    if bad.any():
        index = int(np.argmax(bad))
        raise BenchError(code, f"{name}[{index}]", f"is {values[index]:g} {message}")
