"""The simulated substrate behind the same interface as an instrument."""

import math
import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stressbot_driver.backends.base import Listener, Pacing, Progress
from stressbot_driver.backends.playback import PlaybackBackend
from stressbot_driver.bench import Bench
from stressbot_driver.clock import Clock
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import Limits, Train, VoltageSequence
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Poses, Substrate
from stressbot_driver.simulation.tracker import Tracker

# Playback that is this late [s of wall time] (the process was frozen) goes on from there instead of rushing after.
SLIP = 0.25
CHUNK = 4096  # segments


class SimulatedBackend(PlaybackBackend):
    """Plays a sequence on a `Substrate`, segment by segment, on a thread paced by the injected clock.

    The substrate lives in exact sequence time: pacing decides when a level is applied, never how long it lasts.
    """

    def __init__(
        self,
        bench: Bench,
        clock: Clock,
        listener: Listener,
        options: Mapping[str, Any] | None = None,
        substrate: Substrate | None = None,
    ) -> None:
        super().__init__(bench, clock, listener, options)
        self._substrate = substrate or Substrate(bench)
        self._tracker: Tracker | None = None
        self._rest = bench.electrical.rest_level
        self._sequence: VoltageSequence | None = None
        self._progress = Progress(level=self._rest)
        self._substrate.apply(self._rest)

    @property
    def limits(self) -> Limits:
        electrical = self.bench.electrical
        return Limits(min_level=electrical.min_level, max_level=electrical.max_level)

    def upload(self, sequence: VoltageSequence) -> None:
        self._refuse_while_running("upload")
        self._sequence = sequence
        self._progress = Progress(level=self._rest)

    def start(self, pacing: Pacing) -> None:
        self._refuse_while_running("start")
        if self._sequence is None:
            raise StressbotError(ErrorCode.NOTHING_LOADED, "start", "no sequence was uploaded: upload one first")
        sequence, self._sequence = self._sequence, None
        self._begin(self._run, sequence, pacing)

    def stop(self) -> None:
        self._stop_playing()
        self._join()

    def reset(self) -> None:
        self._refuse_while_running("reset")
        self._sequence = None
        self._substrate.reset()
        self._progress = Progress(level=self._rest)

    def close(self) -> None:
        self.stop()
        self._sequence = None

    def progress(self) -> Progress:
        return self._progress

    def poses(self) -> Poses | None:
        poses = self._substrate.poses()
        return poses if self._tracker is None else self._tracker.measure(poses)

    def impair(self, imperfections: Imperfections) -> None:
        """As `Backend.impair`; raises BUSY as well."""
        self._refuse_while_running("imperfections")
        self._substrate.impair(imperfections)
        self._tracker = None if imperfections.is_ideal else Tracker(imperfections)

    def _run(self, sequence: VoltageSequence, pacing: Pacing) -> None:
        failure = None
        completed = False
        try:
            completed = self._play(sequence, pacing)
        except Exception as error:  # whatever it was, the volts come first and the report second
            failure = StressbotError(ErrorCode.BACKEND_FAILURE, "backend", f"playback broke off ({error!r}): call reset")
        finally:
            self._substrate.apply(self._rest)
            self._set_progress(level=self._rest)
        try:
            if failure is None:
                self._tell(self._progress.time, self._substrate.poses(), at_rest=True)
        except Exception as error:
            failure = StressbotError(ErrorCode.BACKEND_FAILURE, "backend", f"poses were not taken ({error!r}): call reset")
        self._playing = False
        if failure is not None:
            self.listener.failed(failure)
        elif completed:
            self.listener.finished()

    def _play(self, sequence: VoltageSequence, pacing: Pacing) -> bool:
        """Play to the end (True) or until halted (False)."""
        factor = pacing.real_time_factor
        paced = _Paced(self.clock, self._halt, factor)
        samples = _Samples(self.clock, pacing)
        epoch, begin = 0, 0.0
        for level, dwell, end, last_of_epoch, train in _segments(sequence):
            if self._halt.is_set():
                return False
            stretch = self._hold(level) if train is None else _Pulsing(self._substrate, train)
            self._progress = Progress(time=begin, epoch=epoch, level=level)
            while samples.next_time < end and factor > 0.0:
                if paced.wait(samples.next_time):
                    break
                self._report(samples, samples.next_time, stretch.poses(samples.next_time - begin))
            if paced.wait(end):
                # Stopped within the segment: the robots moved for as long as it lasted.
                elapsed = min(max(paced.sequence_time() - begin, 0.0), dwell) if factor > 0.0 else 0.0
                stretch.advance(elapsed)
                self._set_progress(time=begin + elapsed)
                return False
            stretch.advance(dwell)
            begin = end
            if last_of_epoch:
                epoch += 1
                if samples.due:
                    self._report(samples, end, self._substrate.poses())
            self._progress = Progress(time=end, epoch=epoch, level=level)
        return True

    def _hold(self, level: float) -> Substrate:
        self._substrate.apply(level)
        return self._substrate

    def _report(self, samples: "_Samples", time: float, poses: Poses) -> None:
        self._set_progress(time=time)
        self._tell(time, poses)
        samples.taken(time)

    def _tell(self, time: float, poses: Poses, at_rest: bool = False) -> None:
        """Report the poses at `time` as the tracker sees them; at rest nothing is held back, since nobody moves any more."""
        if self._tracker is None:
            self.listener.poses_measured(time, poses)
            return
        known = self._tracker.report(time, poses) + (self._tracker.rest() if at_rest else [])
        for measured in known:
            self.listener.poses_measured(*measured)

    def _set_progress(self, **changes: float) -> None:
        self._progress = replace(self._progress, **changes)


class _Pulsing:
    """A train on a substrate, in the place of a level that it holds."""

    def __init__(self, substrate: Substrate, train: Train) -> None:
        self._substrate, self._train = substrate, train

    def poses(self, after: float) -> Poses:
        """Poses `after` seconds of the train."""
        return self._substrate.poses_during(self._train.pattern, self._train.repeats, after)

    def advance(self, dt: float) -> None:
        """Put `dt` [s] of the train on the electrodes."""
        self._substrate.repeat(self._train.pattern, self._train.repeats, dt)


def _segments(sequence: VoltageSequence) -> Iterator[tuple[float, float, float, bool, Train | None]]:
    """Level [V], dwell [s], end [s] of each segment, whether an epoch ends with it, and its train; some at a time."""
    begin, epoch = 0.0, 0
    for first in range(0, len(sequence.levels), CHUNK):
        dwells = sequence.dwells[first : first + CHUNK]
        ends = np.cumsum(np.concatenate([[begin], dwells]))[1:]  # the same sums as of all at once
        last = np.zeros(len(dwells), dtype=bool)
        until = int(np.searchsorted(sequence.epoch_ends, first + len(dwells), side="right"))
        last[sequence.epoch_ends[epoch:until] - first - 1] = True
        trains = [sequence.train(k) for k in range(first, first + len(dwells))] if len(sequence.pulses) else [None] * len(dwells)
        levels = sequence.levels[first : first + CHUNK].tolist()
        yield from zip(levels, dwells.tolist(), ends.tolist(), last.tolist(), trains, strict=True)
        begin, epoch = float(ends[-1]), until


class _Paced:
    """Sequence time against the wall clock; with factor 0 it never waits."""

    def __init__(self, clock: Clock, halt: threading.Event, factor: float) -> None:
        self._clock, self._halt, self._factor = clock, halt, factor
        self._origin = clock.now()

    def wait(self, time: float) -> bool:
        """Wait for sequence time `time` [s]; True if halted before."""
        if self._factor <= 0.0:
            return self._halt.is_set()
        deadline = self._origin + time / self._factor
        late = self._clock.now() - deadline
        if late > SLIP:
            self._origin += late
        return self._clock.wait_until(deadline, self._halt)

    def sequence_time(self) -> float:
        return (self._clock.now() - self._origin) * self._factor


class _Samples:
    """When poses are reported: at `pose_rate` in wall time, and at the ends of epochs unless one was just reported."""

    def __init__(self, clock: Clock, pacing: Pacing) -> None:
        self._clock = clock
        self._period = 1.0 / pacing.pose_rate
        # In sequence time, so that paced samples lie at exact moments whatever the wall clock does.
        self._interval = self._period * pacing.real_time_factor if pacing.real_time_factor > 0.0 else math.inf
        self._count = 1
        self._last = -math.inf

    @property
    def next_time(self) -> float:
        """[s] sequence time of the next paced sample."""
        return self._interval * self._count

    @property
    def due(self) -> bool:
        """Whether an extra sample at the end of an epoch would not flood the readers."""
        return self._clock.now() - self._last >= 0.5 * self._period

    def taken(self, time: float) -> None:
        self._last = self._clock.now()
        if time >= self.next_time:
            self._count += 1
