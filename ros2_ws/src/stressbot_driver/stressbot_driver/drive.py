"""Whether a voltage sequence moves the robots of a bench as a drive should: what the output can do is not asked here."""

import numpy as np

from stressbot_driver.bench import Electrical
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import VoltageSequence


def check_drive(sequence: VoltageSequence, electrical: Electrical) -> None:
    """Check a sequence that `check_sequence` has passed.

    Raises StressbotError: INVALID_SEQUENCE for a constant level where robots need pulses, or pulses where the drive is described as
    constant; OUT_OF_RANGE for pulses that robots do not answer to, or not as they should.
    """
    trains, drive = sequence.trains, electrical.drive
    if drive is None:
        _refuse(
            trains,
            ErrorCode.INVALID_SEQUENCE,
            "pulses",
            sequence.pulses,
            "and electrical.drive of this swarm is constant: hold a level, or change the scenario",
        )
        return
    levels = np.abs(sequence.levels) if drive.alternating else sequence.levels
    selects = np.zeros_like(trains)
    if len(electrical.pull_downs):  # by a level before a train, whose first pulse it is part of
        selects[:-1] = trains[1:]
        _refuse(
            trains & (levels >= electrical.pull_down),
            ErrorCode.OUT_OF_RANGE,
            "levels",
            sequence.levels,
            f"V and pulses: at {electrical.pull_down:g} V arms come down that another level has left up: send lower pulses",
        )
    _refuse(
        ~trains & ~selects & (levels > electrical.thresholds[-2] - 0.5 * electrical.hysteresis),
        ErrorCode.INVALID_SEQUENCE,
        "levels",
        sequence.levels,
        "V and is held: robots make one step a pulse, so that this moves each of them once: send a train of pulses",
    )
    if not trains.any():
        return
    if sequence.alternating and not drive.alternating:
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE, "alternating", "is true, and polarity of this swarm is unipolar: send pulses of one sign"
        )
    lows = np.abs(sequence.low_levels) if drive.alternating else sequence.low_levels
    half = 0.5 * electrical.hysteresis
    reach, least = float(electrical.thresholds[-1]) + half, electrical.thresholds[-2] + half
    if not len(electrical.pull_downs):
        reach = max(reach, electrical.pull_down)
    _refuse(
        trains & (levels < reach),
        ErrorCode.OUT_OF_RANGE,
        "levels",
        sequence.levels,
        f"V: below {reach:g} V arms do not come down, or nobody steps: send higher pulses",
    )
    _refuse(
        trains & ((lows <= electrical.release) | (lows < least)),
        ErrorCode.OUT_OF_RANGE,
        "low_levels",
        sequence.low_levels,
        f"V: at {max(electrical.release, least):g} V and below arms rise or robots read a reset or symbol: send a higher low level",
    )
    _refuse(
        trains & (lows > electrical.thresholds[-1] - half),
        ErrorCode.OUT_OF_RANGE,
        "low_levels",
        sequence.low_levels,
        f"V: above {electrical.thresholds[-1] - half:g} V no step is finished: send a lower low level",
    )
    part = min(sequence.duty, 1.0 - sequence.duty) * sequence.dwells / np.maximum(sequence.pulses, 1)
    _refuse(
        trains & (part < drive.response),
        ErrorCode.OUT_OF_RANGE,
        "dwells",
        part,
        f"s in the shorter part of a pulse: robots answer to {drive.response:g} s: send pulses of a lower frequency",
    )


def _refuse(bad: np.ndarray, code: ErrorCode, name: str, values: np.ndarray, message: str) -> None:
    if bad.any():
        index = int(np.argmax(bad))
        raise StressbotError(code, f"{name}[{index}]", f"is {values[index]:g} {message}")
