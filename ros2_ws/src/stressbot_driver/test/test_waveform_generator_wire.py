"""Exactly what goes over the wire: set-up, upload, start, stop, and every way to fail."""

import json

import pytest
from driver_support import DEADLINE, sequence
from hypothesis import given, settings
from hypothesis import strategies as st
from instrument_support import (
    ARM,
    AS_TOLD,
    IDENTITY,
    NO_ERROR,
    SETUP,
    TRIGGER,
    Transcript,
    Wire,
    asked,
    blocked,
    codes,
    fine,
    off,
    told,
    verified,
)

from stressbot_driver.backends.base import Pacing
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.instruments.transport import Transport
from stressbot_driver.sequence import check_sequence


@pytest.fixture
def wired(tmp_path):
    """Return a function that puts a backend on transcripts; at the end it lets go without a word."""
    wires = []

    def make(*transcripts, **options):
        wires.append(Wire(tmp_path, *transcripts, **options))
        return wires[-1]

    yield make
    for wire in wires:
        wire.backend._generator.close()


def upload_of_two_levels():
    """[140 V for 10 ms, 0 V for 5 ms], one epoch."""
    names = (
        '"STRESSBOT","W1",1,repeatTilTrig,maintain,4,"W0",2000,repeat,maintain,4,"W1",1000,repeat,maintain,4,'
        '"W1",1,repeatInf,maintain,4'
    )
    return [
        *off(),
        told("SOUR1:DATA:VOL:CLE"),
        blocked("SOUR1:DATA:ARB:DAC W0,", codes(140.0, 250)),
        fine(),
        blocked("SOUR1:DATA:ARB:DAC W1,", codes(0.0, 250)),
        fine(),
        blocked("SOUR1:DATA:SEQ ", names.encode()),
        fine(),
    ]


def two_levels(wire):
    return sequence(wire.bench, [140.0, 0.0], [0.010, 0.005], [2])


def test_from_connection_to_the_end(wired):
    wire = wired(transcript := Transcript(*SETUP))
    transcript.assert_complete()
    assert wire.backend.limits.max_level == pytest.approx(200.0)
    assert wire.backend.limits.min_dwell == pytest.approx(9 / 50e6)
    transcript.expect(*upload_of_two_levels())
    wire.backend.upload(two_levels(wire))
    transcript.assert_complete()
    transcript.expect(*ARM, *TRIGGER, *off())
    wire.backend.start(Pacing())
    assert wire.listener.ended.wait(DEADLINE) and wire.listener.done
    transcript.assert_complete()
    assert wire.clock.now() - 100.0 == pytest.approx(0.015 * 1.0001 + 0.002)
    transcript.expect(*off())
    wire.backend.close()
    transcript.assert_complete()
    assert transcript.closed


def test_each_epoch_waits_for_its_own_trigger(wired):
    wire = wired(transcript := Transcript(*SETUP))
    played = sequence(wire.bench, [140.0, 0.0] * 2, [0.010, 0.005] * 2, [2, 4])
    entries = '"W1",1,repeatTilTrig,maintain,4,"W0",2000,repeat,maintain,4,"W1",1000,repeat,maintain,4'
    names = f'"STRESSBOT",{entries},{entries},"W1",1,repeatInf,maintain,4'
    transcript.expect(*upload_of_two_levels()[:-2], blocked("SOUR1:DATA:SEQ ", names.encode()), fine())
    wire.backend.upload(played)
    transcript.expect(*ARM, *TRIGGER, verified(), *TRIGGER, *off())
    wire.backend.start(Pacing())
    assert wire.listener.ended.wait(DEADLINE) and wire.listener.done
    transcript.assert_complete()
    assert wire.backend.progress().epoch == 2


def test_stop_in_the_middle_switches_off_at_once(wired):
    wire = wired(transcript := Transcript(*SETUP))
    transcript.expect(*upload_of_two_levels())
    wire.backend.upload(two_levels(wire))
    transcript.expect(*ARM, *TRIGGER, *off(), *off())  # by stop, and by the playback that ends
    wire.clock.at(0.004, wire.backend.stop)
    wire.backend.start(Pacing())
    wire.backend._thread.join()
    transcript.assert_complete()
    assert not wire.listener.ended.is_set()
    assert wire.backend.progress().time == pytest.approx(0.004)
    assert wire.backend.progress().level == 0.0


def test_the_scale_ends_where_the_amplifier_does(wired):
    wire_setup = list(SETUP)
    wire_setup[13:17] = [
        told("SOUR1:VOLT:OFFS 2.5000"),
        told("SOUR1:VOLT 5.0000"),
        told("SOUR1:VOLT:LIM:LOW 0.0000"),
        told("SOUR1:VOLT:LIM:HIGH 5.0000"),
    ]
    wire = wired(transcript := Transcript(*wire_setup), amplifier_max_voltage=100.0)
    transcript.assert_complete()
    assert (wire.backend.limits.min_level, wire.backend.limits.max_level) == (0.0, pytest.approx(100.0))


ERROR = '-222,"Data out of range"'


@pytest.mark.parametrize("step", [4, 6, 8])
def test_an_error_after_an_upload_is_quoted(wired, step):
    wire = wired(transcript := Transcript(*SETUP))
    upload = upload_of_two_levels()
    transcript.expect(*upload[:step], asked("SYST:ERR?", ERROR), asked("SYST:ERR?", '+880,"Arb: Out of memory"'), fine())
    with pytest.raises(StressbotError) as failed:
        wire.backend.upload(two_levels(wire))
    transcript.assert_complete()
    assert failed.value.code == ErrorCode.BACKEND_FAILURE
    assert ERROR in failed.value.message and '+880,"Arb: Out of memory"' in failed.value.message


def start_and_fail(wire):
    wire.backend.start(Pacing())
    assert wire.listener.ended.wait(DEADLINE)
    assert wire.listener.error.code == ErrorCode.BACKEND_FAILURE and not wire.listener.done
    return wire.listener.error.message


@pytest.mark.parametrize("step", [4, 7])
def test_an_error_at_start_ends_switched_off(wired, step):
    wire = wired(transcript := Transcript(*SETUP, *upload_of_two_levels()))
    wire.backend.upload(two_levels(wire))
    transcript.expect(*ARM[:step], asked("SYST:ERR?", ERROR), fine(), *off())
    assert ERROR in start_and_fail(wire)
    transcript.assert_complete()


OTHERS = ["NORM", "SIN", '"OTHER"', "+4.9E+07", "NORM", "+1E-01", "0", "VRMS", "-1", "+5", "0", "+50", "IMM"]


@pytest.mark.parametrize(("query", "answer"), list(zip(AS_TOLD, OTHERS, strict=True)))
def test_a_setting_that_did_not_stick_keeps_the_output_off(wired, query, answer):
    wire = wired(transcript := Transcript(*SETUP, *upload_of_two_levels()))
    wire.backend.upload(two_levels(wire))
    transcript.expect(*ARM[:5], verified(**{query: answer}), *off())
    assert query in (message := start_and_fail(wire)) and repr(answer) in message
    transcript.assert_complete()


def test_an_error_after_the_trigger_ends_switched_off(wired):
    wire = wired(transcript := Transcript(*SETUP, *upload_of_two_levels()))
    wire.backend.upload(two_levels(wire))
    transcript.expect(*ARM, told("*TRG"), asked("SYST:ERR?", '-211,"Trigger ignored"'), fine(), *off())
    assert "-211" in start_and_fail(wire)
    transcript.assert_complete()


def timeout():
    raise TimeoutError("no answer within 2 s")


def test_an_instrument_that_falls_silent_is_switched_off_over_a_second_connection(wired):
    first, second = Transcript(*SETUP, *upload_of_two_levels()), Transcript(*off())
    wire = wired(first)
    wire._connections = iter([second.switch])
    wire.backend.upload(two_levels(wire))
    first.expect(*ARM, told("*TRG"), asked("SYST:ERR?", timeout), told("OUTP1 OFF"), asked("OUTP1?", timeout))
    assert "no answer within 2 s" in start_and_fail(wire)
    first.assert_complete()
    second.assert_complete()
    assert first.switch.closed and not second.switch.closed


def test_an_output_that_nobody_can_switch_off_is_said_loudly(wired):
    wire = wired(first := Transcript(*SETUP, *upload_of_two_levels()))
    wire.backend.upload(two_levels(wire))
    first.expect(*ARM, told("*TRG"), asked("SYST:ERR?", timeout), told("OUTP1 OFF"), asked("OUTP1?", timeout))
    assert "THE OUTPUT MAY BE ON" in start_and_fail(wire)
    with pytest.raises(StressbotError, match="THE OUTPUT MAY BE ON.*no connection.*nobody listens"):
        wire.backend.stop()


def test_reset_opens_a_new_connection(wired, tmp_path):
    first, second = Transcript(*SETUP, *off()), Transcript(*SETUP)
    wire = wired(first, second)
    wire.backend.reset()
    first.assert_complete()
    second.assert_complete()
    assert first.closed
    assert len(list(tmp_path.glob("*.jsonl"))) == 2


def test_a_reset_that_reaches_nobody_leaves_nothing_connected_and_the_next_one_may(wired):
    first, second = Transcript(*SETUP, *off()), Transcript(*SETUP)
    wire = wired(first)
    with pytest.raises(StressbotError, match="nobody listens"):
        wire.backend.reset()
    first.assert_complete()
    assert first.closed and first.switch.closed
    wire.backend.stop()  # at rest since before the reset
    with pytest.raises(StressbotError, match="the connection is closed") as failed:
        wire.backend.upload(two_levels(wire))
    assert failed.value.code == ErrorCode.BACKEND_FAILURE
    wire._connections = iter([second, second.switch])
    wire.backend.reset()
    second.assert_complete()


def test_an_instrument_that_could_not_be_set_up_again_is_switched_off_by_stop(wired):
    first, second = Transcript(*SETUP, *off()), Transcript(*SETUP[:10], asked("SYST:ERR?", ERROR), fine())
    wire = wired(first, second)
    with pytest.raises(StressbotError, match="Data out of range"):
        wire.backend.reset()
    second.expect(*off())
    wire.backend.stop()
    second.assert_complete()


@pytest.mark.parametrize(
    ("identity", "code"),
    [("RIGOL TECHNOLOGIES,DG4162,DG4E0,00.01.14", ErrorCode.UNSUPPORTED), ("", ErrorCode.UNSUPPORTED)],
)
def test_an_instrument_without_a_table_is_not_spoken_to(wired, identity, code):
    transcript = Transcript(asked("*IDN?", identity))
    with pytest.raises(StressbotError) as refused:
        wired(transcript)
    transcript.assert_complete()
    assert refused.value.code == code and "Keysight 33500/33600" in refused.value.message
    assert transcript.closed


def test_a_33600_has_longer_shortest_waveforms(wired):
    wire = wired(Transcript(asked("*IDN?", "Keysight Technologies,33622A,MY1,A.02.03"), *SETUP[1:]))
    assert wire.backend.limits.min_dwell == pytest.approx(33 / 50e6)


@pytest.mark.parametrize("answer", ["", "MAX", "-1", "+INF", "0"])
def test_an_answer_that_is_no_number_is_refused(wired, answer):
    with pytest.raises(StressbotError, match="SOUR1:FUNC:ARB:SRAT. MAX answers"):
        wired(Transcript(*SETUP[:11], asked("SOUR1:FUNC:ARB:SRAT? MAX", answer), *off()))


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"visa_resource": ""}, "waveform_generator.visa_resource"),
        ({"amplifier_gain": 0.0}, "waveform_generator.amplifier_gain"),
        ({"amplifier_max_voltage": 0.0}, "waveform_generator.amplifier_max_voltage"),
    ],
)
def test_what_must_be_known_must_be_given(wired, options, field):
    with pytest.raises(StressbotError) as refused:
        wired(**options)
    assert (refused.value.code, refused.value.field) == (ErrorCode.MISSING_FIELD, field)


def test_a_sample_rate_beyond_the_instrument_is_refused(wired):
    with pytest.raises(StressbotError) as refused:
        wired(Transcript(*SETUP[:12], *off()), sample_rate=100e6)
    assert (refused.value.code, refused.value.field) == (ErrorCode.LIMIT_EXCEEDED, "waveform_generator.sample_rate")


def test_everything_sent_is_in_the_record(wired, tmp_path):
    wire = wired(transcript := Transcript(*SETUP, *upload_of_two_levels(), *off()))
    wire.backend.upload(two_levels(wire))
    wire.backend.close()
    transcript.assert_complete()
    (path,) = tmp_path.glob("*.jsonl")
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    sent = [line["sent"] for line in lines if "sent" in line]
    exchange = [*SETUP, *upload_of_two_levels(), *off()]
    assert len(sent) == len(exchange)
    for line, (message, _) in zip(sent, exchange, strict=True):
        assert message.startswith(line.encode())
    assert [line["block_bytes"] for line in lines if "block_bytes" in line][:2] == [500, 500]
    assert [line["received"] for line in lines if "received" in line] == [answer for _, answer in exchange if answer]
    times = [line["time"] for line in lines]
    assert times == sorted(times)


def test_a_record_that_cannot_be_written_ends_in_a_fault_and_the_output_off(wired):
    wire = wired(transcript := Transcript(*SETUP, *upload_of_two_levels()))
    wire.backend.upload(two_levels(wire))
    recorder = wire.backend._generator._recorder
    recorder.flush()
    recorder._file.close()
    recorder._file = open("/dev/full", "wb", buffering=0)  # noqa: SIM115 # what a full disk answers
    transcript.expect(*ARM[:5], *off())
    assert "No space left" in start_and_fail(wire)
    transcript.assert_complete()


def test_a_folder_that_cannot_be_written_is_refused_at_once(wired, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StressbotError, match="cannot be written"):
        wired(Transcript(*SETUP[:11], *off()), record_folder=str(tmp_path / "file"))


class Stubborn(Transport):
    """Answers anything at all; remembers what it was last told about its output."""

    def __init__(self, answers):
        self.answers = iter(answers)
        self.on = False

    def send(self, message):
        if message.startswith(b"OUTP1 O"):
            self.on = message == b"OUTP1 ON\n"

    def receive(self):
        answer = next(self.answers, None)
        if answer is None:
            raise TimeoutError("no answer within 2 s")
        return answer

    def close(self):
        pass


sensible = st.sampled_from([IDENTITY, NO_ERROR, "0", "1", "+6.25E+07", "+2E+01", "+1000000", "ARB", "OFF", "+1E+01", "BUS"])
expected_answers = [answer for _, answer in [*SETUP, *upload_of_two_levels(), *ARM, *TRIGGER, *off()] if answer]


@settings(deadline=None, max_examples=150)
@given(
    st.integers(0, len(expected_answers)),
    st.lists(st.one_of(sensible, st.text(max_size=20), st.floats().map(str)), max_size=12),
)
def test_no_answer_crashes_the_driver_or_leaves_it_without_a_word(tmp_path_factory, sane, answers):
    """After `sane` proper answers come others, then silence: refused, or a fault, and off was the last it was told."""
    stubborn = Stubborn([*expected_answers[:sane], *answers])
    connections = iter([stubborn, stubborn])
    wire = None
    try:
        wire = Wire(tmp_path_factory.getbasetemp() / "stubborn", connect=lambda: next(connections))
        wire.backend.upload(two_levels(wire))
        wire.backend.start(Pacing())
        assert wire.listener.ended.wait(DEADLINE)
    except StressbotError as refused:
        assert refused.code in (ErrorCode.BACKEND_FAILURE, ErrorCode.UNSUPPORTED, ErrorCode.LIMIT_EXCEEDED)
    assert not stubborn.on
    if wire is not None:
        wire.backend._generator.close()


def test_nothing_is_started_twice_or_without_a_sequence(wired):
    wire = wired(Transcript(*SETUP, *upload_of_two_levels()))
    with pytest.raises(StressbotError) as refused:
        wire.backend.start(Pacing())
    assert refused.value.code == ErrorCode.NOTHING_LOADED
    wire.backend.upload(two_levels(wire))
    with pytest.raises(StressbotError) as refused:
        wire.backend.start(Pacing(real_time_factor=0.0))
    assert refused.value.code == ErrorCode.UNSUPPORTED
    wire.backend._playing = True
    for request in (lambda: wire.backend.upload(two_levels(wire)), lambda: wire.backend.start(Pacing()), wire.backend.reset):
        with pytest.raises(StressbotError) as refused:
            request()
        assert refused.value.code == ErrorCode.BUSY


def test_a_level_that_the_amplifier_does_not_reach_in_time_is_refused(wired):
    wire = wired(Transcript(*SETUP), amplifier_slew_rate=20_000.0)
    with pytest.raises(StressbotError) as refused:
        check_sequence(sequence(wire.bench, [140.0, 0.0], [0.010, 0.005], [2]), wire.bench.swarm_id, wire.backend.limits)
    assert (refused.value.code, refused.value.field) == (ErrorCode.LIMIT_EXCEEDED, "dwells[1]")
