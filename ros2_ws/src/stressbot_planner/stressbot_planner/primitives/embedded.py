"""The embedded system and its approximation by activations (paper, section "Switched and Embedded Systems").

    dq/ds = sum_i v_i(s) f_i(q),   v_i(s) >= 0

with s = u t in units of length. The paper takes weights that sum to 1, as here whatever is driven is driven by them. A
switched system comes as close to it as wanted: in each epoch every group is activated once, for the integral of its
weight. Headings then agree at the end of every epoch; positions differ by a sum of brackets [f_i, f_j], of first order in
the length of an epoch. A symmetric cycle, G_1 … G_m … G_1, each by half, leaves brackets of three only (Strang): second order.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from scipy.integrate import solve_ivp

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm, frozen_array
from stressbot_planner.primitives.brackets import f
from stressbot_planner.system.fields import FrozenArray

_TOLERANCE = 1e-11


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of all groups over the way s, linear between samples; two samples at one s make a jump.

    Attributes:
        ways: s of the samples, units, shape (N,), from 0, not falling, the last greater than the one before.
        values: v_i(s) >= 0, shape (N, m).

    Raises:
        StressbotError: naming `ways` or `values`.
    """

    ways: FrozenArray
    values: FrozenArray

    def __post_init__(self):
        object.__setattr__(self, "ways", frozen_array(self.ways))
        object.__setattr__(self, "values", frozen_array(self.values))
        ways, values = self.ways, self.values
        if ways.ndim != 1 or len(ways) < 2 or values.ndim != 2 or len(values) != len(ways):
            raise StressbotError(
                ErrorCode.WRONG_COUNT, "values", f"has shape {values.shape}: give a row for each of at least 2 ways"
            )
        for name, array in (("ways", ways), ("values", values)):
            if not np.all(np.isfinite(array)):
                raise StressbotError(ErrorCode.NOT_FINITE, name, "must be finite numbers")
        if ways[0] != 0 or np.any(np.diff(ways) < 0) or ways[-1] == ways[-2]:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, "ways", "must begin with 0, never fall, and end with a step forward")
        if np.any(values < 0):
            raise StressbotError(ErrorCode.OUT_OF_RANGE, "values", f"has the entry {values.min():g}: nothing drives backward")

    @classmethod
    def sampled(cls, function: Callable[[float], np.ndarray], ways: np.ndarray) -> "Weights":
        """Return the weights that a function s -> v(s), shape (m,), has at some ways (N,)."""
        return cls(ways, [function(float(way)) for way in ways])

    @property
    def length(self) -> float:
        """The last s, units."""
        return float(self.ways[-1])

    def at(self, way: float) -> np.ndarray:
        """Return v(s), shape (m,); after the jump, at one."""
        k, step = self._locate(np.array([way]))
        return (self.values[k] + self._slopes[k] * step[:, None])[0]

    def integrals(self, ways: np.ndarray) -> np.ndarray:
        """Return the integral of v from 0 to each s, exactly, shape (len(ways), m), units."""
        k, step = self._locate(np.asarray(ways, dtype=float))
        areas = 0.5 * np.diff(self.ways)[:, None] * (self.values[1:] + self.values[:-1])
        before = np.vstack([np.zeros(self.values.shape[1]), np.cumsum(areas, axis=0)])
        return before[k] + (self.values[k] + 0.5 * self._slopes[k] * step[:, None]) * step[:, None]

    @property
    def _slopes(self) -> np.ndarray:
        steps = np.diff(self.ways)[:, None]
        return np.divide(np.diff(self.values, axis=0), steps, out=np.zeros((len(steps), self.values.shape[1])), where=steps > 0)

    def _locate(self, ways: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        k = np.clip(np.searchsorted(self.ways, ways, side="right") - 1, 0, len(self.ways) - 2)
        return k, ways - self.ways[k]


def switch(weights: Weights, epochs: int, symmetric: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (K,), 1..m, and lengths (K,), units, of activations that follow the embedded system.

    Args:
        weights: v_i(s).
        epochs: number of equal epochs that the way is cut into, >= 1.
        symmetric: whether the cycle is G_1 … G_m … G_1 (error of second order, about 2m - 2 activations an epoch), or
            G_1 … G_m (first order, m activations).

    Activations of length 0 are left out, neighbours of one group joined.

    Raises:
        StressbotError: fewer than one epoch.
    """
    if epochs < 1:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "epochs", f"is {epochs}: give 1 or more")
    m = weights.values.shape[1]
    cycle = np.arange(1, m + 1)
    # differences of integrals may be negative by round-off
    shares = np.maximum(np.diff(weights.integrals(np.linspace(0.0, weights.length, epochs + 1)), axis=0), 0.0)
    if symmetric:
        cycle, shares = np.concatenate([cycle, cycle[::-1]]), np.hstack([shares, shares[:, ::-1]]) / 2
    groups, lengths = np.tile(cycle, epochs), shares.ravel()
    groups, lengths = groups[lengths > 0], lengths[lengths > 0]
    first = np.flatnonzero(np.diff(groups, prepend=0))
    return groups[first], np.add.reduceat(lengths, first) if len(first) else lengths


def integrate(swarm: Swarm, start: np.ndarray, weights: Weights) -> np.ndarray:
    """Return the poses (n, 3) to which the embedded system leads from poses (n, 3), by numerical integration.

    Raises:
        StressbotError: weights for another number of groups.
    """
    if weights.values.shape[1] != swarm.m:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "values", f"has weights for {weights.values.shape[1]} groups: the swarm has {swarm.m}"
        )
    fields = [f(swarm, group) for group in range(1, swarm.m + 1)]
    poses = np.asarray(start, dtype=float)
    for k in np.flatnonzero(np.diff(weights.ways)):  # weights bend and jump between these stretches only
        begin, end = weights.ways[k], weights.ways[k + 1]
        v, slope = weights.values[k], (weights.values[k + 1] - weights.values[k]) / (end - begin)

        def rate(way, state, begin=begin, v=v, slope=slope):
            now = v + slope * (way - begin)
            field = reduce(add, (field * weight for field, weight in zip(fields, now, strict=True)))
            return field.at(state.reshape(-1, 3)).ravel()

        solved = solve_ivp(rate, (begin, end), poses.ravel(), "DOP853", rtol=_TOLERANCE, atol=_TOLERANCE)
        poses = solved.y[:, -1].reshape(-1, 3)
    return poses
