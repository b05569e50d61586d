"""From a voltage sequence to what a waveform generator is loaded with: waveforms, and sequences that repeat them.

A dwell of n samples becomes a repeats of a constant waveform of B samples and b repeats of one of B + 1, with
a B + b (B + 1) = n and b = n mod B. Any n from B^2 on can be written so: a sequence of any length needs two
waveforms a level, and is exact to the sample. Shorter dwells get a waveform of their own.

A train is one waveform of a pulse, or of two that alternate, and as many repeats: its pulses are counted, not timed.
`exact_rate` is a sample clock at which each part of a pulse is a whole number of samples.

Samples come from cumulative times: edge k lies at round(t_k * rate), so that its error is at most half a sample however
long the sequence is. At every end of an epoch, which must lie at rest, the generator waits for a trigger: what runs without being
told to go on is one block, an epoch or a part of one. An epoch that takes longer than a block may is cut within its drives, trains
between pulses. A rest there changes nothing but the time: a PFSM that has accepted holds its arm up until the next reset, the other
arms come down again under the drive, and no symbol is taken on the way from the drive to rest (docs/electrical.md).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import Train, VoltageSequence

CHUNK = 250
"""B [samples]: 5 us at 50 MSa/s, so that dwells of whole multiples take one entry, and any from 1.25 ms on at most two."""

MOST_POINTS = 10_000
"""[samples] of a pulse: slower ones lower the sample clock, so that they fit into the memory."""

FINEST_DUTY = 100
"""Largest denominator of a duty that is met exactly."""

Wave = tuple[tuple[int, int], ...]
"""What a waveform is made of: DAC codes, and for how many samples each is held."""


@dataclass(frozen=True)
class Capacity:
    """What one load of the generator may hold."""

    min_points: int  # [samples] of a waveform
    memory: int  # [samples]
    points_block: int  # [samples] a waveform takes whole blocks of this many, and so does an entry of a sequence
    max_entries: int
    max_repeats: int


@dataclass(frozen=True)
class Scale:
    """Substrate volts as DAC codes: code = (level / gain - offset) / (amplitude / 2) * full_scale."""

    gain: float  # [V/V] of the amplifier
    offset: float  # [V] of the generator
    amplitude: float  # [Vpp] of the generator
    full_scale: int

    def code(self, level: float) -> int:
        """Raises StressbotError LIMIT_EXCEEDED beyond the full scale; nothing is clipped."""
        code = round((level / self.gain - self.offset) / (0.5 * self.amplitude) * self.full_scale)
        if not -self.full_scale <= code <= self.full_scale:
            raise StressbotError(ErrorCode.LIMIT_EXCEEDED, "levels", f"{level:g} V is beyond the generator's scale: send less")
        return code


@dataclass(frozen=True)
class Entry:
    """Play waveform `name` `repeats` times."""

    name: str
    repeats: int


@dataclass(frozen=True)
class Block:
    """What runs after one trigger."""

    entries: tuple[Entry, ...]
    epochs: int  # that end in it
    begin: float  # [s] nominal sequence time
    duration: float  # [s] by the generator's samples


@dataclass(frozen=True)
class Load:
    """What the generator is loaded with at one time; `rest` is the waveform it waits on."""

    waveforms: dict[str, np.ndarray]  # DAC codes
    blocks: tuple[Block, ...]
    rest: str
    rate: float  # [samples/s]


@dataclass
class _Draft:
    """A load in the making."""

    capacity: Capacity
    rest: Wave
    rate: float
    names: dict[Wave, str] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)

    def takes(self, waves: list[Wave]) -> bool:
        """Whether a block of these waveforms still fits."""
        size = self.capacity.points_block
        entries = sum(len(block.entries) + 1 for block in self.blocks) + len(waves) + 2
        points = sum(-(-_samples(wave) // size) * size for wave in {*self.names, *waves, self.rest}) + entries * size
        return entries <= self.capacity.max_entries and points <= self.capacity.memory

    def name(self, wave: Wave) -> str:
        return self.names.setdefault(wave, f"W{len(self.names)}")

    def load(self) -> Load:
        rest = self.name(self.rest)
        waveforms = {
            name: np.concatenate([np.full(samples, code, dtype=np.int16) for code, samples in wave])
            for wave, name in self.names.items()
        }
        return Load(waveforms, tuple(self.blocks), rest, self.rate)


def _samples(wave: Wave) -> int:
    return sum(samples for _, samples in wave)


def exact_rate(sequence: VoltageSequence, fastest: float) -> float:
    """The sample clock [samples/s], at most `fastest`, at which pulses as of the first train have edges at samples."""
    first = next(sequence.numbered_trains(), None)
    if first is None:
        return fastest
    period = first[1].period
    parts = Fraction(sequence.duty).limit_denominator(FINEST_DUTY).denominator
    samples = int(min(period * fastest * (1.0 + 1e-9), MOST_POINTS)) // parts * parts
    return samples / period if samples else fastest


def compile_sequence(
    sequence: VoltageSequence,
    rest_level: float,
    rate: float,
    scale: Scale,
    capacity: Capacity,
    drive_above: float = math.inf,
    max_block: float = math.inf,
) -> list[Load]:
    """Loads that play `sequence` [V on the substrate] one after the other at `rate` [samples/s].

    No block takes longer than `max_block` [s]; to that end segments above `drive_above` [V] may be cut.

    Raises StressbotError LIMIT_EXCEEDED if an epoch does not end at rest, a level is off the scale, a dwell is shorter than the
    shortest waveform or longer than all entries, or a block takes too long or does not fit.
    """
    longest = capacity.max_entries * capacity.max_repeats * CHUNK / rate
    if (sequence.dwells > longest).any():
        index = int(np.argmax(sequence.dwells > longest))
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED,
            f"dwells[{index}]",
            f"is {sequence.dwells[index]:g} s: the generator holds a level for {longest:g} s at most",
        )
    edges = np.concatenate([[0], np.rint(np.cumsum(sequence.dwells) * rate).astype(np.int64)])
    counts = np.diff(edges)
    trains = {k: _Pulses(train, rate, scale) for k, train in sequence.numbered_trains()}
    shortest = counts.copy()
    for k, pulses in trains.items():
        counts[k], shortest[k] = pulses.samples, pulses.period if pulses.parts_exist else 0
    if (shortest < capacity.min_points).any():
        index = int(np.argmax(shortest < capacity.min_points))
        raise StressbotError(
            ErrorCode.LIMIT_EXCEEDED,
            f"dwells[{index}]",
            f"is {sequence.dwells[index]:g} s: the generator's shortest waveform takes {capacity.min_points / rate:g} s"
            + (", and a pulse takes less" if index in trains else ""),
        )
    codes = {level: scale.code(level) for level in {*sequence.levels.tolist(), rest_level}}
    rest = ((codes[rest_level], CHUNK),)
    loads, draft = [], _Draft(capacity, rest, rate)
    longest_block = math.floor(max_block * rate) if math.isfinite(max_block) else int(counts.sum())
    played = 0  # [samples]
    for begin, end, epochs, parts in _blocks(sequence, counts, trains, rest_level, drive_above, longest_block, max_block):
        waves: list[Wave] = []
        repeats: list[int] = []
        for k, part in parts:
            pieces = trains[k].pieces(part) if k in trains else _pieces(part, codes[float(sequence.levels[k])])
            for wave, count in pieces:
                for first in range(0, count, capacity.max_repeats):
                    waves.append(wave)
                    repeats.append(min(count - first, capacity.max_repeats))
        if not draft.takes(waves):
            if draft.blocks:
                loads.append(draft.load())
                draft = _Draft(capacity, rest, rate)
            if not draft.takes(waves):
                raise StressbotError(
                    ErrorCode.LIMIT_EXCEEDED,
                    f"levels[{begin}]",
                    f"the generator cannot hold the {end - begin} segments until the next end of an epoch at rest "
                    f"({capacity.max_entries} entries, {capacity.memory} samples): send shorter epochs",
                )
        entries = tuple(Entry(draft.name(wave), count) for wave, count in zip(waves, repeats, strict=True))
        length = sum(part for _, part in parts)
        draft.blocks.append(Block(entries, epochs, played / rate, length / rate))
        played += length
    loads.append(draft.load())
    return loads


class _Pulses:
    """A train in samples."""

    def __init__(self, train: Train, rate: float, scale: Scale) -> None:
        self.period = round(train.period * rate)  # [samples]
        self.samples = train.count * self.period
        high = round(train.high_dwell * rate)
        self.parts_exist = 0 < high < self.period
        self._pulse = ((scale.code(train.high), high), (scale.code(train.low), self.period - high))
        self._pattern = self._pulse
        if train.alternating and train.count > 1:
            self._pattern += ((scale.code(-train.high), high), (scale.code(-train.low), self.period - high))
        self.unit = self.period * len(self._pattern) // 2  # [samples] between cuts

    def pieces(self, samples: int) -> Iterator[tuple[Wave, int]]:
        """Waveforms and repeats that add up to `samples`, whole pulses."""
        if whole := samples // self.unit:
            yield self._pattern, whole
        if samples % self.unit:  # an odd one
            yield self._pulse, 1


def _blocks(
    sequence: VoltageSequence,
    counts: np.ndarray,
    trains: dict[int, _Pulses],
    rest_level: float,
    drive_above: float,
    longest: int,
    max_block: float,
) -> Iterator[tuple[int, int, int, list[tuple[int, int]]]]:
    """First segment and end of each block, the number of epochs that end in it, and its parts: segments and their samples."""
    begin = 0
    for end in sequence.epoch_ends.tolist():
        if sequence.levels[end - 1] != rest_level:
            raise StressbotError(
                ErrorCode.LIMIT_EXCEEDED,
                f"levels[{end - 1}]",
                f"is {sequence.levels[end - 1]:g} V at the end of an epoch: there the generator waits, so end each epoch at rest",
            )
        epoch = counts[begin:end]
        if epoch.sum() <= longest:
            yield begin, end, 1, [(begin + k, int(count)) for k, count in enumerate(epoch)]
            begin = end
            continue
        driven = (sequence.levels[begin:end] > drive_above) | sequence.trains[begin:end]
        # Each block has at most one part of a drive, and at most all else.
        most = longest - int(epoch[~driven].sum())
        least = max([CHUNK, *(trains[k].unit for k in range(begin, end) if k in trains)])
        if most < least:
            raise StressbotError(
                ErrorCode.LIMIT_EXCEEDED,
                f"dwells[{begin}]",
                f"begins an epoch that selects and rests for {epoch[~driven].sum() / longest * max_block:g} s, and max_block is "
                f"{max_block:g} s: only drives can be cut, and only between pulses, so send shorter dwells",
            )
        first, parts = begin, []
        for k, count in enumerate(epoch.tolist(), begin):
            unit = trains[k].unit if k in trains else 1
            units = -(-count // unit)
            pieces = -(-units // (most // unit)) if driven[k - begin] else 1
            for piece in range(pieces):
                until = [min(units * number // pieces * unit, count) for number in (piece, piece + 1)]
                parts.append((k, until[1] - until[0]))
                if driven[k - begin] and (piece + 1 < pieces or driven[k + 1 - begin :].any()):
                    yield first, k + 1, 0, parts
                    first, parts = k, []
        yield first, end, 1, parts
        begin = end


def _pieces(samples: int, code: int) -> Iterator[tuple[Wave, int]]:
    """Constant waveforms and repeats that add up to `samples`."""
    longer = samples % CHUNK
    shorter = (samples - longer * (CHUNK + 1)) // CHUNK
    if shorter < 0:
        yield ((code, samples),), 1
        return
    for length, repeats in ((CHUNK, shorter), (CHUNK + 1, longer)):
        if repeats:
            yield ((code, length),), repeats
