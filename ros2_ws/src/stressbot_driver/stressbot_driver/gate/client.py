"""The driver's side of the gate: a backend as others are, whose output another process holds."""

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from stressbot_driver.backends.base import Backend, Listener, Pacing, Progress
from stressbot_driver.bench import Bench
from stressbot_driver.clock import WallClock
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.gate import memory, protocol
from stressbot_driver.gate.protocol import BadMessageError, Beat, Kind, Outcome, Request, Word
from stressbot_driver.sequence import Limits, VoltageSequence
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Poses

STOP_PATIENCE = 10.0
"""[s] A gate that does not answer `stop` for so long is killed, and another one brings the output to rest."""

CLOSE_PATIENCE = 3.0
"""[s] that the driver waits for its gate to end; a gate that needs longer goes on alone."""

SILENCE = 10
"""Silence, in gate_timeouts, after which a gate that leaves beats unanswered while a sequence runs is killed as well."""


class GateProcess:
    """A gate's process and the driver's ends of its sockets. Closing them lets it bring its output to rest and end."""

    def __init__(self) -> None:
        names = ("beats", "stops", "requests", "reports")
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in names]
        self.beats, self.stops, self.requests, self.reports = (ours for ours, _ in pairs)
        theirs = [str(their.fileno()) for _, their in pairs]
        try:
            # A session of its own: what the terminal sends to the driver does not reach it.
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "stressbot_driver.gate", *theirs, str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[int(descriptor) for descriptor in theirs],
                start_new_session=True,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        except BaseException:
            for ours, _ in pairs:
                ours.close()
            raise
        finally:
            for _, their in pairs:
                their.close()

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        """For a gate that does not answer any more."""
        self._process.kill()

    def close(self, patience: float = CLOSE_PATIENCE) -> str | None:
        """Let it go, and wait for its end; how it ended, or None if it has not yet."""
        for connection in (self.beats, self.stops, self.requests, self.reports):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)  # wakes whoever waits in it
        try:
            code = self._process.wait(patience)
        except subprocess.TimeoutExpired:
            return None
        finally:
            for connection in (self.beats, self.stops, self.requests, self.reports):
                connection.close()
        return f"signal {-code}" if code < 0 else f"exit code {code}"


@dataclass(eq=False)
class _Link:
    """One gate that has been opened."""

    process: GateProcess
    ring: memory.Ring
    requests: int = 0
    stops: int = 0
    beats: int = 0
    failures: int = 0  # that were told
    unanswered: tuple[int, float] | None = None  # the oldest beat without an answer: its number, and when it was sent [s]
    # Set when it is dead, and another one was tried for.
    replaced: threading.Event = field(default_factory=lambda: threading.Event())


class GateClient(Backend):
    """Lets a gate make a backend and do what it is told. Its sequences end in rest unless `beat` is called every PERIOD.

    A gate that dies is replaced at once, since opening an output brings it to rest; the run has failed then.
    """

    def __init__(
        self,
        name: str,
        backend: type[Backend],
        bench: Bench,
        listener: Listener,
        options: Mapping[str, Any] | None = None,
        timeout: float = 0.06,
        process: GateProcess | None = None,
        note: Callable[[str], object] = lambda text: None,
    ) -> None:
        """A gate with `backend`, which is registered as `name`, in `process` or in a new one.

        `timeout` [s] of silence brings the output to rest; `note` is told what a log should hold.
        Raises StressbotError as the backend does, or BACKEND_FAILURE if there is no gate.
        """
        super().__init__(bench, WallClock(), listener, options)
        self._asked = {
            "backend": name,
            "class": f"{backend.__module__}:{backend.__qualname__}",
            "bench": bench,
            "options": dict(self.options),
            "timeout": timeout,
        }
        self._note = note
        self._timeout = timeout
        self._lock = threading.Lock()  # guards the word and the run; never held while waiting
        self._requesting = threading.Lock()
        self._stopping = threading.Lock()
        self._delivering = threading.Lock()  # held while a run's end is told, so that no other begins meanwhile
        self._word = Word()
        self._run = 0  # number of the run whose end is still to be told; 0: none
        self._closed = False
        self._link: _Link | None = self._connect(process)  # a dead one until it is replaced; None: no other one could be had

    @property
    def limits(self) -> Limits:
        return self._word.limits

    @property
    def dropped(self) -> int:
        """Reports of poses that came faster than they were read."""
        return self._word.dropped

    @property
    def pid(self) -> int | None:
        """Of the gate's process."""
        return self._link and self._link.process.pid

    def upload(self, sequence: VoltageSequence) -> None:
        self._request(Kind.UPLOAD, [memory.sealed_sequence(sequence)])

    def start(self, pacing: Pacing) -> None:
        with self._requesting:
            link = self._link
            with self._delivering, self._lock:
                self._run = link.requests + 1 if link else 0
            try:
                self._asked_for(link, Kind.START, [], pacing)
            except StressbotError:
                with self._lock:
                    self._run = 0
                raise

    def stop(self) -> None:
        with self._stopping:
            link = self._link
            if link is None or not self._stopped(link) and not (link.replaced.wait(STOP_PATIENCE) and self._link):
                raise _failure("there is none, and the output MAY BE ON: see to it, then call reset")
            with self._lock:
                self._run = 0

    def reset(self) -> None:
        if self._link is None:
            self._link = self._connect(None)
        self._request(Kind.RESET, [])

    def close(self) -> None:
        self._closed = True
        link = self._link
        if link is None:
            return
        if link.process.close() is None:
            self._link = None
            self._note(f"gate {link.process.pid} goes on alone: its output is not at rest yet")
        link.replaced.set()  # for a `stop` that was under way; a gate that has ended left its output at rest

    def progress(self) -> Progress:
        return self._word.progress

    def poses(self) -> Poses | None:
        with self._requesting:
            link = self._link
            if link is None:
                return None
            try:
                return link.ring.taken_aside() if self._asked_for(link, Kind.LOOK, []).seen else None
            except StressbotError:  # of a gate that is gone, which is told otherwise
                return None

    def impair(self, imperfections: Imperfections) -> None:
        self._request(Kind.IMPAIR, [memory.sealed_object("imperfections", imperfections)])

    def beat(self) -> None:
        """Say that all is well. For whoever serves `stop` to call, every PERIOD."""
        link = self._link
        if link is None:
            return
        now = time.monotonic()
        beats = link.process.beats
        try:
            beats.send(protocol.pack_beat(Beat(link.beats + 1, now)), socket.MSG_DONTWAIT)
            link.beats += 1
            link.unanswered = link.unanswered or (link.beats, now)
            while message := protocol.receive(beats, socket.MSG_DONTWAIT):
                word = protocol.unpack_word(message)
                if link.unanswered and word.number >= link.unanswered[0]:
                    link.unanswered = (link.beats, now) if word.number < link.beats else None
                self._heard(word, link)
        except BlockingIOError:
            pass
        except OSError:
            return  # it is dead, as the thread that reads its reports sees too
        except BadMessageError:
            link.process.kill()
        if self._run and link.unanswered and now - link.unanswered[1] > SILENCE * self._timeout:
            link.process.kill()

    # One gate

    def _connect(self, process: GateProcess | None) -> _Link:
        """Open a gate's output, which brings it to rest."""
        try:
            link = _Link(process or GateProcess(), memory.Ring(len(self.bench.ids)))
        except OSError as error:
            raise _failure(f"it cannot be started ({error}): see to memory and limits of processes") from error
        self._word = Word()
        try:
            try:
                configuration = memory.sealed_object("configuration", self._asked)
            except OSError as error:
                raise _failure(f"it cannot be told what to open ({error}): see to memory and limits of processes") from error
            word = self._asked_for(link, Kind.OPEN, [configuration, link.ring.descriptor])
        except BaseException:
            link.process.close()
            raise
        if word.text:
            self._note(f"gate {link.process.pid} {word.text}")
        threading.Thread(target=self._listen, args=(link,), name="gate", daemon=True).start()
        return link

    def _request(self, kind: Kind, descriptors: list[int]) -> None:
        with self._requesting:
            self._asked_for(self._link, kind, descriptors)

    def _asked_for(self, link: _Link | None, kind: Kind, descriptors: list[int], pacing: Pacing | None = None) -> Word:
        """The answer to a request. Raises what went wrong with it, or StressbotError BACKEND_FAILURE if the gate has ended."""
        try:
            if link is None:
                raise _failure("there is none: see to its cause, then call reset")
            number = link.requests + 1
            numbers = (pacing.real_time_factor, pacing.pose_rate) if pacing else ()
            link.requests = number
            try:
                socket.send_fds(link.process.requests, [protocol.pack_request(Request(kind, number, *numbers))], descriptors)
                message = protocol.receive(link.process.requests)
            except OSError as error:
                raise _failure(f"it has ended ({error}): call reset") from error
        finally:
            for descriptor in descriptors:
                os.close(descriptor)
        if not message:
            raise _failure("it has ended: call reset")
        word = protocol.unpack_word(message)
        self._learn(word)
        if word.error is not None:
            raise word.error
        return word

    def _stopped(self, link: _Link) -> bool:
        """Ask for rest; False if the gate is dead, or has been killed because it did not answer. Raises what it says."""
        stops = link.process.stops
        try:
            stops.settimeout(STOP_PATIENCE)
            stops.send(protocol.pack_stop(link.stops + 1))
            link.stops += 1
            message = protocol.receive(stops)
        except TimeoutError:
            link.process.kill()
            return False
        except OSError:
            return False
        if not message:
            return False
        word = protocol.unpack_word(message)
        self._learn(word)
        if word.error is not None:
            raise word.error
        return True

    # What it tells

    def _listen(self, link: _Link) -> None:
        """Read reports until the gate is gone, then see to another one."""
        try:
            while message := protocol.receive(link.process.reports):
                report = protocol.unpack_report(message)
                while (poses := link.ring.take()) is not None:
                    self.listener.poses_measured(*poses)
                if isinstance(report, Word):
                    self._heard(report, link)
        except (BadMessageError, OSError):
            link.process.kill()
        if self._closed:
            return
        said = self._word.error
        why = f"; it said: {said.message}" if said and said.code == ErrorCode.INTERNAL else ""
        self._run = 0
        error = f"it has ended ({link.process.close() or 'not yet'}{why}), and with it what ran"
        try:
            self._link = self._connect(None)
            if self._closed:
                self._link.process.close()
            error = _failure(f"{error}; another one has brought the output to rest: call reset")
        except StressbotError as cause:
            self._link = None
            error = _failure(f"{error}; another one could not open the output, which MAY BE ON ({cause}): call reset")
        link.replaced.set()
        self.listener.failed(error)

    def _heard(self, word: Word, link: _Link) -> None:
        """A word about the output: tell the end of a run, and a failure, once."""
        self._learn(word)
        with self._delivering:
            with self._lock:
                error = word.error if word.failures > link.failures else None
                finished = word.outcome == Outcome.FINISHED and word.run == self._run
                if link is not self._link or not (error or finished):
                    return
                link.failures = max(word.failures, link.failures)
                self._run = 0
            if error is not None:
                self.listener.failed(error)
            else:
                self.listener.finished()

    def _learn(self, word: Word) -> None:
        with self._lock:
            if word.serial > self._word.serial:
                self._word = word


def _failure(message: str) -> StressbotError:
    return StressbotError(ErrorCode.BACKEND_FAILURE, "gate", message)
