"""How the swarm reads volts: the alphabet and the codes of its Physical Finite-State Machines (PFSMs)."""

from dataclasses import dataclass

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError


@dataclass(frozen=True)
class Electrical:
    """Levels (V), dwells (s) and group codes; docs/electrical.md explains each and marks the assumptions.

    Attributes:
        codes: symbols that select each group, m tuples of equal length K; symbol s is ``symbol_levels[s]``.

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

    def __post_init__(self):
        if not self.codes or not self.codes[0]:
            _refuse("codes", "must give at least one symbol for each group")
        for name in ("rest_level", "reset_level", "drive_level", "hysteresis", "pull_down", "release", "reset_dwell",
                     "symbol_dwell", "guard_dwell", "min_dwell", "min_level", "max_level"):
            _check_finite(name, getattr(self, name))
        for name in ("symbol_levels", "thresholds"):
            for index, value in enumerate(getattr(self, name)):
                _check_finite(f"{name}[{index}]", value)
        if self.hysteresis < 0:
            _refuse("hysteresis", f"is {self.hysteresis}: give 0 or more")
        if self.min_dwell <= 0:
            _refuse("min_dwell", f"is {self.min_dwell}: give a time greater than 0")
        for name in ("reset_dwell", "symbol_dwell", "guard_dwell"):
            if getattr(self, name) < self.min_dwell:
                _refuse(name, f"is shorter than min_dwell ({self.min_dwell} s): no PFSM would notice it")
        levels = self.levels
        if any(a >= b for a, b in zip(levels, levels[1:], strict=False)):
            _refuse("symbol_levels", f"must lie in order: rest < symbols < reset < drive, but they are {levels}")
        if levels[0] < self.min_level or levels[-1] > self.max_level:
            _refuse("max_level", f"and min_level must enclose all levels, {levels[0]} V to {levels[-1]} V")
        if len(self.thresholds) != len(levels) - 1:
            _refuse("thresholds", f"needs {len(levels) - 1} entries, one between each two levels")
        half = self.hysteresis / 2
        for index, threshold in enumerate(self.thresholds):
            if not levels[index] < threshold - half or not threshold + half < levels[index + 1]:
                _refuse(
                    f"thresholds[{index}]",
                    f"({threshold} V, hysteresis {self.hysteresis} V) must lie between the levels {levels[index]} V "
                    f"and {levels[index + 1]} V",
                )
        if not self.rest_level <= self.release < self.pull_down <= self.drive_level:
            _refuse("pull_down", "must satisfy rest_level <= release < pull_down <= drive_level")
        if len({len(code) for code in self.codes}) > 1 or len(set(self.codes)) < len(self.codes):
            _refuse("codes", "must all have the same length and differ from each other")
        if any(not 0 <= symbol < len(self.symbol_levels) for code in self.codes for symbol in code):
            _refuse("codes", f"may only use the symbols 0 to {len(self.symbol_levels) - 1}")

    @property
    def levels(self) -> tuple[float, ...]:
        """All levels in ascending order: rest, symbols, reset, drive."""
        return (self.rest_level, *self.symbol_levels, self.reset_level, self.drive_level)

    @property
    def selection_time(self) -> float:
        """Time that one epoch takes besides driving, s."""
        return self.reset_dwell + len(self.codes[0]) * (self.symbol_dwell + self.guard_dwell) + 2 * self.guard_dwell


def _check_finite(name: str, value: float) -> None:
    if not np.isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, f"electrical.{name}", f"is {value}: give a finite number")


def _refuse(name: str, message: str) -> None:
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
