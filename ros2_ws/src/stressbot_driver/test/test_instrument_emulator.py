"""The emulated instrument: it understands the wire by itself, refuses what a real one refuses, and never exceeds its limits."""

import itertools

import numpy as np
import pytest
from driver_support import FakeClock
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_driver.instruments.emulator import COMMANDS, VOLTS, Emulator, Port
from stressbot_driver.instruments.scpi import MAX_LINE, Reader, header_pattern

FINE = '+0,"No error"'


class Rig:
    def __init__(self, **arguments):
        self.clock = FakeClock()
        self.played = []
        self.emulator = Emulator(self.clock, lambda volts, seconds: self.played.append((volts, seconds)), **arguments)
        self.port = Port(self.emulator)

    def send(self, *messages):
        """Answers of all messages; blocks are bytes within them."""
        data = b"".join((message.encode() if isinstance(message, str) else message) + b"\n" for message in messages)
        return self.port.feed(data).decode().splitlines()

    def errors(self):
        found = []
        while (answer := self.send("SYST:ERR?")) != [FINE]:
            found += answer
        return found

    def refuse(self, number, *messages):
        assert self.errors() == []
        self.send(*messages)
        (error,) = self.errors()
        assert error.startswith(f"{number:+d},"), error

    def wait(self, seconds):
        self.clock.time += seconds
        self.emulator.advance()


def block(data):
    size = str(len(data))
    return f"#{len(size)}{size}".encode() + data


def waveform(name, *values, header="DATA:ARB:DAC"):
    return f"{header} {name},".encode() + block(np.array(values, dtype=">i2").tobytes())


def sequence(name, *entries):
    return b"DATA:SEQ " + block(",".join([f'"{name}"', *(f'"{n}",{r},{c},maintain,4' for n, r, c in entries)]).encode())


LOW, HIGH = waveform("LOW", *[-32767] * 10), waveform("HIGH", *[32767] * 10)
PULSE = sequence("PULSE", ("LOW", 1, "repeatTilTrig"), ("HIGH", 100, "repeat"), ("LOW", 1, "repeatInf"))
READY = (
    "*RST", "OUTP:LOAD INF", "VOLT:OFFS 2.5", "VOLT 5", "VOLT:LIM:LOW 0", "VOLT:LIM:HIGH 5", "VOLT:LIM:STAT ON", LOW, HIGH, PULSE,
    "FUNC:ARB PULSE", "FUNC ARB", "FUNC:ARB:SRAT 1e6", "FUNC:ARB:FILT OFF", "TRIG:SOUR BUS",
)  # fmt: skip


@pytest.fixture
def rig():
    return Rig()


@pytest.fixture
def ready(rig):
    rig.send(*READY)
    assert rig.errors() == []
    return rig


# The grammar


def test_headers_have_long_and_short_forms_and_optional_parts():
    pattern = header_pattern("[SOURce#:]VOLTage[:LEVel][:IMMediate][:AMPLitude]")
    for header in ("VOLT", "voltage", "SOUR1:VOLT", "source2:Volt:LEV:imm:AMPL", "SOUR:VOLTAGE:IMM"):
        assert pattern.fullmatch(header), header
    for header in ("VOLTA", "SOU1:VOLT", "SOUR1VOLT", "VOLT:OFFS", "1VOLT", "VOLT1"):
        assert not pattern.fullmatch(header), header
    assert header_pattern("*IDN").fullmatch("*idn")
    assert not header_pattern("*IDN").fullmatch("IDN")


def test_messages_are_cut_at_line_feeds_outside_of_blocks_however_they_arrive():
    stream = b"*IDN?\r\nDATA:ARB:DAC W," + block(b"\n\n#9\n") + b"\nOUTP ON;:OUTP?\n"
    expected = [b"*IDN?", b"DATA:ARB:DAC W," + block(b"\n\n#9\n"), b"OUTP ON;:OUTP?"]
    assert Reader().feed(stream) == expected
    reader = Reader()
    assert list(itertools.chain.from_iterable(reader.feed(stream[k : k + 1]) for k in range(len(stream)))) == expected


def test_two_commands_in_a_message(rig):
    assert rig.send("OUTP:LOAD INF;:OUTP:LOAD?;*OPC?") == ["+9.90000000000000E+37;1"]


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (-113, "FOO:BAR 1"),
        (-113, "OUTP1:FOO?"),
        (-113, "*IDN"),
        (-113, "*TRG?"),
        (-113, "VOLT 1;OFFS 1"),
        (-114, "OUTP3 ON"),
        (-114, "SOUR0:VOLT 1"),
        (-108, "OUTP ON,OFF"),
        (-108, "*IDN? 5"),
        (-109, "OUTP"),
        (-109, "DATA:ARB:DAC W"),
        (-104, "VOLT much"),
        (-121, "VOLT 1V5"),
        (-224, "OUTP MAYBE"),
        (-224, "FUNC WAVY"),
        (-224, "VOLT:UNIT V"),
        (-101, b"OUT\xffP ON"),
        (-151, 'FUNC:ARB "open'),
        (-151, 'FUNC:ARB "a b"'),
        (-161, b"DATA:SEQ #0abc"),
        (-104, "DATA:SEQ abc"),
        (-161, b"DATA:ARB:DAC W," + block(b"123")),
        (-363, "A" * (MAX_LINE + 1)),
        (-223, b"DATA:ARB:DAC W,#9999999999"),
    ],
)
def test_what_is_no_command_is_refused(rig, number, message):
    rig.refuse(number, message)


def test_a_refused_command_changes_nothing_and_ends_its_message(ready):
    ready.refuse(-222, "VOLT 50;:VOLT 1")
    assert ready.send("VOLT?") == ["+5.00000000000000E+00"]


def test_errors_queue_up_and_the_last_place_tells_of_an_overflow(rig):
    rig.send(*["FOO"] * 25)
    errors = rig.errors()
    assert errors[:19] == ['-113,"Undefined header"'] * 19 and errors[19:] == ['-350,"Queue overflow"']
    rig.send("FOO", "*CLS")
    assert rig.errors() == []


# Volts


def test_the_display_follows_the_assumed_load_and_the_volts_do_not(rig):
    rig.send("OUTP:LOAD 50", "VOLT 2", "VOLT:OFFS 1", "OUTP:LOAD INF")
    assert rig.send("VOLT?", "VOLT:OFFS?") == ["+4.00000000000000E+00", "+2.00000000000000E+00"]
    assert rig.send("VOLT? MAX") == ["+1.60000000000000E+01"]
    rig.send("VOLT:OFFS 0")
    assert rig.send("VOLT? MAX", "OUTP:LOAD 50;:VOLT? MAX") == ["+2.00000000000000E+01", "+1.00000000000000E+01"]


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (-222, "VOLT 20.01"),
        (-222, "VOLT 0"),
        (-222, "VOLT -1"),
        (-222, "VOLT 1e999"),
        (-222, "VOLT:OFFS 9.96"),
        (-222, "VOLT:LIM:HIGH 11"),
        (-222, "VOLT:LIM:LOW 11"),
        (-221, "VOLT:LIM:LOW 0;:VOLT:LIM:STAT ON"),
        (-222, "OUTP:LOAD 0.5"),
        (-222, "OUTP:LOAD 20000"),
        (-221, "VOLT:UNIT DBM"),
        (-222, "FUNC:ARB:SRAT 1e10"),
    ],
)
def test_volts_and_rates_beyond_the_instrument_are_refused(rig, number, message):
    rig.send("OUTP:LOAD INF")
    rig.refuse(number, message)


@pytest.mark.parametrize(
    "message", ["VOLT 5.1", "VOLT:OFFS 2.6", "VOLT:OFFS 2.4", "OUTP:LOAD 50", "VOLT:LIM:HIGH 4.9", "VOLT:LIM:LOW 0.1"]
)
def test_limits_guard_the_levels_and_the_load(ready, message):
    ready.refuse(-221, message)


def test_the_filter_bounds_the_sample_rate(rig):
    rig.send("FUNC:ARB:SRAT 100e6")
    rig.refuse(-221, "FUNC:ARB:FILT OFF")
    rig.send("FUNC:ARB:SRAT 62.5e6", "FUNC:ARB:FILT OFF")
    rig.refuse(-222, "FUNC:ARB:SRAT 62.6e6")
    assert rig.send("FUNC:ARB:SRAT? MAX") == ["+6.25000000000000E+07"]


# Waveforms and sequences


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (-222, waveform("SHORT", *[0] * 7)),
        (-222, "DATA:ARB:DAC OFF_SCALE,0,0,0,0,0,0,0,32768"),
        (-222, "DATA:ARB OFF_SCALE,0,0,0,0,0,0,0,1.1"),
        (783, waveform("A_NAME_OF_13_", *[0] * 8)),
        (-200, waveform("low", *[0] * 8)),
        (-200, waveform("PULSE", *[0] * 8)),
        (785, "FUNC:ARB NOBODY"),
        (785, sequence("S", ("LOW", 1, "once"), ("NOBODY", 1, "once"), ("LOW", 1, "repeatInf"))),
        (-222, sequence("S", ("LOW", 1, "once"), ("LOW", 1, "repeatInf"))),
        (-222, sequence("S", *[("LOW", 1, "once")] * 512, ("LOW", 1, "repeatInf"))),
        (-222, sequence("S", ("LOW", 0, "repeat"), ("LOW", 1, "once"), ("LOW", 1, "repeatInf"))),
        (-222, sequence("S", ("LOW", 1_000_001, "repeat"), ("LOW", 1, "once"), ("LOW", 1, "repeatInf"))),
        (-224, sequence("S", ("LOW", 1, "thrice"), ("LOW", 1, "once"), ("LOW", 1, "repeatInf"))),
        (-221, sequence("S", ("LOW", 1, "once"), ("HIGH", 1, "once"), ("LOW", 1, "once"))),
        (-109, b"DATA:SEQ " + block(b'"S","LOW",1,once,maintain')),
        (-222, b"DATA:SEQ " + block(b'"S"' + b',"LOW",1,once,maintain,8' * 3)),
        (-200, sequence("PULSE", ("LOW", 1, "once"), ("HIGH", 1, "once"), ("LOW", 1, "repeatInf"))),
    ],
)
def test_what_cannot_be_played_is_refused(ready, number, message):
    ready.refuse(number, message)


def test_memory_is_handed_out_in_blocks_until_it_is_full():
    rig = Rig(memory=1024)
    rig.send(waveform("A", *[0] * 129))
    assert rig.send("DATA:VOL:FREE?") == ["+768"]
    rig.refuse(880, waveform("B", *[0] * 769))
    rig.send(waveform("B", *[0] * 512))
    assert rig.send("DATA:VOL:FREE?", "DATA:VOL:CAT?") == ["+256", '"A","B"']
    rig.refuse(880, sequence("S", ("A", 1, "once"), ("A", 1, "once"), ("A", 1, "repeatInf")))
    rig.send("DATA:VOL:CLE")
    assert rig.send("DATA:VOL:FREE?") == ["+1024"]


def test_bytes_have_an_order(rig):
    rig.send("FORM:BORD SWAP", b"DATA:ARB:DAC W," + block(np.array([-32768, *[32767] * 9], dtype="<i2").tobytes()))
    assert rig.errors() == []
    assert rig.emulator._channels[0].waveforms["W"].tolist() == [-1.0] + [1.0] * 9


@pytest.mark.parametrize("message", ["FUNC:ARB PULSE", "FUNC SIN", "FUNC:ARB:SRAT 2e6", "FUNC:ARB:FILT STEP", "DATA:VOL:CLE"])
def test_a_live_output_is_not_meddled_with(ready, message):
    ready.send("OUTP ON")
    ready.refuse(-221, message)
    assert ready.send("OUTP?", "FUNC:ARB:SRAT?", "FUNC:ARB?") == ["1", "+1.00000000000000E+06", '"PULSE"']


def test_an_output_is_switched_on_only_with_a_sequence_that_was_just_selected(rig):
    rig.refuse(-221, "OUTP ON")
    rig.send(*READY, "OUTP ON", "OUTP OFF")
    rig.refuse(-221, "OUTP ON")
    rig.send("FUNC:ARB PULSE", "OUTP ON")
    assert rig.errors() == []


# What comes out


def test_a_sequence_waits_plays_to_the_sample_and_holds(ready):
    ready.send("OUTP ON")
    ready.wait(0.5)
    assert ready.emulator.waiting and ready.emulator.volts == 0.0
    ready.played.clear()
    ready.send("*TRG")
    ready.wait(0.0004)
    assert ready.emulator.volts == 5.0 and not ready.emulator.waiting
    ready.wait(0.0016)
    assert ready.emulator.waiting
    seconds = {volts: sum(s for v, s in ready.played if v == volts) for volts in (0.0, 5.0)}
    assert seconds == {0.0: pytest.approx(0.001, abs=1e-9), 5.0: pytest.approx(0.001, abs=1e-12)}
    ready.refuse(-211, "*TRG")


def test_a_trigger_that_nobody_waits_for_is_ignored_with_an_error(ready):
    ready.refuse(-211, "*TRG")
    ready.send("OUTP ON", "*TRG")
    ready.refuse(-211, "*TRG")
    ready.send("OUTP OFF", "TRIG:SOUR EXT", "FUNC:ARB PULSE", "OUTP ON")
    ready.refuse(-211, "*TRG")


def test_off_is_zero_volts_at_once(ready):
    ready.send("OUTP ON", "*TRG")
    ready.wait(0.0005)
    ready.played.clear()
    ready.send("OUTP OFF")
    ready.wait(1.0)
    assert ready.emulator.volts == 0.0
    assert {volts for volts, _ in ready.played} == {0.0}


def test_a_sequence_starts_again_after_its_last_entry(ready):
    ready.send(sequence("LOOP", ("LOW", 1, "onceWaitTrig"), ("HIGH", 100, "repeat"), ("LOW", 100, "repeat")))
    ready.send("FUNC:ARB LOOP", "OUTP ON", "*TRG")
    assert ready.errors() == []
    ready.wait(0.0025)
    assert ready.emulator.waiting
    ready.send("*TRG")
    assert ready.errors() == []


def test_a_waveform_of_several_levels_is_rendered_step_by_step(ready):
    ready.send(waveform("STAIRS", *[-32767] * 4, *[0] * 4, *[32767] * 4))
    ready.send(sequence("S", ("LOW", 1, "repeatTilTrig"), ("STAIRS", 3, "repeat"), ("LOW", 1, "repeatInf")))
    ready.send("FUNC:ARB S", "OUTP ON", "*TRG")
    assert ready.errors() == []
    ready.played.clear()
    ready.wait(18e-6)
    ready.wait(18e-6)
    assert [volts for volts, _ in ready.played if volts] == [2.5, 5.0, 2.5, 2.5, 5.0, 2.5, 5.0]
    assert sum(seconds for volts, seconds in ready.played if volts == 5.0) == pytest.approx(12e-6)


# Any bytes whatever

words = st.sampled_from(
    [header.replace("[", "").replace("]", "").replace("#", "") for header, *_ in COMMANDS] + ["SOUR2", "LIM", "ON", "OFF"]
)
pieces = st.one_of(
    words.map(str.encode),
    st.sampled_from([b" ", b",", b";", b":", b"?", b"\n", b"#", b'"', b"*", b"ON", b"1", b"INF", b"MAX", b"ARB", b"PULSE", b"BUS"]),
    st.floats(-30, 30).map(lambda value: f"{value:.3g}".encode()),
    st.binary(max_size=12),
    st.binary(max_size=40).map(block),
    st.sampled_from([LOW, HIGH, PULSE, b"OUTP ON", b"OUTP OFF", b"*TRG", b"*RST", b"FUNC ARB", b"FUNC:ARB PULSE"]).map(
        lambda message: b"\n" + message + b"\n"
    ),
    st.tuples(st.sampled_from([b"VOLT", b"VOLT:OFFS", b"VOLT:LIM:LOW", b"VOLT:LIM:HIGH", b"OUTP:LOAD"]), st.floats(-12, 22)).map(
        lambda pair: b"\n" + pair[0] + f" {pair[1]:.3f}".encode() + b"\n"
    ),
)


@settings(deadline=None, max_examples=200)
@given(st.lists(pieces, max_size=40), st.booleans())
def test_no_bytes_crash_it_or_drive_it_beyond_its_limits(drawn, limited):
    rig = Rig()
    rig.send(*READY)
    if not limited:
        rig.send("VOLT:LIM:STAT OFF")
    for piece in drawn:
        rig.port.feed(piece)
        rig.wait(3e-4)
        channel = rig.emulator._channels[0]
        low, high = (channel.limit_low, channel.limit_high) if channel.limits_on else (-VOLTS, VOLTS)
        for volts, seconds in rig.played:
            assert seconds >= 0.0 and -VOLTS - 1e-9 <= volts <= VOLTS + 1e-9
        if rig.emulator.volts:
            assert low - 1e-9 <= rig.emulator.volts <= high + 1e-9
        rig.played.clear()
    rig.port.feed(b"\n" * 3)
    fresh = Port(rig.emulator)
    assert fresh.feed(b"*RST\n*CLS\nSYST:ERR?\n") == FINE.encode() + b"\n"
