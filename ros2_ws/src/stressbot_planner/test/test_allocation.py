"""Group allocation: what the paper claims about codewords, and what the other schemes promise."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.model.allocation import SCHEMES, allocate, balanced, binary, by_radius, tight
from stressbot_planner.model.swarm import EQUAL, Swarm, classes, fastest

SIZES = range(1, 301)


def sizes(codewords) -> np.ndarray:
    return np.array([[int(bit) for bit in word] for word in codewords]).sum(axis=0)


def test_binary_is_table_1_of_the_paper():
    table = [[0, 0, 0, 1, 1, 1], [0, 1, 1, 0, 0, 1], [1, 0, 1, 0, 1, 0], [0, 0, 0, 0, 0, 0]]
    np.testing.assert_array_equal(Swarm(1.0, 1.0, 0.3, binary(6)).membership, np.array(table, dtype=bool))


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int64, np.uint64])
@pytest.mark.parametrize("scheme", SCHEMES.values())
def test_whole_numbers_of_numpy_are_whole_numbers(scheme, kind):
    for n in (1, 2, 6, 100):
        assert scheme(kind(n)) == scheme(n)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_codewords_are_distinct_and_nobody_is_left_out(scheme):
    for n in SIZES:
        words = SCHEMES[scheme](n)
        assert len(words) == len(set(words)) == n
        assert len({len(word) for word in words}) == 1
        assert all("1" in word and not set(word) - {"0", "1"} for word in words)


def test_number_of_groups_of_the_paper():
    for n in SIZES:
        assert len(binary(n)[0]) + 1 == int(np.ceil(np.log2(n + 2))) + 1
        if n > 1:
            assert len(balanced(n)[0]) == len(binary(n)[0])


def test_the_all_ones_codeword_saves_a_group():
    # the paper calls log2(n + 2) + 1 minimal; with G_m, n = 2^(m-1) - 1 robots fit
    for n in SIZES:
        assert len(tight(n)[0]) + 1 == int(np.ceil(np.log2(n + 1))) + 1
    for n, m in ((1, 2), (3, 3), (7, 4), (15, 5), (31, 6)):
        assert Swarm(1.0, 1.0, 0.3, tight(n)).m == m == Swarm(1.0, 1.0, 0.3, binary(n)).m - 1


def test_binary_leaves_the_all_ones_codeword_free():
    for n in SIZES:
        assert all("0" in word for word in binary(n))


@pytest.mark.parametrize("n", [2, 6, 14, 30, 62, 126, 254])
def test_every_group_holds_half_of_the_robots_when_all_codewords_are_used(n):
    for scheme in (binary, balanced):
        assert np.all(sizes(scheme(n)) == n // 2)


def test_binary_groups_may_be_empty_otherwise():
    assert sizes(binary(7)).tolist() == [0, 4, 4, 4]
    assert sizes(binary(1)).tolist() == [0, 1]


def test_balanced_group_sizes_differ_by_one_at_most_and_none_is_empty():
    for n in SIZES:
        found = sizes(balanced(n))
        assert found.max() - found.min() <= 1, n
        assert found.min() >= 1, n


def test_tight_groups_are_not_empty():
    for n in SIZES:
        assert sizes(tight(n)).min() >= 1, n


@pytest.mark.parametrize("scheme", SCHEMES)
def test_schemes_pass_the_checks_of_a_swarm(scheme):
    for n in itertools.chain(range(1, 40), (127, 300)):
        swarm = Swarm(1.0, 1.0, 0.3, SCHEMES[scheme](n))
        assert not swarm.membership[-1].any()
        np.testing.assert_array_equal(swarm.group_sizes[:-1], sizes(swarm.codewords))


# --- different turning radii ----------------------------------------------------------------------------------------

RADII = st.lists(st.sampled_from([0.3, 0.5, 0.75, 1.0, 1.5]), min_size=1, max_size=40)


@pytest.mark.parametrize("n", [1, 2, 6, 30])
def test_two_groups_serve_any_number_of_robots_whose_radii_all_differ(n):
    radii = np.linspace(0.5, 1.5, n)
    swarm = Swarm(1.0, radii, 0.3, by_radius(radii.tolist()))
    assert swarm.m == 2
    assert swarm.membership.tolist() == [[True] * n, [False] * n]


@given(RADII)
def test_robots_of_equal_radii_are_told_apart_by_as_few_groups_as_the_largest_set_needs(radii):
    words = by_radius(radii)
    swarm = Swarm(1.0, radii, 0.3, words)  # refuses robots that cannot be told apart
    assert swarm.m == len(tight(max(radii.count(radius) for radius in radii))[0]) + 1
    for radius in set(radii):
        mine = [word for word, own in zip(words, radii, strict=True) if own == radius]
        assert [int(word, 2) for word in mine] == list(range(1, len(mine) + 1))


@pytest.mark.parametrize("n", [1, 6, 7])
def test_schemes_by_name(n):
    assert allocate("by_radius", [1.0] * n) == tight(n)
    for name, scheme in SCHEMES.items():
        assert allocate(name, np.linspace(1, 2, n).tolist()) == scheme(n)


# --- equal but for round-off ----------------------------------------------------------------------------------------

DECIMALS = st.integers(1, 9999).map(lambda value: value / 1000)


@given(st.lists(st.tuples(DECIMALS, DECIMALS), min_size=1, max_size=4), st.lists(DECIMALS, min_size=2, max_size=6), st.randoms())
def test_robots_of_proportional_radii_and_speeds_are_equal_whatever_rounding_says(kinds, factors, random):
    robots = [(radius * factor, speed * factor) for radius, speed in kinds for factor in factors]
    random.shuffle(robots)
    radius, speed = np.array(robots).T
    true = [round(r / s, 9) for r, s in robots]
    if np.any(np.abs(np.diff(np.unique(true))) < 1e-6):
        return
    u, pace = fastest(speed)
    words = by_radius(radius / speed)
    swarm = Swarm(u, radius, 0.3, words, pace)  # refuses robots that cannot be told apart
    assert swarm.m == len(tight(max(true.count(value) for value in true))[0]) + 1
    assert len(np.unique(swarm.turning_length)) == len(set(true))
    np.testing.assert_allclose(swarm.turning_length, radius / pace, rtol=len(robots) * EQUAL)


@given(st.lists(st.floats(1e-9, 1e9), min_size=1, max_size=30), st.randoms())
def test_classes_do_not_depend_on_the_order_and_split_where_neighbours_differ(values, random):
    values = [value * (1 + random.choice([0, 1e-12, 5e-10, 1e-8])) for value in values]
    order = list(range(len(values)))
    random.shuffle(order)
    labels = classes(np.array(values))
    np.testing.assert_array_equal(classes(np.array(values)[order]), labels[order])
    ascending = sorted(zip(values, labels.tolist(), strict=True))
    for (low, a), (high, b) in itertools.pairwise(ascending):
        assert b - a == (high > (1 + EQUAL) * low)


@given(DECIMALS, DECIMALS, st.integers(2, 6), st.floats(-EQUAL / 2, EQUAL / 2))
def test_robots_that_differ_by_round_off_are_alike(radius, speed, n, off):
    speeds = speed * np.append(np.ones(n - 1), 1 + off)
    u, pace = fastest(speeds)
    swarm = Swarm(u, np.append(np.full(n - 1, radius), radius * (1 - off / 2)), 0.3, binary(n), pace)
    assert swarm.alike and swarm.common_turning_radius() == pytest.approx(radius, rel=2 * EQUAL)
    assert len(np.unique(swarm.turning_length)) == 1 and set(np.unique(swarm.slides)) <= {0.0, 1.0}
