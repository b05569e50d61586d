"""How late pictures are stamped: the time delay between drive and motion, by cross-correlation.

All robots move while something is driven, and rest otherwise; when that is, the driver says. With S(t) the seconds driven until t,
and y the seconds of a drive for which robots have moved between pictures stamped t₁ and t₂, by their described speeds,

    y = k (S(t₂ - L) - S(t₁ - L)) + noise,

where k is how fast they really are. L is where both sides are correlated most. What tells it are the pictures between which a drive
begins or ends; its standard error is White's, since these fit worse than others.

C. Knapp and G. Carter, The generalized correlation method for estimation of time delay, IEEE Trans. ASSP 24(4), 1976. Of cameras
and other sensors it is called temporal calibration: P. Furgale, J. Rehder and R. Siegwart, Unified temporal and spatial calibration
for multi-sensor systems, IROS 2013.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from stressbot_driver.vision.planar import wrapped

LEAST, MOST, STEP, FINE = -0.1, 1.0, 0.01, 81
"""s: between which a latency is looked for, in steps, and then in so many between two of them. Below 0: clocks differ."""

LEAST_EDGES = 10
"""Begins and ends of drives that are enough to tell it."""

SURE = 5.0
"""Standard deviations of the correlation of things that have nothing to do with each other, at least; and"""

MOST_ERROR = 0.02
"""s of standard error, at most: otherwise robots do not move as they are driven."""

LATE = 0.03
"""s by which a measured latency differs from a given one before that is said, and at least three standard errors."""

KEPT_PICTURES, KEPT_DRIVES = 2000, 200

FARTHEST = 0.5
"""s between two pictures, at most, of which the second tells how robots have moved since the first."""


@dataclass(frozen=True)
class Latency:
    """By how much pictures are stamped after they were taken.

    Attributes:
        seconds: below 0: before.
        error: standard error, s.
        edges: begins and ends of drives that it is told by.
    """

    seconds: float
    error: float
    edges: int


def remark(measured: Latency, given: float) -> str:
    """Return what to do about a latency [s] that is given and is not the measured one; nothing if it may be."""
    late = measured.seconds - given
    if abs(late) < max(LATE, 3.0 * measured.error):
        return ""
    moves = f"robots move {1e3 * abs(late):.0f} ms {'later' if late > 0.0 else 'earlier'} in the pictures than they are driven"
    if measured.seconds < -LATE:
        return f"{moves}: compare the clocks of camera and driver"
    return f"{moves}: put `latency: {max(measured.seconds, 0.0):.3f}` into the camera file"


def driven_for(before: np.ndarray, after: np.ndarray, speed: np.ndarray | float, turning_rate: np.ndarray | float) -> float:
    """Return for how many seconds robots have been driven, by the median.

    Args:
        before: poses (k, 3), m, m, rad.
        after: poses (k, 3); each robot has slid or turned.
        speed: m/s, shape (k,) or of all.
        turning_rate: rad/s, likewise.

    Returns:
        NaN if there are none.
    """
    if not len(before):
        return float("nan")
    x, y, turn = (after - before).T
    cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
    return float(np.median((cos * x + sin * y) / speed + wrapped(turn) / turning_rate))


class LatencyMeter:
    """Compares what was driven with what pictures show."""

    def __init__(self) -> None:
        self._stamps: deque[float] = deque(maxlen=KEPT_PICTURES)
        self._moved: deque[float] = deque(maxlen=KEPT_PICTURES)  # s of a drive since the picture before; NaN: not known
        self._drives: deque[tuple[float, float]] = deque(maxlen=KEPT_DRIVES)

    def look(self, stamp: float, moved: float) -> None:
        """Take in a picture's stamp [s], and how long robots were driven since the one before [s], see `driven_for`."""
        is_near = self._stamps and stamp - self._stamps[-1] < FARTHEST
        self._moved.append(moved if is_near else np.nan)
        self._stamps.append(stamp)

    def drive(self, begins: np.ndarray, ends: np.ndarray) -> None:
        """Take in drives, later than those before, by the stamps [s] between which they were, shape (k,) each."""
        self._drives.extend(zip(begins.tolist(), ends.tolist(), strict=True))

    def latency(self) -> Latency | None:
        """Return what is known by now; None if that is too little, or robots do not move as they are driven."""
        stamps, moved, drives = np.array(self._stamps), np.array(self._moved), np.array(self._drives)
        known = np.flatnonzero(np.isfinite(moved[1:]))
        if not len(known) or not len(drives):
            return None
        first, last, moved = stamps[known], stamps[known + 1], moved[known + 1]
        edges = np.maximum.accumulate(drives.ravel())
        driven_at = np.concatenate([[0.0], np.cumsum(np.diff(edges) * (np.arange(len(edges) - 1) % 2 == 0))])

        def driven(latency: np.ndarray) -> np.ndarray:
            """Seconds between the pictures of each pair, shape (pairs, latencies)."""
            return np.interp(last[:, None] - latency, edges, driven_at) - np.interp(first[:, None] - latency, edges, driven_at)

        def correlation(latency: np.ndarray) -> np.ndarray:
            x = driven(latency)
            return moved @ x / np.maximum(np.linalg.norm(x, axis=0) * np.linalg.norm(moved), 1e-12)

        steps = np.arange(LEAST, MOST + STEP, STEP)
        steps = steps[np.argmax(correlation(steps))] + np.linspace(-STEP, STEP, FINE)
        alike = correlation(steps)
        seconds = float(steps[np.argmax(alike)])
        slope = np.searchsorted(edges, first - seconds, "right") % 2 - np.searchsorted(edges, last - seconds, "right") % 2
        count = int(np.count_nonzero(slope))
        if float(alike.max()) * np.sqrt(len(known)) < SURE or count < LEAST_EDGES:
            return None
        x = driven(np.array([seconds]))[:, 0]
        speed = float(moved @ x / (x @ x))
        error = float(np.linalg.norm(slope * (moved - speed * x))) / (speed * count)
        return Latency(seconds, error, count) if error < MOST_ERROR else None
