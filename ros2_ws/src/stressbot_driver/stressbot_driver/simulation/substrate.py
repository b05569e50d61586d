"""The plant: volts over time in, poses out. Event-driven and exact between level changes, no time step."""

from dataclasses import dataclass

import numpy as np

from stressbot_driver.bench import Bench
from stressbot_driver.simulation.arm import Arms
from stressbot_driver.simulation.pfsm import PfsmBank
from stressbot_driver.simulation.quantiser import Quantiser

_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Poses:
    """Where robots are: ids (k,), x and y [m] (k,), heading [rad] (k,) in (-pi, pi]."""

    ids: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray


class Substrate:
    """n robots on one electrode grid, all under the same voltage.

    `apply` steps the voltage, `advance` lets time pass at it: d = u·dt forward for a robot whose arm is up in the
    drive band, dt·u/r counter-clockwise on the spot for one whose arm is down, nothing in any other band.
    """

    def __init__(self, bench: Bench) -> None:
        electrical = bench.electrical
        self._bench = bench
        self._electrical = electrical
        count = len(bench.ids)
        symbols = len(electrical.symbol_levels)
        self._reset_band = symbols + 1
        self._drive_band = symbols + 2
        # One reader stands for all robots while they share their thresholds; rows per robot would work alike.
        self._quantiser = Quantiser(electrical.thresholds[None, :], electrical.hysteresis)
        self._pfsms = PfsmBank(bench.membership, electrical.codes, symbols)
        self._arms = Arms(count, electrical.pull_down, electrical.release)
        self._speed = np.full(count, bench.speed)  # [m/s]
        self._turning_rate = bench.speed / bench.turning_radius  # [rad/s]
        self.reset()

    def reset(self) -> None:
        """Robots back at their starts, at rest level, every PFSM initial, every arm up."""
        start = self._bench.start
        self._x, self._y = start[:, 0].copy(), start[:, 1].copy()
        # The heading is a remainder in (-pi, pi] and a count of whole turns: a plain sum of ten thousand turns would
        # lose the digits that a pose exact to 1e-6 needs.
        self._turns = np.zeros(len(start))
        self._heading = start[:, 2].copy()
        self._wrap()
        self._quantiser.reset()
        self._time_in_band = np.zeros(len(self._quantiser.band))
        self._pfsms.reset(slice(None))
        self.level = self._electrical.rest_level
        self._arms.update(self.level, self._pfsms.holding)

    def apply(self, level: float) -> None:
        """Step the voltage to `level` [V]."""
        self.level = level
        before = self._quantiser.band
        band = self._quantiser.read(level)
        changed = band != before
        if changed.any():
            # A symbol is taken on the return to rest, if it was held long enough; bands that a step runs through
            # take no time and are never taken.
            taken = (
                changed
                & (band == 0)
                & (before >= 1)
                & (before < self._reset_band)
                & (self._time_in_band >= self._electrical.min_dwell)
            )
            if taken.any():
                self._pfsms.step(self._rows(taken), (before[taken] - 1))
            self._time_in_band[changed] = 0.0
        self._arms.update(level, self._pfsms.holding)

    def advance(self, dt: float) -> None:
        """Hold the present level for `dt` [s]."""
        band = self._quantiser.band
        if (band == self._drive_band).any():
            self._x, self._y, self._heading = self._moved(dt)
            self._wrap()
        self._time_in_band += dt
        resetting = (band == self._reset_band) & (self._time_in_band >= self._electrical.min_dwell)
        if resetting.any():
            self._pfsms.reset(self._rows(resetting))
            self._arms.update(self.level, self._pfsms.holding)

    def poses(self, after: float = 0.0) -> Poses:
        """Poses now, or `after` seconds more at the present level; looking changes nothing."""
        x, y, heading = self._moved(after) if after else (self._x.copy(), self._y.copy(), self._heading)
        return Poses(ids=self._bench.ids, x=x, y=y, heading=heading - _TURN * _whole_turns(heading))

    @property
    def heading_unwrapped(self) -> np.ndarray:
        """Headings [rad] (n,) with every turn since the reset counted."""
        return self._heading + _TURN * self._turns

    @property
    def arm_up(self) -> np.ndarray:
        """Whether each arm is up (n,)."""
        return self._arms.up

    def _moved(self, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        driving = self._quantiser.band == self._drive_band
        slide = np.where(driving & self._arms.up, self._speed * dt, 0.0)
        turn = np.where(driving & ~self._arms.up, self._turning_rate * dt, 0.0)
        return (
            self._x + slide * np.cos(self._heading),
            self._y + slide * np.sin(self._heading),
            self._heading + turn,
        )

    def _wrap(self) -> None:
        turns = _whole_turns(self._heading)
        self._heading = self._heading - _TURN * turns
        self._turns = self._turns + turns

    def _rows(self, readers: np.ndarray) -> np.ndarray | slice:
        """The robots of the chosen readers: all of them where one reader stands for all."""
        return slice(None) if len(readers) == 1 else readers


def _whole_turns(heading: np.ndarray) -> np.ndarray:
    """Turns to take off a heading so that it lies in (-pi, pi]."""
    return np.ceil((heading - np.pi) / _TURN)
