"""How real robots and trackers depart from the model: settings, all off by default, and what a seed makes of them.

Definitions and units are in docs/imperfections.md. One seed gives every robot its own lasting errors and every run the
same noise; each kind has a random stream of its own, so that switching one on leaves the others as they were.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from stressbot_driver.errors import ErrorCode, StressbotError

PREFIX = "imperfections."
LARGEST_DRAW = 4.0
"""Sigmas within which lasting errors of a robot are drawn, so that no speed or radius comes near zero."""

_LASTING = (
    "speed_error", "radius_error", "heading_bias", "threshold_drift", "charging", "frequency_slope", "level_slope",
    "threshold_error",
)
_OF_STEPS = ("missed_steps", "step_spread", "frequency_slope", "level_slope")
_PAUSE = 10.0
"""Nominal periods between two pulses, beyond which the second one is a first one again."""


def _number(description: str, high: float, per_robot: bool = False) -> Any:
    return field(default=0.0, metadata={"description": description, "high": high, "per_robot": per_robot})


def _ids(description: str) -> Any:
    return field(default=(), metadata={"description": description})


def _count(description: str, default: int, low: int, high: int) -> Any:
    return field(default=default, metadata={"description": description, "low": low, "high": high})


@dataclass(frozen=True)
class Imperfections:
    """The settings. Those that last per robot are a sigma, or a sequence of one true value per robot.

    Raises:
        StressbotError: WRONG_TYPE, OUT_OF_RANGE; the field is named as the driver's parameter is.
    """

    seed: int = _count("Of all random numbers of the imperfections.", 0, 0, 2**63 - 1)
    speed_error: float | Sequence[float] = _number("Relative speed error: sigma, or one value per robot.", 0.2, True)
    radius_error: float | Sequence[float] = _number("Relative error of the turning radius: sigma, or one per robot.", 0.2, True)
    heading_bias: float | Sequence[float] = _number(
        "[rad] Angle from a robot's heading to the direction that it slides in: sigma, or one per robot.", 1.0, True
    )
    heading_noise: float = _number("[rad] Sigma of the jump of every robot's heading as each activation begins.", 1.0)
    threshold_error: float | Sequence[float] = _number(
        "[V] By how much all thresholds of a robot, those of its arm too, are higher: sigma, or one per robot.", 1e3, True
    )
    threshold_drift: float | Sequence[float] = _number(
        "[V/s] Rate at which all thresholds of a robot rise with time: sigma, or one per robot.", 1e3, True
    )
    charging: float | Sequence[float] = _number(
        "[V/(V s)] How far the time integral of the volts raises all thresholds of a robot: sigma, or one per robot.", 1e3, True
    )
    charge_leak: float = _number("[1/s] Rate at which that integral decays.", 1e6)
    missed_steps: float = _number("Probability that a robot makes no step at a pulse.", 1.0)
    step_spread: float = _number("Relative sigma of every single step.", 1.0)
    frequency_slope: float | Sequence[float] = _number(
        "Relative change of a robot's steps per relative change of the frequency: sigma, or one per robot.", 10.0, True
    )
    level_slope: float | Sequence[float] = _number(
        "Relative change of a robot's steps per relative change of the high level: sigma, or one per robot.", 10.0, True
    )
    dropped_symbols: float = _number("Probability that a robot does not take a symbol.", 1.0)
    misread_symbols: float = _number("Probability that a robot takes another symbol for the one sent.", 1.0)
    selection_motion: float = _number("Fraction of its speed at which a robot moves at symbol and reset levels.", 1.0)
    always_slide: Sequence[int] = _ids("Ids of robots whose arm is stuck up.")
    always_turn: Sequence[int] = _ids("Ids of robots whose arm is stuck down.")
    position_noise: float = _number("[m] Sigma of measured x and y.", 1e3)
    orientation_noise: float = _number("[rad] Sigma of measured headings.", 10.0)
    latency: float = _number("[s] Substrate time from a measurement to its report.", 1e3)
    lost_probability: float = _number("Probability that a measurement loses a robot.", 1.0)
    lost_frames: int = _count("Measurements in a row that a lost robot is missing from.", 1, 1, 10**9)

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, limits = getattr(self, entry.name), entry.metadata
            if isinstance(entry.default, tuple):
                values = self._items(entry.name, value)
                if any(isinstance(item, bool) or not isinstance(item, int) for item in values):
                    raise _refusal(ErrorCode.WRONG_TYPE, entry.name, f"is {value!r}: list robot ids")
                object.__setattr__(self, entry.name, values)
            elif isinstance(entry.default, int):
                if isinstance(value, bool) or not isinstance(value, int):
                    raise _refusal(ErrorCode.WRONG_TYPE, entry.name, f"is {value!r}: give a whole number")
                if not limits["low"] <= value <= limits["high"]:
                    raise _out_of_range(entry.name, value, limits["low"], limits["high"])
            elif limits["per_robot"] and not _is_number(value):
                values = self._items(entry.name, value)
                for item in values:
                    self._check(entry.name, item, -limits["high"], limits["high"])
                object.__setattr__(self, entry.name, tuple(map(float, values)))
            else:
                self._check(entry.name, value, 0.0, limits["high"])
        if self.dropped_symbols + self.misread_symbols > 1.0:
            raise _out_of_range("misread_symbols", self.misread_symbols, 0.0, 1.0 - self.dropped_symbols)
        if both := set(self.always_slide) & set(self.always_turn):
            raise _refusal(ErrorCode.OUT_OF_RANGE, "always_turn", f"names robot {min(both)}, as always_slide does: name it once")

    @property
    def is_ideal(self) -> bool:
        """Whether nothing at all is off the model."""
        return not self.active

    @property
    def active(self) -> list[str]:
        """Names of the settings that have an effect."""
        return [
            entry.name
            for entry in fields(self)
            if not isinstance(entry.default, int) and np.any(np.asarray(getattr(self, entry.name)))
        ]

    def refuse_steps(self) -> None:
        """Raises StressbotError UNSUPPORTED if a setting is about steps: for robots that make none."""
        for name in _OF_STEPS:
            if name in self.active:
                raise _refusal(ErrorCode.UNSUPPORTED, name, "is about single steps: give electrical.drive pulses, or leave it at 0")

    def _items(self, name: str, value: Any) -> tuple:
        try:
            return tuple(value.tolist() if hasattr(value, "tolist") else value)
        except TypeError:
            raise _refusal(ErrorCode.WRONG_TYPE, name, f"is {value!r}: give a list") from None

    def _check(self, name: str, value: Any, low: float, high: float) -> None:
        if not _is_number(value):
            raise _refusal(ErrorCode.WRONG_TYPE, name, f"is {value!r}: give a number")
        if not low <= value <= high:  # NaN fails as well
            raise _out_of_range(name, value, low, high)


class Flaws:
    """The true errors of n robots under some settings, and their noise.

    Attributes:
        speed_factor, radius_factor: of the nominal values, (n,).
        heading_bias: [rad] (n,).
        threshold_error: [V] (n,).
        threshold_drift: [V/s] (n,).
        charging: [1/s] (n,) V of thresholds per V s.
        always_slide, always_turn: (n,) bool.
    """

    def __init__(self, settings: Imperfections, ids: np.ndarray, symbol_count: int) -> None:
        """Raises StressbotError WRONG_COUNT or UNKNOWN_ROBOT if the settings are for other robots."""
        self.settings = settings
        self._symbol_count = symbol_count
        count = len(ids)
        streams = dict(zip(_LASTING, _streams(settings.seed, 0, len(_LASTING)), strict=True))
        lasting = {name: _lasting(name, getattr(settings, name), streams[name], count) for name in _LASTING}
        self.speed_factor = 1.0 + lasting["speed_error"]
        self.radius_factor = 1.0 + lasting["radius_error"]
        self.heading_bias = lasting["heading_bias"]
        self.threshold_error = lasting["threshold_error"]
        self.threshold_drift = lasting["threshold_drift"]
        self.charging = lasting["charging"]
        self._slopes = lasting["frequency_slope"], lasting["level_slope"]
        self.always_slide = _chosen("always_slide", settings.always_slide, ids)
        self.always_turn = _chosen("always_turn", settings.always_turn, ids)
        self.restart()

    def restart(self) -> None:
        """The noise begins again, so that a run after a reset is the same run."""
        self._heading, self._symbols, self._steps = _streams(self.settings.seed, 1, 3)
        self._missing, self._spreading = np.zeros((2, len(self.speed_factor)))

    def heading_jumps(self) -> np.ndarray:
        """[rad] (n,) what one activation adds to each heading."""
        return self.settings.heading_noise * self._heading.standard_normal(len(self.speed_factor))

    # Steps of one activation. Chance is drawn once for it, so that looking how far it has got, however often, changes nothing.

    def begin_steps(self, robots: np.ndarray) -> None:
        """Draw the chance of an activation that begins for the chosen robots (n,)."""
        missing, spreading = self._steps.standard_normal((2, len(robots)))
        self._missing = np.where(robots, missing, self._missing)
        self._spreading = np.where(robots, spreading, self._spreading)

    def share_of_steps(self, answered: np.ndarray, more: np.ndarray, interval: np.ndarray | float, height: float) -> np.ndarray:
        """Steps made per pulse (n,) in `more` pulses after `answered` ones, in steps of the nominal length.

        They come `interval` nominal periods apart, with a high level of `height` times the nominal one.
        """
        made = self._made(answered + more) - self._made(answered)
        by_frequency, by_level = self._slopes
        known = (np.asarray(interval) <= _PAUSE) & (np.asarray(interval) > 0.0)
        faster = np.where(known, 1.0 / np.where(known, interval, 1.0) - 1.0, 0.0)
        longer = np.maximum(1.0 + by_frequency * faster + by_level * (height - 1.0), 0.0)
        return longer * np.divide(made, more, out=np.zeros_like(made), where=more > 0.0)

    def _made(self, pulses: np.ndarray) -> np.ndarray:
        """Steps made in the first pulses (n,) of an activation: binomial and normal sums, as of large numbers."""
        missed, spread = self.settings.missed_steps, self.settings.step_spread
        lost = np.rint(pulses * missed + self._missing * np.sqrt(pulses * missed * (1.0 - missed)))
        made = pulses - np.clip(lost, 0.0, pulses)
        return np.maximum(made + spread * self._spreading * np.sqrt(made), 0.0)

    @property
    def drifts(self) -> bool:
        """Whether thresholds change with time."""
        return bool(self.threshold_drift.any() or self.charging.any())

    def charged(self, charge: float, level: float, dt: float) -> float:
        """[V s] the integral of the volts, as it decays, after `dt` [s] more at `level` [V]."""
        leak = self.settings.charge_leak
        if leak == 0.0:
            return charge + level * dt
        return charge * math.exp(-leak * dt) - level * math.expm1(-leak * dt) / leak

    def charged_by(self, pattern: Sequence[tuple[float, float]], period: float, charge: float, count: int) -> float:
        """As `charged`, after `count` times a pattern of levels [V] and dwells [s] that takes `period`."""
        once = 0.0
        for level, dwell in pattern:
            once = self.charged(once, level, dwell)
        leak = self.settings.charge_leak
        if leak == 0.0:
            return charge + count * once
        return charge * math.exp(-leak * count * period) + once * math.expm1(-leak * count * period) / math.expm1(-leak * period)

    def symbols_read(self, sent: np.ndarray) -> np.ndarray:
        """(n,) what each robot makes of the symbol sent to it, `sent` (n,): a symbol, or -1 if it takes none."""
        draw = self._symbols.random(len(sent))
        others = (sent + self._symbols.integers(1, self._symbol_count, len(sent))) % self._symbol_count
        dropped, misread = self.settings.dropped_symbols, self.settings.misread_symbols
        return np.where(draw < dropped, -1, np.where(draw < dropped + misread, others, sent))


def measurement_stream(settings: Imperfections) -> np.random.Generator:
    """The random numbers of a tracker: apart from those of the robots, so that looking changes no motion."""
    return _streams(settings.seed, 2, 1)[0]


def _streams(seed: int, kind: int, count: int) -> list[np.random.Generator]:
    return [np.random.default_rng(child) for child in np.random.SeedSequence([seed, kind]).spawn(count)]


def _lasting(name: str, value: float | Sequence[float], stream: np.random.Generator, count: int) -> np.ndarray:
    if isinstance(value, (int, float)):
        return value * np.clip(stream.standard_normal(count), -LARGEST_DRAW, LARGEST_DRAW)
    if len(value) != count:
        raise _refusal(ErrorCode.WRONG_COUNT, name, f"has {len(value)} values for {count} robots: give one each, or a sigma")
    return np.array(value)


def _chosen(name: str, chosen: Sequence[int], ids: np.ndarray) -> np.ndarray:
    for robot in chosen:
        if robot not in ids:
            raise _refusal(ErrorCode.UNKNOWN_ROBOT, name, f"names robot {robot}: the swarm has robots {ids[0]} to {ids[-1]}")
    return np.isin(ids, chosen)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _out_of_range(name: str, value: Any, low: float, high: float) -> StressbotError:
    return _refusal(ErrorCode.OUT_OF_RANGE, name, f"{value!r} must lie between {low:g} and {high:g}")


def _refusal(code: ErrorCode, name: str, message: str) -> StressbotError:
    return StressbotError(code, PREFIX + name, message)


IDEAL = Imperfections()
