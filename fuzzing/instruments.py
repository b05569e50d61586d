"""Instruments: a client whose instrument lies, falls silent and babbles; an emulated instrument that is told anything."""

import socket
import threading
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import mkdtemp

from driver_support import FakeClock, Recorder, bench, encode
from hypothesis import strategies as st
from instrument_support import AMPLIFIER, GAIN

from fuzzing.interface import ACCEPTED, Interface, Violation, check_refusal, outcome
from fuzzing.strategies import NUMBERS, spliced
from stressbot_driver.backends.base import Pacing
from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.errors import StressbotError
from stressbot_driver.instruments.emulator import VOLTS, Emulator, Port
from stressbot_driver.instruments.transport import Transport, VisaTransport
from stressbot_driver.session import Session, State

SCRATCH = Path(mkdtemp(prefix="stressbot-fuzz-record-"))
BENCH = bench(2)
GOOD = encode(BENCH, [(1, 0.02), (3, 0.01)])

ANSWERS = st.one_of(
    st.sampled_from(
        [
            "",
            "0",
            "1",
            "+0",
            "-0,",
            '+0,"No error"',
            "0,",
            '-222,"Data out of range"',
            "nan",
            "inf",
            "-1",
            "1e400",
            "9.9E+37",
            "9" * 500,
            "1_000",
            "ARB",
            '"ARB"',
            "OFF",
            "BUS",
            "\0",
            "{channel}",
            "%s",
            "ON;ON",
            "0;0",
            "Agilent Technologies,33522B,",
            "Keysight Technologies,33622A,MY1,1",
            "Tektronix,AFG1022,1,1",
            "#15hello",
            "\ud800",
        ]
    ),
    NUMBERS.map(repr),
    st.text(max_size=12),
)


class Lie:
    """In place of an answer: another one, or nothing at all."""

    def __init__(self, answer: str | None) -> None:
        self.answer = answer

    def __repr__(self) -> str:
        return f"Lie({self.answer!r})"


class Loopback(Transport):
    """Straight into an emulated instrument; `lies` (by the number of the exchange) come instead of its answers."""

    def __init__(self, emulator: Emulator, lies: dict[int, Lie] | None = None, count: list[int] | None = None) -> None:
        self._port = Port(emulator)
        self._lies = lies or {}
        self._count = count if count is not None else [0]
        self._answers = b""

    def send(self, message: bytes) -> None:
        """Hand a message to the emulator."""
        self._answers += self._port.feed(message)

    def receive(self) -> str:
        """The next answer, or the lie."""
        line, _, self._answers = self._answers.partition(b"\n")
        self._count[0] += 1
        lie = self._lies.get(self._count[0])
        if lie is None:
            return line.decode("ascii")
        if lie.answer is None:
            raise TimeoutError("VI_ERROR_TMO")
        return lie.answer

    def close(self) -> None:
        """Nothing to close."""


def lied_to(lies: dict[int, Lie]) -> str:
    """Open, play a good sequence and close, while some answers are wrong. The output is off in the end.

    The volts follow from what the instrument was told, whatever it answered.
    """
    clock = FakeClock()
    heard: list[float] = []
    emulator = Emulator(clock, lambda volts, _seconds: heard.append(volts))
    options = {"visa_resource": "any", "record_folder": str(SCRATCH), **AMPLIFIER}
    connect = partial(Loopback, emulator, lies, [0])
    made: list[Session[WaveformGeneratorBackend]] = []

    def run() -> None:
        session = Session(
            lambda listener: WaveformGeneratorBackend(BENCH, clock, listener, options, connect=connect),
            lambda: None,
            lambda _time, _poses: None,
            now=lambda: 1,
        )
        made.append(session)
        session.load(GOOD)
        session.start(Pacing())
        session.backend._join()

    result = outcome(run)
    for session in made:
        status = session.status()
        if status.error_code:
            check_refusal(status.error_code, *status.error_msg.partition(": ")[::2])
            result = status.error_code.name
        elif result == ACCEPTED and status.state != State.DONE:
            raise Violation(f"ended in {status}")
        with suppress(StressbotError):
            session.close()
    if emulator.volts != 0.0:
        raise Violation(f"{emulator.volts} V on the output in the end")
    low, high = BENCH.electrical.min_level, BENCH.electrical.max_level
    if any(not low - 1e-6 <= volts * GAIN <= high + 1e-6 for volts in heard):
        raise Violation(f"{min(heard)} V to {max(heard)} V from the generator")
    return result


# Anything at all, over TCP


class Babbler:
    """A TCP server that answers every line with the next of some chunks of bytes, whatever they are."""

    def __init__(self) -> None:
        self.chunks: list[bytes] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, name="babbler", daemon=True).start()

    def _serve(self) -> None:
        while True:
            connection, _ = self._listener.accept()
            with connection, suppress(OSError):
                chunks = iter(list(self.chunks))
                while connection.recv(65536):
                    if (chunk := next(chunks, None)) is None:
                        break
                    connection.sendall(chunk)


def babbled_at(chunks: list[bytes]) -> str:
    """The client's own connection to something on the network that is no instrument."""
    server = _babbler()
    server.chunks = chunks
    connect = partial(VisaTransport, f"TCPIP0::127.0.0.1::{server.port}::SOCKET", 0.02)
    options = {"visa_resource": "any", "record_folder": str(SCRATCH), **AMPLIFIER}
    return outcome(lambda: WaveformGeneratorBackend(BENCH, FakeClock(), Recorder(), options, connect=connect).close())


_babblers: list[Babbler] = []


def _babbler() -> Babbler:
    if not _babblers:
        _babblers.append(Babbler())
    return _babblers[0]


# The emulator

SESSION = [
    "*IDN?\n",
    "*RST\n",
    "*CLS\n",
    "OUTP1:LOAD INF\n",
    "SOUR1:VOLT:UNIT VPP\n",
    "FORM:BORD SWAP\n",
    "TRIG1:SOUR BUS\n",
    "SOUR1:FUNC:ARB:FILT OFF\n",
    "SOUR1:VOLT:OFFS 5\n",
    "SOUR1:VOLT 10\n",
    "SOUR1:VOLT:LIM:LOW 0\n",
    "SOUR1:VOLT:LIM:HIGH 10\n",
    "SOUR1:VOLT:LIM:STAT ON\n",
    "SOUR1:DATA:VOL:CLE\n",
    "SOUR1:DATA:ARB:DAC W0,#220" + "\x10\x20" * 10 + "\n",
    "SOUR1:DATA:ARB W1," + ",".join(["0.5"] * 10) + "\n",
    'SOUR1:DATA:SEQ #3100"S","W0",1,repeatTilTrig,maintain,4,"W0",3,repeat,maintain,4,"W1",1,repeatInf,maintain,4'.ljust(120)
    + "\n",
    'SOUR1:FUNC:ARB "S"\n',
    "SOUR1:FUNC ARB\n",
    "SOUR1:FUNC:ARB:SRAT 50E6\n",
    "OUTP1 ON\n",
    "*TRG\n",
    "SYST:ERR?\n",
    "OUTP1?\n",
    "SOUR1:DATA:VOL:FREE?\n",
    "SOUR1:VOLT? MAX\n",
    "OUTP1 OFF\n",
]
_entries = '"S","W0",1,repeatTilTrig,maintain,4,"W0",3,repeat,maintain,4,"W1",1,repeatInf,maintain,4'
SESSION[16] = f"SOUR1:DATA:SEQ #2{len(_entries)}{_entries}\n"
SCPI_TOKENS = [
    *SESSION,
    "#",
    "#0",
    "#9",
    "#9999999999",
    "#1",
    "#10",
    ";",
    ":",
    ",",
    "?",
    "??",
    "*",
    '"',
    "'",
    "\n",
    "\r\n",
    "\0",
    "\xff",
    " ",
    "\t",
    "MAX",
    "MIN",
    "INF",
    "1e999",
    "-0",
    ".",
    "+",
    "SOUR9:",
    "SOUR0:",
    "OUTP99999999999999999999 ON\n",
    "FUNC:ARB:SRAT 1e-6\n",
    "²",
    "VOLT 1e-9\n",
]


def streams() -> st.SearchStrategy[bytes]:
    """Of commands, most of them nearly right."""
    shuffled = st.lists(st.sampled_from(SESSION), max_size=12).map("".join)
    one = spliced(["".join(SESSION), *SESSION], SCPI_TOKENS)
    return st.one_of(st.tuples(shuffled, one).map("".join), one).map(lambda text: text.encode("latin-1", "replace")) | st.binary(
        max_size=60
    )


def told(stream: bytes) -> str:
    """The emulated instrument executes a stream, some seconds pass, and it still answers."""
    clock = FakeClock()

    def sink(volts: float, seconds: float) -> None:
        if not (abs(volts) <= VOLTS + 1e-6 and seconds >= 0.0):
            raise Violation(f"{volts!r} V for {seconds!r} s")

    emulator = Emulator(clock, sink)
    port = Port(emulator)
    for begin in range(0, len(stream), 64):
        answers = port.feed(stream[begin : begin + 64])
        answers.decode("ascii")
        clock.time += 0.003
    fresh = Port(emulator)
    first = fresh.feed(b"SYST:ERR?\n").decode("ascii")
    if not fresh.feed(b"*IDN?\n").startswith(b"Agilent"):
        raise Violation("the emulator does not answer any more")
    return ACCEPTED if first.startswith("+0") else f"error {first.split(',')[0]}"


_lies = st.one_of(ANSWERS, st.none()).map(Lie)
_chunk = st.one_of(
    ANSWERS.map(lambda text: text.encode("utf-8", "replace") + b"\n"),
    st.binary(max_size=30),
    st.just(b"x" * 5000),
    st.just(b""),
    st.just(b"Agilent Technologies,33522B,MY1,3\n"),
    st.just(b'+0,"No error"\n'),
    st.just(b"\xff\xfe\n"),
)

INTERFACES: tuple[Interface, ...] = (
    Interface("instrument answers", st.dictionaries(st.integers(1, 60), _lies, min_size=1, max_size=3), lied_to, 3),
    Interface("instrument answers, bytes over TCP", st.lists(_chunk, max_size=6), babbled_at, 0.15),
    Interface("commands to the emulated instrument", streams(), told, 4),
)
