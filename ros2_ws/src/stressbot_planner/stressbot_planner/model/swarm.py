"""The swarm: who belongs to which group, and how each robot moves."""

from dataclasses import Field, dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system.fields import ONE, FrozenArray


def frozen_array(values: ArrayLike, dtype: DTypeLike = float) -> np.ndarray:
    """Return a read-only copy, so that immutable values may hold it; by rows, so that kernels are compiled for one layout."""
    array = np.array(values, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


class Remade:
    """A dataclass that is pickled as what it is made of: its arrays stay read-only, as those that kernels are compiled for."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __reduce__(self):
        return type(self), tuple(getattr(self, entry.name) for entry in fields(self))


@dataclass(frozen=True, eq=False)
class Swarm(Remade):
    """n robots in m groups (paper, section "Group-Control").

    Attributes:
        speed: u, forward speed of the fastest robot, units/s.
        turning_radius: r_j, units, shape (n,); a robot outside the active group turns at u s_j / r_j.
        body_radius: radius of the disc that the turning body sweeps, units, shape (n,); 0: a point, which other points pass.
        codewords: one bit string per robot, all of length m - 1; bit i (from 1) is '1' for a member of G_i.
        pace: s_j, speed of each robot in relation to u, shape (n,), the largest is 1.

    Raises:
        StressbotError: no robots, ill-formed or empty codewords, turning radii or speed not positive, negative body radii, or
            two robots that share codeword and turning radius ÷ speed.
    """

    speed: float
    turning_radius: FrozenArray
    body_radius: FrozenArray
    codewords: tuple[str, ...]
    pace: FrozenArray = ONE

    def __post_init__(self):
        n = len(self.codewords)
        if n == 0:
            raise StressbotError(ErrorCode.NO_ROBOTS, "robots", "is empty: list at least one robot")
        check_codewords(self.codewords)
        _check_size("swarm.speed", self.speed)
        for name in ("turning_radius", "body_radius", "pace"):
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape not in ((), (n,)):
                raise StressbotError(
                    ErrorCode.WRONG_COUNT, f"swarm.{name}", f"has shape {values.shape} for {n} robots: give one number, or {n}"
                )
            for value in np.unique(values):
                if name == "body_radius":
                    _check_body(value)
                else:
                    _check_size(f"swarm.{name}", value)
            object.__setattr__(self, name, frozen_array(np.broadcast_to(values, (n,))))
        if self.pace.max() != 1.0:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, "swarm.pace", f"is at most {self.pace.max()}: the fastest has 1")
        check_told_apart(self.codewords, self.turning_radius, self.speed * self.pace)

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.codewords)

    @cached_property
    def m(self) -> int:
        """Number of groups, the all-rotate group G_m included."""
        return len(self.codewords[0]) + 1

    @cached_property
    def membership(self) -> np.ndarray:
        """Activation vectors alpha: shape (m, n), True where robot j is in group i; the last row is all False."""
        bits = np.array([[bit == "1" for bit in word] for word in self.codewords], dtype=bool)
        return frozen_array(np.vstack([bits.T, np.zeros(self.n, dtype=bool)]), dtype=bool)

    @cached_property
    def slides(self) -> np.ndarray:
        """How far each robot slides in an activation of length 1, shape (m, n): its pace in its groups, else 0."""
        return frozen_array(self.membership * (1.0 if self.equal_speeds else self.pace))

    @cached_property
    def turning_length(self) -> np.ndarray:
        """r_j / s_j, shape (n,): length of an activation in which a robot that does not slide turns by 1 rad, units.

        Equal ones are one number, see `classes`.
        """
        lengths = self.turning_radius / self.pace
        _, first, label = np.unique(classes(lengths), return_index=True, return_inverse=True)
        return frozen_array(lengths[first][label])

    @cached_property
    def group_sizes(self) -> np.ndarray:
        """Number of members of each group, shape (m,)."""
        return frozen_array(self.membership.sum(axis=1), dtype=int)

    @cached_property
    def equal_radii(self) -> bool:
        """Whether one turning radius serves all robots, as the paper assumes from section 3.1 on."""
        return not classes(self.turning_radius).any()

    @cached_property
    def equal_speeds(self) -> bool:
        """Whether all robots are equally fast, as the paper assumes."""
        return not classes(self.pace).any()

    @cached_property
    def girth(self) -> np.ndarray:
        """What margins and noises are taken of, shape (n,), units: the body radius, of a point a share of its turning radius."""
        return frozen_array(np.where(self.body_radius > 0, self.body_radius, POINT_GIRTH * self.turning_radius))

    @property
    def alike(self) -> bool:
        """Whether an activation turns all robots by one angle, and slides all by one distance."""
        return self.equal_radii and self.equal_speeds

    def common_turning_radius(self) -> float:
        """Return r.

        Raises:
            StressbotError: radii or speeds differ, so that no activation turns every robot by the same angle.
        """
        if not self.alike:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                "swarm.speed" if self.equal_radii else "swarm.turning_radius",
                "differs between robots: the primitives h_i, g_i and Rot need one common turning radius and speed; "
                "use activations, or isolate in the form 'radii'",
            )
        return float(self.turning_length[0])


POINT_GIRTH = 0.1
"""Of a point, in turning radii."""

EQUAL = 1e-9
"""Radii and speeds, and their quotients, are equal if they differ by no more than this, relative: computed ones are rounded."""


def classes(values: ArrayLike) -> np.ndarray:
    """Return which of positive values (n,) are equal: numbers of their classes, 0 for the smallest values, shape (n,).

    A class ends where the next larger value differs by more than `EQUAL`, so that the order of values makes no difference.
    """
    values = np.asarray(values, dtype=float)
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    labels = np.empty(len(values), dtype=np.int64)
    labels[order] = np.cumsum(np.r_[False, ascending[1:] > (1 + EQUAL) * ascending[:-1]])
    return labels


def fastest(speeds: ArrayLike) -> tuple[float, np.ndarray]:
    """Return the speed u and the paces s_j, as `Swarm` takes them, of robots with these speeds, units/s.

    Raises:
        StressbotError: a speed is not positive, naming `swarm.speed`.
    """
    speeds = np.asarray(speeds, dtype=float)
    if speeds.size == 0:
        raise StressbotError(ErrorCode.NO_ROBOTS, "swarm.speed", "is empty: list at least one robot")
    for speed in np.unique(speeds):
        _check_size("swarm.speed", speed)
    return float(speeds.max()), speeds / speeds.max()


LARGEST = 1e9 * (1 + 1e-9)
"""Largest coordinate, radius or speed: beyond it a double cannot tell places apart that are 1e-6 from each other.

The schema of scenario files has 1e9. What a driver describes has been converted to metres and back.
"""


def check_coordinates(field: str, values: ArrayLike) -> None:
    """Raise unless all values, of one point (d,) or several (v, d), are finite and at most `LARGEST` in size."""
    values = np.asarray(values, dtype=float)
    if values.ndim > 1:
        for k in np.flatnonzero(~np.all(np.abs(values) <= LARGEST, axis=1))[:1]:
            check_coordinates(f"{field}[{k}]", values[k])
        return
    if not np.all(np.isfinite(values)):
        raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {values.tolist()}: give finite numbers")
    if np.any(np.abs(values) > LARGEST):
        raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {values.tolist()}: give numbers of at most {LARGEST:g} in size")


def _check_size(field: str, value: float) -> None:
    check_positive(field, value)
    if not 1 / LARGEST <= value <= LARGEST:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {value}: give a number from {1 / LARGEST:g} to {LARGEST:g}")


def _check_body(radius: float) -> None:
    if not np.isfinite(radius):
        raise StressbotError(ErrorCode.NOT_FINITE, "swarm.body_radius", f"is {radius}: give a finite number")
    if radius != 0 and not 1 / LARGEST <= radius <= LARGEST:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "swarm.body_radius", f"is {radius}: give 0, or a number from {1 / LARGEST:g} to {LARGEST:g}"
        )


def check_positive(field: str, value: float) -> None:
    """Raise unless value is finite and greater than zero."""
    if not np.isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {value}: give a finite number")
    if value <= 0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {value}: give a number greater than 0")


def check_codewords(codewords: tuple[str, ...]) -> None:
    """Raise unless all codewords are well formed and every robot is in some group."""
    width = len(codewords[0])
    for k, word in enumerate(codewords):
        field = f"swarm.groups[{k}]"
        if not word or set(word) - {"0", "1"}:
            raise StressbotError(ErrorCode.INVALID_CODEWORD, field, f"is '{word}': use only the characters 0 and 1")
        if len(word) != width:
            raise StressbotError(
                ErrorCode.INVALID_CODEWORD, field, f"has {len(word)} bits, the first has {width}: use one length for all"
            )
        if "1" not in word:
            raise StressbotError(
                ErrorCode.EMPTY_CODEWORD, field, f"is '{word}': robot {k + 1} is in no group and could never move"
            )


def check_told_apart(codewords: tuple[str, ...], turning_radius: np.ndarray, speed: np.ndarray) -> None:
    """Raise if two robots share codeword and turning radius ÷ speed (n,): they would copy each other's motion for ever."""
    robot_with: dict[tuple[str, int], int] = {}
    for k, key in enumerate(zip(codewords, classes(turning_radius / speed).tolist(), strict=True)):
        if key in robot_with:
            both = robot_with[key], k
            quotients = " and ".join(f"{turning_radius[j] / speed[j]:g} ({turning_radius[j]:g} ÷ {speed[j]:g})" for j in both)
            raise StressbotError(
                ErrorCode.DUPLICATE_CODEWORD,
                f"swarm.groups[{k}]",
                f"is '{key[0]}' for robots {both[0] + 1} and {k + 1}, whose turning radius ÷ speed is {quotients}: equal, so that "
                "they cannot be told apart; change the codeword, turning radius or speed of one",
            )
        robot_with[key] = k
