"""Vector fields of the swarm and their Lie brackets, in closed form (paper, sections 3.2 to 4 and Table 2).

Every field that the generators f_i, g_i, h_i span acts on each robot alone, as a left-invariant field of SE(2):

    turn_j d/dtheta + forward_j E1 + sideways_j E2,   E1 = (cos theta, sin theta),   E2 = (-sin theta, cos theta)

with constants per robot. Brackets follow from [d/dtheta, E1] = E2, [d/dtheta, E2] = -E1 and [E1, E2] = 0, so that they
are exact and need no state. The order of a bracket is the number of generators in it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stressbot_planner.model.swarm import Swarm


@dataclass(frozen=True, eq=False)
class VectorField:
    """A field on the swarm's states; all rates are per unit of length driven.

    Attributes:
        turn: rad, shape (n,).
        forward: along the heading, shape (n,).
        sideways: to the left of the heading, shape (n,).
    """

    turn: np.ndarray
    forward: np.ndarray
    sideways: np.ndarray

    def __add__(self, other: "VectorField") -> "VectorField":
        return VectorField(self.turn + other.turn, self.forward + other.forward, self.sideways + other.sideways)

    def __mul__(self, factor: float) -> "VectorField":
        return VectorField(factor * self.turn, factor * self.forward, factor * self.sideways)

    __rmul__ = __mul__

    def __neg__(self) -> "VectorField":
        return -1.0 * self

    def __sub__(self, other: "VectorField") -> "VectorField":
        return self + -other

    def at(self, poses: np.ndarray) -> np.ndarray:
        """Return the rates of x, y and heading at poses (n, 3), shape (n, 3)."""
        cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        return np.column_stack(
            [self.forward * cosine - self.sideways * sine, self.forward * sine + self.sideways * cosine, self.turn]
        )

    @property
    def robots(self) -> tuple[int, ...]:
        """Ids of the robots whose position the field changes."""
        return tuple((np.flatnonzero((self.forward != 0) | (self.sideways != 0)) + 1).tolist())

    @property
    def is_zero(self) -> bool:
        """Whether the field changes nothing."""
        return not (np.any(self.turn) or np.any(self.forward) or np.any(self.sideways))


def g(swarm: Swarm, group: int) -> VectorField:
    """g_i: the members of G_i translate."""
    return VectorField(np.zeros(swarm.n), swarm.slides[group - 1], np.zeros(swarm.n))


def h(swarm: Swarm, group: int) -> VectorField:
    """h_i: all but the members of G_i turn."""
    rest = 1.0 - swarm.membership[group - 1]
    return VectorField(rest / swarm.turning_length, np.zeros(swarm.n), np.zeros(swarm.n))


def f(swarm: Swarm, group: int) -> VectorField:
    """f_i = g_i + h_i: what an activation of G_i does. f_m only turns."""
    return g(swarm, group) + h(swarm, group)


def bracket(first: VectorField, second: VectorField) -> VectorField:
    """Return [X, Y] = DY X - DX Y."""
    return VectorField(
        np.zeros_like(first.turn),
        second.turn * first.sideways - first.turn * second.sideways,
        first.turn * second.forward - second.turn * first.forward,
    )


def bracket_robots(first: VectorField, second: VectorField) -> tuple[int, ...]:
    """Return the ids of the robots that [X, Y] moves (the right column of Table 2)."""
    return bracket(first, second).robots


def generators(swarm: Swarm) -> list[VectorField]:
    """Return the paper's F = {g_1 … g_{m-1}, h_1 … h_{m-1}, f_m}."""
    groups = range(1, swarm.m)
    return [*(g(swarm, i) for i in groups), *(h(swarm, i) for i in groups), f(swarm, swarm.m)]


def position_rank(swarm: Swarm, order: int) -> int:
    """Return in how many independent directions brackets up to an order move the positions, at most 2n.

    Brackets of two translations vanish, so nested brackets with one translation and any rotations span everything.
    """
    rotations = [h(swarm, i) for i in range(1, swarm.m)] + [f(swarm, swarm.m)]
    layer = [g(swarm, i) for i in range(1, swarm.m)]
    spanned = _basis(layer)
    for _ in range(order - 1):
        layer = _basis([bracket(rotation, field) for rotation in rotations for field in layer])
        spanned = _basis(spanned + layer)
    return len(spanned)


def _basis(fields: Iterable[VectorField]) -> list[VectorField]:
    """Return orthonormal fields that span the same translations."""
    rows = np.array([np.concatenate([field.forward, field.sideways]) for field in fields])
    if not rows.size:
        return []
    _, size, directions = np.linalg.svd(rows, full_matrices=False)
    kept = directions[size > 1e-9 * max(size[0], 1e-300)]
    n = rows.shape[1] // 2
    return [VectorField(np.zeros(n), row[:n], row[n:]) for row in kept]
