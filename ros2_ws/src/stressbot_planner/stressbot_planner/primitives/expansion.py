"""Motion primitives and their expansion into activations (paper, sections 3 and 5).

Every primitive expands without knowledge of any pose: only groups, lengths and turning radii matter. The bilateral
vector fields h_i and g_i, Rot and the subgroup primitives hold for one common turning radius r.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf, pi

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.kinematics import Activation
from stressbot_planner.model.swarm import Swarm

TURN = 2 * pi
_NEGLIGIBLE = 1e-12
"""Angles below this (rad) are left out: round-off of a reduction modulo 2 pi."""

MAX_ACTIVATIONS = 1_000_000
"""A primitive that expands into more is refused: with a tiny excursion it would fill the memory."""


@dataclass(frozen=True)
class Activate:
    """f_i(length): members of G_i slide by length, all others turn by length / r_j. Works for any turning radii."""

    group: int
    length: float

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        _check_group(swarm, self.group, swarm.m)
        check_length("length", self.length)
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
        check_finite("distance", self.distance)
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
            activations += _turn(swarm, group, float(angle), self.excursion)
            _check_count(len(activations), self.excursion)
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
        check_length("distance", self.distance)
        # the first factor is the innermost, and a half turn of the members (outside) drives less
        factors = [(j, False) for j in self.outside] + [(j, True) for j in self.inside]
        _check_excursion(self.excursion)
        for k, (j, _) in enumerate(factors):
            _check_group(swarm, j, swarm.m - 1)
            if j == self.group or j in [other for other, _ in factors[:k]]:
                raise StressbotError(ErrorCode.INVALID_PLAN, "inside/outside", f"names the group {j} twice: leave it out once")
        half_turns, count = [], 1
        for j, keep_members in factors:
            half_turn = _turn(swarm, j, pi, self.excursion)
            half_turns.append(half_turn if keep_members else merge(swarm, half_turn + _turn_all(swarm, pi)))
            count = 2 * (count + len(half_turns[-1]))
        repeats = _repeats(self.distance / 2, self.excursion, count) if factors else 1
        pulse = [Activation(self.group, self.distance / repeats / self.pulses)]
        for half_turn in half_turns:
            pulse = [*pulse, *half_turn, *pulse, *half_turn]
        return pulse * repeats

    @property
    def pulses(self) -> int:
        """Number of slides of G_i that add up to the distance, each of distance / pulses; an excursion repeats them."""
        return 2 ** (len(self.inside) + len(self.outside))


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

    def pulses(self, swarm: Swarm) -> int:
        """Return the number of slides of G_i that add up to the distance: 2^(m - 2) at most."""
        return self.subgroup(swarm).pulses

    def subgroup(self, swarm: Swarm) -> Subgroup:
        """Return the subgroup primitive that moves this robot only, with as few halvings as a greedy choice finds."""
        _check_members(swarm, self.group, [self.robot])
        inside, outside = halvings(swarm, self.group, self.robot, swarm.membership[self.group - 1])
        return Subgroup(self.group, self.distance, inside, outside, self.excursion)


@dataclass(frozen=True)
class Extract:
    """Only some robots of G_i move, forward by distance: the recursion P_{k+1} = (P_k, Rot, P_k) of the paper's STLC proof.

    Each Rot turns further members of G_i by pi, as many as it can besides keeping `robots` as they are, so that these
    go back. Turns that P_k itself has caused are made up for. Every level doubles the pulses; headings are not
    restored, which makes it shorter than `Subgroup` and `Isolate` where few levels are needed (one at n = 6).
    """

    robots: tuple[int, ...]
    group: int
    distance: float
    excursion: float = inf

    def expand(self, swarm: Swarm) -> list[Activation]:
        """Return the activations."""
        check_length("distance", self.distance)
        _check_excursion(self.excursion)
        pulses = self.pulses(swarm)
        batches = _batches(swarm, self.robots, self.group)
        repeats = _repeats(self.distance / 2, self.excursion, pulses) if batches else 1
        pulse = [Activation(self.group, self.distance / repeats / pulses)]
        for batch in batches:
            turned = _turned_by(swarm, pulse)
            angles = [-turned[robot - 1] for robot in self.robots] + [pi - turned[robot - 1] for robot in batch]
            rot = Orient(self.robots + batch, tuple(angles), self.excursion).expand(swarm)
            pulse = merge(swarm, [*pulse, *rot, *pulse])
            _check_count(repeats * len(pulse), self.excursion)
        return pulse * repeats

    def pulses(self, swarm: Swarm) -> int:
        """Return the number of slides of G_i that add up to the distance: doubled with every level."""
        _check_members(swarm, self.group, self.robots)
        return 2 ** len(_batches(swarm, self.robots, self.group))


Primitive = Activate | Turn | TurnAll | Translate | Orient | Subgroup | Isolate | Extract


def expand(swarm: Swarm, primitives: Iterable[Primitive]) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (K,), 1..m, and lengths (K,), units, of the activations that realise primitives."""
    activations = [activation for primitive in primitives for activation in primitive.expand(swarm)]
    groups = np.array([activation.group for activation in activations], dtype=np.int64)
    return groups, np.array([activation.length for activation in activations], dtype=float)


def as_primitives(groups: np.ndarray, lengths: np.ndarray) -> tuple[Activate, ...]:
    """Return activations of groups (K,), 1..m, with lengths (K,), units, as primitives: what `expand` undoes."""
    return tuple(Activate(int(group), float(length)) for group, length in zip(groups, lengths, strict=True))


def merge(swarm: Swarm, activations: list[Activation]) -> list[Activation]:
    """Join neighbours of the same group; drop what does nothing. Turns of all robots are reduced modulo 2 pi."""
    merged: list[Activation] = []
    alike = swarm.alike
    full_turn = TURN * float(swarm.turning_radius[0]) if alike else inf
    for group, length in activations:
        if merged and merged[-1].group == group:
            length += merged.pop().length
        if group == swarm.m and alike:
            length %= full_turn
            if min(length, full_turn - length) < _NEGLIGIBLE * full_turn:
                continue
        if length > 0:
            merged.append(Activation(group, length))
    return merged


_MOST_BASES = 64


@lru_cache(maxsize=4096)
def _bases(rows: bytes, count: int, m: int) -> list[tuple[tuple[int, ...], np.ndarray]]:
    """Return column choices that make the orientation matrix invertible, cheap ones (with f_m) first.

    Every choice that is looked into leads to one: of thirty robots and as many groups there are millions that do not.
    """
    matrix = np.frombuffer(rows, dtype=float).reshape(count, m)
    found: list[tuple[tuple[int, ...], np.ndarray]] = []

    def extend(columns: tuple[int, ...], left: range) -> None:
        if len(columns) == count:
            found.append((columns, np.linalg.inv(matrix[:, columns])))
            return
        for k in left:
            if len(found) == _MOST_BASES or not _independent(matrix[:, columns + tuple(range(k, -1, -1))].T, count):
                return
            chosen = (*columns, k)
            if _independent(matrix[:, chosen], len(chosen)):
                extend(chosen, range(k - 1, -1, -1))

    extend((), range(m - 1, -1, -1))
    return found


def _independent(matrix: np.ndarray, rank: int) -> bool:
    return np.linalg.matrix_rank(matrix) == rank


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
    for index, angle in enumerate(angles):
        check_finite(f"angles[{index}]", angle)
    rows = orientation_matrix(swarm)[[robot - 1 for robot in robots]]
    bases = _bases(np.ascontiguousarray(rows).tobytes(), len(robots), swarm.m)
    if not bases:
        raise StressbotError(
            ErrorCode.INVALID_PLAN,
            "robots",
            f"{list(robots)} cannot be turned independently: their rows of the orientation matrix are dependent",
        )
    wanted = np.asarray(angles, dtype=float)

    def inputs(columns: Sequence[int], inverse: np.ndarray) -> np.ndarray:
        turns = np.zeros(swarm.m)
        turns[list(columns)] = [_wrap(float(turn)) for turn in inverse @ wanted]
        return turns

    def way(turns: np.ndarray) -> float:
        return turns[-1] + sum(turn + TURN for turn in turns[:-1] if turn > 0)

    return min((inputs(*basis) for basis in bases), key=way)


def halvings(swarm: Swarm, group: int, robot: int, among: np.ndarray) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return other groups in all of the first and in none of the second of which only one robot (id) is, of those `among` (n,).

    As few as a greedy choice finds. Codewords of those among must differ.
    """
    k, left = robot - 1, among.copy()
    inside, outside = [], []
    others = [j for j in range(swarm.m - 1) if j != group - 1]
    while left.sum() > 1:
        like_k = [left & (swarm.membership[j] == swarm.membership[j, k]) for j in others]
        best = min(range(len(others)), key=lambda index: like_k[index].sum())
        j = others.pop(best)
        left = like_k[best]
        (inside if swarm.membership[j, k] else outside).append(j + 1)
    return tuple(inside), tuple(outside)


def check_robot(swarm: Swarm, robot: int) -> None:
    """Raise unless robot is an id of the swarm."""
    if not 1 <= robot <= swarm.n:
        raise StressbotError(ErrorCode.UNKNOWN_ROBOT, "robot", f"is {robot}: the swarm has robots 1 to {swarm.n}")


@lru_cache(maxsize=4096)
def _batches(swarm: Swarm, keep: tuple[int, ...], group: int) -> list[tuple[int, ...]]:
    """Return the members of a group except keep, in sets that can be turned independently of each other and of keep."""
    left = [int(robot) + 1 for robot in np.flatnonzero(swarm.membership[group - 1]) if robot + 1 not in keep]
    batches = []
    while left:
        batch: tuple[int, ...] = ()
        for robot in left:
            if can_orient(swarm, keep + batch + (robot,)):
                batch += (robot,)
        if not batch:
            raise StressbotError(
                ErrorCode.INVALID_PLAN, "robots", f"{list(keep)} cannot be kept while robot {left[0]} turns: extract fewer robots"
            )
        batches.append(batch)
        left = [robot for robot in left if robot not in batch]
    return batches


def _turned_by(swarm: Swarm, activations: list[Activation]) -> np.ndarray:
    """Return by how much activations turn each robot, rad, shape (n,)."""
    groups = np.array([activation.group for activation in activations], dtype=int) - 1
    lengths = np.array([activation.length for activation in activations])
    return (~swarm.membership[groups]).T @ lengths / swarm.turning_length


def _wrap(angle: float) -> float:
    wrapped = angle % TURN
    return 0.0 if min(wrapped, TURN - wrapped) < _NEGLIGIBLE else wrapped


def _turn_all(swarm: Swarm, angle: float) -> list[Activation]:
    check_finite("angle", angle)
    angle = _wrap(float(angle))
    return [Activation(swarm.m, angle * swarm.common_turning_radius())] if angle else []


def _turn(swarm: Swarm, group: int, angle: float, excursion: float) -> list[Activation]:
    r = swarm.common_turning_radius()
    check_finite("angle", angle)
    _check_excursion(excursion)
    angle = _wrap(float(angle))
    if not angle:
        return []
    swing = angle * r / 2
    repeats = _repeats(swing, excursion, 4)
    half = [Activation(group, swing / repeats), Activation(swarm.m, pi * r)]
    return half * (2 * repeats)


def _check_group(swarm: Swarm, group: int, largest: int) -> None:
    if not 1 <= group <= largest:
        raise StressbotError(ErrorCode.UNKNOWN_GROUP, "group", f"is {group}: use 1 to {largest}")


def _check_members(swarm: Swarm, group: int, robots: Iterable[int]) -> None:
    """Raise unless robots are members of a group, and h_j and Rot, which single them out, exist."""
    _check_group(swarm, group, swarm.m - 1)
    swarm.common_turning_radius()
    for robot in robots:
        check_robot(swarm, robot)
        if not swarm.membership[group - 1, robot - 1]:
            raise StressbotError(
                ErrorCode.INVALID_PLAN, "group", f"{group} does not contain robot {robot}: choose one that does"
            )


def _repeats(reach: float, excursion: float, activations: int) -> int:
    """Return in how many parts a motion is to be made so that none reaches out farther than excursion."""
    parts = max(1.0, np.ceil(reach / excursion - 1e-12))
    _check_count(parts * activations, excursion)
    return int(parts)


def _check_count(activations: float, excursion: float) -> None:
    if activations > MAX_ACTIVATIONS:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "excursion", f"is {excursion}: this takes {activations:.3g} activations; enlarge it"
        )


def _check_excursion(excursion: float) -> None:
    if not excursion > 0:
        code = ErrorCode.NOT_FINITE if np.isnan(excursion) else ErrorCode.OUT_OF_RANGE
        raise StressbotError(code, "excursion", f"is {excursion}: give a length greater than 0")


def check_finite(field: str, value: float) -> None:
    """Raise unless a value is finite."""
    if not np.isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {value}: give a finite number")


def check_length(field: str, length: float) -> None:
    """Raise unless a length is finite and not negative."""
    check_finite(field, length)
    if length < 0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {length}: robots cannot move backward; give 0 or more")


