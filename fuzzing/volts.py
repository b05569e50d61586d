"""Volts: sequences at the driver's gate, and all that gets past it, on both backends."""

import math
from array import array
from collections.abc import Callable
from functools import partial

import numpy as np
from driver_support import FakeClock, encode
from hypothesis import strategies as st
from instrument_support import AMPLIFIER, GAIN
from stressbot_msgs.msg import VoltageSequence

from fuzzing.instruments import SCRATCH, Loopback
from fuzzing.interface import ACCEPTED, Interface, Violation, check_refusal, outcome
from fuzzing.orders import BENCH
from fuzzing.strategies import COUNTS, NUMBERS, messages
from stressbot_driver.backends.base import Backend, Pacing
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.instruments.emulator import Emulator
from stressbot_driver.ros.conversions import sequence_from_message
from stressbot_driver.session import Session, State
from stressbot_driver.simulation.substrate import Substrate

LOW, HIGH = BENCH.electrical.min_level, BENCH.electrical.max_level
PATIENCE = 100.0
"""s of the substrate."""

REST = BENCH.electrical.rest_level
GOOD = encode(BENCH, [(1, 0.5), (4, 0.25), (2, 1.0)])


class Witness:
    """Hears every volt on the substrate, and for how long."""

    def __init__(self) -> None:
        self.level = REST
        self.seconds = 0.0

    def hold(self, level: float, seconds: float) -> None:
        """Note that the substrate is at `level` for some time.

        Raises:
            Violation: beyond the limits of the bench.
        """
        if not LOW - 1e-9 <= level <= HIGH + 1e-9:
            raise _Unsafe(f"{level!r} V on the substrate, the limits are {LOW:g} V to {HIGH:g} V")
        if not (seconds >= 0.0 and math.isfinite(seconds)):
            raise _Unsafe(f"a level for {seconds!r} s")
        self.level, self.seconds = level, self.seconds + seconds


class _Unsafe(BaseException):
    """Not an Exception: backends report those, and go on."""


class WatchedSubstrate(Substrate):
    """The simulated one, with a witness."""

    def __init__(self) -> None:
        self.witness = Witness()
        super().__init__(BENCH)

    def apply(self, level: float) -> None:
        """As the plant does."""
        self.witness.hold(level, 0.0)
        super().apply(level)

    def advance(self, dt: float) -> None:
        """As the plant does."""
        self.witness.hold(self.level, dt)
        super().advance(dt)


def sequences() -> st.SearchStrategy[VoltageSequence]:
    """For the driver: the good one with damage, and any others with a sum that is right."""
    size = len(GOOD.levels)
    damage = st.dictionaries(st.integers(0, size - 1), NUMBERS, max_size=2)

    def arrays(levels: list[float], dwells: list[float], ends: list[int]) -> st.SearchStrategy[VoltageSequence]:
        with np.errstate(all="ignore"):
            total = float(np.sum(np.array(dwells, dtype=float)))
        return messages(
            VoltageSequence,
            1,
            plan_id="plan",
            swarm_id=BENCH.swarm_id,
            levels=levels,
            dwells=dwells,
            epoch_ends=ends,
            duration=total,
        )

    def changed(level_damage: dict, dwell_damage: dict) -> st.SearchStrategy[VoltageSequence]:
        levels, dwells = GOOD.levels.tolist(), GOOD.dwells.tolist()
        for values, edits in ((levels, level_damage), (dwells, dwell_damage)):
            for index, value in edits.items():
                values[index] = value
        return arrays(levels, dwells, GOOD.epoch_ends.tolist())

    def free(pairs: list[tuple[float, float]], repeats: int) -> st.SearchStrategy[VoltageSequence]:
        pairs = pairs * max(1, min(repeats, 20_000) // len(pairs))
        return arrays([level for level, _ in pairs], [dwell for _, dwell in pairs], [len(pairs)])

    levels = st.one_of(st.sampled_from([LOW, HIGH, 40.0, 90.0, 140.0]), st.floats(LOW, HIGH), NUMBERS)
    dwells = st.one_of(st.sampled_from([0.001, 0.01, 1.0]), st.floats(1e-9, 1e4), NUMBERS)
    return st.one_of(
        st.builds(changed, damage, damage).flatmap(lambda chosen: chosen),
        st.builds(free, st.lists(st.tuples(levels, dwells), min_size=1, max_size=6), COUNTS).flatmap(lambda chosen: chosen),
    )


def _driven(message: VoltageSequence, make: Callable[[Session], tuple[Backend, Callable[[], None]]]) -> str:
    session = Session(lambda: None, lambda _time, _poses: None, now=lambda: 1)
    backend, look = make(session)
    session.attach(backend)

    def run() -> None:
        session.load(sequence_from_message(message))
        session.start(Pacing(real_time_factor=1.0, pose_rate=0.1))
        backend._join()
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


def on_substrate(message: VoltageSequence) -> str:
    """As the driver plays a sequence on the simulated substrate."""
    substrate, clock = WatchedSubstrate(), FakeClock()

    def make(session: Session) -> tuple[Backend, Callable[[], None]]:
        return _patient(Watched(BENCH, clock, session, substrate=substrate), clock), look

    def look() -> None:
        if substrate.witness.level != REST:
            raise Violation(f"{substrate.witness.level} V after the end")

    return _driven(message, make)


def on_generator(message: VoltageSequence) -> str:
    """As the driver plays a sequence by the language of an instrument, which is emulated."""
    clock, witness = FakeClock(), Witness()
    emulator = Emulator(clock, lambda volts, seconds: witness.hold(volts * GAIN, seconds))

    def look() -> None:
        if emulator.volts != 0.0:
            raise Violation(f"{emulator.volts} V on the instrument after the end")

    def make(session: Session) -> tuple[Backend, Callable[[], None]]:
        options = {"visa_resource": "any", "record_folder": str(SCRATCH), **AMPLIFIER}
        backend = WatchedGenerator(BENCH, clock, session, options, connect=partial(Loopback, emulator))
        return _patient(backend, clock), look

    return _driven(message, make)


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


INTERFACES = (
    Interface("voltage_sequence, simulated substrate", sequences(), on_substrate, 6),
    Interface("voltage_sequence, waveform generator", sequences(), on_generator, 3),
)


def good_message() -> VoltageSequence:
    """Return a sequence that must run."""
    return VoltageSequence(
        plan_id="good",
        swarm_id=BENCH.swarm_id,
        levels=array("d", GOOD.levels),
        dwells=array("d", GOOD.dwells),
        epoch_ends=array("I", GOOD.epoch_ends.tolist()),
        duration=GOOD.duration,
    )
