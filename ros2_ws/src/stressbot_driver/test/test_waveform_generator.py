"""The backend speaks to the emulated instrument over TCP, and the substrate hears nothing but volts."""

import socket
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from driver_support import DEADLINE, Recorder, closed_form, encode, sequence
from instrument_support import AMPLIFIER, AS_TOLD, EmulatedBench

from stressbot_driver.backends.base import Listener, Pacing, backend_class, make_backend
from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.clock import WallClock
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.instruments.transport import connect
from stressbot_driver.session import Session, State

PLAN = [(1, 0.5), (4, 1.0), (2, 0.71234567), (3, 2.0), (4, 0.1), (1, 1.5)]


@pytest.fixture
def emulated(tmp_path):
    benches = []

    def make(**arguments):
        benches.append(EmulatedBench(tmp_path, **arguments))
        return benches[-1]

    yield make
    for one in benches:
        one.close()


def run(one, plan):
    backend = one.backend or one.open()
    backend.upload(played := encode(one.bench, plan))
    one.listener.ended.clear()
    backend.start(Pacing())
    assert one.listener.ended.wait(DEADLINE)
    assert one.listener.error is None and one.listener.done
    return played


@pytest.mark.parametrize(("count", "drives", "tolerance"), [(2, 40, 1e-6), (6, 40, 1e-6), (14, 40, 1e-6), (6, 600, 1e-5)])
def test_robots_end_where_the_closed_form_says(emulated, count, drives, tolerance):
    one = emulated(count=count)
    rng = np.random.default_rng(count)
    groups = rng.integers(1, one.bench.group_count + 1, drives)
    plan = [(int(group), float(seconds)) for group, seconds in zip(groups, rng.exponential(1.0, drives), strict=True)]
    run(one, plan)
    distance, turn = one.deviation(closed_form(one.bench, plan))
    print(f"{drives} drives of {count} robots: {distance:.2g} units, {turn:.2g} rad")
    assert distance < tolerance and turn < tolerance
    assert one.send("OUTP?", "SYST:ERR?") == ["0", '+0,"No error"']
    progress = one.backend.progress()
    assert (progress.epoch, progress.level) == (drives, 0.0)


def test_the_substrate_sees_every_level_for_its_time(emulated):
    one = emulated()
    played = run(one, PLAN)
    seen = [(level, seconds) for level, seconds in one.volts if level > 1e-9]
    meant = [(level, dwell) for level, dwell in zip(played.levels, played.dwells, strict=True) if level]
    assert [level for level, _ in seen] == pytest.approx([level for level, _ in meant], abs=0.004)
    assert [seconds for _, seconds in seen] == pytest.approx([seconds for _, seconds in meant], abs=2e-8)
    assert max(level for level, _ in one.volts) <= one.backend.limits.max_level


def test_one_plan_after_the_other(emulated):
    one = emulated()
    run(one, PLAN[:3])
    run(one, PLAN[3:])
    assert one.deviation(closed_form(one.bench, PLAN))[0] < 1e-6


def test_small_memory_is_filled_again_and_again(emulated):
    one = emulated(memory=8192)
    run(one, PLAN * 3)
    assert one.deviation(closed_form(one.bench, PLAN * 3))[0] < 1e-6


def test_limits_are_those_of_bench_amplifier_and_generator_together(emulated):
    one = emulated(amplifier_max_voltage=150.0)
    assert one.open().limits.max_level == pytest.approx(150.0)
    other = emulated(amplifier_gain=10.0)
    assert other.open().limits.max_level == pytest.approx(100.0)  # the generator has 10 V
    third = emulated(amplifier_gain=30.0)
    assert 199.9 < third.open().limits.max_level <= 200.0  # the bench has 200 V, rounded inward to the generator's digits


def test_an_amplifier_that_leaves_no_volts_is_refused(emulated):
    with pytest.raises(StressbotError) as refused:
        emulated(amplifier_gain=1e6).open()
    assert refused.value.code == ErrorCode.LIMIT_EXCEEDED


def test_stop_freezes_the_robots(emulated):
    one = emulated()
    backend = one.open()
    backend.upload(encode(one.bench, PLAN))
    one.clock.at(0.30, backend.stop)  # 50 ms of selection and 245 ms of drive
    backend.start(Pacing())
    backend._thread.join()
    assert one.send("OUTP?") == ["0"]
    moved = one.deviation(closed_form(one.bench, []))[0]
    assert 0.2 < moved < 0.3
    one.clock.time += 10.0
    assert one.deviation(closed_form(one.bench, []))[0] == moved
    assert not one.listener.ended.is_set()
    with pytest.raises(StressbotError, match="no sequence"):
        backend.start(Pacing())


def test_a_dead_driver_leaves_the_substrate_at_rest_after_the_epoch_that_runs(emulated):
    """Nobody sends a trigger, and nobody switches off."""
    one = emulated()
    backend = one.open()
    backend.upload(encode(one.bench, PLAN))
    backend._generator.arm(50e6)
    backend._generator.trigger()
    one.server.disconnect()
    one.clock.time += 1000.0
    assert one.deviation(closed_form(one.bench, PLAN[:1]))[0] < 1e-6
    assert one.emulator.waiting and abs(one.emulator.volts) < 1e-9


def test_progress_follows_the_clock(emulated):
    one = emulated()
    backend = one.open()
    backend.upload(encode(one.bench, PLAN))
    seen = []
    for moment in (0.005, 0.012, 0.02, 0.3):
        one.clock.at(moment, lambda: seen.append(backend.progress()))
    backend.start(Pacing())
    assert one.listener.ended.wait(DEADLINE)
    assert [progress.time for progress in seen] == pytest.approx([0.005, 0.012, 0.02, 0.3])
    assert [progress.level for progress in seen] == [90.0, 0.0, 40.0, 140.0]


class Forward(Listener):
    """A session's ears, which can be waited for."""

    def __init__(self, session):
        self.session = session
        self.ended = threading.Event()
        self.error = None

    def poses_measured(self, time, poses):
        raise AssertionError("this backend sees no robots")

    def finished(self):
        self.session.finished()
        self.ended.set()

    def failed(self, error):
        self.error = error
        self.session.failed(error)
        self.ended.set()


def session_on(one):
    def make(session):
        one.listener = Forward(session)
        return one.open()

    return Session(make, on_change=lambda: None, on_poses=lambda time, poses: None)


@pytest.mark.parametrize("listening", [True, False])
def test_a_pulled_cable_is_a_fault(emulated, listening):
    one = emulated()
    session = session_on(one)
    session.load(encode(one.bench, PLAN))
    one.clock.at(0.7, one.server.disconnect if listening else one.server.close)
    session.start(Pacing())
    assert one.listener.ended.wait(DEADLINE)
    status = session.status()
    assert (status.state, status.error_code) == (State.FAULT, ErrorCode.BACKEND_FAILURE)
    if listening:
        assert one.send("OUTP?") == ["0"]  # over the second connection
        session.reset()
        assert session.status().state == State.IDLE
        session.load(encode(one.bench, PLAN[:1]))
    else:
        assert "THE OUTPUT MAY BE ON" in status.error_msg
        with pytest.raises(StressbotError):
            session.stop()
        assert session.status().state == State.FAULT
        one.backend._generator.close()
        one.backend = None


def test_an_error_of_the_instrument_is_a_fault_that_quotes_it(emulated):
    one = emulated()
    session = session_on(one)
    session.load(encode(one.bench, PLAN))
    one.clock.at(0.7, lambda: one.send("NONSENSE"))
    session.start(Pacing())
    assert one.listener.ended.wait(DEADLINE)
    assert session.status().state == State.FAULT
    assert '-113,"Undefined header"' in session.status().error_msg
    assert one.send("OUTP?") == ["0"]


def test_somebody_who_turns_a_knob_is_noticed_before_the_output_is_on(emulated):
    one = emulated()
    backend = one.open()
    backend.upload(encode(one.bench, PLAN))
    one.send("VOLT 2", "SYST:ERR?")
    backend.start(Pacing())
    assert one.listener.ended.wait(DEADLINE)
    assert "SOUR1:VOLT? answers" in one.listener.error.message
    assert not one.volts or max(level for level, _ in one.volts) == 0.0


HOSTILE = ["FORM:BORD NORM", "VOLT 2", "VOLT:LIM:STAT OFF", "VOLT:LIM:LOW -5", "TRIG:SOUR IMM"]


@pytest.mark.parametrize("order", HOSTILE)
def test_somebody_who_turns_a_knob_between_two_blocks_is_noticed_before_the_next(emulated, order):
    one = emulated()
    backend = one.open()
    backend.upload(encode(one.bench, [(1, 0.2), (4, 0.2)]))
    turned = []

    def turn():
        before = one.send(*AS_TOLD)
        one.send(order, "*CLS")
        turned.append(before != one.send(*AS_TOLD))  # what the instrument itself refuses changes nothing

    one.clock.at(0.2495, turn)  # in the last half millisecond of the drive
    backend.start(Pacing())
    assert one.listener.ended.wait(DEADLINE)
    assert turned == [True] and one.listener.error.code == ErrorCode.BACKEND_FAILURE
    assert one.send("OUTP?") == ["0"]
    assert backend.progress().epoch <= 1


def test_somebody_who_switches_the_output_on_at_rest_is_noticed(emulated):
    one = emulated(clock=WallClock(), watch=0.01)
    backend = one.open()
    backend.upload(encode(one.bench, [(4, 5.0)]))
    assert not one.listener.ended.wait(0.1)
    one.send('FUNC:ARB "STRESSBOT"', "FUNC ARB", "FUNC:ARB:SRAT 50000000", "OUTP ON", "*TRG")
    assert one.listener.ended.wait(DEADLINE)
    assert "somebody else" in one.listener.error.message
    assert one.send("OUTP?") == ["0"]
    one.listener.error = None
    backend.reset()
    run(one, [(1, 0.02)])


def test_a_connection_that_is_lost_within_an_epoch_is_a_failure_while_it_runs(emulated):
    one = emulated(clock=WallClock(), watch=0.01)
    backend = one.open()
    backend.upload(encode(one.bench, [(4, 600.0)]))
    backend.start(Pacing())
    assert not one.listener.ended.wait(0.3)
    one.server.disconnect()
    assert one.listener.ended.wait(DEADLINE) and one.listener.error.code == ErrorCode.BACKEND_FAILURE
    assert one.send("OUTP?") == ["0"]


def test_stop_does_not_wait_for_an_upload_or_a_disk_that_hangs(emulated, monkeypatch):
    one = emulated(clock=WallClock())
    backend = one.open()
    backend.upload(encode(one.bench, [(4, 600.0)]))
    backend.start(Pacing())
    while one.send("OUTP?") != ["1"]:
        pass
    backend._generator._recorder._lines.put(hang := threading.Event())
    hung, go_on = threading.Event(), threading.Event()
    hang.set = lambda: (hung.set(), go_on.wait(DEADLINE))  # the thread that writes the record
    try:
        assert hung.wait(DEADLINE)
        backend.stop()
        assert one.send("OUTP?") == ["0"]
    finally:
        go_on.set()


def test_an_answer_that_trickles_in_is_not_waited_for_longer_than_a_whole_one():
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = connect(f"TCPIP0::127.0.0.1::{server.getsockname()[1]}::SOCKET", 0.3)
        other, _ = server.accept()
        over = threading.Event()

        def trickle():
            with suppress(OSError):
                while not over.wait(0.02):
                    other.sendall(b"1")

        thread = threading.Thread(target=trickle)
        thread.start()
        began = time.monotonic()
        with pytest.raises(TimeoutError):
            line.receive()
        assert time.monotonic() - began < 30.0
        over.set()
        thread.join()
        other.sendall(b"2\n3")
        assert line.receive().endswith("2")
        other.close()
        with pytest.raises(ConnectionError):
            line.receive()
        line.close()


def test_nobody_at_the_address(tmp_path, emulated):
    one = emulated()
    one.server.close()
    with pytest.raises(StressbotError) as failed:
        one.open()
    assert failed.value.code == ErrorCode.BACKEND_FAILURE and "check address" in failed.value.message
    one.server = EmulatedBench(tmp_path).server


def test_it_is_found_by_name_and_says_that_it_is_untried(emulated):
    assert backend_class("waveform_generator") is WaveformGeneratorBackend
    assert "NOT YET BEEN TRIED ON A PHYSICAL INSTRUMENT" in WaveformGeneratorBackend.NOTICE
    one = emulated()
    one.backend = make_backend("waveform_generator", one.bench, one.clock, Recorder(), one.options)
    one.backend.close()
    one.backend.close()


def test_rest_must_be_where_an_output_that_is_off_lies(tmp_path):
    from driver_support import FakeClock, bench

    lifted = bench(2, **{"electrical.rest_level": 5.0})
    with pytest.raises(StressbotError) as refused:
        WaveformGeneratorBackend(lifted, FakeClock(), Recorder(), {"visa_resource": "any", **AMPLIFIER})
    assert (refused.value.code, refused.value.field) == (ErrorCode.UNSUPPORTED, "electrical.rest_level")


def test_on_the_wall_clock_too(emulated):
    one = emulated(clock=WallClock())
    plan = [(1, 0.02), (4, 0.05), (2, 0.03)]
    run(one, plan)
    assert one.deviation(closed_form(one.bench, plan))[0] < 1e-6


def test_an_epoch_that_does_not_end_at_rest_is_refused_and_what_is_loaded_stays(emulated):
    one = emulated()
    session = session_on(one)
    session.load(encode(one.bench, PLAN[:2], plan_id="first"))
    for levels, ends in (([90.0, 0.0, 140.0], [3]), ([140.0, 90.0, 0.0], [1, 3])):
        with pytest.raises(StressbotError) as refused:
            session.load(sequence(one.bench, levels, [0.01, 0.005, 0.25], ends, plan_id="second"))
        assert refused.value.code == ErrorCode.LIMIT_EXCEEDED and "at rest" in refused.value.message
        status = session.status()
        assert (status.state, status.plan_id, status.refused_plan_id) == (State.LOADED, "first", "second")
    session.start(Pacing())
    assert one.listener.ended.wait(DEADLINE) and one.listener.error is None
    assert one.deviation(closed_form(one.bench, PLAN[:2]))[0] < 1e-6


@pytest.mark.parametrize("max_block", [0.3, 1.0, 10.0])
def test_no_block_takes_longer_than_it_may_and_the_robots_do_not_notice(emulated, max_block):
    one = emulated(max_block=max_block)
    plan = [(1, 2.5), (4, 0.05), (2, 31.0), (3, 0.7 * max_block)]
    played = run(one, plan)
    distance, turn = one.deviation(closed_form(one.bench, plan))
    assert distance < 2e-6 and turn < 2e-6
    progress = one.backend.progress()
    assert (progress.epoch, progress.time) == (4, pytest.approx(played.duration))
    driven = [seconds for level, seconds in one.volts if level > 139.0]
    assert max(driven) <= max_block and sum(driven) == pytest.approx(33.55 + 0.7 * max_block)


def test_a_selection_longer_than_a_block_is_refused(emulated):
    one = emulated(max_block=0.1)
    slow = sequence(one.bench, [90.0, 0.0, 140.0, 0.0], [0.09, 0.02, 5.0, 0.005], [4])
    with pytest.raises(StressbotError) as refused:
        one.open().upload(slow)
    assert refused.value.code == ErrorCode.LIMIT_EXCEEDED and "max_block is 0.1 s" in refused.value.message
