"""Motion primitives and their expansion into activations (paper, sections 3 and 5).

Every primitive expands without knowledge of any pose: only groups, lengths and turning radii matter. The bilateral
vector fields h_i and g_i, Rot and the subgroup primitives hold for one common turning radius r.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import ceil, inf, pi

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.kinematics import Activation
from stressbot_planner.swarm import Swarm

TURN = 2 * pi
_NEGLIGIBLE = 1e-12
"""Angles below this (rad) are left out: round-off of a reduction modulo 2 pi."""


@dataclass(frozen=True)
class Activate:
    """f_i(length): members of G_i slide by length, all others turn by length / r_j. Works for any turning radii."""

    group: int
    length: float

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        _check_group(swarm, self.group, swarm.m)
        _check_length("length", self.length)
        return [Activation(self.group, self.length)]


@dataclass(frozen=True)
class Turn:
    """h_i(angle): all robots but the members of G_i turn by angle; nobody ends displaced.

    h_i(2 d / r) = (f_i(d), f_m(pi), f_i(d), f_m(pi)), and h_i(-angle) = h_i(2 pi - angle). Members swing out by d and
    back; with an excursion they swing several times, at most that far.
    """

    group: int
    angle: float
    excursion: float = inf

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        _check_group(swarm, self.group, swarm.m - 1)
        return _turn(swarm, self.group, self.angle, self.excursion)


@dataclass(frozen=True)
class TurnAll:
    """f_m(angle): all robots turn counter-clockwise by angle, reduced to [0, 2 pi)."""

    angle: float

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        return _turn_all(swarm, self.angle)


@dataclass(frozen=True)
class Translate:
    """g_i(distance): members of G_i move by distance, forward or backward; nobody else ends displaced, nobody turned.

    g_i(d) = (f_i(d), h_i(-d / r)) and g_i(-d) = (f_m(pi), g_i(d), f_m(pi)). The paper prints h_i(pi) for the last
    factor, which would leave the members turned by pi.
    """

    group: int
    distance: float
    excursion: float = inf

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        _check_group(swarm, self.group, swarm.m - 1)
        distance = abs(self.distance)
        forward = [
            Activation(self.group, distance),
            *_turn(swarm, self.group, -distance / swarm.common_turning_radius(), self.excursion),
        ]
        return forward if self.distance >= 0 else [*_turn_all(swarm, pi), *forward, *_turn_all(swarm, pi)]


@dataclass(frozen=True)
class Orient:
    """Rot: each of some robots turns by its own angle; the others turn by unspecified angles, nobody ends displaced.

    Any three robots will do, and any set whose rows of the orientation matrix are independent (at most m).
    """

    robots: tuple[int, ...]
    angles: tuple[float, ...]
    excursion: float = inf

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        turns = rotation_inputs(swarm, self.robots, self.angles)
        activations = []
        for group, angle in enumerate(turns[:-1], start=1):
            activations += _turn(swarm, group, angle, self.excursion)
        return activations + _turn_all(swarm, turns[-1])


@dataclass(frozen=True)
class Subgroup:
    """Only the members of G_i that lie in all groups of `inside` and in none of `outside` move, forward by distance.

    One factor at a time halves the group: for each other group G_j take (Q, A_j, Q, A_j), where A_j turns by pi all
    robots outside G_j (A_j = h_j(pi)) or all in G_j (A_j = f_m(pi) h_j(pi)). Robots that A_j turns go forth and back,
    the others move twice as far. The pulse Q starts as f_i. This realises the brackets [h_j, g_i] (Table 2) and
    their nested forms with 2^(depth) pulses, where the paper's recursion needs exponentially many in the group size.
    Robots outside G_i end turned by distance / r; all other headings are restored.
    """

    group: int
    distance: float
    inside: tuple[int, ...] = ()
    outside: tuple[int, ...] = ()
    excursion: float = inf

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        _check_group(swarm, self.group, swarm.m - 1)
        _check_length("distance", self.distance)
        # the first factor is the innermost, and a half turn of the members (outside) drives less
        factors = [(j, False) for j in self.outside] + [(j, True) for j in self.inside]
        for j, _ in factors:
            _check_group(swarm, j, swarm.m - 1)
            if j == self.group:
                raise StressbotError(ErrorCode.UNKNOWN_GROUP, "inside/outside", f"repeats the group {j} itself: leave it out")
        repeats = max(1, ceil(self.distance / 2 / self.excursion - 1e-12)) if factors else 1
        pulse = [Activation(self.group, self.distance / repeats / 2 ** len(factors))]
        for j, keep_members in factors:
            half_turn = _turn(swarm, j, pi, self.excursion)
            if not keep_members:
                half_turn = merge(swarm, half_turn + _turn_all(swarm, pi))
            pulse = [*pulse, *half_turn, *pulse, *half_turn]
        return pulse * repeats


@dataclass(frozen=True)
class Isolate:
    """One robot alone slides by distance along its heading: the subgroup of G_i that only it belongs to.

    This is the constructive form of the paper's STLC proposition, in O(n) pulses.
    """

    robot: int
    distance: float
    group: int
    excursion: float = inf

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        return self.subgroup(swarm).expand(swarm)

    def subgroup(self, swarm: Swarm) -> Subgroup:
        """Return the subgroup primitive that moves this robot only, with as few halvings as a greedy choice finds."""
        _check_group(swarm, self.group, swarm.m - 1)
        check_robot(swarm, self.robot)
        k = self.robot - 1
        if not swarm.membership[self.group - 1, k]:
            raise StressbotError(
                ErrorCode.INVALID_PLAN, "group", f"{self.group} does not contain robot {self.robot}: choose one that does"
            )
        left = swarm.membership[self.group - 1].copy()
        inside, outside = [], []
        others = [j for j in range(swarm.m - 1) if j != self.group - 1]
        while left.sum() > 1:
            like_k = [left & (swarm.membership[j] == swarm.membership[j, k]) for j in others]
            best = min(range(len(others)), key=lambda index: like_k[index].sum())
            j = others.pop(best)
            left = like_k[best]
            (inside if swarm.membership[j, k] else outside).append(j + 1)
        return Subgroup(self.group, self.distance, tuple(inside), tuple(outside), self.excursion)


Primitive = Activate | Turn | TurnAll | Translate | Orient | Subgroup | Isolate


def expand(swarm: Swarm, primitives: Iterable[Primitive]) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (K,), 1..m, and lengths (K,), units, of the activations that realise primitives."""
    activations = [activation for primitive in primitives for activation in primitive.expand(swarm)]
    groups = np.array([activation.group for activation in activations], dtype=np.int64)
    return groups, np.array([activation.length for activation in activations], dtype=float)


def merge(swarm: Swarm, activations: list[Activation]) -> list[Activation]:
    """Join neighbours of the same group; drop what does nothing. Turns of all robots are reduced modulo 2 pi."""
    merged: list[Activation] = []
    full_turn = TURN * float(swarm.turning_radius[0]) if swarm.equal_radii else inf
    for group, length in activations:
        if merged and merged[-1].group == group:
            length += merged.pop().length
        if group == swarm.m and swarm.equal_radii:
            length %= full_turn
            if min(length, full_turn - length) < _NEGLIGIBLE * full_turn:
                continue
        if length > 0:
            merged.append(Activation(group, length))
    return merged


@cache
def _bases(rows: bytes, count: int, m: int) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """Return column choices that make the orientation matrix invertible, cheap ones (with f_m) first."""
    matrix = np.frombuffer(rows, dtype=float).reshape(count, m)
    found = []
    for columns in combinations(range(m - 1, -1, -1), count):
        basis = matrix[:, columns]
        if abs(np.linalg.det(basis)) > 0.5:
            found.append((columns, np.linalg.inv(basis)))
        if len(found) == 64:
            break
    return found


def orientation_matrix(swarm: Swarm) -> np.ndarray:
    """Return the matrix of the paper's equation for Rot, shape (n, m): h_1 … h_{m-1}, f_m by columns.

    Entry (j, i) is 1 where robot j turns. Built from the allocation: rows 4 and 6 of the printed one are swapped.
    """
    matrix = np.ones((swarm.n, swarm.m))
    matrix[:, :-1] = ~swarm.membership[:-1].T
    return matrix


def can_orient(swarm: Swarm, robots: Iterable[int]) -> bool:
    """Return whether the headings of these robots (ids) can be set independently (rank condition)."""
    rows = [robot - 1 for robot in robots]
    return len(rows) <= swarm.m and np.linalg.matrix_rank(orientation_matrix(swarm)[rows]) == len(rows)


def rotation_inputs(swarm: Swarm, robots: tuple[int, ...], angles: tuple[float, ...]) -> np.ndarray:
    """Return the angles u in [0, 2 pi), shape (m,), of h_1 … h_{m-1}, f_m that turn robots by angles.

    Of the bases of the orientation matrix the one that drives shortest is taken.

    Raises:
        StressbotError: the robots' headings cannot be set independently.
    """
    if len(robots) != len(angles):
        raise StressbotError(ErrorCode.WRONG_COUNT, "angles", f"has {len(angles)} entries for {len(robots)} robots")
    for robot in robots:
        check_robot(swarm, robot)
    rows = orientation_matrix(swarm)[[robot - 1 for robot in robots]]
    bases = _bases(np.ascontiguousarray(rows).tobytes(), len(robots), swarm.m)
    if not bases:
        raise StressbotError(
            ErrorCode.INVALID_PLAN,
            "robots",
            f"{list(robots)} cannot be turned independently: their rows of the orientation matrix are dependent",
        )
    best, best_cost = None, inf
    for columns, inverse in bases:
        turns = np.zeros(swarm.m)
        turns[list(columns)] = _wrap(inverse @ np.asarray(angles, dtype=float))
        cost = turns[-1] + sum(turn + TURN for turn in turns[:-1] if turn > 0)
        if cost < best_cost:
            best, best_cost = turns, cost
    return best


def check_robot(swarm: Swarm, robot: int) -> None:
    """Raise unless robot is an id of the swarm."""
    if not 1 <= robot <= swarm.n:
        raise StressbotError(ErrorCode.UNKNOWN_ROBOT, "robot", f"is {robot}: the swarm has robots 1 to {swarm.n}")


def _wrap(angle):
    wrapped = np.mod(angle, TURN)
    return np.where(np.minimum(wrapped, TURN - wrapped) < _NEGLIGIBLE, 0.0, wrapped)


def _turn_all(swarm: Swarm, angle: float) -> list[Activation]:
    angle = float(_wrap(angle))
    return [Activation(swarm.m, angle * swarm.common_turning_radius())] if angle else []


def _turn(swarm: Swarm, group: int, angle: float, excursion: float) -> list[Activation]:
    r = swarm.common_turning_radius()
    angle = float(_wrap(angle))
    if not angle:
        return []
    if excursion <= 0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "excursion", f"is {excursion}: give a length greater than 0")
    swing = angle * r / 2
    repeats = max(1, ceil(swing / excursion - 1e-12))
    half = [Activation(group, swing / repeats), Activation(swarm.m, pi * r)]
    return half * (2 * repeats)


def _check_group(swarm: Swarm, group: int, largest: int) -> None:
    if not 1 <= group <= largest:
        raise StressbotError(ErrorCode.UNKNOWN_GROUP, "group", f"is {group}: use 1 to {largest}")


def _check_length(field: str, length: float) -> None:
    if not np.isfinite(length):
        raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {length}: give a finite length")
    if length < 0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {length}: robots cannot move backward; give 0 or more")


