"""Codewords to choose from, and small changes of those that are chosen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError

SWAP, REPLACE = 0.5, 0.75
"""A change is a swap, up to the second number a replacement, else a flip: which, a number from 0 to 1 decides."""

ATTEMPTS = 1000
"""To draw a word that is not in use, before its robot keeps the one that it has."""


@dataclass(frozen=True)
class Words:
    """Words of some bits for n robots, all different, none empty.

    Attributes:
        n: number of robots.
        bits: of a word, groups without the one in which all turn.
        most: ones of a word, modules of a robot.

    Raises:
        StressbotError: there are too few groups or modules to tell the robots apart, or more groups than they can use.
    """

    n: int
    bits: int
    most: int

    def __post_init__(self):
        fewest = fewest_groups(self.n)
        if self.bits + 1 < fewest:
            _refuse(
                "--groups",
                f"is {self.bits + 1}: {self.n} robots need {fewest} for a codeword each, give {fewest} or more",
            )
        if self.bits > self.n:
            _refuse(
                "--groups",
                f"is {self.bits + 1}: {self.n} robots have no use for more than {self.n + 1}, a group for each and the one in "
                "which all turn; give at most so many",
            )
        if not 1 <= self.most <= self.bits:
            _refuse("--modules", f"is {self.most}: give 1 to {self.bits}, the groups without the one in which all turn")
        if self.count < self.n:
            needed = next(k for k in range(self.most, self.bits + 1) if _count(self.bits, k) >= self.n)
            _refuse(
                "--modules",
                f"is {self.most}: {self.bits + 1} groups then make {self.count} codewords for {self.n} robots; give {needed} or "
                "more, or more --groups",
            )

    @property
    def count(self) -> int:
        """How many words there are."""
        return _count(self.bits, self.most)

    def all_bits(self) -> np.ndarray:
        """Return all words, those of few ones first, shape (count, bits)."""
        places = [place for ones in range(1, self.most + 1) for place in combinations(range(self.bits), ones)]
        table = np.zeros((len(places), self.bits), dtype=bool)
        for row, place in enumerate(places):
            table[row, list(place)] = True
        return table

    def fits(self, codewords: Sequence[str]) -> bool:
        """Return whether these are words of this kind, all different."""
        return len(set(codewords)) == self.n and all(
            len(word) == self.bits and 1 <= word.count("1") <= self.most for word in codewords
        )

    def as_text(self, table: np.ndarray) -> tuple[str, ...]:
        """Return words, shape (n, bits), as bit strings. Groups have no order: theirs is that of their members.

        So choices that differ by the names of groups only are one.
        """
        order = np.lexsort(table[::-1])[::-1]
        return tuple("".join("1" if bit else "0" for bit in word) for word in table[:, order])

    def in_order(self, codewords: Sequence[str]) -> tuple[str, ...]:
        """Return codewords with groups named as `as_text` does."""
        return self.as_text(_table(codewords))

    def random(self, rng: np.random.Generator) -> tuple[str, ...]:
        """Draw different words, all equally likely."""
        chosen: dict[bytes, np.ndarray] = {}
        while len(chosen) < self.n:
            word = self._draw(rng)
            chosen[word.tobytes()] = word
        return self.as_text(np.array(list(chosen.values())))

    def changed(self, codewords: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
        """Return other codewords: two robots swap theirs, one gets a word that nobody has, or one bit is another.

        A bit that would give a robot the word of another makes them swap.
        """
        table = _table(codewords)
        robot, kind = int(rng.integers(self.n)), rng.random()
        if kind < SWAP and self.n > 1:
            other = int(rng.choice(np.delete(np.arange(self.n), robot)))
            table[[robot, other]] = table[[other, robot]]
            return self.as_text(table)
        if kind < REPLACE and self.count > self.n:
            word = self._unused(table, rng)
        else:
            word = table[robot].copy()
            word[int(rng.integers(self.bits))] ^= True
            if not 1 <= word.sum() <= self.most:
                return self.as_text(table)
        owner = np.flatnonzero((table == word).all(axis=1))
        table[owner] = table[robot]
        table[robot] = word
        return self.as_text(table)

    def neighbours(self, codewords: Sequence[str], rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
        """Yield changes of codewords without end: of one step, every fourth of two."""
        while True:
            near = self.changed(codewords, rng)
            yield self.changed(near, rng) if rng.random() < 0.25 else near

    def _draw(self, rng: np.random.Generator) -> np.ndarray:
        counts = np.array([float(comb(self.bits, ones)) for ones in range(1, self.most + 1)])
        ones = 1 + int(rng.choice(self.most, p=counts / counts.sum()))
        word = np.zeros(self.bits, dtype=bool)
        word[rng.permutation(self.bits)[:ones]] = True
        return word

    def _unused(self, table: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        for _ in range(ATTEMPTS):
            word = self._draw(rng)
            if not (table == word).all(axis=1).any():
                return word
        return table[0]


def fewest_groups(n: int) -> int:
    """Return the number of groups that tell n robots apart, the one in which all turn included."""
    return n.bit_length() + 1


def _count(bits: int, most: int) -> int:
    return sum(comb(bits, ones) for ones in range(1, most + 1))


def _table(codewords: Sequence[str]) -> np.ndarray:
    return np.array([[bit == "1" for bit in word] for word in codewords])


def _refuse(option: str, message: str) -> None:
    raise StressbotError(ErrorCode.OUT_OF_RANGE, option, message)
