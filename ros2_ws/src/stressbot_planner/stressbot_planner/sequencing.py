"""From activations to volts and back (paper, section on the selection of a group by a Physical Finite-State Machine).

One epoch selects a group and then drives:

    reset level for reset_dwell, rest for guard_dwell,
    then for each of the K symbols of the group's code: its level for symbol_dwell, rest for guard_dwell,
    then drive level for length / u, rest for guard_dwell.

A robot takes a symbol when the voltage returns to rest; the guards make that moment unmistakable. An activation of
length 0 moves nobody and gets no epoch. Neighbours of the same group are left apart: the plan decides, not this module.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.electrical import Electrical
from stressbot_planner.model.swarm import Swarm, frozen_array
from stressbot_planner.primitives.expansion import Primitive, expand
from stressbot_planner.system.fields import FrozenArray

MAX_ACTIVATIONS = 500_000
"""A plan of more is refused: its voltage sequence would take a hundred megabytes and hours on the substrate."""

_PER_SYMBOL = 2
_AROUND_CODE = 4
"""Segments of an epoch: two for each symbol, and reset, rest, drive, rest."""


@dataclass(frozen=True, eq=False)
class VoltageProgram:
    """A piecewise constant voltage: hold levels[k] for dwells[k].

    Attributes:
        levels: V, shape (N,).
        dwells: s, > 0, shape (N,).
        epoch_ends: epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1, shape (E,).
    """

    levels: FrozenArray
    dwells: FrozenArray
    epoch_ends: FrozenArray

    def __post_init__(self):
        object.__setattr__(self, "levels", frozen_array(self.levels))
        object.__setattr__(self, "dwells", frozen_array(self.dwells))
        object.__setattr__(self, "epoch_ends", frozen_array(self.epoch_ends, dtype=np.int64))

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


def encode(swarm: Swarm, electrical: Electrical, groups: np.ndarray, lengths: np.ndarray) -> VoltageProgram:
    """Return the volts that realise activations.

    Args:
        swarm: the robots.
        electrical: levels, dwells and the code of each group.
        groups: 1..m, shape (K,).
        lengths: units, >= 0, shape (K,); zeros are dropped.

    Raises:
        StressbotError: UNKNOWN_GROUP, NOT_FINITE, OUT_OF_RANGE or WRONG_COUNT, naming the activation.
    """
    groups, lengths = _checked(swarm, groups, lengths)
    groups, lengths = groups[lengths > 0], lengths[lengths > 0]
    level_template, dwell_template = _templates(swarm, electrical)
    levels = level_template[groups - 1]
    dwells = np.repeat(dwell_template[None, :], len(groups), axis=0)
    dwells[:, -2] = lengths / swarm.speed
    if np.any(dwells[:, -2] == 0.0):
        index = int(np.argmax(dwells[:, -2] == 0.0))
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "lengths", f"contains {lengths[index]}, which takes no time at all: leave it out"
        )
    segments = levels.shape[1]
    return VoltageProgram(levels.ravel(), dwells.ravel(), segments * np.arange(1, len(groups) + 1))


def decode(swarm: Swarm, electrical: Electrical, program: VoltageProgram) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (E,) and lengths (E,), units, of a program that `encode` made: its inverse.

    Raises:
        StressbotError: INVALID_SEQUENCE, naming the first epoch that does not select a group and then drive.
    """
    level_template, dwell_template = _templates(swarm, electrical)
    segments = level_template.shape[1]
    count = program.epoch_count
    whole = (
        len(program.levels) == len(program.dwells) == count * segments
        and np.array_equal(program.epoch_ends, segments * np.arange(1, count + 1))
    )
    if not whole:
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE, "epoch_ends", f"must divide the sequence into epochs of {segments} segments each"
        )
    levels = program.levels.reshape(count, segments)
    dwells = program.dwells.reshape(count, segments)
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
    wrong = (groups == 0) | ~timed.all(axis=1) | ~drives
    if np.any(wrong):
        raise StressbotError(
            ErrorCode.INVALID_SEQUENCE, f"epoch {int(np.argmax(wrong))}", "does not select a group by its code and then drive"
        )
    return groups, dwells[:, -2] * swarm.speed


def _templates(swarm: Swarm, electrical: Electrical) -> tuple[np.ndarray, np.ndarray]:
    """Return levels (m, S) of an epoch of each group and its dwells (S,); the drive, last but one, lasts 0."""
    if len(electrical.codes) != swarm.m:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "electrical.codes", f"has {len(electrical.codes)} entries for {swarm.m} groups"
        )
    codes = np.array(electrical.codes, dtype=int)
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
