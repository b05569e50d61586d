"""The plant: volts over time in, poses out. Event-driven and exact between level changes, no time step."""

from dataclasses import dataclass

import numpy as np

from stressbot_driver.bench import Bench
from stressbot_driver.simulation.arm import Arms
from stressbot_driver.simulation.imperfections import IDEAL, Flaws, Imperfections
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
    drive band, dt·u/r counter-clockwise on the spot for one whose arm is down, nothing in any other band. Imperfections
    make each robot depart from that in its own way.
    """

    def __init__(self, bench: Bench, imperfections: Imperfections = IDEAL) -> None:
        electrical = bench.electrical
        self._bench = bench
        self._electrical = electrical
        symbols = len(electrical.symbol_levels)
        self._reset_band = symbols + 1
        self._drive_band = symbols + 2
        self._pfsms = PfsmBank(bench.membership, electrical.codes, symbols)
        self.impair(imperfections)
        self.reset()

    def impair(self, imperfections: Imperfections) -> None:
        """Take on imperfections in place of earlier ones, at rest level; robots stay where they are.

        Raises BenchError WRONG_COUNT or UNKNOWN_ROBOT if they are for other robots.
        """
        bench, electrical = self._bench, self._electrical
        count = len(bench.ids)
        flaws = None
        if not imperfections.is_ideal:
            flaws = Flaws(imperfections, bench.ids, len(electrical.symbol_levels))
        self._flaws = flaws
        self._drifting = 0.0  # [s] since the thresholds began to drift
        # One reader stands for all robots while they read alike.
        self._quantiser = Quantiser(np.tile(electrical.thresholds, (1 if flaws is None else count, 1)), electrical.hysteresis)
        self._time_in_band = np.zeros(len(self._quantiser.band))
        self._arms = Arms(count, electrical.pull_down, electrical.release)
        self._speed = bench.speed  # [m/s]
        self._turning_rate = bench.speed / bench.turning_radius  # [rad/s]
        if flaws is not None:
            self._speed = self._speed * flaws.speed_factor
            self._turning_rate = self._turning_rate * flaws.speed_factor / flaws.radius_factor
            self._arms.stuck_up, self._arms.stuck_down = flaws.always_slide, flaws.always_turn
        self._pfsms.reset(slice(None))
        self.level = electrical.rest_level
        self._arms.update(self.level, self._pfsms.holding)

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
        if self._flaws is not None:
            self._flaws.restart()
        self._drifting = 0.0
        self.level = self._electrical.rest_level
        self._arms.update(self.level, self._pfsms.holding)

    def apply(self, level: float) -> None:
        """Step the voltage to `level` [V]."""
        self.level = level
        felt = self._felt(level)
        before = self._quantiser.band
        band = self._quantiser.read(felt if self._flaws is None else felt[:, None])
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
                self._take(taken, before - 1)
            self._time_in_band[changed] = 0.0
            if self._flaws is not None:
                self._begin_activation(changed & (band == self._drive_band))
        self._arms.update(felt, self._pfsms.holding)

    def advance(self, dt: float) -> None:
        """Hold the present level for `dt` [s]."""
        band = self._quantiser.band
        if (band == self._drive_band).any() or self._flaws is not None:
            self._x, self._y, self._heading = self._moved(dt)
            self._wrap()
        self._time_in_band += dt
        self._drifting += dt
        resetting = (band == self._reset_band) & (self._time_in_band >= self._electrical.min_dwell)
        if resetting.any():
            self._pfsms.reset(self._rows(resetting))
            self._arms.update(self._felt(self.level), self._pfsms.holding)

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
        band = self._quantiser.band
        driving = band == self._drive_band
        moving, direction = dt, self._heading
        if self._flaws is not None:
            moving = dt * np.where(driving, 1.0, np.where(band > 0, self._flaws.settings.selection_motion, 0.0))
            direction = direction + self._flaws.heading_bias
            driving = moving > 0.0
        slide = np.where(driving & self._arms.up, self._speed * moving, 0.0)
        turn = np.where(driving & ~self._arms.up, self._turning_rate * moving, 0.0)
        return (
            self._x + slide * np.cos(direction),
            self._y + slide * np.sin(direction),
            self._heading + turn,
        )

    def _felt(self, level: float) -> float | np.ndarray:
        """What the robots make of `level` [V]; thresholds that rise are a voltage that falls."""
        return level if self._flaws is None else level - self._flaws.threshold_drift * self._drifting

    def _take(self, readers: np.ndarray, symbol: np.ndarray) -> None:
        """The chosen readers take their symbols, each as it reads it."""
        if self._flaws is None:
            self._pfsms.step(slice(None), symbol)
            return
        symbol = self._flaws.symbols_read(symbol)
        readers = readers & (symbol >= 0)
        self._pfsms.step(readers, symbol[readers])

    def _begin_activation(self, robots: np.ndarray) -> None:
        if robots.any():
            self._heading = self._heading + np.where(robots, self._flaws.heading_jumps(), 0.0)
            self._wrap()

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
