"""Group allocation: a codeword for each robot (paper, section "Group-Control" and Table 1)."""

from collections import Counter
from collections.abc import Callable, Sequence
from operator import index

from stressbot_planner.model.swarm import classes


def _bits(n: int, more: int) -> int:
    """Return ceil(log2(n + more))."""
    return (index(n) + more - 1).bit_length()  # numpy's whole numbers have no bit_length, and 1.26 adds an unsigned one to a float


def binary(n: int) -> tuple[str, ...]:
    """Codeword k for robot k (from 1), in the paper's m - 1 = ceil(log2(n + 2)) bits, G_1 the most significant.

    Neither the all-zeros nor the all-ones codeword occurs.
    """
    return _count_up(n, _bits(n, 2))


def tight(n: int) -> tuple[str, ...]:
    """Codeword k for robot k, in ceil(log2(n + 1)) bits.

    The paper keeps the all-ones codeword free so that every robot rotates in some group. G_m already does that,
    so one robot more fits: n = 2^(m-1) - 1.
    """
    return _count_up(n, _bits(n, 1))


def balanced(n: int) -> tuple[str, ...]:
    """Codewords in complement pairs: 1, ~1, 2, ~2, …, in ceil(log2(n + 2)) bits; the last of an odd n is half a pair.

    Each pair puts one robot into every group, so that group sizes differ by at most one and, for n > 1, none is
    empty. `binary` leaves groups empty for some n (n = 7: codewords 1..7 in four bits never set the first).
    """
    if n == 1:
        return ("1",)
    width = _bits(n, 2)
    ones = (1 << width) - 1
    codes = [code for c in range(1, 1 << (width - 1)) for code in (c, ones - c)]
    return tuple(f"{code:0{width}b}" for code in codes[:n])


def by_radius(turning_radius: Sequence[float]) -> tuple[str, ...]:
    """Codewords 1, 2, … within each set of robots of equal turning radius (see `swarm.classes`), in ceil(log2(s + 1)) bits.

    s is the size of the largest set. Robots of different radii need no codewords of their own (paper, section 4 and its
    remark on sets of equal radii): they can be told apart by how far they turn. So two groups serve any number of
    robots whose radii all differ, and if all are equal this is `tight`.
    """
    in_set: Counter[int] = Counter()
    numbers = []
    for label in classes(turning_radius).tolist():
        in_set[label] += 1
        numbers.append(in_set[label])
    width = _bits(max(numbers), 1)
    return tuple(f"{k:0{width}b}" for k in numbers)


def by_level(pull_down: Sequence[float]) -> tuple[str, ...]:
    """Codewords of robots whose arms come down at levels of their own, s different ones, in s bits.

    G_1 is everybody; G_i is whose arms stay up at the i - 1 lowest of these levels; G_m, m = s + 1, is nobody. The groups are
    nested, as a voltage can only bring down the arms of whoever is below it (Donald et al., "Planning and control for
    microassembly of structures composed of stress-engineered MEMS microrobots", IJRR 32(2), 2013).
    """
    levels = sorted(set(pull_down))
    rank = {level: k for k, level in enumerate(levels, 1)}
    return tuple("1" * rank[level] + "0" * (len(levels) - rank[level]) for level in pull_down)


def _count_up(n: int, width: int) -> tuple[str, ...]:
    return tuple(f"{k:0{width}b}" for k in range(1, index(n) + 1))


BY_LEVEL = "by_level"

SCHEMES: dict[str, Callable[[int], tuple[str, ...]]] = {"binary": binary, "tight": tight, "balanced": balanced}
"""Those that need to know nothing but the number of robots."""


def allocate(scheme: str, turning_radius: Sequence[float]) -> tuple[str, ...]:
    """Return the codewords of a named scheme, `by_radius` or one of `SCHEMES`, for robots of these radii."""
    return by_radius(turning_radius) if scheme == "by_radius" else SCHEMES[scheme](len(turning_radius))
