"""The gate itself: a backend, and the rule that its output is at rest unless somebody keeps saying that all is well.

The main thread reads beats and stops and waits for nothing else; a second one does what is asked for; the backend plays on its own.
Whatever comes to an end ends at rest: silence (latched until a reset), a closed socket, and a message that is none, after which
the gate itself ends as soon as the output is at rest.
"""

import os
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from stressbot_driver.backends.base import Backend, Listener, Pacing
from stressbot_driver.drive import check_drive
from stressbot_driver.errors import ErrorCode, StressbotError, as_failure
from stressbot_driver.gate import memory, protocol
from stressbot_driver.gate.hardening import PLAYING, real_time
from stressbot_driver.gate.protocol import BadMessageError, Kind, Outcome, PosesReport, Request, Word
from stressbot_driver.sequence import check_sequence
from stressbot_driver.simulation.substrate import Poses

PATIENCE = 30.0
"""[s] for which a gate without a driver goes on trying to bring its output to rest."""

AGAIN = 0.1  # [s] between such tries
LATE = 0.001  # [s] a timer that ends too early would find nothing to do
MEET = 1.0  # [s] a start waits for so long for a beat


@dataclass(frozen=True)
class Sockets:
    """The gate's ends."""

    beats: socket.socket
    stops: socket.socket
    requests: socket.socket
    reports: socket.socket


@dataclass(frozen=True)
class Opening:
    """What a request OPEN asks for, once it has been read."""

    make: Callable[[Listener], Backend]
    timeout: float  # [s] of silence before the output goes to rest
    robots: int
    notes: list[str]  # for the driver's log; `make` may add some


@dataclass(frozen=True)
class Output:
    """The backend that the driver has asked for, and where its poses go."""

    backend: Backend
    ring: memory.Ring


class Gate:
    """Serves one driver until that is gone.

    Attributes:
        output: None until the driver has asked for it.
    """

    def __init__(
        self, sockets: Sockets, read_opening: Callable[[int], Opening], now: Callable[[], float] = time.monotonic
    ) -> None:
        """`read_opening` reads the memory that comes with OPEN."""
        self.output: Output | None = None
        self._sockets = sockets
        self._read_opening = read_opening
        self._now = now
        self._timeout = 0.0  # [s]
        self._last_beat = now()  # [s] when the newest beat was sent
        self._beats = self._stops = self._requests = 0  # numbers of the last messages
        self._lock = threading.Lock()  # guards the word and the run; never held while the backend is called
        self._reporting = threading.Lock()  # one report at a time
        self._word = Word()
        self._latched: StressbotError | None = None
        self._unrested: StressbotError | None = None  # why the output may not be at rest
        self._ending = False
        self._rests = 0  # how often the output was told to rest
        self._worker = threading.Thread(target=self._work, name="requests", daemon=True)

    def run(self) -> None:
        """Serve until the driver is gone; then bring the output to rest and let go of it."""
        self._worker.start()
        try:
            self._serve()
        except BadMessageError as error:
            self._latch(StressbotError(ErrorCode.INTERNAL, "gate", f"it was sent {error}, and ended at rest: call reset"))
        finally:
            self._end()

    # Beats and stops, on the main thread

    def _serve(self) -> None:
        beats, stops = self._sockets.beats, self._sockets.stops
        poll = select.poll()
        for connection in (beats, stops):
            connection.setblocking(False)
            poll.register(connection, select.POLLIN)
        while not self._ending:
            poll.poll(1e3 * self._wait())
            # Stops first. Both are looked at whatever has woken us: what has come meanwhile counts.
            if not self._read_stops(stops) or not self._read_beats(beats):
                return
            if self._playing and (silent := self._now() - self._last_beat) > self._timeout:
                self._latch(
                    StressbotError(
                        ErrorCode.NO_HEARTBEAT,
                        "gate",
                        f"the driver showed no life for {1e3 * silent:.0f} ms (frozen, overloaded or blocked), and gate_timeout is "
                        f"{1e3 * self._timeout:g} ms: see to the machine's load, then call reset",
                    )
                )

            elif self._unrested is not None:
                self._rest()

    def _wait(self) -> float:
        """[s] until there is something to see to, if nothing comes. Never for ever: a run may begin while we wait."""
        if self._unrested is not None:
            return AGAIN
        if not self._playing:
            return self._timeout or AGAIN
        return max(self._last_beat + self._timeout - self._now(), 0.0) + LATE

    def _read_stops(self, stops: socket.socket) -> bool:
        """False if the driver is gone."""
        while True:
            try:
                message = protocol.receive(stops)
            except BlockingIOError:
                return True
            if not message:
                return False
            self._stops = _next(self._stops, protocol.unpack_stop(message))
            failure = self._rest()
            if failure is None:
                self._set(Outcome.RESTED, only_from=Outcome.PLAYING)
            self._send(stops, self._say(self._stops).answering(failure))

    def _read_beats(self, beats: socket.socket) -> bool:
        """False if the driver is gone."""
        while True:
            try:
                message = protocol.receive(beats)
            except BlockingIOError:
                return True
            if not message:
                return False
            beat = protocol.unpack_beat(message)
            self._beats = _next(self._beats, beat.number)
            self._last_beat = max(self._last_beat, beat.time)
            self._send(beats, self._say(self._beats))

    def _latch(self, error: StressbotError) -> None:
        """Rest for a reason that stays until a reset."""
        self._latched = error
        self._fail(self._rest() or error)

    def _rest(self) -> StressbotError | None:
        """Bring the output to rest; return why it may not be, which is then tried again and again."""
        failure = None
        self._rests += 1  # first, so that a start that is under way sees it
        try:
            if self.output is not None:
                self.output.backend.stop()
        except Exception as cause:
            failure = as_failure(cause)
        self._unrested = failure
        return failure

    def _end(self) -> None:
        """At rest, and nothing held. Never raises."""
        self._ending = True
        limit = self._now() + PATIENCE
        with suppress(OSError):
            self._sockets.requests.shutdown(socket.SHUT_RDWR)
        while self._rest() and self._now() < limit:
            time.sleep(AGAIN)
        self._worker.join(max(limit - self._now(), 0.0))
        if self.output is not None:
            with suppress(Exception):
                self.output.backend.close()  # which rests again, for a start that was under way
        for connection in vars(self._sockets).values():
            connection.close()

    # Requests, on the second thread

    def _work(self) -> None:
        requests = self._sockets.requests
        try:
            while not self._ending:
                message, descriptors, _, _ = socket.recv_fds(requests, protocol.ROOM, max(protocol.MEMORIES.values()) + 1)
                try:
                    if not message:
                        return
                    request = protocol.unpack_request(message)
                    self._requests = _next(self._requests, request.number)
                    if len(descriptors) != protocol.MEMORIES[request.kind]:
                        raise BadMessageError(f"{len(descriptors)} file descriptors with a request {request.kind.name}")
                    answer = self._answer(request, descriptors)
                finally:
                    for descriptor in descriptors:
                        os.close(descriptor)
                requests.send(protocol.pack_word(answer))
        except BadMessageError as error:
            self._latch(StressbotError(ErrorCode.INTERNAL, "gate", f"it was sent {error}, and ended at rest: call reset"))
        except OSError:
            pass  # the driver is gone, as the main thread sees too
        finally:
            self._ending = True
            with suppress(OSError):  # wakes the main thread
                self._sockets.beats.shutdown(socket.SHUT_RDWR)

    def _answer(self, request: Request, descriptors: list[int]) -> Word:
        error, changes = None, {}
        try:
            if request.kind == Kind.OPEN:
                changes = self._open(*descriptors)
            elif self.output is None:
                raise BadMessageError(f"a request {request.kind.name} before OPEN")
            else:
                changes = self._do(self.output, request, descriptors) or {}
        except BadMessageError:
            raise
        except Exception as cause:
            error = as_failure(cause)
        return replace(self._say(request.number).answering(error), **changes)

    def _open(self, configuration: int, poses: int) -> dict[str, str]:
        if self.output is not None:
            raise BadMessageError("a second request OPEN")
        opening = self._read_opening(configuration)
        ring = memory.Ring(opening.robots, poses)
        self._timeout = opening.timeout
        backend = opening.make(_Reports(self, ring))
        self._set(Outcome.NONE, limits=backend.limits)
        self.output = Output(backend, ring)
        return {"text": "; ".join(opening.notes)}

    def _do(self, output: Output, request: Request, descriptors: list[int]) -> dict[str, bool] | None:
        backend, kind = output.backend, request.kind
        if kind == Kind.LOOK:
            poses = backend.poses()
            if poses is not None:
                output.ring.put_aside(poses)
            return {"seen": poses is not None}
        if kind == Kind.RESET:
            backend.reset()
            self._latched = None
            self._set(Outcome.NONE, limits=backend.limits)
        elif self._latched is not None:
            raise self._latched
        elif kind == Kind.UPLOAD:
            sequence = memory.read_sequence(*descriptors)
            check_sequence(sequence, backend.bench.swarm_id, self._word.limits)
            check_drive(sequence, backend.bench.electrical)
            backend.upload(sequence)
        elif kind == Kind.START:
            rests = self._rests
            self._meet()
            self._set(Outcome.PLAYING, run=request.number)
            # For the thread that plays. At more than its own pace it may need all of a processor, which others need too.
            real_time(PLAYING if 0.0 < request.real_time_factor <= 1.0 else 0)
            try:
                backend.start(Pacing(request.real_time_factor, request.pose_rate))
            except BaseException:
                self._rest()
                self._set(Outcome.RESTED, only_from=Outcome.PLAYING)
                raise
            if self._rests != rests or self._ending:  # a stop or a loss since; what rested then may have come too early
                self._rest()
                self._set(Outcome.RESTED, only_from=Outcome.PLAYING)
        elif kind == Kind.IMPAIR:
            backend.impair(memory.read_object(*descriptors))
        return None

    def _meet(self) -> None:
        """Wait for a beat: the driver may just have been busy with a large sequence. Raises StressbotError NO_HEARTBEAT."""
        limit = self._now() + MEET
        while self._now() - self._last_beat > 0.5 * self._timeout:
            if self._now() > limit:
                raise StressbotError(
                    ErrorCode.NO_HEARTBEAT, "gate", f"the driver has shown no life for {MEET:g} s: see to its load, start again"
                )
            time.sleep(LATE)

    # What the backend reports, on its own thread

    def tell_poses(self, ring: memory.Ring, time: float, poses: Poses) -> None:
        """Poses at sequence time `time` [s] are for the driver."""
        with self._reporting:
            if not ring.put(time, poses):
                with self._lock:
                    self._word = replace(self._word, dropped=self._word.dropped + 1)
            self._send(self._sockets.reports, PosesReport(ring.put_so_far))

    def tell_end(self, error: StressbotError | None) -> None:
        """A run has ended, or the output has failed."""
        if error is None:
            self._set(Outcome.FINISHED, only_from=Outcome.PLAYING)
            self._report()
        else:
            self._fail(error)

    # Words

    @property
    def _playing(self) -> bool:
        return self._word.outcome == Outcome.PLAYING

    def _set(self, outcome: Outcome, only_from: Outcome | None = None, **changes: object) -> None:
        """A new outcome; a run that is being played has none of an earlier one's errors."""
        with self._lock:
            if only_from is None or self._word.outcome == only_from:
                self._word = replace(self._word.answering(None), outcome=outcome, **changes)

    def _fail(self, error: StressbotError) -> None:
        with self._lock:
            self._word = replace(self._word.answering(error), outcome=Outcome.FAILED, failures=self._word.failures + 1)
        self._report()

    def _say(self, number: int) -> Word:
        """What there is to say now, in answer to message `number`."""
        progress = self._word.progress if self.output is None else self.output.backend.progress()
        with self._lock:
            self._word = replace(self._word, serial=self._word.serial + 1, progress=progress)
            return replace(self._word, number=number)

    def _report(self) -> None:
        """Say at once how a run has ended; if nobody reads, the answer to the next beat says it too."""
        with self._reporting:
            self._send(self._sockets.reports, self._say(0))

    def _send(self, connection: socket.socket, what: Word | PosesReport) -> None:
        """Unless nobody reads."""
        message = protocol.pack_word(what) if isinstance(what, Word) else protocol.pack_poses(what)
        with suppress(BlockingIOError, ConnectionError):
            connection.send(message, socket.MSG_DONTWAIT)


class _Reports(Listener):
    """What the backend of a gate reports."""

    def __init__(self, gate: Gate, ring: memory.Ring) -> None:
        self._gate, self._ring = gate, ring

    def poses_measured(self, time: float, poses: Poses) -> None:
        self._gate.tell_poses(self._ring, time, poses)

    def finished(self) -> None:
        self._gate.tell_end(None)

    def failed(self, error: StressbotError) -> None:
        self._gate.tell_end(error)


def _next(last: int, number: int) -> int:
    if number != last + 1:
        raise BadMessageError(f"a message of number {number} after number {last}")
    return number
