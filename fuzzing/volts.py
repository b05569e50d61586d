"""Volts: sequences at the driver's gate, and all that gets past it, on both backends."""

import math
from array import array
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from driver_support import FakeClock, bench, encode
from hypothesis import strategies as st
from instrument_support import AMPLIFIER, GAIN
from stressbot_msgs.msg import VoltageSequence

from fuzzing.instruments import SCRATCH, Loopback
from fuzzing.interface import ACCEPTED, Interface, Violation, check_refusal, outcome
from fuzzing.strategies import COUNTS, NUMBERS, messages
from stressbot_driver.backends.base import Backend, Listener, Pacing
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.bench import Bench
from stressbot_driver.instruments.emulator import Emulator
from stressbot_driver.ros.conversions import sequence_from_message
from stressbot_driver.session import Session, State
from stressbot_driver.simulation.substrate import Pattern, Substrate

BENCHES = {
    "constant drive": bench(6),
    "pulses": bench(6, **{"electrical.drive": "pulses"}),
    "alternating pulses": bench(
        6, **{"electrical.drive": {"polarity": "alternating", "duty": 0.4}, "electrical.min_level": -150.0}
    ),
}
"""By the name of their drive."""

PATIENCE = 100.0
"""s of the substrate."""

REST = 0.0
ACTIVATIONS = ((1, 0.5), (4, 0.25), (2, 1.0))


class Witness:
    """Hears every volt on the substrate of a bench, and for how long."""

    def __init__(self, bench: Bench) -> None:
        self.low, self.high = bench.electrical.min_level, bench.electrical.max_level
        self.level = REST
        self.seconds = 0.0

    def hold(self, level: float, seconds: float) -> None:
        """Note that the substrate is at `level` for some time.

        Raises:
            Violation: beyond the limits of the bench.
        """
        if not self.low - 1e-9 <= level <= self.high + 1e-9:
            raise _Unsafe(f"{level!r} V on the substrate, the limits are {self.low:g} V to {self.high:g} V")
        if not (seconds >= 0.0 and math.isfinite(seconds)):
            raise _Unsafe(f"a level for {seconds!r} s")
        self.level, self.seconds = level, self.seconds + seconds

    def repeat(self, pattern: Sequence[tuple[float, float]], count: int) -> None:
        """Note that the substrate saw levels, each for some time, `count` times."""
        for level, seconds in pattern:
            self.hold(level, count * seconds)


class _Unsafe(BaseException):
    """Not an Exception: backends report those, and go on."""


class WatchedSubstrate(Substrate):
    """The simulated one, with a witness."""

    def __init__(self, bench: Bench) -> None:
        self.witness = Witness(bench)
        super().__init__(bench)

    def apply(self, level: float) -> None:
        """As the plant does."""
        self.witness.hold(level, 0.0)
        super().apply(level)

    def advance(self, dt: float) -> None:
        """As the plant does."""
        self.witness.hold(self.level, dt)
        super().advance(dt)

    def repeat(self, pattern: Pattern, count: int, during: float | None = None) -> None:
        """As the plant does."""
        self.witness.repeat(pattern, count)
        super().repeat(pattern, count, during)


def sequences(bench: Bench) -> st.SearchStrategy[VoltageSequence]:
    """For the driver: the good one with damage, and any others with a sum that is right."""
    good, limits = encode(bench, ACTIVATIONS), (bench.electrical.min_level, bench.electrical.max_level)
    size = len(good.levels)
    damage = st.dictionaries(st.integers(0, size - 1), NUMBERS, max_size=2)

    def arrays(
        levels: list[float], dwells: list[float], ends: list[int], pulses: list[int], lows: list[float]
    ) -> st.SearchStrategy[VoltageSequence]:
        with np.errstate(all="ignore"):
            total = float(np.sum(np.array(dwells, dtype=float)))
        return messages(
            VoltageSequence,
            1,
            plan_id="plan",
            swarm_id=bench.swarm_id,
            levels=levels,
            dwells=dwells,
            epoch_ends=ends,
            duration=total,
            pulses=pulses if any(pulses) else [],
            low_levels=lows if any(pulses) else [],
            duty=st.sampled_from([0.4, 0.5, 0.5, 0.5, 0.9]) if any(pulses) else 0.0,
            alternating=st.just(good.alternating) | st.booleans() if any(pulses) else False,
        )

    def changed(
        levels_damage: dict, dwells_damage: dict, lows_damage: dict, pulses_damage: dict
    ) -> st.SearchStrategy[VoltageSequence]:
        levels, dwells = good.levels.tolist(), good.dwells.tolist()
        pulses, lows = (good.pulses.tolist(), good.low_levels.tolist()) if good.trains.any() else ([0] * size, [0.0] * size)
        edited = (levels, levels_damage), (dwells, dwells_damage), (lows, lows_damage), (pulses, pulses_damage)
        for values, edits in edited:
            for index, value in edits.items():
                values[index] = value
        return arrays(levels, dwells, good.epoch_ends.tolist(), pulses, lows)

    def free(segments: list[tuple[float, float, int, float]], repeats: int) -> st.SearchStrategy[VoltageSequence]:
        segments = segments * max(1, min(repeats, 20_000) // len(segments))
        levels, dwells, pulses, lows = map(list, zip(*segments, strict=True))
        return arrays(levels, dwells, [len(segments)], pulses, lows)

    levels = st.one_of(st.sampled_from([*limits, 40.0, 90.0, 110.0, 140.0]), st.floats(*limits), NUMBERS)
    dwells = st.one_of(st.sampled_from([0.001, 0.01, 1.0]), st.floats(1e-9, 1e4), NUMBERS)
    pulses = st.one_of(st.just(0), st.integers(1, 20_000), st.sampled_from([1, 2, 2**53, 2**53 + 1, 2**64 - 1]))
    segments = st.lists(st.tuples(levels, dwells, pulses, levels), min_size=1, max_size=6)
    odd_pulses = st.dictionaries(st.integers(0, size - 1), pulses, max_size=2)
    return st.one_of(
        st.builds(changed, damage, damage, damage, odd_pulses).flatmap(lambda chosen: chosen),
        st.builds(free, segments, COUNTS).flatmap(lambda chosen: chosen),
    )


def _driven(message: VoltageSequence, make: Callable[[Listener], Backend], look: Callable[[], None]) -> str:
    session = Session(make, lambda: None, lambda _time, _poses: None, now=lambda: 1)

    def run() -> None:
        session.load(sequence_from_message(message))
        session.start(Pacing(real_time_factor=1.0, pose_rate=0.1))
        session.backend._join()
        if session.status().state == State.RUNNING:  # it would go on for a thousand years
            session.stop()

    try:
        result = outcome(run)
        status = session.status()
        if status.state not in (
            (State.DONE, State.STOPPED, State.FAULT) if result == ACCEPTED else (State.IDLE, State.LOADED, State.FAULT)
        ):
            raise Violation(f"{result}, but the driver is in {status.state!r}: {status.error_msg}")
        if status.error_code:
            check_refusal(status.error_code, *status.error_msg.partition(": ")[::2])
            result = status.error_code.name
        look()
    finally:
        session.close()
    return result


def on_substrate(bench: Bench, message: VoltageSequence) -> str:
    """As the driver plays a sequence on the simulated substrate."""
    substrate, clock = WatchedSubstrate(bench), FakeClock()

    def make(listener: Listener) -> Backend:
        return _patient(Watched(bench, clock, listener, substrate=substrate), clock)

    def look() -> None:
        if substrate.witness.level != REST:
            raise Violation(f"{substrate.witness.level} V after the end")

    return _driven(message, make, look)


def on_generator(bench: Bench, message: VoltageSequence) -> str:
    """As the driver plays a sequence by the language of an instrument, which is emulated."""
    clock, witness = FakeClock(), Witness(bench)

    def heard(pattern: list[tuple[float, float]], count: int) -> None:
        witness.repeat([(volts * GAIN, seconds) for volts, seconds in pattern], count)

    emulator = Emulator(clock, lambda volts, seconds: witness.hold(volts * GAIN, seconds), repeated=heard)

    def look() -> None:
        if emulator.volts != 0.0:
            raise Violation(f"{emulator.volts} V on the instrument after the end")

    def make(listener: Listener) -> Backend:
        options = {"visa_resource": "any", "record_folder": str(SCRATCH), **AMPLIFIER}
        backend = WatchedGenerator(bench, clock, listener, options, connect=partial(Loopback, emulator))
        return _patient(backend, clock)

    return _driven(message, make, look)


def _patient(backend: Backend, clock: FakeClock) -> Backend:
    """Break off what takes longer than PATIENCE."""
    clock.at(PATIENCE, backend._halt.set)
    return backend


class _Watching:
    """Tells the caller of unsafe volts, whatever thread they came on."""

    unsafe: _Unsafe | None = None

    def _run(self, *arguments: object) -> None:
        try:
            super()._run(*arguments)
        except _Unsafe as error:
            self.unsafe = error

    def _join(self) -> None:
        super()._join()
        if self.unsafe is not None:
            raise Violation(str(self.unsafe))


class Watched(_Watching, SimulatedBackend):
    """The simulated backend, watched."""


class WatchedGenerator(_Watching, WaveformGeneratorBackend):
    """The backend for instruments, watched."""


INTERFACES = tuple(
    Interface(f"voltage_sequence, {name}, {where}", sequences(bench), partial(attempt, bench), weight)
    for name, bench in BENCHES.items()
    for where, attempt, weight in (("simulated substrate", on_substrate, 2), ("waveform generator", on_generator, 1))
)


def good_message(bench: Bench) -> VoltageSequence:
    """Return a sequence that must run."""
    good = encode(bench, ACTIVATIONS, "good")
    return VoltageSequence(
        plan_id=good.plan_id,
        swarm_id=bench.swarm_id,
        levels=array("d", good.levels),
        dwells=array("d", good.dwells),
        epoch_ends=array("I", good.epoch_ends.tolist()),
        duration=good.duration,
        pulses=array("Q", good.pulses.tolist()),
        low_levels=array("d", good.low_levels),
        duty=good.duty,
        alternating=good.alternating,
    )
