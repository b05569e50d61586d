"""The swarm: who belongs to which group, and how each robot moves."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError


def frozen_array(values, dtype=float) -> np.ndarray:
    """Return a read-only copy, so that immutable values may hold it."""
    array = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Swarm:
    """n robots in m groups (paper, section "Group-Control").

    Attributes:
        speed: u, forward speed, units/s.
        turning_radius: r_j, units, shape (n,); a robot outside the active group turns at u / r_j.
        body_radius: radius of the disc that the turning body sweeps, units, shape (n,).
        codewords: one bit string per robot, all of length m - 1; bit i (from 1) is '1' for a member of G_i.

    Raises:
        StressbotError: no robots, ill-formed, empty or duplicate codewords, radii or speed not positive.
    """

    speed: float
    turning_radius: np.ndarray
    body_radius: np.ndarray
    codewords: tuple[str, ...]

    def __post_init__(self):
        n = len(self.codewords)
        if n == 0:
            raise StressbotError(ErrorCode.NO_ROBOTS, "robots", "is empty: list at least one robot")
        check_codewords(self.codewords)
        check_positive("swarm.speed", self.speed)
        for name in ("turning_radius", "body_radius"):
            values = np.broadcast_to(np.asarray(getattr(self, name), dtype=float), (n,))
            for value in values:
                check_positive(f"swarm.{name}", value)
            object.__setattr__(self, name, frozen_array(values))

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.codewords)

    @property
    def m(self) -> int:
        """Number of groups, the all-rotate group G_m included."""
        return len(self.codewords[0]) + 1

    @cached_property
    def membership(self) -> np.ndarray:
        """Activation vectors alpha: shape (m, n), True where robot j is in group i; the last row is all False."""
        bits = np.array([[bit == "1" for bit in word] for word in self.codewords], dtype=bool)
        return frozen_array(np.vstack([bits.T, np.zeros(self.n, dtype=bool)]), dtype=bool)

    @cached_property
    def group_sizes(self) -> np.ndarray:
        """Number of members of each group, shape (m,)."""
        return frozen_array(self.membership.sum(axis=1), dtype=int)

    @property
    def equal_radii(self) -> bool:
        """Whether one turning radius serves all robots, as the paper assumes from section 3.1 on."""
        return bool(np.all(self.turning_radius == self.turning_radius[0]))

    def common_turning_radius(self) -> float:
        """Return r.

        Raises:
            StressbotError: the radii differ, so that no activation turns every robot by the same angle.
        """
        if not self.equal_radii:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                "swarm.turning_radius",
                "differs between robots: the primitives h_i, g_i and Rot need one common turning radius; "
                "use the planner 'optimize'",
            )
        return float(self.turning_radius[0])


def check_positive(field: str, value: float) -> None:
    """Raise unless value is finite and greater than zero."""
    if not np.isfinite(value):
        raise StressbotError(ErrorCode.NOT_FINITE, field, f"is {value}: give a finite number")
    if value <= 0:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {value}: give a number greater than 0")


def check_codewords(codewords: tuple[str, ...]) -> None:
    """Raise unless all robots can be told apart and moved by their group memberships."""
    width = len(codewords[0])
    robot_with = {}
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
        if word in robot_with:
            raise StressbotError(
                ErrorCode.DUPLICATE_CODEWORD,
                field,
                f"is '{word}', as for robot {robot_with[word]}: these two cannot be told apart",
            )
        robot_with[word] = k + 1
