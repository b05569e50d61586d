"""From activations to volts and back (paper, section on the selection of a group by a Physical Finite-State Machine).

One epoch selects a group and then drives:

    reset level for reset_dwell, rest for guard_dwell,
    then for each of the K symbols of the group's code: its level for symbol_dwell, rest for guard_dwell,
    then drive level for length / u, rest for guard_dwell.

Where robots have pull-down levels of their own, one level stands in place of reset and symbols, after a rest that lets all arms
rise; the drive follows at once, since arms that are down come up at rest.

Where the drive pulses, it is a train of length / step pulses instead, rounded to a whole number: what makes plans whole is
`model.whole_pulses`. Pulses of alternating polarity take epochs of either sign, so that the volts sum up to little.

A robot takes a symbol when the voltage returns to rest; the guards make that moment unmistakable. An activation of
length 0 moves nobody and gets no epoch. Neighbours of the same group are left apart: the plan decides, not this module.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.electrical import Electrical, Pulses
from stressbot_planner.model.swarm import Swarm, frozen_array
from stressbot_planner.model.whole_pulses import whole
from stressbot_planner.primitives.expansion import Primitive, expand
from stressbot_planner.system.fields import NO_ENTRIES, FrozenArray

MAX_ACTIVATIONS = 500_000
"""A plan of more is refused: its voltage sequence would take a hundred megabytes and hours on the substrate."""

MOST_PULSES = 2**53
"""Of one activation; more cannot be told apart as doubles."""

_PER_SYMBOL = 2
_AROUND_CODE = 4
"""Segments of an epoch: two for each symbol, and reset, rest, drive, rest."""


@dataclass(frozen=True, eq=False)
class VoltageProgram:
    """Segments of a voltage: levels that are held, and trains of pulses; as `voltage_sequence`.

    Attributes:
        levels: V, shape (N,): held, or the high level of a train's first pulse.
        dwells: s, > 0, shape (N,): how long each segment takes in all.
        epoch_ends: epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1, shape (E,).
        pulses: of each train, 0 where a level is held, shape (N,); (0,): there are no trains.
        low_levels: V, of the trains, shape as that of pulses.
        duty: share of a pulse at its high level.
        alternating: whether every other pulse of a train has the other sign.
    """

    levels: FrozenArray
    dwells: FrozenArray
    epoch_ends: FrozenArray
    pulses: FrozenArray = NO_ENTRIES
    low_levels: FrozenArray = NO_ENTRIES
    duty: float = 0.0
    alternating: bool = False

    def __post_init__(self):
        for name in ("levels", "dwells", "low_levels"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "epoch_ends", frozen_array(self.epoch_ends, dtype=np.int64))
        object.__setattr__(self, "pulses", frozen_array(self.pulses, dtype=np.uint64))

    def __eq__(self, other):
        if not isinstance(other, VoltageProgram):
            return NotImplemented
        return all(np.array_equal(a, b) for a, b in zip(vars(self).values(), vars(other).values(), strict=True))

    @property
    def epoch_count(self) -> int:
        """Number of epochs E."""
        return len(self.epoch_ends)

    @property
    def duration(self) -> float:
        """Sum of the dwells, s."""
        return float(np.sum(self.dwells))


def expand_bounded(swarm: Swarm, primitives: Iterable[Primitive]) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (K,) and lengths (K,), units, as `primitives.expand` does, for primitives of unknown origin.

    Raises:
        StressbotError: naming the primitive, INVALID_PLAN if there are more than MAX_ACTIVATIONS, or what `expand` refuses.
    """
    parts, total = [expand(swarm, ())], 0
    for index, primitive in enumerate(primitives):
        try:
            parts.append(expand(swarm, [primitive]))
        except StressbotError as error:
            raise StressbotError(error.code, f"primitives[{index}].{error.field}", error.message) from error
        total += len(parts[-1][0])
        if total > MAX_ACTIVATIONS:
            raise StressbotError(
                ErrorCode.INVALID_PLAN,
                f"primitives[{index}]",
                f"is where the plan exceeds {MAX_ACTIVATIONS} activations: plan less, or allow larger excursions",
            )
    return np.concatenate([groups for groups, _ in parts]), np.concatenate([lengths for _, lengths in parts])


def volts_of(
    swarm: Swarm, electrical: Electrical, starts: np.ndarray, groups: np.ndarray, lengths: np.ndarray
) -> VoltageProgram:
    """Return the volts that realise a plan from poses `starts` (n, 3): where the drive pulses, in pulses that are whole.

    The other arguments, and what is raised, are those of `encode`.
    """
    step = electrical.pulse_length(swarm.speed)
    if step is not None:
        lengths = step * whole(swarm, starts, groups, lengths, step)
    return encode(swarm, electrical, groups, lengths)


def encode(swarm: Swarm, electrical: Electrical, groups: np.ndarray, lengths: np.ndarray) -> VoltageProgram:
    """Return the volts that realise activations.

    Args:
        swarm: the robots.
        electrical: levels, dwells and the code of each group.
        groups: 1..m, shape (K,).
        lengths: units, >= 0, shape (K,); what takes no time is dropped, and of pulses what is less than half a step.

    Raises:
        StressbotError: UNKNOWN_GROUP, NOT_FINITE, OUT_OF_RANGE or WRONG_COUNT, naming the activation.
    """
    groups, lengths = _checked(swarm, groups, lengths)
    drive = electrical.drive
    counts = np.empty(0)
    if drive is not None:
        counts = _counts(lengths * (drive.frequency / swarm.speed))
        groups, counts = groups[counts > 0], counts[counts > 0]
        times = counts / drive.frequency
    else:
        groups, lengths = groups[lengths > 0], lengths[lengths > 0]
        times = lengths / swarm.speed
    level_template, dwell_template = _templates(swarm, electrical)
    levels = level_template[groups - 1]
    dwells = np.repeat(dwell_template[None, :], len(groups), axis=0)
    dwells[:, -2] = times
    if np.any(times == 0.0):
        index = int(np.argmax(times == 0.0))
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "lengths", f"contains {lengths[index]}, which takes no time at all: leave it out"
        )
    ends = levels.shape[1] * np.arange(1, len(groups) + 1)
    if drive is None:
        return VoltageProgram(levels.ravel(), dwells.ravel(), ends)
    pulses, lows = np.zeros(levels.shape), np.zeros(levels.shape)
    pulses[:, -2], lows[:, -2] = counts, drive.low_level
    if drive.alternating:
        signs = _balanced(drive, electrical.drive_level, levels, dwells, counts)
        levels, lows = signs * levels, signs * lows
    return VoltageProgram(levels.ravel(), dwells.ravel(), ends, pulses.ravel(), lows.ravel(), drive.duty, drive.alternating)


def _counts(steps: np.ndarray) -> np.ndarray:
    counts = np.rint(steps)
    if np.any(counts > MOST_PULSES):
        index = int(np.argmax(counts > MOST_PULSES))
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, f"activations[{index}].length", f"takes {counts[index]:g} pulses: give at most 2^53"
        )
    return counts


def _balanced(drive: Pulses, high: float, levels: np.ndarray, dwells: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return 1 or -1 for each epoch, shape (E, 1): the sign that takes the sum of the volts back towards 0.

    A train of alternating pulses leaves no more than its last one, if their number is odd.
    """
    pulse = (drive.duty * high + (1 - drive.duty) * drive.low_level) / drive.frequency
    charges = np.sum(np.delete(levels * dwells, -2, axis=1), axis=1) + (counts % 2) * pulse
    signs, total = np.ones((len(levels), 1)), 0.0
    for epoch, charge in enumerate(charges.tolist()):
        if total > 0:
            signs[epoch] = -1.0
        total += signs[epoch, 0] * charge
    return signs


def decode(swarm: Swarm, electrical: Electrical, program: VoltageProgram) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (E,) and lengths (E,), units, of a program that `encode` made: its inverse, but for rounding to whole pulses.

    Raises:
        StressbotError: INVALID_SEQUENCE, naming the first epoch that does not select a group and then drive.
    """
    level_template, dwell_template = _templates(swarm, electrical)
    segments = level_template.shape[1]
    count = program.epoch_count
    whole = (
        len(program.levels) == len(program.dwells) == count * segments
        and np.array_equal(program.epoch_ends, segments * np.arange(1, count + 1))
        and len(program.pulses) == len(program.low_levels) == (0 if electrical.drive is None else count * segments)
    )
    if not whole:
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE, "epoch_ends", f"must divide the sequence into epochs of {segments} segments each"
        )
    levels = program.levels.reshape(count, segments)
    dwells = program.dwells.reshape(count, segments)
    drive = electrical.drive
    pulses = lows = np.zeros((count, segments))
    if drive is not None:
        if (program.duty, program.alternating) != (drive.duty, drive.alternating):
            raise StressbotError(ErrorCode.INVALID_SEQUENCE, "duty", "and polarity must be those of electrical.drive")
        signs = np.where(levels[:, -2:-1] < 0, -1.0, 1.0) if drive.alternating else 1.0
        levels = signs * levels
        pulses, lows = program.pulses.reshape(count, segments), signs * program.low_levels.reshape(count, segments)
    # A level template is unlike every other, because the codes are, so that sorting finds its group.
    known, group_of_known = np.unique(level_template, axis=0, return_index=True)
    found, row_of_epoch = np.unique(levels, axis=0, return_inverse=True) if count else (levels, np.empty(0, dtype=int))
    group_of_found = np.zeros(len(found), dtype=np.int64)
    for row, pattern in enumerate(found):
        match = np.flatnonzero((known == pattern).all(axis=1))
        group_of_found[row] = group_of_known[match[0]] + 1 if len(match) else 0
    groups = group_of_found[row_of_epoch.ravel()]
    timed = np.delete(dwells, segments - 2, axis=1) == np.delete(dwell_template, segments - 2)
    drives = np.isfinite(dwells[:, -2]) & (dwells[:, -2] > 0)
    if drive is not None:
        held = np.delete(pulses, segments - 2, axis=1) == 0
        drives &= held.all(axis=1) & (lows[:, -2] == drive.low_level) & (pulses[:, -2] > 0)
        drives &= pulses[:, -2] / drive.frequency == dwells[:, -2]
    wrong = (groups == 0) | ~timed.all(axis=1) | ~drives
    if np.any(wrong):
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE, f"epoch {int(np.argmax(wrong))}", "does not select a group by its code and then drive"
        )
    return groups, dwells[:, -2] * swarm.speed if drive is None else pulses[:, -2] * (swarm.speed / drive.frequency)


def _templates(swarm: Swarm, electrical: Electrical) -> tuple[np.ndarray, np.ndarray]:
    """Return levels (m, S) of an epoch of each group and its dwells (S,); the drive, last but one, lasts 0."""
    if len(electrical.codes) != swarm.m:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "electrical.codes", f"has {len(electrical.codes)} entries for {swarm.m} groups"
        )
    codes = np.array(electrical.codes, dtype=int)
    if electrical.pull_downs:
        rest = np.full(swarm.m, electrical.rest_level)
        chosen = np.array(electrical.symbol_levels)[codes[:, 0]]
        levels = np.column_stack([rest, chosen, np.full(swarm.m, electrical.drive_level), rest])
        return levels, np.array([electrical.guard_dwell, electrical.symbol_dwell, 0.0, electrical.guard_dwell])
    count = codes.shape[1]
    levels = np.full((swarm.m, _PER_SYMBOL * count + _AROUND_CODE), electrical.rest_level)
    levels[:, 0] = electrical.reset_level
    levels[:, 2:-2:2] = np.array(electrical.symbol_levels)[codes]
    levels[:, -2] = electrical.drive_level
    dwells = np.full(levels.shape[1], electrical.guard_dwell)
    dwells[0] = electrical.reset_dwell
    dwells[2:-2:2] = electrical.symbol_dwell
    dwells[-2] = 0.0
    return levels, dwells


def _checked(swarm: Swarm, groups: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    groups, lengths = np.asarray(groups), np.asarray(lengths, dtype=float)
    if groups.shape != lengths.shape or groups.ndim != 1:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "lengths", f"has shape {lengths.shape}, groups {groups.shape}: give one length per group"
        )
    if len(groups) and not np.issubdtype(groups.dtype, np.integer):
        raise StressbotError(ErrorCode.WRONG_TYPE, "groups", "must be whole numbers")
    for wrong, code, field, change in (
        ((groups < 1) | (groups > swarm.m), ErrorCode.UNKNOWN_GROUP, "group", f"use 1 to {swarm.m}"),
        (~np.isfinite(lengths), ErrorCode.NOT_FINITE, "length", "give a finite length"),
        (lengths < 0, ErrorCode.OUT_OF_RANGE, "length", "robots cannot move backward; give 0 or more"),
    ):
        if np.any(wrong):
            index = int(np.argmax(wrong))
            value = (groups if field == "group" else lengths)[index]
            raise StressbotError(code, f"activations[{index}].{field}", f"is {value}: {change}")
    return groups.astype(np.int64), lengths
