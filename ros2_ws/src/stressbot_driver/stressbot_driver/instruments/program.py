"""From a voltage sequence to what a waveform generator is loaded with: waveforms, and sequences that repeat them.

A dwell of n samples becomes a repeats of a constant waveform of B samples and b repeats of one of B + 1, with
a B + b (B + 1) = n and b = n mod B. Any n from B^2 on can be written so: a sequence of any length needs two
waveforms a level, and is exact to the sample. Shorter dwells get a waveform of their own.

Samples come from cumulative times: edge k lies at round(t_k * rate), so that its error is at most half a sample however long
the sequence is. At every end of an epoch, which must lie at rest, the generator waits for a trigger: what runs without being
told to go on is one block, an epoch or a part of one. An epoch that takes longer than a block may is cut within its drives.
A rest there changes nothing but the time: a PFSM that has accepted holds its arm up until the next reset, the other arms come
down again under the drive, and no symbol is taken on the way from the drive to rest (docs/electrical.md).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from stressbot_driver.errors import BenchError, ErrorCode
from stressbot_driver.sequence import VoltageSequence

CHUNK = 250
"""B [samples]: 5 us at 50 MSa/s, so that dwells of whole multiples take one entry, and any from 1.25 ms on at most two."""


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
        """Raises BenchError LIMIT_EXCEEDED beyond the full scale; nothing is clipped."""
        code = round((level / self.gain - self.offset) / (0.5 * self.amplitude) * self.full_scale)
        if not -self.full_scale <= code <= self.full_scale:
            raise BenchError(ErrorCode.LIMIT_EXCEEDED, "levels", f"{level:g} V is beyond the generator's scale: send less")
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


@dataclass
class _Draft:
    """A load in the making."""

    capacity: Capacity
    rest_code: int
    names: dict[tuple[int, int], str] = field(default_factory=dict)  # by code and number of samples
    blocks: list[Block] = field(default_factory=list)

    def takes(self, runs: list[tuple[int, int]]) -> bool:
        """Whether a block of these waveforms and repeats still fits."""
        kinds = {*self.names, *runs, (self.rest_code, CHUNK)}
        size = self.capacity.points_block
        entries = sum(len(block.entries) + 1 for block in self.blocks) + len(runs) + 2
        points = sum(-(-samples // size) * size for _, samples in kinds) + entries * size
        return entries <= self.capacity.max_entries and points <= self.capacity.memory

    def name(self, code: int, samples: int) -> str:
        return self.names.setdefault((code, samples), f"W{len(self.names)}")

    def load(self) -> Load:
        rest = self.name(self.rest_code, CHUNK)
        waveforms = {name: np.full(samples, code, dtype=np.int16) for (code, samples), name in self.names.items()}
        return Load(waveforms, tuple(self.blocks), rest)


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

    Raises BenchError LIMIT_EXCEEDED if an epoch does not end at rest, a level is off the scale, a dwell is shorter than the
    shortest waveform or longer than all entries, or a block takes too long or does not fit.
    """
    longest = capacity.max_entries * capacity.max_repeats * CHUNK / rate
    if (sequence.dwells > longest).any():
        index = int(np.argmax(sequence.dwells > longest))
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED,
            f"dwells[{index}]",
            f"is {sequence.dwells[index]:g} s: the generator holds a level for {longest:g} s at most",
        )
    edges = np.concatenate([[0], np.rint(np.cumsum(sequence.dwells) * rate).astype(np.int64)])
    counts = np.diff(edges)
    if (counts < capacity.min_points).any():
        index = int(np.argmax(counts < capacity.min_points))
        raise BenchError(
            ErrorCode.LIMIT_EXCEEDED,
            f"dwells[{index}]",
            f"is {sequence.dwells[index]:g} s: the generator's shortest waveform takes {capacity.min_points / rate:g} s",
        )
    codes = {level: scale.code(level) for level in {*sequence.levels.tolist(), rest_level}}
    loads, draft = [], _Draft(capacity, codes[rest_level])
    longest_block = math.floor(max_block * rate) if math.isfinite(max_block) else int(edges[-1])
    played = 0  # [samples]
    for begin, end, epochs, parts in _blocks(sequence, counts, rest_level, drive_above, longest_block, max_block):
        runs: list[tuple[int, int]] = []
        repeats: list[int] = []
        for k, part in parts:
            for samples, count in _pieces(part, capacity.max_repeats):
                runs.append((codes[float(sequence.levels[k])], samples))
                repeats.append(count)
        if not draft.takes(runs):
            if draft.blocks:
                loads.append(draft.load())
                draft = _Draft(capacity, codes[rest_level])
            if not draft.takes(runs):
                raise BenchError(
                    ErrorCode.LIMIT_EXCEEDED,
                    f"levels[{begin}]",
                    f"the generator cannot hold the {end - begin} segments until the next end of an epoch at rest "
                    f"({capacity.max_entries} entries, {capacity.memory} samples): send shorter epochs",
                )
        entries = tuple(Entry(draft.name(*run), count) for run, count in zip(runs, repeats, strict=True))
        length = sum(part for _, part in parts)
        draft.blocks.append(Block(entries, epochs, played / rate, length / rate))
        played += length
    loads.append(draft.load())
    return loads


def _blocks(
    sequence: VoltageSequence, counts: np.ndarray, rest_level: float, drive_above: float, longest: int, max_block: float
) -> Iterator[tuple[int, int, int, list[tuple[int, int]]]]:
    """First segment and end of each block, the number of epochs that end in it, and its parts: segments and their samples."""
    begin = 0
    for end in sequence.epoch_ends.tolist():
        if sequence.levels[end - 1] != rest_level:
            raise BenchError(
                ErrorCode.LIMIT_EXCEEDED,
                f"levels[{end - 1}]",
                f"is {sequence.levels[end - 1]:g} V at the end of an epoch: there the generator waits, so end each epoch at rest",
            )
        epoch = counts[begin:end]
        if epoch.sum() <= longest:
            yield begin, end, 1, [(begin + k, int(count)) for k, count in enumerate(epoch)]
            begin = end
            continue
        driven = sequence.levels[begin:end] > drive_above
        # Each block has at most one part of a drive, and at most all else.
        most = longest - int(epoch[~driven].sum())
        if most < CHUNK:
            raise BenchError(
                ErrorCode.LIMIT_EXCEEDED,
                f"dwells[{begin}]",
                f"begins an epoch that selects and rests for {epoch[~driven].sum() / longest * max_block:g} s, and max_block is "
                f"{max_block:g} s: only drives can be cut, so send shorter dwells",
            )
        first, parts = begin, []
        for k, count in enumerate(epoch.tolist(), begin):
            pieces = -(-count // most) if driven[k - begin] else 1
            for piece in range(pieces):
                parts.append((k, count * (piece + 1) // pieces - count * piece // pieces))
                if driven[k - begin] and (piece + 1 < pieces or driven[k + 1 - begin :].any()):
                    yield first, k + 1, 0, parts
                    first, parts = k, []
        yield first, end, 1, parts
        begin = end


def _pieces(samples: int, max_repeats: int) -> Iterator[tuple[int, int]]:
    """Lengths and repeats that add up to `samples`."""
    longer = samples % CHUNK
    shorter = (samples - longer * (CHUNK + 1)) // CHUNK
    if shorter < 0:
        yield samples, 1
        return
    for length, repeats in ((CHUNK, shorter), (CHUNK + 1, longer)):
        while repeats > 0:
            yield length, min(repeats, max_repeats)
            repeats -= max_repeats
