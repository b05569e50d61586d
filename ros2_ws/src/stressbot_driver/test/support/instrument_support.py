"""An instrument for tests: exact transcripts, and a bench with the emulated one on a TCP port."""

import re

import numpy as np
from driver_support import FakeClock, Recorder, bench

from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.instruments.emulator import Emulator
from stressbot_driver.instruments.emulator_server import EmulatorServer
from stressbot_driver.instruments.transport import Transport
from stressbot_driver.simulation.substrate import Substrate

GAIN = 20.0
AMPLIFIER = {"amplifier_gain": GAIN, "amplifier_max_voltage": 200.0}
IDENTITY = "Agilent Technologies,33522B,MY00000000,3.03-1.19-2.00-52-00"
NO_ERROR = '+0,"No error"'


class Transcript(Transport):
    """Expects an exact exchange: messages as bytes, each followed by its answer if there is one.

    A function in place of an answer is called, to fail or to do something at that moment. `switch` is the instrument's second
    connection, on the same transcript: the output is switched off over that one only, and nothing else said.
    """

    def __init__(self, *exchange):
        self.exchange = list(exchange)
        self.closed = False
        self._answer = None
        self.switch = _Switch(self)

    def expect(self, *exchange):
        self.exchange += exchange

    def send(self, message):
        if self.closed:
            raise OSError("the connection is closed")
        off = b"OUTP1 OFF\n", b"OUTP1?\n"
        assert message not in off or message == off[0] and self.exchange[1][0] == b"*RST\n", "off over the wrong connection"
        self.take(message)

    def take(self, message):
        assert self._answer is None, f"{self._answer!r} was not read before {message!r}"
        assert self.exchange, f"unexpected {message!r}"
        expected, answer = self.exchange.pop(0)
        assert message == expected
        self._answer = answer

    def receive(self):
        answer, self._answer = self._answer, None
        assert answer is not None, "nothing was asked"
        return answer() if callable(answer) else answer

    def close(self):
        self.closed = True

    def assert_complete(self):
        assert not self.exchange, f"not sent: {self.exchange}"
        assert self._answer is None


class _Switch(Transport):
    def __init__(self, transcript):
        self.transcript = transcript
        self.closed = False

    def send(self, message):
        assert message in (b"OUTP1 OFF\n", b"OUTP1?\n")
        self.transcript.take(message)

    def receive(self):
        return self.transcript.receive()

    def close(self):
        self.closed = True


def told(line):
    return (line.encode() + b"\n", None)


def asked(line, answer):
    return (line.encode() + b"\n", answer)


def blocked(line, data):
    digits = str(len(data))
    return (line.encode() + f"#{len(digits)}{digits}".encode() + data + b"\n", None)


def fine():
    return asked("SYST:ERR?", NO_ERROR)


AS_TOLD = {
    "FORM:BORD?": "SWAP",
    "SOUR1:FUNC?": "ARB",
    "SOUR1:FUNC:ARB?": '"STRESSBOT"',
    "SOUR1:FUNC:ARB:SRAT?": "+5.000000000000000E+07",
    "SOUR1:FUNC:ARB:FILT?": "OFF",
    "SOUR1:VOLT?": "+1.000000000000000E+01",
    "SOUR1:VOLT:OFFS?": "+5.000000000000000E+00",
    "SOUR1:VOLT:UNIT?": "VPP",
    "SOUR1:VOLT:LIM:LOW?": "+0.000000000000000E+00",
    "SOUR1:VOLT:LIM:HIGH?": "+1.000000000000000E+01",
    "SOUR1:VOLT:LIM:STAT?": "1",
    "OUTP1:LOAD?": "+9.900000000000000E+37",
    "TRIG1:SOUR?": "BUS",
}


def verified(**_changes):
    """The question how everything is set, and the answer, some of it otherwise."""
    return asked(";:".join(AS_TOLD), ";".join((AS_TOLD | _changes).values()))


def off():
    return [told("OUTP1 OFF"), asked("OUTP1?", "0")]


SETUP = [
    asked("*IDN?", IDENTITY),
    told("OUTP1 OFF"),
    told("*RST"),
    told("*CLS"),
    told("OUTP1:LOAD INF"),
    told("SOUR1:VOLT:UNIT VPP"),
    told("SOUR1:DATA:VOL:CLE"),
    told("SOUR1:FUNC:ARB:FILT OFF"),
    told("FORM:BORD SWAP"),
    told("TRIG1:SOUR BUS"),
    fine(),
    asked("SOUR1:FUNC:ARB:SRAT? MAX", "+6.250000000000000E+07"),
    asked("SOUR1:VOLT? MAX", "+2.000000000000000E+01"),
    told("SOUR1:VOLT:OFFS 5.0000"),
    told("SOUR1:VOLT 10.0000"),
    told("SOUR1:VOLT:LIM:LOW 0.0000"),
    told("SOUR1:VOLT:LIM:HIGH 10.0000"),
    told("SOUR1:VOLT:LIM:STAT ON"),
    fine(),
    asked("SOUR1:DATA:VOL:FREE?", "+1000000"),
]
ARM = [
    told('SOUR1:FUNC:ARB "STRESSBOT"'),
    told("SOUR1:FUNC ARB"),
    told("SOUR1:FUNC:ARB:SRAT 50000000"),
    told("SOUR1:FUNC:ARB:FILT OFF"),
    fine(),
    verified(),
    told("OUTP1 ON"),
    fine(),
]
TRIGGER = [told("*TRG"), fine()]


def codes(level, samples):
    """A constant waveform at `level` [V on the substrate] as it goes over the wire."""
    code = round((level / GAIN - 5.0) / 5.0 * 32767)
    return np.full(samples, code, dtype="<i2").tobytes()


class Wire:
    """A backend on transcripts: one for each pair of connections that it opens."""

    def __init__(self, folder, *transcripts, connect=None, **options):
        self.bench = bench(2)
        self.clock = FakeClock()
        self.listener = Recorder()
        self.transcripts = list(transcripts)
        self._connections = (connection for one in self.transcripts for connection in (one, one.switch))
        options = {"visa_resource": "any", "record_folder": str(folder), **AMPLIFIER, **options}
        connect = connect or self._connect
        self.backend = WaveformGeneratorBackend(self.bench, self.clock, self.listener, options, connect=connect, watch=0)

    def _connect(self):
        transcript = next(self._connections, None)
        if transcript is None:
            raise ConnectionRefusedError("nobody listens")
        return transcript


class EmulatedBench:
    """A backend, the emulator over TCP, the amplifier and the substrate; one clock for all."""

    def __init__(self, folder, count=6, clock=None, memory=1_000_000, listener=None, watch=0.0, changes=None, **options):
        self.bench = bench(count, **(changes or {}))
        self.clock = clock or FakeClock()
        self.substrate = Substrate(self.bench)
        self.volts = []  # [V] on the substrate, with their durations [s]
        self.trains = []  # patterns of the generator's volts, and how often they were repeated
        self.emulator = Emulator(self.clock, self._play, memory=memory, repeated=self._repeat)
        self.server = EmulatorServer(self.emulator)
        self.listener = listener or Recorder()
        self.options = {
            "visa_resource": f"TCPIP0::127.0.0.1::{self.server.port}::SOCKET",
            "record_folder": str(folder),
            **AMPLIFIER,
            **options,
        }
        self.backend = None
        self._watch = watch

    def open(self):
        self.backend = WaveformGeneratorBackend(self.bench, self.clock, self.listener, self.options, watch=self._watch)
        return self.backend

    def _play(self, volts, seconds):
        level = volts * GAIN
        if level != self.substrate.level:
            self.substrate.apply(level)
        self.substrate.advance(seconds)
        if self.volts and self.volts[-1][0] == level:
            self.volts[-1] = (level, self.volts[-1][1] + seconds)
        else:
            self.volts.append((level, seconds))

    def _repeat(self, pattern, count):
        self.substrate.repeat([(volts * GAIN, seconds) for volts, seconds in pattern], count)
        self.trains.append((pattern, count))

    def deviation(self, expected):
        """Largest distance [units] and turn [rad] between the robots and poses (n, 3) [m, m, rad]."""
        with self.server.lock:
            self.emulator.advance()
            poses = self.substrate.poses()
        distance = np.hypot(poses.x - expected[:, 0], poses.y - expected[:, 1]).max() / self.bench.length_unit
        return distance, np.abs(np.angle(np.exp(1j * (poses.heading - expected[:, 2])))).max()

    def send(self, *lines):
        """Answers of the emulator to lines, as if from another connection."""
        with self.server.lock:
            return [self.emulator.execute(re.sub(r"\s+", " ", line).encode()) for line in lines]

    def close(self):
        if self.backend is not None:
            self.backend.close()
        self.server.close()
