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

    A function in place of an answer is called, to fail or to do something at that moment.
    """

    def __init__(self, *exchange):
        self.exchange = list(exchange)
        self.closed = False
        self._answer = None

    def expect(self, *exchange):
        self.exchange += exchange

    def send(self, message):
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


def told(line):
    return (line.encode() + b"\n", None)


def asked(line, answer):
    return (line.encode() + b"\n", answer)


def blocked(line, data):
    digits = str(len(data))
    return (line.encode() + f"#{len(digits)}{digits}".encode() + data + b"\n", None)


def fine():
    return asked("SYST:ERR?", NO_ERROR)


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
    asked("SOUR1:FUNC?", "ARB"),
    asked("SOUR1:FUNC:ARB:SRAT?", "+5.000000000000000E+07"),
    asked("SOUR1:FUNC:ARB:FILT?", "OFF"),
    asked("SOUR1:VOLT?", "+1.000000000000000E+01"),
    asked("SOUR1:VOLT:OFFS?", "+5.000000000000000E+00"),
    asked("SOUR1:VOLT:LIM:STAT?", "1"),
    asked("OUTP1:LOAD?", "+9.900000000000000E+37"),
    asked("TRIG1:SOUR?", "BUS"),
    told("OUTP1 ON"),
    fine(),
]
TRIGGER = [told("*TRG"), fine()]


def codes(level, samples):
    """A constant waveform at `level` [V on the substrate] as it goes over the wire."""
    code = round((level / GAIN - 5.0) / 5.0 * 32767)
    return np.full(samples, code, dtype="<i2").tobytes()


class Wire:
    """A backend on transcripts: one for each connection that it opens."""

    def __init__(self, folder, *transcripts, connect=None, **options):
        self.bench = bench(2)
        self.clock = FakeClock()
        self.listener = Recorder()
        self.transcripts = list(transcripts)
        self._connections = iter(self.transcripts)
        options = {"visa_resource": "any", "record_folder": str(folder), **AMPLIFIER, **options}
        self.backend = WaveformGeneratorBackend(self.bench, self.clock, self.listener, options, connect=connect or self._connect)

    def _connect(self):
        transcript = next(self._connections, None)
        if transcript is None:
            raise ConnectionRefusedError("nobody listens")
        return transcript


class EmulatedBench:
    """A backend, the emulator over TCP, the amplifier and the substrate; one clock for all."""

    def __init__(self, folder, count=6, clock=None, memory=1_000_000, listener=None, **options):
        self.bench = bench(count)
        self.clock = clock or FakeClock()
        self.substrate = Substrate(self.bench)
        self.volts = []  # [V] on the substrate, with their durations [s]
        self.emulator = Emulator(self.clock, self._play, memory=memory)
        self.server = EmulatorServer(self.emulator)
        self.listener = listener or Recorder()
        self.options = {
            "visa_resource": f"TCPIP0::127.0.0.1::{self.server.port}::SOCKET",
            "record_folder": str(folder),
            **AMPLIFIER,
            **options,
        }
        self.backend = None

    def open(self):
        self.backend = WaveformGeneratorBackend(self.bench, self.clock, self.listener, self.options)
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
