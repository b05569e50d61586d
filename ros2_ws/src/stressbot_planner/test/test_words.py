"""Codewords to choose from: told apart, of few enough ones, and changed within what is allowed."""

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.codesign.words import Words, fewest_groups
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm

SEEDS = st.integers(0, 2**32 - 1)


@st.composite
def kinds(draw):
    n = draw(st.integers(1, 40))
    bits = draw(st.integers(fewest_groups(n) - 1, n))
    enough = [most for most in range(1, bits + 1) if words_of(bits, most) >= n]
    return Words(n, bits, draw(st.sampled_from(enough)))


def words_of(bits: int, most: int) -> int:
    ways = [1] + [0] * bits
    for _ in range(bits):
        ways = [ways[0], *(ways[k] + ways[k - 1] for k in range(1, bits + 1))]
    return sum(ways[1 : most + 1])


@given(kinds(), SEEDS)
def test_what_is_drawn_and_changed_tells_robots_apart(words, seed):
    rng = np.random.default_rng(seed)
    codewords = words.random(rng)
    near = words.neighbours(codewords, rng)
    for chosen in (codewords, *(next(near) for _ in range(20))):
        assert words.fits(chosen)
        swarm = Swarm(1.0, 1.0, 0.1, chosen)  # which refuses robots that are alike, and those of no group
        assert (swarm.n, swarm.m) == (words.n, words.bits + 1)
        assert swarm.membership.sum(axis=0).max() <= words.most


@given(kinds(), SEEDS)
def test_groups_have_no_order(words, seed):
    rng = np.random.default_rng(seed)
    codewords = words.random(rng)
    order = rng.permutation(words.bits)
    assert words.in_order(["".join(word[i] for i in order) for word in codewords]) == codewords


@given(st.integers(2, 5), SEEDS)
def test_a_change_is_small(n, seed):
    """But for the order of groups, two robots have changed at most, and two only by a swap."""
    words, rng = Words(n, n, n), np.random.default_rng(seed)
    codewords = words.random(rng)
    changed = words.changed(codewords, rng)
    renamed = [["".join(word[i] for i in order) for word in changed] for order in permutations(range(n))]
    found = [pairs(codewords, one) for one in renamed]
    assert any(len(before) <= 1 or (len(before) == 2 and sorted(before) == sorted(after)) for before, after in found)


def pairs(codewords, others):
    """Return the words of robots that differ, before and after."""
    differ = [(a, b) for a, b in zip(codewords, others, strict=True) if a != b]
    return [a for a, _ in differ], [b for _, b in differ]


def test_every_choice_is_reached_by_changes():
    words, rng = Words(3, 2, 2), np.random.default_rng(0)
    every = {words.in_order(choice) for choice in product(("01", "10", "11"), repeat=3) if len(set(choice)) == 3}
    reached = {words.random(rng)}
    for _ in range(200):
        reached |= {words.changed(one, rng) for one in reached}
    assert reached == every


@given(kinds())
def test_all_words_are_listed_once(words):
    if words.count > 5000:
        return
    table = words.all_bits()
    assert len(np.unique(table, axis=0)) == len(table) == words.count == words_of(words.bits, words.most)
    assert table.sum(axis=1).min() >= 1 and table.sum(axis=1).max() <= words.most


@given(st.integers(1, 3000))
def test_the_fewest_groups_are_the_fewest(n):
    bits = fewest_groups(n) - 1
    assert 2**bits - 1 >= n > 2 ** (bits - 1) - 1


@pytest.mark.parametrize(
    ("n", "bits", "most", "named", "said"),
    [
        (6, 2, 2, "--groups", "6 robots need 4"),
        (6, 7, 7, "--groups", "no use for more than 7"),
        (6, 3, 1, "--modules", "3 codewords for 6 robots; give 2"),
        (6, 3, 4, "--modules", "give 1 to 3"),
        (14, 4, 2, "--modules", "give 3"),
    ],
)
def test_what_cannot_be_is_refused_with_what_to_change(n, bits, most, named, said):
    with pytest.raises(StressbotError, match=said) as refused:
        Words(n, bits, most)
    assert (refused.value.code, refused.value.field) == (ErrorCode.OUT_OF_RANGE, named)
