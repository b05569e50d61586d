"""The plant: volts over time in, poses out. Event-driven and exact between level changes, no time step.

Volts are levels, or a pattern of levels that is repeated. Of a repetition one period is played edge by edge, then another,
until one leaves everybody's comparators, arms and machines as it found them; every further one then moves each robot by the same,
in its own frame, and so many of them are summed in closed form. Where thresholds drift, what is left out ends before anybody
reads a period differently.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stressbot_driver.bench import Bench, Pulses
from stressbot_driver.simulation.arm import Arms
from stressbot_driver.simulation.imperfections import IDEAL, Flaws, Imperfections
from stressbot_driver.simulation.pfsm import PfsmBank
from stressbot_driver.simulation.quantiser import Quantiser

_TURN = 2.0 * np.pi

Pattern = Sequence[tuple[float, float]]
"""Levels [V], and how long each is held [s]."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Where robots are: ids (k,), x and y [m] (k,), heading [rad] (k,) in (-pi, pi]."""

    ids: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray


_MOST_PERIODS = 64
"""Played edge by edge at most, before a pattern that never leaves things as it found them is taken for one that does."""

_ROUNDING = 1.0 - 1e-9
"""Times are sums: so much of a response is enough."""

_INSTANT = 1e-9
"""Of a period: a shorter time is none."""


class Substrate:
    """n robots on one electrode grid, all under the same voltage.

    `apply` steps the voltage, `advance` lets time pass at it, `repeat` does both many times over. A robot makes a step each time
    that the voltage falls out of the highest band, if it has been there for its response, and below for as long before: d = u / f
    forward if its arm is up, at the level that the voltage has fallen to, else d / r counter-clockwise on the spot. Where the drive
    is described as constant, it moves steadily instead while it reads the drive band: by u·dt, or u·dt / r. Imperfections make
    each robot depart from that in its own way.
    """

    def __init__(self, bench: Bench, imperfections: Imperfections = IDEAL) -> None:
        electrical = bench.electrical
        self._bench = bench
        self._electrical = electrical
        self._pulses = electrical.drive
        by_level = len(electrical.pull_downs) > 0
        symbols = 0 if by_level else len(electrical.symbol_levels)
        self._reset_band = symbols + 1
        self._drive_band = symbols + 2
        self._high_band = symbols + 3
        membership = np.zeros_like(bench.membership) if by_level else bench.membership
        self._pfsms = PfsmBank(membership, electrical.codes, len(electrical.symbol_levels))
        self.impair(imperfections)
        self.reset()

    def impair(self, imperfections: Imperfections) -> None:
        """Take on imperfections in place of earlier ones, at rest level; robots stay where they are.

        Raises StressbotError WRONG_COUNT or UNKNOWN_ROBOT if they are for other robots, UNSUPPORTED if for another drive.
        """
        bench, electrical = self._bench, self._electrical
        count = len(bench.ids)
        flaws = None
        if self._pulses is None:
            imperfections.refuse_steps()
        if not imperfections.is_ideal:
            flaws = Flaws(imperfections, bench.ids, len(electrical.symbol_levels))
        self._flaws = flaws
        # One reader stands for all robots while they read alike.
        self._quantiser = Quantiser(np.tile(electrical.thresholds, (1 if flaws is None else count, 1)), electrical.hysteresis)
        own = electrical.pull_downs
        self._arms = Arms(count, own if len(own) else electrical.pull_down, electrical.release)
        self._speed = bench.speed  # [m/s]
        self._turning_rate = bench.speed / bench.turning_radius  # [rad/s]
        if flaws is not None:
            self._speed = self._speed * flaws.speed_factor
            self._turning_rate = self._turning_rate * flaws.speed_factor / flaws.radius_factor
            self._arms.stuck_up, self._arms.stuck_down = flaws.always_slide, flaws.always_turn
        self._rest()

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
        if self._flaws is not None:
            self._flaws.restart()
        self._rest()

    def _rest(self) -> None:
        """As after a long time at rest level."""
        readers = len(self._quantiser.band)
        self._drifting = 0.0  # [s] since the thresholds began to drift
        self._charge = 0.0  # [V s] that the insulator has taken
        self._time_in_band = np.zeros(readers)
        self._time_high, self._time_below = np.zeros(readers), np.full(readers, np.inf)
        self._relaxed = np.ones(readers, dtype=bool)  # before the voltage rose
        self._rested = np.ones(readers, dtype=bool)  # since the last activation
        robots = np.zeros(len(self._bench.ids))
        self._slid, self._turned = robots, robots  # pulses that were answered to by slides, and by turns
        self._answered, self._since = robots, robots  # in this activation; [s] since the last one
        self._last_high = self._electrical.drive_level  # [V]
        self._pfsms.reset(slice(None))
        self.level = self._electrical.rest_level
        self._arms.update(self.level, self._pfsms.holding)

    def apply(self, level: float) -> None:
        """Step the voltage to `level` [V]."""
        self._apply(level)

    def advance(self, dt: float) -> None:
        """Hold the present level for `dt` [s]."""
        self._advance(dt)

    def repeat(self, pattern: Pattern, count: int, during: float | None = None) -> None:
        """Put `pattern` on the electrodes `count` times; or only as much of it as takes `during` [s]."""
        self._repeat(pattern, count, during)

    def poses(self, after: float = 0.0) -> Poses:
        """Poses now, or `after` seconds more at the present level; looking changes nothing."""
        x, y, heading = self._moved(after) if after else (self._x.copy(), self._y.copy(), self._heading)
        return Poses(ids=self._bench.ids, x=x, y=y, heading=heading - _TURN * _whole_turns(heading))

    def poses_during(self, pattern: Pattern, count: int, after: float) -> Poses:
        """Poses `after` seconds of `pattern`, `count` times, from now on; looking changes nothing."""
        other = self._twin()
        other._repeat(pattern, count, after)
        return other.poses()

    @property
    def heading_unwrapped(self) -> np.ndarray:
        """Headings [rad] (n,) with every turn since the reset counted."""
        return self._heading + _TURN * self._turns

    @property
    def arm_up(self) -> np.ndarray:
        """Whether each arm is up (n,)."""
        return self._arms.up

    @property
    def pulses_answered(self) -> np.ndarray:
        """Pulses (n,) that each robot has read since it was last at rest for good: a `reset`, or new imperfections."""
        return self._slid + self._turned

    def _apply(self, level: float) -> None:
        self.level = level
        felt = self._felt(level)
        before = self._quantiser.band
        band = self._quantiser.read(felt[:, None])
        changed = band != before
        fell = np.zeros(len(self._bench.ids), dtype=bool)
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
            self._begin_activation(changed, band)
            if self._pulses is not None:
                fell = self._fell(self._pulses, before, band)
        self._arms.update(felt, self._pfsms.holding)
        if self._pulses is not None and fell.any():
            self._step(self._pulses, fell)

    def _advance(self, dt: float) -> None:
        band = self._quantiser.band
        if (self._pulses is None and (band == self._drive_band).any()) or self._flaws is not None:
            self._x, self._y, self._heading = self._moved(dt)
            self._wrap()
        self._time_in_band += dt
        if self._pulses is not None:
            high = band == self._high_band
            self._time_high = np.where(high, self._time_high + dt, self._time_high)
            self._time_below = np.where(high, self._time_below, self._time_below + dt)
        if self._flaws is not None:
            self._since = self._since + dt
            self._charge = self._flaws.charged(self._charge, self.level, dt)
        self._drifting += dt
        resetting = (band == self._reset_band) & (self._time_in_band >= self._electrical.min_dwell)
        if resetting.any():
            self._pfsms.reset(self._rows(resetting))
            self._arms.update(self._felt(self.level), self._pfsms.holding)

    def _moved(self, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        band = self._quantiser.band
        driving = (band == self._drive_band) & (self._pulses is None)
        moving, direction = dt, self._heading
        if self._flaws is not None:
            selecting = (band > 0) & (band <= self._reset_band)
            moving = dt * np.where(driving, 1.0, np.where(selecting, self._flaws.settings.selection_motion, 0.0))
            direction = direction + self._flaws.heading_bias
            driving = moving > 0.0
        slide = np.where(driving & self._arms.up, self._speed * moving, 0.0)
        turn = np.where(driving & ~self._arms.up, self._turning_rate * moving, 0.0)
        return (
            self._x + slide * np.cos(direction),
            self._y + slide * np.sin(direction),
            self._heading + turn,
        )

    # Pulses: `drive` is what robots answer to

    def _fell(self, drive: Pulses, before: np.ndarray, band: np.ndarray) -> np.ndarray:
        """Which robots (n,) finish a step with this change of bands."""
        response = drive.response * _ROUNDING
        rose, fell = (before < self._high_band) & (band == self._high_band), (before == self._high_band) & (band < before)
        if rose.any():
            self._last_high = self.level
        self._relaxed = np.where(rose, self._time_below >= response, self._relaxed)
        finished = fell & self._relaxed & (self._time_high >= response)
        self._time_high = np.where(rose, 0.0, self._time_high)
        self._time_below = np.where(fell, 0.0, self._time_below)
        return np.broadcast_to(finished, self._arms.up.shape)

    def _step(self, drive: Pulses, robots: np.ndarray) -> None:
        """The chosen robots (n,) make a step, as their arms are now."""
        up = self._arms.up
        self._go(drive, (robots & up).astype(float), (robots & ~up).astype(float), 1, self._since)
        self._since = np.where(robots, 0.0, self._since)

    def _go(self, drive: Pulses, slides: np.ndarray, turns: np.ndarray, periods: int, interval: np.ndarray | float) -> None:
        """Answer to so many pulses (n,) of each of some periods by slides, and by turns; they come `interval` [s] apart."""
        slid, turned, direction = slides * periods, turns * periods, self._heading
        self._slid, self._turned = self._slid + slid, self._turned + turned
        if self._flaws is not None:
            more = slid + turned
            share = self._flaws.share_of_steps(self._answered, more, interval * drive.frequency, self._height())
            self._answered = self._answered + more
            slid, turned = slid * share, turned * share
            direction = direction + self._flaws.heading_bias
        slide = slid * (self._speed / drive.frequency)
        turn = turned * (self._turning_rate / drive.frequency)
        mixed = (slide != 0.0) & (turn != 0.0)
        if periods > 1 and mixed.any():  # slides that begin where turns have ended: a sum of cosines of an arithmetic series
            half = np.where(mixed, 0.5 * turn / periods, 1.0)
            slide = slide * np.where(mixed, np.sin(periods * half) / (periods * np.sin(half)), 1.0)
            direction = direction + np.where(mixed, (periods - 1) * half, 0.0)
        self._x = self._x + slide * np.cos(direction)
        self._y = self._y + slide * np.sin(direction)
        self._heading = self._heading + turn
        self._wrap()

    def _repeat(self, pattern: Pattern, count: int, during: float | None) -> None:
        period, left = sum(dwell for _, dwell in pattern), 0.0
        if during is not None and during < count * period:
            count = int(during / period)
            left = during - count * period
        played, state = 0, None
        while count > 0:
            slid, turned = self._slid, self._turned
            self._play(pattern)
            count, played = count - 1, played + 1
            before, state = state, self._state()
            if count and self._pulses is not None and before is not None and (_alike(before, state) or played > _MOST_PERIODS):
                motion = self._slid - slid, self._turned - turned
                skipped = self._unchanged(pattern, period, count, state, motion)
                self._skip(self._pulses, pattern, period, skipped, motion)
                count -= skipped
        for level, dwell in pattern:
            if left <= _INSTANT * period:
                break
            self._apply(level)
            self._advance(min(dwell, left))
            left -= dwell

    def _play(self, pattern: Pattern) -> None:
        for level, dwell in pattern:
            self._apply(level)
            self._advance(dwell)

    def _state(self) -> tuple[np.ndarray, ...]:
        """All that decides what another period does, but for what drifts."""
        return self._quantiser.band, self._arms.up, self._relaxed, self._pfsms.state.copy()

    def _unchanged(
        self, pattern: Pattern, period: float, count: int, state: tuple[np.ndarray, ...], motion: tuple[np.ndarray, ...]
    ) -> int:
        """How many of `count` periods are like the last one. Thresholds drift one way, so that the last of them speaks for all."""
        if self._flaws is None or not self._flaws.drifts:
            return count
        while count > 0:
            other = self._twin()
            other._pass(pattern, period, count - 1)
            slid, turned = other._slid, other._turned
            other._play(pattern)
            if _alike(state, other._state()) and _alike(motion, (other._slid - slid, other._turned - turned)):
                return count
            count //= 2
        return 0

    def _skip(self, drive: Pulses, pattern: Pattern, period: float, count: int, motion: tuple[np.ndarray, ...]) -> None:
        """Let `count` periods pass that all do the same."""
        if count:
            slides, turns = motion
            self._go(drive, slides, turns, count, period / np.maximum(slides + turns, 1.0))
            self._pass(pattern, period, count)

    def _pass(self, pattern: Pattern, period: float, count: int) -> None:
        """Let the time of `count` periods pass: all clocks that a period does not set."""
        if self._flaws is not None:
            self._charge = self._flaws.charged_by(pattern, period, self._charge, count)
        self._drifting += count * period

    def _twin(self) -> "Substrate":
        """Another one in the same state."""
        twin = copy.copy(self)
        twin._quantiser, twin._arms, twin._pfsms = copy.copy(self._quantiser), copy.copy(self._arms), copy.copy(self._pfsms)
        twin._pfsms.state, twin._time_in_band = self._pfsms.state.copy(), self._time_in_band.copy()
        twin._flaws = copy.deepcopy(self._flaws)
        return twin

    def _felt(self, level: float) -> np.ndarray:
        """What the robots make of `level` [V] (n,), or all of them (1,); thresholds that rise are a voltage that falls."""
        either_sign = self._pulses is not None and self._pulses.alternating
        if self._flaws is None:
            return np.array([abs(level) if either_sign else level], dtype=float)
        charging = self._flaws.charging * self._charge
        felt = np.abs(level - charging) if either_sign else level - charging
        return felt - self._flaws.threshold_error - self._flaws.threshold_drift * self._drifting

    def _height(self) -> float:
        """High level of the last pulse, in relation to what it should be."""
        return abs(self._last_high) / self._electrical.drive_level

    def _take(self, readers: np.ndarray, symbol: np.ndarray) -> None:
        """The chosen readers take their symbols, each as it reads it."""
        if self._flaws is None:
            self._pfsms.step(slice(None), symbol)
            return
        symbol = self._flaws.symbols_read(symbol)
        readers = readers & (symbol >= 0)
        self._pfsms.step(readers, symbol[readers])

    def _begin_activation(self, changed: np.ndarray, band: np.ndarray) -> None:
        """Headings jump where an activation begins: of pulses, with the first one since rest."""
        if self._flaws is None:
            return
        if self._pulses is None:
            robots = changed & (band == self._drive_band)
        else:
            robots = self._rested & (band >= self._drive_band)
            self._rested = np.where(robots, False, self._rested | (band == 0))
        if robots.any():
            self._heading = self._heading + np.where(robots, self._flaws.heading_jumps(), 0.0)
            if self._pulses is not None:
                self._answered = np.where(robots, 0.0, self._answered)
                self._flaws.begin_steps(robots)
            self._wrap()

    def _wrap(self) -> None:
        turns = _whole_turns(self._heading)
        self._heading = self._heading - _TURN * turns
        self._turns = self._turns + turns

    def _rows(self, readers: np.ndarray) -> np.ndarray | slice:
        """The robots of the chosen readers: all of them where one reader stands for all."""
        return slice(None) if len(readers) == 1 else readers


def _alike(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def _whole_turns(heading: np.ndarray) -> np.ndarray:
    """Turns to take off a heading so that it lies in (-pi, pi]."""
    return np.ceil((heading - np.pi) / _TURN)
