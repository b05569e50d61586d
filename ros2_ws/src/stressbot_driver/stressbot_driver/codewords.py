"""Which robot belongs to which group: the named allocation schemes, and the codes that select a group.

A codeword is a string of m-1 characters 0 or 1; character i (from 1) is 1 if the robot belongs to G_i. G_m, the
all-rotate group, has no members and no character.
"""

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np

from stressbot_driver.errors import ErrorCode, StressbotError

SCHEMES = ("binary", "tight", "balanced", "by_radius")
BY_LEVEL = "by_level"
CHECKED = "checked"

# Quotients of radius and speed are rounded: those that differ by no more than this, relative, are equal.
EQUAL = 1e-9


def classes(values: np.ndarray) -> np.ndarray:
    """Which of positive values (n,) are equal: numbers of their classes (n,), ascending with the values.

    A class ends where the next larger value differs by more than `EQUAL`; the order of the robots makes no difference.
    """
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    labels = np.empty(len(values), dtype=np.int64)
    labels[order] = np.cumsum(np.r_[False, ascending[1:] > (1.0 + EQUAL) * ascending[:-1]])
    return labels


def allocate(scheme: str, turning_time: Sequence[float] | np.ndarray) -> list[str]:
    """Codewords of n >= 1 robots, of which turning radius ÷ speed (n,) is given, under a named scheme.

    - `binary`: w = ceil(log2(n+2)) bits, robot k has codeword k, G_1 the most significant bit (the paper's).
    - `tight`: w = ceil(log2(n+1)) bits, robot k has codeword k; the all-ones codeword is used too.
    - `balanced`: w = ceil(log2(n+2)) bits; for c = 1, 2, 3, … two robots take c and its complement 2^w-1-c, so that
      each pair gives every group one member. With n odd the last robot takes the next c alone. Group sizes differ
      by at most 1 and none is empty. n = 1 is the exception: one bit, codeword "1".
    - `by_radius`: robots of one turning radius ÷ speed take codewords 1, 2, 3, … in turn, and so do those of every other one;
      w = ceil(log2(s+1)) bits for s robots in the largest set of equal ones. One bit if all differ.
    """
    count = len(turning_time)
    if scheme == "by_radius":
        labels = classes(np.asarray(turning_time)).tolist()
        width = max(Counter(labels).values()).bit_length()  # ceil(log2(s+1))
        next_code = {label: itertools.count(1) for label in labels}
        return [format(next(next_code[label]), f"0{width}b") for label in labels]
    if scheme == "tight":
        width = count.bit_length()  # ceil(log2(n+1))
        return [format(k, f"0{width}b") for k in range(1, count + 1)]
    width = (count + 1).bit_length()  # ceil(log2(n+2))
    if scheme == "binary":
        return [format(k, f"0{width}b") for k in range(1, count + 1)]
    if scheme == "balanced":
        if count == 1:
            return ["1"]
        last = (1 << width) - 1
        pairs = (code for c in range(1, (count + 1) // 2 + 1) for code in (c, last - c))
        return [format(code, f"0{width}b") for _, code in zip(range(count), pairs, strict=False)]
    raise StressbotError(
        ErrorCode.OUT_OF_RANGE,
        "swarm.groups",
        f"{scheme!r} is no allocation scheme: write one of {', '.join(SCHEMES)}, or one bit string per robot",
    )


def by_level(pull_down: np.ndarray) -> list[str]:
    """Codewords of robots whose arms come down at levels (n,) of their own: of s different ones, G_1 is everybody, G_i those whose
    arms stay up at the i-1 lowest of them, and G_m, m = s + 1, nobody."""
    levels, rank = np.unique(pull_down, return_inverse=True)
    return ["1" * (k + 1) + "0" * (len(levels) - k - 1) for k in rank.tolist()]


def control_levels(pull_down: np.ndarray, drive_level: float) -> np.ndarray:
    """Levels [V] (m,) that select the groups of `by_level`, G_1 first: the drive's own, which brings down nobody's arm, then one
    between each two neighbours of `pull_down` (n,), and one that is above them all by half of the smallest gap."""
    ladder = np.r_[drive_level, np.unique(pull_down)]
    return np.r_[drive_level, 0.5 * (ladder[1:-1] + ladder[2:]), ladder[-1] + 0.5 * np.diff(ladder).min()]


def check_codewords(codewords: Sequence, turning_radius: np.ndarray, speed: np.ndarray) -> list[str]:
    """Check explicit codewords of robots of which turning radii and speeds (n,) are given.

    Raises StressbotError: WRONG_COUNT, INVALID_CODEWORD, EMPTY_CODEWORD, or DUPLICATE_CODEWORD for two robots that share both
    codeword and turning radius ÷ speed.
    """
    count = len(turning_radius)
    if len(codewords) != count:
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "swarm.groups",
            f"{len(codewords)} codewords for {count} robots: give one per robot",
        )
    labels = classes(turning_radius / speed).tolist()
    owner: dict[tuple[str, int], int] = {}
    for index, codeword in enumerate(codewords):
        field = f"swarm.groups[{index}]"
        if not isinstance(codeword, str):
            raise StressbotError(
                ErrorCode.INVALID_CODEWORD,
                field,
                f'{codeword!r} is not a string: quote them, as in ["001", "010"], or YAML reads a number',
            )
        if not codeword or set(codeword) - {"0", "1"}:
            raise StressbotError(
                ErrorCode.INVALID_CODEWORD, field, f"{codeword!r} must consist of the characters 0 and 1, first bit G1"
            )
        if len(codeword) != len(codewords[0]):
            raise StressbotError(
                ErrorCode.INVALID_CODEWORD,
                field,
                f"{codeword!r} has {len(codeword)} bits, the first codeword has {len(codewords[0])}: give all the same length",
            )
        if "1" not in codeword:
            raise StressbotError(
                ErrorCode.EMPTY_CODEWORD,
                field,
                f"robot {index + 1} belongs to no group and can never move: set at least one bit",
            )
        key = (codeword, labels[index])
        if key in owner:
            both = owner[key], index
            quotients = " and ".join(f"{turning_radius[j] / speed[j]:g} ({turning_radius[j]:g} ÷ {speed[j]:g})" for j in both)
            raise StressbotError(
                ErrorCode.DUPLICATE_CODEWORD,
                field,
                f"robots {both[0] + 1} and {index + 1} share {codeword!r}, and their turning radius ÷ speed is {quotients}: equal, "
                "so that they cannot be told apart; change the codeword, turning radius or speed of one",
            )
        owner[key] = index
    return list(codewords)


def check_headings(codewords: Sequence[str], headings: np.ndarray) -> None:
    """Check headings at goals (n,), NaN where they are free.

    Raises StressbotError: INFEASIBLE if the heading of one robot follows from those of others.
    """
    turning = np.array([[bit == "0" for bit in word] + [True] for word in codewords], dtype=float)
    kept: list[int] = []
    for row in np.flatnonzero(~np.isnan(headings)).tolist():
        if np.linalg.matrix_rank(turning[[*kept, row]]) == len(kept):
            shares = np.linalg.lstsq(turning[kept].T, turning[row], rcond=None)[0]
            others = [str(other + 1) for other, share in zip(kept, shares, strict=True) if abs(share) > 1e-9]
            raise StressbotError(
                ErrorCode.INFEASIBLE,
                f"robots[{row}].goal",
                f"the heading follows from those of robots {', '.join(others)}, as the codewords tell: leave out one of them",
            )
        kept.append(row)


def check_parked(codewords: Sequence[str], turning_time: np.ndarray, parked: Sequence[int]) -> None:
    """Check that groups without parked robots (rows) tell the others apart, of which turning radius ÷ speed (n,) is given too.

    Raises StressbotError: INFEASIBLE if they do not, or leave a robot out, or if all are parked.
    """
    if not parked:
        return
    labels = classes(turning_time).tolist()
    kept = [bit for bit in range(len(codewords[0])) if all(codewords[row][bit] == "0" for row in parked)]
    left = [
        ("".join(word[bit] for bit in kept), labels[row]) for row, word in enumerate(codewords) if row not in parked
    ]
    if not left or len(set(left)) < len(left) or any("1" not in word for word, _ in left):
        names = ", ".join(str(row + 1) for row in parked)
        raise StressbotError(
            ErrorCode.INFEASIBLE,
            f"robots[{parked[0]}].goal",
            f"robots {names} are parked, and groups that leave them out do not move each of the others in its own way: give fewer "
            "parked robots, or more groups",
        )


def default_codes(group_count: int, symbol_count: int) -> list[list[int]]:
    """The PFSM code of each group: the digits of i-1 to the base L, most significant first.

    K = max(1, ceil(log_L m)) symbols each, for m = group_count groups and L = symbol_count >= 2 symbols.
    """
    length = 1
    while symbol_count**length < group_count:
        length += 1
    return [[(index // symbol_count**place) % symbol_count for place in reversed(range(length))] for index in range(group_count)]


def checked_codes(codes: list[list[int]], symbol_count: int) -> list[list[int]]:
    """Codes with a check symbol, which makes their sums multiples of L: no two differ in one symbol alone."""
    return [[*code, -sum(code) % symbol_count] for code in codes]
