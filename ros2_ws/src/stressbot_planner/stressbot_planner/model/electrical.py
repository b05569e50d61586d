"""How the swarm reads volts: the alphabet and the codes of its Physical Finite-State Machines (PFSMs)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError

CHECKED = "checked"
"""The word for codes with a check symbol."""

MOST_LEVELS = 256
"""That select groups: a symbol is a byte."""

SLOWEST_PULSES = 1e-3
"""Hz; in the schema of scenario files too, but a frequency may follow from speed and step."""


@dataclass(frozen=True)
class Pulses:
    """A drive of pulses, each of which moves every robot by one step: its speed / frequency.

    Attributes:
        low_level: between pulses, V; the high level is ``drive_level``.
        frequency: pulses per second.
        duty: share of a period at the high level.
        alternating: whether each pulse has the other sign than the one before; robots feel the amount of a voltage then.
        response: shortest time at the high or the low level that a robot answers to, s.
    """

    low_level: float
    frequency: float
    duty: float
    alternating: bool
    response: float


@dataclass(frozen=True)
class Electrical:
    """Levels (V), dwells (s) and group codes; docs/electrical.md explains each and marks the assumptions.

    Attributes:
        codes: symbols that select each group, m tuples of equal length K; symbol s is ``symbol_levels[s]``.
        drive: None: a constant drive_level, in which robots move steadily.
        pull_downs: of each robot its own, above drive_level, ``pull_down`` being the lowest; (): all are alike. Where there are
            some there are no PFSMs: ``symbol_levels`` are those of `control_levels`, from drive_level on, and code i is symbol i.

    The other attributes are those of ``stressbot_msgs/msg/ElectricalDescription``.
    """

    rest_level: float
    symbol_levels: tuple[float, ...]
    reset_level: float
    drive_level: float
    thresholds: tuple[float, ...]
    hysteresis: float
    pull_down: float
    release: float
    reset_dwell: float
    symbol_dwell: float
    guard_dwell: float
    min_dwell: float
    codes: tuple[tuple[int, ...], ...]
    min_level: float
    max_level: float
    drive: Pulses | None = None
    pull_downs: tuple[float, ...] = ()

    def __post_init__(self):
        for name in ("rest_level", "reset_level", "drive_level", "hysteresis", "pull_down", "release", "reset_dwell",
                     "symbol_dwell", "guard_dwell", "min_dwell", "min_level", "max_level"):
            _check_finite(name, getattr(self, name))
        if self.drive is not None:
            for name in ("low_level", "frequency", "duty", "response"):
                _check_finite(f"drive.{name}", getattr(self.drive, name))
        for name in ("symbol_levels", "thresholds", "pull_downs"):
            for index, value in enumerate(getattr(self, name)):
                _check_finite(f"{name}[{index}]", value)
        if self.hysteresis < 0:
            _refuse("hysteresis", f"is {self.hysteresis}: give 0 or more")
        for name in ("reset_dwell", "symbol_dwell", "guard_dwell", "min_dwell"):
            if getattr(self, name) <= 0:
                _refuse(name, f"is {getattr(self, name)}: give a time greater than 0")
        self._check_levels()
        self._check_pulses()
        for name in ("reset_dwell", "symbol_dwell"):
            if getattr(self, name) < self.min_dwell:
                _refuse(name, f"is {getattr(self, name)} s: a PFSM ignores less than min_dwell ({self.min_dwell} s)")
        self._check_codes()

    def _check_levels(self) -> None:
        levels = self.levels
        low = () if self.drive is None else ("drive.low_level",)
        symbols = () if self.pull_downs else (f"symbol_levels[{s}]" for s in range(len(self.symbol_levels)))
        names = ("rest_level", *symbols, "reset_level", *low, "drive_level")
        for k in range(1, len(levels)):
            if levels[k] <= levels[k - 1]:
                _refuse(names[k], f"is {levels[k]} V: give more than {names[k - 1]} ({levels[k - 1]} V)")
        if self.min_level > levels[0]:
            _refuse("min_level", f"is {self.min_level} V: give at most rest_level ({levels[0]} V)")
        if self.max_level < levels[-1]:
            _refuse("max_level", f"is {self.max_level} V: give at least drive_level ({levels[-1]} V)")
        if len(self.thresholds) != len(levels) - 1:
            raise StressbotError(
                ErrorCode.WRONG_COUNT,
                "electrical.thresholds",
                f"has {len(self.thresholds)} entries for {len(levels)} levels: give {len(levels) - 1}, one between neighbours",
            )
        half = self.hysteresis / 2
        for k, threshold in enumerate(self.thresholds):
            if not levels[k] < threshold - half or not threshold + half < levels[k + 1]:
                _refuse(
                    "hysteresis" if threshold == midpoints(levels)[k] else f"thresholds[{k}]",
                    f"puts the threshold {threshold} V ± {half} V beyond {names[k]} ({levels[k]} V) or {names[k + 1]} "
                    f"({levels[k + 1]} V): it must lie between",
                )
        if self.release < self.rest_level:
            _refuse("release", f"is {self.release} V: below rest_level ({self.rest_level} V) no arm would rise")
        if self.pull_down <= self.release:
            _refuse("pull_down", f"is {self.pull_down} V: give more than release ({self.release} V)")
        if self.pull_downs:
            self._check_control_levels()
        elif self.pull_down > self.drive_level:
            _refuse("pull_down", f"is {self.pull_down} V: above drive_level ({self.drive_level} V) no arm would come down")

    def _check_control_levels(self) -> None:
        if self.drive is None:
            _refuse("drive", "is constant: robots whose arms come down at levels of their own take pulses")
        if self.pull_down != min(self.pull_downs):
            _refuse("pull_down", f"is {self.pull_down} V: give the lowest of pull_downs ({min(self.pull_downs)} V)")
        if self.pull_down <= self.drive_level:
            _refuse(
                "pull_down",
                f"is {self.pull_down} V: give more than drive_level ({self.drive_level} V), at which arms of such robots stay up",
            )
        levels = control_levels(self.pull_downs, self.drive_level)
        if len(levels) > MOST_LEVELS:
            _refuse("pull_down", f"has {len(levels) - 1} different levels: give at most {MOST_LEVELS - 1}")
        if self.max_level < levels[-1]:
            _refuse("max_level", f"is {self.max_level} V: give {levels[-1]} V or more, at which all arms are down")
        if self.drive.alternating and self.min_level > -levels[-1]:
            _refuse("min_level", f"is {self.min_level} V: alternating pulses take {-levels[-1]} V, too")
        if self.symbol_levels != levels:
            _refuse("symbol_levels", "are not those that follow from pull_down: leave them out")
        if self.codes != tuple((index,) for index in range(len(levels))):
            _refuse("codes", "are not those that follow from pull_down: leave them out")

    def _check_pulses(self) -> None:
        drive = self.drive
        if drive is None:
            return
        if drive.low_level <= self.release:
            _refuse(
                "drive.low_level", f"is {drive.low_level} V: at release ({self.release} V) and below arms rise, give more"
            )
        if drive.alternating and self.rest_level != 0:
            _refuse("rest_level", f"is {self.rest_level} V: alternating pulses need 0 V")
        if drive.alternating and self.min_level > -self.drive_level:
            _refuse("min_level", f"is {self.min_level} V: alternating pulses need -drive_level ({-self.drive_level} V)")
        if not 0 < drive.duty < 1:
            _refuse("drive.duty", f"is {drive.duty}: give a number between 0 and 1")
        if not 0 < drive.response <= self.min_dwell:
            _refuse("drive.response", f"is {drive.response} s: give more than 0 and at most min_dwell ({self.min_dwell} s)")
        if drive.frequency < SLOWEST_PULSES:
            _refuse("drive.frequency", f"is {drive.frequency:g} Hz: give at least {SLOWEST_PULSES:g} Hz, by a shorter step_length")
        share = min(drive.duty, 1 - drive.duty)
        if share / drive.frequency < drive.response:
            _refuse(
                "drive.frequency",
                f"is {drive.frequency:g} Hz: a pulse would be high or low for {share / drive.frequency:g} s, and robots answer to "
                f"{drive.response:g} s; give at most {share / drive.response:g} Hz, by a longer step_length or a lower speed",
            )

    def _check_codes(self) -> None:
        if not self.codes or not self.codes[0]:
            raise StressbotError(ErrorCode.WRONG_COUNT, "electrical.codes", "must give at least one symbol for each group")
        group_with: dict[tuple[int, ...], int] = {}
        for index, code in enumerate(self.codes):
            name = f"codes[{index}]"
            if len(code) != len(self.codes[0]):
                raise StressbotError(
                    ErrorCode.WRONG_COUNT, f"electrical.{name}", f"has {len(code)} symbols, not {len(self.codes[0])} as codes[0]"
                )
            if not 0 <= min(code) <= max(code) < len(self.symbol_levels):
                _refuse(name, f"may only use the symbols 0 to {len(self.symbol_levels) - 1}")
            if code in group_with:
                _refuse(name, f"equals codes[{group_with[code]}], so that one code selects two groups: change one")
            group_with[code] = index

    @property
    def levels(self) -> tuple[float, ...]:
        """All levels in ascending order: rest, a PFSM's symbols, reset, drive; of pulses the low level before the high one."""
        low = () if self.drive is None else (self.drive.low_level,)
        symbols = () if self.pull_downs else self.symbol_levels
        return (self.rest_level, *symbols, self.reset_level, *low, self.drive_level)

    def pulse_length(self, speed: float) -> float | None:
        """Return how far the fastest robots, of this speed, slide with one pulse; None: the drive is constant."""
        return None if self.drive is None else speed / self.drive.frequency

    @property
    def symbols(self) -> int:
        """Symbols of a code, K."""
        return len(self.codes[0])

    @property
    def states(self) -> int:
        """States of a module: as many symbols taken as there are right ones, 0 to K, or dead after a wrong one."""
        return self.symbols + 2

    @property
    def selection_time(self) -> float:
        """Time that one epoch takes besides driving, s."""
        if self.pull_downs:
            return self.symbol_dwell + 2 * self.guard_dwell
        return self.reset_dwell + self.symbols * (self.symbol_dwell + self.guard_dwell) + 2 * self.guard_dwell


def control_levels(pull_downs: Iterable[float], drive_level: float) -> tuple[float, ...]:
    """Return the levels, V, that select the groups of `allocation.by_level`, G_1 first.

    The drive's own, which brings down nobody's arm, then one between each two neighbours of pull_downs, and one that is above them
    all by half of the smallest gap, that to the drive included.
    """
    ladder = (drive_level, *sorted(set(pull_downs)))
    gap = min(above - below for below, above in zip(ladder, ladder[1:], strict=False))
    return (drive_level, *midpoints(ladder[1:]), ladder[-1] + gap / 2)


def midpoints(levels: tuple[float, ...]) -> tuple[float, ...]:
    """Return the thresholds between neighbouring levels, V, unless others are given."""
    return tuple((a + b) / 2 for a, b in zip(levels, levels[1:], strict=False))


def _check_finite(name: str, value: float) -> None:
    if not np.isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, f"electrical.{name}", f"is {value}: give a finite number")


def _refuse(name: str, message: str) -> NoReturn:
    raise StressbotError(ErrorCode.OUT_OF_RANGE, f"electrical.{name}", message)


def default_codes(m: int, level_count: int) -> tuple[tuple[int, ...], ...]:
    """Return the code of each of m groups: the digits of i - 1 to the base L, most significant first.

    K = ceil(log_L m) symbols, at least one (paper: "k = O(log2 m) bits to select a group through a PFSM").
    """
    length, reach = 1, level_count
    while reach < m:
        length, reach = length + 1, reach * level_count
    return tuple(
        tuple(index // level_count**place % level_count for place in reversed(range(length))) for index in range(m)
    )


def checked_codes(codes: Iterable[Sequence[int]], level_count: int) -> tuple[tuple[int, ...], ...]:
    """Return codes with a check symbol (single parity check code): sums are 0 modulo L, so that any two differ in two symbols."""
    return tuple((*code, -sum(code) % level_count) for code in codes)
