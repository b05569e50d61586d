"""The gate in this process, over a backend that obeys the test, with a clock that does too: whatever comes, volts end."""

import itertools
import os
import socket
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest
from driver_support import DEADLINE, bench, sequence
from gate_support import PuppetBackend
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.gate import gate as gate_module
from stressbot_driver.gate import memory, protocol
from stressbot_driver.gate.gate import Gate, Opening, Sockets
from stressbot_driver.gate.hardening import PLAYING
from stressbot_driver.gate.protocol import Beat, Kind, Outcome, Request
from stressbot_driver.simulation.imperfections import IDEAL

TIMEOUT = 0.06
BENCH = bench(2)
SEQUENCE = sequence(BENCH, [90.0, 0.0], [0.1, 0.1])


class Rig:
    """A driver's ends of the sockets, and the gate at the others on a thread of its own."""

    def __init__(self):
        self.now = 1000.0
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(4)]
        self.beats, self.stops, self.requests, self.reports = self.ours = [ours for ours, _ in pairs]
        for ours in self.ours:
            ours.settimeout(DEADLINE)
        self.numbers = {ours: 0 for ours in self.ours}
        self.backend = None
        self.gate = Gate(Sockets(*(theirs for _, theirs in pairs)), self._read, now=lambda: self.now)
        self.thread = threading.Thread(target=self.gate.run)
        self.thread.start()

    def _read(self, configuration):
        return Opening(self._make, TIMEOUT, len(BENCH.ids), [])

    def _make(self, listener):
        self.backend = PuppetBackend(BENCH, listener)
        return self.backend

    def _next(self, connection):
        self.numbers[connection] += 1
        return self.numbers[connection]

    def answer(self, connection):
        message = connection.recv(protocol.ROOM)
        return protocol.unpack_report(message) if message else None

    def beat(self, age=0.0):
        self.beats.send(protocol.pack_beat(Beat(self._next(self.beats), self.now - age)))
        return self.answer(self.beats)

    def stop(self):
        self.stops.send(protocol.pack_stop(self._next(self.stops)))
        return self.answer(self.stops)

    def ask(self, kind):
        if kind == Kind.OPEN:
            given = [memory.sealed_object("configuration", None), memory.Ring(len(BENCH.ids)).descriptor]
        else:
            given = [memory.sealed_sequence(SEQUENCE)] if kind == Kind.UPLOAD else []
        if kind == Kind.IMPAIR:
            given = [memory.sealed_object("imperfections", IDEAL)]
        request = Request(kind, self._next(self.requests), 1.0, 50.0)
        socket.send_fds(self.requests, [protocol.pack_request(request)], given)
        for descriptor in given:
            os.close(descriptor)
        return self.answer(self.requests)

    def running(self):
        for kind in (Kind.OPEN, Kind.UPLOAD):
            assert self.ask(kind).error is None
        self.beat()
        assert self.ask(Kind.START).outcome == Outcome.PLAYING
        return self

    def ended(self):
        """The gate has let go of everything."""
        self.thread.join(DEADLINE)
        assert not self.thread.is_alive()
        assert self.backend is None or (not self.backend.volts and self.backend.calls[-1] == "close")
        return True

    def close(self):
        for ours in self.ours:
            ours.close()
        assert self.ended()


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


def test_silence_is_rest_latched_with_its_reason(rig):
    rig.running()
    rig.now += TIMEOUT
    assert rig.beat(age=TIMEOUT).outcome == Outcome.PLAYING  # as late as it may be
    rig.now += 0.01
    rig.beat(age=TIMEOUT + 0.01)
    word = rig.answer(rig.reports)
    assert (word.outcome, word.code, rig.backend.volts) == (Outcome.FAILED, ErrorCode.NO_HEARTBEAT, False)
    assert "70 ms" in word.text and "60 ms" in word.text
    rig.beat()  # life that comes back does not undo it
    for kind in (Kind.UPLOAD, Kind.START):
        assert rig.ask(kind).code == ErrorCode.NO_HEARTBEAT
    assert rig.beat().code == ErrorCode.NO_HEARTBEAT and not rig.backend.volts
    assert rig.ask(Kind.RESET).error is None and rig.beat().error is None
    rig.ask(Kind.UPLOAD)
    assert rig.ask(Kind.START).outcome == Outcome.PLAYING


def test_beats_that_waited_are_no_signs_of_life(rig):
    """Both were frozen: when they go on, the socket is full of old beats."""
    rig.running()
    rig.now += 5.0
    for age in (5.0, 4.98, 4.96):
        rig.beat(age)
    assert rig.answer(rig.reports).code == ErrorCode.NO_HEARTBEAT and not rig.backend.volts


def test_nothing_starts_for_a_driver_that_shows_no_life(rig):
    for kind in (Kind.OPEN, Kind.UPLOAD):
        rig.ask(kind)
    clock = itertools.count(2000.0, 0.01)
    rig.gate._now = lambda: next(clock)
    refused = rig.ask(Kind.START)
    assert refused.code == ErrorCode.NO_HEARTBEAT and refused.outcome == Outcome.NONE and "start" not in rig.backend.calls


@pytest.mark.parametrize("which", ["beats", "stops", "requests"])
@pytest.mark.parametrize("end", ["close", "shutdown"])
def test_a_closed_socket_is_rest_and_the_end(which, end):
    rig = Rig().running()
    connection = getattr(rig, which)
    connection.close() if end == "close" else connection.shutdown(socket.SHUT_RDWR)
    assert rig.ended()
    rig.close()


@pytest.mark.parametrize("which", ["beats", "stops", "requests"])
@pytest.mark.parametrize(
    "message",
    [b"x", bytes(24), protocol.pack_beat(Beat(7, 1e9)), protocol.pack_stop(9), protocol.pack_request(Request(Kind.LOOK, 99))],
)
def test_a_bad_message_is_rest_a_reason_and_the_end(which, message):
    rig = Rig().running()
    getattr(rig, which).send(message)
    word = rig.answer(rig.reports)
    assert word.code == ErrorCode.INTERNAL and "a message of" in word.text
    assert rig.ended()
    rig.close()


def test_a_request_out_of_turn_or_without_its_memory_is_bad():
    for kind, given in ((Kind.UPLOAD, 1), (Kind.OPEN, 1), (Kind.START, 1)):
        rig = Rig()
        descriptors = [memory.sealed("test", [b"x"]) for _ in range(given)]
        socket.send_fds(rig.requests, [protocol.pack_request(Request(kind, 1))], descriptors)
        assert rig.answer(rig.reports).code == ErrorCode.INTERNAL
        assert rig.ended()
        rig.close()
        for descriptor in descriptors:
            os.close(descriptor)


def test_a_sequence_is_checked_here_too(rig):
    rig.ask(Kind.OPEN)
    good = memory.sealed_sequence
    hot = replace(SEQUENCE, levels=SEQUENCE.levels + 150.0)
    try:
        memory.sealed_sequence = lambda _sequence: good(hot)
        refused = rig.ask(Kind.UPLOAD)
    finally:
        memory.sealed_sequence = good
    assert refused.code == ErrorCode.LIMIT_EXCEEDED and rig.backend.calls == []


def test_real_robots_take_no_imperfections(rig):
    rig.ask(Kind.OPEN)
    assert rig.ask(Kind.IMPAIR).code == ErrorCode.UNSUPPORTED


def test_a_look_says_whether_anybody_was_seen(rig):
    rig.ask(Kind.OPEN)
    assert not rig.ask(Kind.LOOK).seen
    rig.backend.poses = lambda: memory.Poses(*(BENCH.start.T[[0, 0, 1, 2]]))
    assert rig.ask(Kind.LOOK).seen


@pytest.mark.parametrize(("age", "starts"), [(0.5 * TIMEOUT, True), (0.6 * TIMEOUT, False)])
def test_a_start_wants_a_beat_that_is_younger_than_half_the_silence(rig, age, starts):
    for kind in (Kind.OPEN, Kind.UPLOAD):
        rig.ask(kind)
    rig.beat()
    last, looked = rig.gate._last_beat, []
    rig.gate._now = lambda: looked.append(0) or (last + age if len(looked) < 50 else last + 100.0)
    assert (rig.ask(Kind.START).error is None) == starts
    rig.gate._now = lambda: last


def test_a_start_waits_for_the_next_beat(rig, monkeypatch):
    for kind in (Kind.OPEN, Kind.UPLOAD):
        rig.ask(kind)
    rig.beat()
    rig.now += 0.05
    slept = []
    monkeypatch.setattr(gate_module, "time", SimpleNamespace(sleep=lambda seconds: slept.append(seconds) or rig.beat()))
    assert rig.ask(Kind.START).outcome == Outcome.PLAYING and len(slept) == 1


def test_the_gate_looks_again_when_silence_would_be_too_long(rig):
    rig.ask(Kind.OPEN)
    assert rig.gate._wait() == TIMEOUT
    rig.ask(Kind.UPLOAD)
    rig.beat()
    rig.ask(Kind.START)
    rig.now += 0.02
    assert rig.gate._wait() == pytest.approx(0.04 + gate_module.LATE)
    rig.now += 0.02
    rig.beat()
    assert rig.gate._wait() == pytest.approx(TIMEOUT + gate_module.LATE)
    rig.backend.broken = {"stop"}
    rig.stop()
    assert rig.gate._wait() == gate_module.AGAIN
    rig.backend.broken = set()


def test_a_request_with_one_file_descriptor_too_many_is_bad(rig):
    descriptors = [memory.sealed("test", [b"x"]) for _ in range(3)]
    socket.send_fds(rig.requests, [protocol.pack_request(Request(Kind.OPEN, 1))], descriptors)
    word = rig.answer(rig.reports)
    assert word.code == ErrorCode.INTERNAL and "3 file descriptors with a request OPEN" in word.text
    for descriptor in descriptors:
        os.close(descriptor)


def test_a_newer_word_has_a_higher_number_and_no_request_leaves_a_file_descriptor(rig):
    serials = [rig.ask(Kind.OPEN).serial, rig.beat().serial, rig.stop().serial]
    open_files = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        serials.append(rig.ask(Kind.UPLOAD).serial)
    assert serials == sorted(set(serials)) and len(os.listdir("/proc/self/fd")) <= open_files + 2


def test_only_at_its_own_pace_is_playback_real_time(rig, monkeypatch):
    asked = []
    monkeypatch.setattr(gate_module, "real_time", asked.append)
    rig.ask(Kind.OPEN)
    for factor in (1.0, 0.5, 2.0, 0.0):
        rig.ask(Kind.UPLOAD)
        rig.beat()
        request = Request(Kind.START, rig._next(rig.requests), factor, 50.0)
        rig.requests.send(protocol.pack_request(request))
        assert rig.answer(rig.requests).error is None
        rig.stop()
    assert asked == [PLAYING, PLAYING, 0, 0]


def test_stop_overtakes_a_request_that_hangs(rig):
    rig.running()
    begun, go_on = threading.Event(), threading.Event()
    rig.backend.reset = lambda: (begun.set(), go_on.wait(DEADLINE))
    asking = threading.Thread(target=rig.ask, args=(Kind.RESET,))
    asking.start()
    begun.wait(DEADLINE)
    try:
        assert rig.stop().error is None and not rig.backend.volts
    finally:
        go_on.set()
        asking.join()


@pytest.mark.parametrize("end", ["silence", "death", "stop"])
def test_an_end_during_a_start_still_ends_at_rest(end):
    rig = Rig()
    rig.ask(Kind.OPEN), rig.ask(Kind.UPLOAD), rig.beat()
    stopped, stop = threading.Event(), rig.backend.stop

    def noticed_stop():
        stop()
        stopped.set()

    def start(_pacing):
        rig.now += 1.0
        if end == "death":
            rig.beats.close()
        if end == "stop":
            rig.stop()
        stopped.wait(DEADLINE)
        rig.backend.volts = True  # what the stop came too early for

    rig.backend.stop, rig.backend.start = noticed_stop, start
    rig.ask(Kind.START)
    assert not rig.backend.volts
    rig.close()


def test_an_output_that_does_not_come_to_rest_is_tried_again(rig):
    rig.running()
    rig.backend.broken = {"stop"}
    failed = rig.stop()
    assert failed.code == ErrorCode.BACKEND_FAILURE and "cable unplugged" in failed.text
    rig.backend.broken = set()
    while rig.backend.volts:
        rig.thread.join(0.01)
    assert rig.stop().error is None


def test_reports_that_nobody_reads_hold_nothing_up(rig):
    rig.running()
    poses = memory.Poses(*(BENCH.start.T[[0, 0, 1, 2]]))
    for k in range(1000):
        rig.backend.listener.poses_measured(float(k), poses)
    word = rig.beat()
    assert word.dropped == 1000 - 64 and word.outcome == Outcome.PLAYING
    rig.backend.finish()
    assert rig.beat().outcome == Outcome.FINISHED  # also said where it is read


class GateMachine(RuleBasedStateMachine):
    """Driver, gate, backend and clock in any order; the backend fails at times."""

    def __init__(self):
        super().__init__()
        self.rig = Rig()
        self.rig.ask(Kind.OPEN)
        self.latched = self.uploaded = self.gone = False

    def _playing(self):
        return self.rig.gate._playing

    @rule()
    def upload(self):
        self._beat_if_playing()
        word = self.rig.ask(Kind.UPLOAD)
        assert (word.error is None) == (not self.latched and "upload" not in self.rig.backend.broken)

    @rule()
    def start(self):
        self.rig.beat()
        word = self.rig.ask(Kind.START)
        if self.latched:
            assert word.code == ErrorCode.NO_HEARTBEAT

    @rule()
    def stop(self):
        word = self.rig.stop()
        assert (word.error is None) == ("stop" not in self.rig.backend.broken)
        assert word.error is not None or not self.rig.backend.volts

    @rule()
    def reset(self):
        self._beat_if_playing()
        self.rig.stop()
        if self.rig.ask(Kind.RESET).error is None:
            self.latched = False

    @rule()
    def beat(self):
        self.rig.beat()

    @rule(seconds=st.sampled_from([0.01, 0.05, 0.07, 10.0]))
    def time_passes(self, seconds):
        self.rig.beat()  # so that the last one is as old as the time that passes
        playing = self._playing()
        self.rig.now += seconds
        if playing and seconds > TIMEOUT:
            self.latched = True
            self.rig.beat(age=seconds)
            while self.rig.gate._latched is None or self._playing():
                self.rig.thread.join(0.001)
        self.rig.beat()

    @rule()
    def the_sequence_ends(self):
        if self._playing() and self.rig.backend.volts:
            self.rig.backend.finish()

    @rule()
    def playback_fails(self):
        if self._playing() and self.rig.backend.volts:
            self.rig.backend.volts = False
            self.rig.backend.listener.failed(StressbotError(ErrorCode.BACKEND_FAILURE, "backend", "it broke"))

    @rule(name=st.sampled_from(["upload", "start", "stop", "reset"]))
    def something_breaks(self, name):
        self.rig.backend.broken.add(name)

    @rule()
    def it_is_mended(self):
        self.rig.backend.broken.clear()

    @precondition(lambda self: not self.gone)
    @rule(which=st.sampled_from(["beats", "stops", "requests"]))
    def the_driver_dies(self, which):
        self.rig.backend.broken.clear()
        getattr(self.rig, which).shutdown(socket.SHUT_RDWR)
        self.rig.ended()
        self.rig.close()
        self.__init__()

    def _beat_if_playing(self):
        if self._playing():
            self.rig.beat()

    @invariant()
    def volts_only_in_a_run_that_somebody_watches_over(self):
        backend, gate = self.rig.backend, self.rig.gate
        if backend.volts and "stop" not in backend.broken and gate._unrested is None:
            assert gate._word.outcome == Outcome.PLAYING
        if self.latched and "stop" not in backend.broken:
            assert gate._latched is not None

    def teardown(self):
        self.rig.backend.broken.clear()
        self.rig.close()


GateMachine.TestCase.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
TestGateMachine = GateMachine.TestCase
