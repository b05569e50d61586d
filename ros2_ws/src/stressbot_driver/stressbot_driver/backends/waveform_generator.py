"""A waveform generator and an amplifier in front of the substrate. Not yet tried on a physical instrument."""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stressbot_driver.backends.base import Listener, Pacing, Progress
from stressbot_driver.backends.playback import PlaybackBackend
from stressbot_driver.bench import Bench
from stressbot_driver.clock import Clock
from stressbot_driver.declaration import Declaration
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.instruments.generator import Generator, inward
from stressbot_driver.instruments.program import Block, Load, compile_sequence, exact_rate
from stressbot_driver.instruments.recorder import Recorder, log_folder
from stressbot_driver.instruments.transport import Transport
from stressbot_driver.instruments.transport import connect as connect_to
from stressbot_driver.sequence import Limits, VoltageSequence

WATCH = 0.05  # [s] between looks at the output
# A block counts as over when this much more than its duration has passed by the computer's clock: the two clocks differ by
# less, and a trigger that comes before the generator waits for it would be lost.
CLOCK_DIFFERENCE = 1e-4
SLACK = 0.002  # [s]


class WaveformGeneratorBackend(PlaybackBackend):
    """Plays sequences by the generator's sample clock, one block (an epoch, or a part of one) a trigger, at rest in between.

    If this process dies, the block that runs ends at rest, where the generator waits for a trigger that does not come.
    Sees no robots: poses come from a tracker.
    """

    RESOURCE = "visa_resource"
    NOTICE = "the waveform_generator backend has NOT YET BEEN TRIED ON A PHYSICAL INSTRUMENT: see docs/instruments.md"
    OPTIONS = (
        Declaration("visa_resource", "", "VISA address, such as TCPIP0::192.168.1.5::5025::SOCKET. Required.", read_only=True),
        Declaration("channel", 1, "Output of the generator.", low=1, high=2, read_only=True),
        Declaration(
            "sample_rate", 50e6, "[samples/s] At most. Edges are exact to half a sample, of pulses wholly.", low=1e3, high=1e9,
            read_only=True,
        ),
        Declaration("amplifier_gain", 0.0, "[V/V] Substrate per generator. Required.", low=0.0, high=1e6, read_only=True),
        Declaration("amplifier_max_voltage", 0.0, "[V] Largest output, either sign. Required.", low=0.0, high=1e6, read_only=True),
        Declaration("amplifier_slew_rate", 0.0, "[V/s] 0: faster than matters.", low=0.0, high=1e15, read_only=True),
        Declaration("amplifier_bandwidth", 0.0, "[Hz] Fastest pulses; 0: faster than matters.", low=0.0, high=1e9, read_only=True),
        Declaration("amplifier_max_power", 0.0, "[W] Into the load; 0: more than matters.", low=0.0, high=1e6, read_only=True),
        Declaration("load_capacitance", 0.0, "[F] Of substrate and cables.", low=0.0, high=1.0, read_only=True),
        Declaration(
            "max_block", 10.0, "[s] Longest time without a trigger; longer drives are cut.", low=0.1, high=3600.0, read_only=True
        ),
        Declaration(
            "timeout", 2.0, "[s] Longest exchange with the instrument; it is lost, in FAULT, after that.", low=0.1, high=60.0,
            read_only=True,
        ),
        Declaration("record_folder", "", "Where the record of all that was sent goes; empty: ROS's log folder.", read_only=True),
    )

    def __init__(
        self,
        bench: Bench,
        clock: Clock,
        listener: Listener,
        options: Mapping[str, Any] | None = None,
        connect: Callable[[], Transport] | None = None,
        watch: float = WATCH,
    ) -> None:
        """`watch` [s] between looks at the output; 0: none."""
        super().__init__(bench, clock, listener, options)
        self._check_options()
        self._gain = float(self.options["amplifier_gain"])
        self._rate = float(self.options["sample_rate"])
        folder = Path(self.options["record_folder"]) if self.options["record_folder"] else log_folder()
        connect = connect or partial(connect_to, self.options["visa_resource"], float(self.options["timeout"]))
        self._connect = lambda: Generator(connect, Recorder(folder), self.options["channel"])
        self._played = _Played(bench.electrical.rest_level)
        self._loads: list[Load] = []
        self._attending = threading.Lock()  # held while the connections may change
        self._seen: StressbotError | None = None  # what a look at the output has found
        self._closed = threading.Event()
        self._generator = self._connect()
        try:
            self._set_up()
        except BaseException:
            self.close()
            raise
        if watch:
            threading.Thread(target=self._watch, args=(watch,), name="watch", daemon=True).start()

    @property
    def limits(self) -> Limits:
        return self._limits

    def upload(self, sequence: VoltageSequence) -> None:
        self._refuse_while_running("upload")
        electrical = self.bench.electrical
        drive_above, max_block = float(electrical.thresholds[-1]), float(self.options["max_block"])
        rate = exact_rate(sequence, self._rate)
        loads = compile_sequence(sequence, electrical.rest_level, rate, self._scale, self._capacity, drive_above, max_block)
        self._generator.load(loads[0])
        self._loads = loads
        self._played = _Played(self.bench.electrical.rest_level, sequence)

    def start(self, pacing: Pacing) -> None:
        self._refuse_while_running("start")
        if not self._loads:
            raise StressbotError(ErrorCode.NOTHING_LOADED, "start", "no sequence was uploaded: upload one first")
        if pacing.real_time_factor != 1.0:
            message = f"is {pacing.real_time_factor:g}: a generator plays in real time, set it to 1"
            raise StressbotError(ErrorCode.UNSUPPORTED, "real_time_factor", message)
        loads, self._loads = self._loads, []
        self._begin(self._run, loads)

    def stop(self) -> None:
        self._stop_playing()
        try:
            self._generator.off()
        finally:
            # What is switched on or triggered behind the back of `off` is at rest, and the thread that did it switches off too.
            self._join()

    def reset(self) -> None:
        """Forget the sequence and set the instrument up anew, over a new connection. The robots stay where they are."""
        self._refuse_while_running("reset")
        self._loads = []
        self._generator.off()
        with self._attending:
            self._generator.close()
            self._generator = self._connect()
            self._set_up()
            self._seen = None
        self._played = _Played(self.bench.electrical.rest_level)

    def close(self) -> None:
        self._closed.set()
        try:
            self.stop()
        finally:
            with self._attending:
                self._generator.close()

    def progress(self) -> Progress:
        return self._played.progress(self.clock.now())

    def _check_options(self) -> None:
        hints = {
            "visa_resource": "TCPIP0::<address>::5025::SOCKET",
            "amplifier_gain": "the amplifier's gain in V/V",
            "amplifier_max_voltage": "the amplifier's largest output in V",
        }
        for name, hint in hints.items():
            if not self.options[name]:
                raise StressbotError(ErrorCode.MISSING_FIELD, f"waveform_generator.{name}", f"is not set: give {hint}")
        if self.bench.electrical.rest_level != 0.0:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                "electrical.rest_level",
                f"is {self.bench.electrical.rest_level:g} V: an output that is switched off is at 0 V, make rest 0 V",
            )

    def _set_up(self) -> None:
        """Output off, and find out what generator, amplifier and bench allow together."""
        self._generator.set_up()
        if self._rate > (fastest := self._generator.rate_max()):
            raise StressbotError(
                ErrorCode.LIMIT_EXCEEDED,
                "waveform_generator.sample_rate",
                f"is {self._rate:g}: {self._generator.identity} takes at most {fastest:g} samples/s",
            )
        electrical = self.bench.electrical
        reach = min(float(self.options["amplifier_max_voltage"]), self._gain * self._generator.volts_max())
        low, high = inward(max(electrical.min_level, -reach) / self._gain, min(electrical.max_level, reach) / self._gain)
        if not low <= 0.0 < high:
            raise StressbotError(
                ErrorCode.LIMIT_EXCEEDED,
                "waveform_generator.amplifier_gain",
                f"is {self._gain:g} V/V: that leaves {low:g} V to {high:g} V of the generator, without rest or without volts",
            )
        self._scale = self._generator.scale(low, high, self._gain)
        self._capacity = self._generator.capacity()
        self._limits = Limits(
            min_level=low * self._gain,
            max_level=high * self._gain,
            min_dwell=(self._capacity.min_points + 1) / self._rate,
            max_slew_rate=float(self.options["amplifier_slew_rate"]) or math.inf,
            max_frequency=float(self.options["amplifier_bandwidth"]) or math.inf,
            capacitance=float(self.options["load_capacitance"]),
            max_power=float(self.options["amplifier_max_power"]) or math.inf,
        )

    def _watch(self, period: float) -> None:
        """Look whether the instrument is there, and whether its output is off while nothing is played."""
        while not self._closed.wait(period):
            with self._attending:
                if self._seen is not None or self._closed.is_set():
                    continue
                playing, seen = self._playing, None
                try:
                    if not self._generator.is_off() and not playing and not self._playing:
                        seen = "the output was on though nothing is played: somebody else has switched it on; call reset"
                except StressbotError as error:
                    seen = error.message
                if seen is None:
                    continue
                self._seen = StressbotError(ErrorCode.BACKEND_FAILURE, "instrument", seen)
            if self._playing:
                self._stop_playing()  # the thread that plays switches off and tells
                continue
            try:
                self._generator.off()
            except StressbotError as error:
                self._seen = error
            self.listener.failed(self._seen)

    def _run(self, loads: list[Load]) -> None:
        completed, failure = False, None
        try:
            completed = self._play(loads)
        except Exception as error:
            failure = error
        try:
            self._generator.off()
        except StressbotError as error:
            failure = error  # the graver of the two
        self._played.end(self.clock.now())
        self._playing = False
        failure = failure or self._seen
        if failure is not None and not isinstance(failure, StressbotError):
            failure = StressbotError(ErrorCode.BACKEND_FAILURE, "backend", f"playback broke off ({failure!r}): call reset")
        if failure is not None:
            self.listener.failed(failure)
        elif completed:
            self.listener.finished()

    def _play(self, loads: list[Load]) -> bool:
        """Play to the end (True) or until halted (False)."""
        for index, load in enumerate(loads):
            if index:
                self._generator.load(load)
            if self._halt.is_set():
                return False
            self._generator.arm(load.rate)
            for number, block in enumerate(load.blocks):
                if self._halt.is_set():
                    return False
                if number:
                    self._generator.verify()
                self._generator.trigger()
                self._played.begin(block, self.clock.now())
                over = self.clock.now() + block.duration * (1.0 + CLOCK_DIFFERENCE) + SLACK
                if self.clock.wait_until(over, self._halt):
                    return False
                self._played.finish(block)
        return True


class _Played:
    """Where playback stands, by the computer's clock."""

    def __init__(self, rest_level: float, sequence: VoltageSequence | None = None) -> None:
        self._rest_level = rest_level
        self._levels = sequence.levels if sequence else np.zeros(0)
        self._ends = np.cumsum(sequence.dwells) if sequence else np.zeros(0)
        self._running: tuple[Block, float] | None = None
        self._done = Progress(level=rest_level)

    def begin(self, block: Block, now: float) -> None:
        self._running = (block, now)

    def finish(self, block: Block) -> None:
        self._done = Progress(time=block.begin + block.duration, epoch=self._done.epoch + block.epochs, level=self._rest_level)
        self._running = None

    def end(self, now: float) -> None:
        """The output is off; time stands where it stopped."""
        self._done = replace(self.progress(now), level=self._rest_level)
        self._running = None

    def progress(self, now: float) -> Progress:
        running = self._running
        if running is None:
            return self._done
        block, began = running
        elapsed = min(now - began, block.duration)
        time = block.begin + elapsed
        if elapsed >= block.duration:
            return Progress(time=time, epoch=self._done.epoch, level=self._rest_level)
        index = min(int(np.searchsorted(self._ends, time, side="right")), len(self._ends) - 1)
        return Progress(time=time, epoch=self._done.epoch, level=float(self._levels[index]))
