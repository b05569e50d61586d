"""An emulated Keysight 33522B, at least as strict as what is known of the real one.

It executes the commands that it is sent, keeps an error queue, and tells a sink what volts its output carries for how long.
Where the real instrument clips, rounds or shrugs, this one refuses. What it does not know, it refuses as undefined.

The load is an amplifier: high impedance, so that the output carries twice what the display says for 50 ohm.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stressbot_driver.clock import Clock
from stressbot_driver.instruments.scpi import (
    MAX_LINE,
    Reader,
    ScpiError,
    Unit,
    block,
    boolean,
    choice,
    header_pattern,
    label,
    number,
    parse_units,
    split,
)

VOLTS = 10.0  # [V] either way into an open circuit
OHMS = 50.0  # of the output
MIN_AMPLITUDE = 1e-3  # [Vpp] into 50 ohm
MEMORY = 1_000_000  # [samples] per channel
POINTS_BLOCK = 128
MIN_POINTS = 8
ENTRIES = range(3, 513)
MAX_REPEATS = 1_000_000
RATES = {"OFF": 62.5e6, "NORM": 250e6, "STEP": 250e6}  # [samples/s] at most, by filter
MIN_RATE = 1e-6
FULL_SCALE = 32767
NAME = 12  # letters of a waveform's name, at most
QUEUE = 20  # errors kept
CONTROLS = ("once", "onceWaitTrig", "repeat", "repeatInf", "repeatTilTrig")
MARKERS = ("maintain", "lowAtStart", "highAtStart", "highAtStartGoLow")
MAX_STEPS = 1_000_000  # of the output in one entry of a sequence: more cannot be rendered in time
INFINITE = 9.9e37

Sink = Callable[[float, float], None]
"""Is told volts [V] and for how long [s] they lasted."""

RepeatSink = Callable[[list[tuple[float, float]], int], None]
"""Is told the same of several volts, one after the other, and how often all of them were repeated."""


@dataclass(frozen=True)
class Entry:
    """One entry of a sequence: runs of (fraction of full scale, samples), played `repeats` times."""

    runs: tuple[tuple[float, int], ...]
    repeats: int
    control: str

    @property
    def holds(self) -> bool:
        return self.control in ("onceWaitTrig", "repeatInf", "repeatTilTrig")

    @property
    def length(self) -> int:
        """[samples] of one repeat."""
        return sum(samples for _, samples in self.runs)

    def run_at(self, position: int) -> tuple[float, int]:
        """Fraction of full scale at a sample counted from the start of the entry, and for how many samples from there on."""
        position %= self.length
        index = 0
        while position >= self.runs[index][1]:
            position -= self.runs[index][1]
            index += 1
        fraction, samples = self.runs[index]
        return fraction, samples - position


@dataclass
class Playing:
    """A sequence that is selected: at which entry it is, since when, and how many samples have been rendered."""

    entries: list[Entry]
    began: float  # [s] of the clock, when the present stretch between holds began
    index: int = 0  # of the present entry
    rendered: int = 0  # [samples] of that stretch
    within: int = 0  # [samples] of the present entry

    @property
    def entry(self) -> Entry:
        return self.entries[self.index]

    def go_on(self) -> None:
        """To the next entry, or the first one after the last."""
        self.within = 0
        self.index = (self.index + 1) % len(self.entries)


@dataclass
class Channel:
    """One output."""

    on: bool = False
    load: float = OHMS  # [ohm] that the display assumes
    amplitude: float = 0.2  # [Vpp] into an open circuit; 100 mVpp into 50 ohm
    offset: float = 0.0  # [V] into an open circuit
    limits_on: bool = False
    limit_low: float = -VOLTS
    limit_high: float = VOLTS
    function: str = "SIN"
    filter: str = "STEP"
    rate: float = 40e3
    trigger: str = "IMM"
    waveforms: dict[str, np.ndarray] = field(default_factory=dict)  # fractions of full scale
    sequences: dict[str, list[Entry]] = field(default_factory=dict)
    selected: str = ""
    playing: Playing | None = None

    @property
    def scale(self) -> float:
        """Displayed volts per volt into an open circuit."""
        return 1.0 if math.isinf(self.load) else self.load / (self.load + OHMS)

    def used(self) -> int:
        """[samples] of memory. What a sequence takes is not published; this is generous."""
        points = sum(-(-len(codes) // POINTS_BLOCK) * POINTS_BLOCK for codes in self.waveforms.values())
        return points + sum(len(entries) * POINTS_BLOCK for entries in self.sequences.values())


class Emulator:
    """The instrument behind its connector. One thread at a time."""

    def __init__(
        self, clock: Clock, sink: Sink, channels: int = 2, memory: int = MEMORY, repeated: RepeatSink | None = None
    ) -> None:
        """`sink` and `repeated` hear of channel 1 only, where the amplifier is; without `repeated`, `sink` of every repeat."""
        self._clock = clock
        self._sink = sink
        self._repeated = repeated
        self._memory = memory
        self._count = channels
        self._channels = [Channel() for _ in range(channels)]
        self._errors: deque[ScpiError] = deque()
        self._swapped = False
        self._time = clock.now()

    @property
    def volts(self) -> float:
        """[V] on channel 1 now."""
        self.advance()
        return self._volts(self._channels[0])

    @property
    def waiting(self) -> bool:
        """Whether channel 1 waits for a trigger, or holds for good."""
        self.advance()
        playing = self._channels[0].playing
        return playing is not None and playing.entry.holds

    def execute(self, message: bytes | ScpiError) -> str:
        """Execute one message; the answers of its queries, separated by semicolons, empty if there are none."""
        self.advance()
        answers = []
        try:
            if isinstance(message, ScpiError):
                raise message
            for unit in parse_units(message):
                answer = self._unit(unit)
                if answer is not None:
                    answers.append(answer)
        except ScpiError as error:
            self._report(error)
        return ";".join(answers)

    def advance(self) -> None:
        """Render the output until now."""
        now = self._clock.now()
        elapsed, self._time = now - self._time, now
        for index, channel in enumerate(self._channels):
            sink, repeated = (self._sink, self._repeated) if index == 0 else (_nowhere, _nowhere)
            if channel.playing is None:
                if elapsed > 0.0:
                    sink(0.0, elapsed)
            else:
                self._render(channel, channel.playing, now, sink, repeated)

    # Rendering

    def _volts(self, channel: Channel) -> float:
        playing = channel.playing
        if not channel.on or playing is None:
            return 0.0
        return self._level(channel, playing.entry.run_at(playing.within)[0])

    @staticmethod
    def _level(channel: Channel, fraction: float) -> float:
        return channel.offset + 0.5 * channel.amplitude * fraction if channel.on else 0.0

    def _render(self, channel: Channel, playing: Playing, now: float, sink: Sink, repeated: RepeatSink | None) -> None:
        target = math.floor((now - playing.began) * channel.rate + 1e-6)
        while True:
            entry = playing.entry
            if entry.holds:
                # Whole stretches of time instead of samples: the next one starts with a trigger, whenever it comes.
                held = now - playing.began - playing.rendered / channel.rate
                if held > 0.0:
                    sink(self._level(channel, entry.runs[0][0]), held)
                    playing.began, playing.rendered = now, 0
                return
            total = entry.length * entry.repeats
            while playing.within < total and playing.rendered < target:
                whole = min(total - playing.within, target - playing.rendered) // entry.length
                if repeated is not None and whole > 1 and len(entry.runs) > 1 and playing.within % entry.length == 0:
                    repeated([(self._level(channel, fraction), samples / channel.rate) for fraction, samples in entry.runs], whole)
                    samples = whole * entry.length
                else:
                    fraction, samples = entry.run_at(playing.within)
                    if len(entry.runs) == 1:
                        samples = total - playing.within
                    samples = min(samples, target - playing.rendered)
                    sink(self._level(channel, fraction), samples / channel.rate)
                playing.rendered += samples
                playing.within += samples
            if playing.within < total:
                return
            playing.go_on()

    # Commands

    def _report(self, error: ScpiError) -> None:
        if len(self._errors) >= QUEUE:
            self._errors[-1] = ScpiError(-350)
        else:
            self._errors.append(error)

    def _unit(self, unit: Unit) -> str | None:
        for header, command, query, arity in COMMANDS:
            match = header_pattern(header).fullmatch(unit.header.removesuffix("?"))
            if match is None:
                continue
            asks = unit.header.endswith("?")
            method = query if asks else command
            if method is None:
                raise ScpiError(-113)
            channel = 1
            if "suffix" in match.re.groupindex:
                channel = int((match.group("suffix") or "1")[:9])
                if not 1 <= channel <= self._count:
                    raise ScpiError(-114)
            least, most = (0, method.__code__.co_argcount - 2) if asks else arity
            if len(unit.parameters) > most:
                raise ScpiError(-108)
            if len(unit.parameters) < least:
                raise ScpiError(-109)
            return method(self, self._channels[channel - 1], *unit.parameters)
        raise ScpiError(-113)

    def _identify(self, _channel: Channel) -> str:
        return "Agilent Technologies,33522B,EMULATED,0.00-stressbot"

    def _reset(self, _channel: Channel) -> None:
        self._channels = [Channel() for _ in range(self._count)]
        self._swapped = False

    def _clear_status(self, _channel: Channel) -> None:
        self._errors.clear()

    def _complete(self, _channel: Channel) -> str:
        return "1"

    def _nothing(self, _channel: Channel) -> None:
        pass

    def _next_error(self, _channel: Channel) -> str:
        return str(self._errors.popleft()) if self._errors else '+0,"No error"'

    def _trigger(self, _channel: Channel) -> None:
        waiting = [
            channel.playing
            for channel in self._channels
            if channel.trigger == "BUS"
            and channel.on
            and channel.playing is not None
            and channel.playing.entry.control in ("onceWaitTrig", "repeatTilTrig")
        ]
        if not waiting:
            raise ScpiError(-211)
        for playing in waiting:
            playing.began, playing.rendered = self._time, 0
            playing.go_on()

    def _set_byte_order(self, _channel: Channel, order: bytes) -> None:
        self._swapped = choice(order, "NORMal", "SWAPped") == "SWAP"

    def _byte_order(self, _channel: Channel) -> str:
        return "SWAP" if self._swapped else "NORM"

    # The output

    def _switch(self, channel: Channel, state: bytes) -> None:
        on = boolean(state)
        if on and not channel.on:
            if channel.function != "ARB" or channel.selected not in channel.sequences:
                raise ScpiError(-221, "only sequences are emulated")
            if channel.playing is None:
                raise ScpiError(-221, "select the sequence again")
        channel.on = on
        if not on:
            channel.playing = None

    def _is_on(self, channel: Channel) -> str:
        return str(int(channel.on))

    def _set_load(self, channel: Channel, ohms: bytes) -> None:
        if channel.limits_on:
            raise ScpiError(-221, "output load cannot be changed while voltage limits are on")
        load = number(ohms, {"INFinity": lambda: math.inf, "MINimum": lambda: 1.0, "MAXimum": lambda: 10e3})
        if load >= INFINITE:
            load = math.inf
        if not (1.0 <= load <= 10e3 or math.isinf(load)):
            raise ScpiError(-222)
        channel.load = load

    def _load(self, channel: Channel, which: bytes = b"") -> str:
        if which:
            return _real(number(which, {"MINimum": lambda: 1.0, "MAXimum": lambda: INFINITE}))
        return _real(min(channel.load, INFINITE))

    def _may_be(self, channel: Channel, amplitude: float, offset: float) -> None:
        """Refuse what the output cannot or may not do; volts into an open circuit."""
        slack = 1e-9 * VOLTS
        if amplitude < 2.0 * MIN_AMPLITUDE - slack or abs(offset) + 0.5 * amplitude > VOLTS + slack:
            raise ScpiError(-222)
        if channel.limits_on:
            low, high = offset - 0.5 * amplitude, offset + 0.5 * amplitude
            if low < channel.limit_low - slack or high > channel.limit_high + slack:
                raise ScpiError(-221, "beyond the voltage limits")

    def _set_amplitude(self, channel: Channel, volts: bytes) -> None:
        names = {"MINimum": lambda: MIN_AMPLITUDE, "MAXimum": lambda: self._amplitude_max(channel)}
        amplitude = number(volts, names) / channel.scale
        self._may_be(channel, amplitude, channel.offset)
        channel.amplitude = amplitude

    def _amplitude_max(self, channel: Channel) -> float:
        return 2.0 * (VOLTS - abs(channel.offset)) * channel.scale

    def _amplitude(self, channel: Channel, which: bytes = b"") -> str:
        if which:
            return _real(number(which, {"MINimum": lambda: MIN_AMPLITUDE, "MAXimum": lambda: self._amplitude_max(channel)}))
        return _real(channel.amplitude * channel.scale)

    def _offset_max(self, channel: Channel) -> float:
        return (VOLTS - 0.5 * channel.amplitude) * channel.scale

    def _set_offset(self, channel: Channel, volts: bytes) -> None:
        names = {"MINimum": lambda: -self._offset_max(channel), "MAXimum": lambda: self._offset_max(channel)}
        offset = number(volts, names) / channel.scale
        self._may_be(channel, channel.amplitude, offset)
        channel.offset = offset

    def _offset(self, channel: Channel, which: bytes = b"") -> str:
        if which:
            names = {"MINimum": lambda: -self._offset_max(channel), "MAXimum": lambda: self._offset_max(channel)}
            return _real(number(which, names))
        return _real(channel.offset * channel.scale)

    def _set_unit(self, _channel: Channel, unit: bytes) -> None:
        if choice(unit, "VPP", "VRMS", "DBM") != "VPP":
            raise ScpiError(-221, "only Vpp is emulated")

    def _unit_name(self, _channel: Channel) -> str:
        return "VPP"

    def _set_limit(self, channel: Channel, low: float, high: float) -> None:
        if not -VOLTS <= low < high <= VOLTS:
            raise ScpiError(-222)
        if channel.limits_on and not self._within(channel, low, high):
            raise ScpiError(-221, "the present levels lie beyond these limits")
        channel.limit_low, channel.limit_high = low, high

    @staticmethod
    def _within(channel: Channel, low: float, high: float) -> bool:
        slack = 1e-9 * VOLTS
        bottom, top = channel.offset - 0.5 * channel.amplitude, channel.offset + 0.5 * channel.amplitude
        return low - slack <= bottom and top <= high + slack

    def _set_limit_low(self, channel: Channel, volts: bytes) -> None:
        self._set_limit(channel, number(volts) / channel.scale, channel.limit_high)

    def _set_limit_high(self, channel: Channel, volts: bytes) -> None:
        self._set_limit(channel, channel.limit_low, number(volts) / channel.scale)

    def _limit_low(self, channel: Channel) -> str:
        return _real(channel.limit_low * channel.scale)

    def _limit_high(self, channel: Channel) -> str:
        return _real(channel.limit_high * channel.scale)

    def _switch_limits(self, channel: Channel, state: bytes) -> None:
        on = boolean(state)
        if on and not self._within(channel, channel.limit_low, channel.limit_high):
            raise ScpiError(-221, "the present levels lie beyond the limits")
        channel.limits_on = on

    def _limits_on(self, channel: Channel) -> str:
        return str(int(channel.limits_on))

    # Waveforms

    def _take(self, channel: Channel, name: bytes, values: tuple[bytes, ...], dac: bool) -> None:
        title = self._new_name(channel, name)
        if len(values) == 1 and values[0].lstrip().startswith(b"#"):
            data = block(values[0])
            kind = np.dtype(("<" if self._swapped else ">") + ("i2" if dac else "f4"))
            if len(data) % kind.itemsize:
                raise ScpiError(-161)
            points = np.frombuffer(data, dtype=kind).astype(float)
        else:
            points = np.array([number(value) for value in values])
        if len(points) < MIN_POINTS:
            raise ScpiError(-222, f"a waveform has at least {MIN_POINTS} points")
        low, high = (-FULL_SCALE - 1.0, FULL_SCALE) if dac else (-1.0, 1.0)
        if not ((points >= low) & (points <= high)).all():
            raise ScpiError(-222)
        points = np.maximum(points / high, -1.0)
        blocks = -(-len(points) // POINTS_BLOCK)
        if channel.used() + blocks * POINTS_BLOCK > self._memory:
            raise ScpiError(880)
        channel.waveforms[title] = points

    def _waveform(self, channel: Channel, name: bytes, *values: bytes) -> None:
        self._take(channel, name, values, dac=False)

    def _waveform_dac(self, channel: Channel, name: bytes, *values: bytes) -> None:
        self._take(channel, name, values, dac=True)

    def _new_name(self, channel: Channel, name: bytes) -> str:
        title = label(name)
        if len(title) > NAME:
            raise ScpiError(783)
        if title.upper() in {known.upper() for known in (*channel.waveforms, *channel.sequences)}:
            raise ScpiError(-200, "Specified arb waveform already exists")
        return title

    def _sequence(self, channel: Channel, descriptor: bytes) -> None:
        parts = split(block(descriptor), 0x2C)
        title = self._new_name(channel, parts[0])
        if len(parts) % 5 != 1:
            raise ScpiError(-109, "five fields an entry")
        if len(parts) // 5 not in ENTRIES:
            raise ScpiError(-222, f"{ENTRIES.start} to {ENTRIES.stop - 1} entries")
        entries = [self._sequence_entry(channel, *parts[k : k + 5]) for k in range(1, len(parts), 5)]
        if channel.used() + len(entries) * POINTS_BLOCK > self._memory:
            raise ScpiError(880)
        if not any(entry.holds for entry in entries):
            raise ScpiError(-221, "only sequences that wait or hold somewhere are emulated")
        channel.sequences[title] = entries

    def _sequence_entry(self, channel: Channel, name: bytes, count: bytes, control: bytes, marker: bytes, point: bytes) -> Entry:
        points = channel.waveforms.get(label(name))
        if points is None:
            raise ScpiError(785)
        mode = _exactly(control, CONTROLS)
        _exactly(marker, MARKERS)
        if not 4 <= number(point) <= len(points) - 3:
            raise ScpiError(-222, "marker")
        repeats = number(count)
        if mode == "repeat" and not (1 <= repeats <= MAX_REPEATS and repeats.is_integer()):
            raise ScpiError(-222, "repeats")
        edges = np.flatnonzero(np.diff(points)) + 1
        begins, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(points)]])
        runs = tuple((float(points[begin]), int(end - begin)) for begin, end in zip(begins, ends, strict=True))
        entry = Entry(runs, int(repeats) if mode == "repeat" else 1, mode)
        if entry.holds and len(runs) > 1:
            raise ScpiError(-221, "only constant waveforms are emulated where a sequence holds")
        if len(runs) * (entry.repeats if len(runs) > 1 and self._repeated is None else 1) > MAX_STEPS:
            raise ScpiError(-221, "too many steps to be emulated")
        return entry

    def _catalog(self, channel: Channel) -> str:
        return ",".join(f'"{name}"' for name in (*channel.waveforms, *channel.sequences)) or '""'

    def _clear(self, channel: Channel) -> None:
        self._refuse_live(channel)
        channel.waveforms, channel.sequences = {}, {}
        channel.selected, channel.playing = "", None

    def _free(self, channel: Channel) -> str:
        return f"{self._memory - channel.used():+d}"

    def _select(self, channel: Channel, name: bytes) -> None:
        title = label(name)
        self._refuse_live(channel)
        if title not in channel.waveforms and title not in channel.sequences:
            raise ScpiError(785)
        channel.selected = title
        self._restart(channel)

    def _selected(self, channel: Channel) -> str:
        return f'"{channel.selected}"'

    def _set_function(self, channel: Channel, function: bytes) -> None:
        self._refuse_live(channel)
        channel.function = choice(function, "SINusoid", "SQUare", "RAMP", "PULSe", "NOISe", "DC", "PRBS", "ARBitrary")
        self._restart(channel)

    def _function(self, channel: Channel) -> str:
        return channel.function

    def _set_rate(self, channel: Channel, rate: bytes) -> None:
        fastest = RATES[channel.filter]
        value = number(rate, {"MINimum": lambda: MIN_RATE, "MAXimum": lambda: fastest})
        if not MIN_RATE <= value <= fastest:
            raise ScpiError(-222)
        self._refuse_live(channel)
        channel.rate = value
        self._restart(channel)

    def _rate(self, channel: Channel, which: bytes = b"") -> str:
        if which:
            return _real(number(which, {"MINimum": lambda: MIN_RATE, "MAXimum": lambda: RATES[channel.filter]}))
        return _real(channel.rate)

    def _set_filter(self, channel: Channel, kind: bytes) -> None:
        value = choice(kind, "OFF", "NORMal", "STEP")
        if channel.rate > RATES[value]:
            raise ScpiError(-221, "the sample rate is too fast for this filter")
        self._refuse_live(channel)
        channel.filter = value

    def _filter(self, channel: Channel) -> str:
        return channel.filter

    def _set_trigger_source(self, channel: Channel, source: bytes) -> None:
        channel.trigger = choice(source, "IMMediate", "EXTernal", "TIMer", "BUS")

    def _trigger_source(self, channel: Channel) -> str:
        return channel.trigger

    @staticmethod
    def _refuse_live(channel: Channel) -> None:
        """What is not known about a live output, the driver does not do."""
        if channel.on:
            raise ScpiError(-221, "the output is on")

    def _restart(self, channel: Channel) -> None:
        """A sequence begins anew when it is selected or its clock is changed."""
        plays = channel.function == "ARB" and channel.selected in channel.sequences
        channel.playing = Playing(channel.sequences[channel.selected], self._time) if plays else None


def _nowhere(_what: object, _how_long: object) -> None:
    pass


def _real(value: float) -> str:
    return f"{value:+.14E}"


def _exactly(parameter: bytes, names: tuple[str, ...]) -> str:
    text = parameter.strip().decode("latin-1").lower()
    for name in names:
        if text == name.lower():
            return name
    raise ScpiError(-224)


NONE, ONE, POINTS = (0, 0), (1, 1), (2, MAX_LINE)
# Header, what it does, what its query does, and how few and how many parameters the command takes.
COMMANDS = (
    ("*IDN", None, Emulator._identify, NONE),
    ("*RST", Emulator._reset, None, NONE),
    ("*CLS", Emulator._clear_status, None, NONE),
    ("*OPC", Emulator._nothing, Emulator._complete, NONE),
    ("*WAI", Emulator._nothing, None, NONE),
    ("*TRG", Emulator._trigger, None, NONE),
    ("SYSTem:ERRor[:NEXT]", None, Emulator._next_error, NONE),
    ("FORMat:BORDer", Emulator._set_byte_order, Emulator._byte_order, ONE),
    ("OUTPut#[:STATe]", Emulator._switch, Emulator._is_on, ONE),
    ("OUTPut#:LOAD", Emulator._set_load, Emulator._load, ONE),
    ("TRIGger#:SOURce", Emulator._set_trigger_source, Emulator._trigger_source, ONE),
    ("[SOURce#:]FUNCtion[:SHAPe]", Emulator._set_function, Emulator._function, ONE),
    ("[SOURce#:]FUNCtion:ARBitrary", Emulator._select, Emulator._selected, ONE),
    ("[SOURce#:]FUNCtion:ARBitrary:SRATe", Emulator._set_rate, Emulator._rate, ONE),
    ("[SOURce#:]FUNCtion:ARBitrary:FILTer", Emulator._set_filter, Emulator._filter, ONE),
    ("[SOURce#:]VOLTage[:LEVel][:IMMediate][:AMPLitude]", Emulator._set_amplitude, Emulator._amplitude, ONE),
    ("[SOURce#:]VOLTage[:LEVel][:IMMediate]:OFFSet", Emulator._set_offset, Emulator._offset, ONE),
    ("[SOURce#:]VOLTage:UNIT", Emulator._set_unit, Emulator._unit_name, ONE),
    ("[SOURce#:]VOLTage:LIMit:LOW", Emulator._set_limit_low, Emulator._limit_low, ONE),
    ("[SOURce#:]VOLTage:LIMit:HIGH", Emulator._set_limit_high, Emulator._limit_high, ONE),
    ("[SOURce#:]VOLTage:LIMit:STATe", Emulator._switch_limits, Emulator._limits_on, ONE),
    ("[SOURce#:]DATA:ARBitrary", Emulator._waveform, None, POINTS),
    ("[SOURce#:]DATA:ARBitrary:DAC", Emulator._waveform_dac, None, POINTS),
    ("[SOURce#:]DATA:SEQuence", Emulator._sequence, None, ONE),
    ("[SOURce#:]DATA:VOLatile:CATalog", None, Emulator._catalog, NONE),
    ("[SOURce#:]DATA:VOLatile:CLEar", Emulator._clear, None, NONE),
    ("[SOURce#:]DATA:VOLatile:FREE", None, Emulator._free, NONE),
)


class Port:
    """One connection: a stream of bytes in, lines out."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._reader = Reader()

    def feed(self, data: bytes) -> bytes:
        """Execute the messages that `data` completes; their answers, a line for each message that asks."""
        answers = [self._emulator.execute(message) for message in self._reader.feed(data)]
        return b"".join(answer.encode() + b"\n" for answer in answers if answer)
