"""Lie brackets: Table 2, the commutation relations and the ranks behind STLC, against numerical differentiation."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.model.allocation import SCHEMES, binary, by_radius
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.brackets import VectorField, bracket, bracket_robots, f, g, generators, h, position_rank

TABLE_2_PAIRS = {(2, 1): (4, 5), (3, 1): (4, 6), (1, 2): (2, 3), (3, 2): (2, 6), (1, 3): (1, 3), (2, 3): (1, 5)}


def swarm_of(n: int, scheme="binary") -> Swarm:
    return Swarm(1.0, 0.7, 0.3, SCHEMES[scheme](n))


def flat_field(swarm: Swarm, kind: str, group: int):
    """The paper's own definition on q = (x_1, y_1, …, theta_1, …), independent of the library's coefficients."""
    bits = [group < swarm.m and word[group - 1] == "1" for word in swarm.codewords]

    def field(q):
        n = len(bits)
        rates = np.zeros(3 * n)
        for j, member in enumerate(bits):
            if member and kind in "fg":
                rates[2 * j : 2 * j + 2] = np.cos(q[2 * n + j]), np.sin(q[2 * n + j])
            if not member and kind in "fh":
                rates[2 * n + j] = 1 / swarm.turning_radius[j]
        return rates

    return field


def numerical_bracket(first, second, q):
    """DY X - DX Y by central differences."""
    step = 1e-5

    def along(field, direction):
        return (field(q + step * direction) - field(q - step * direction)) / (2 * step)

    return along(second, first(q)) - along(first, second(q))


def as_state_rates(field, q):
    n = len(q) // 3
    rates = field.at(np.column_stack([q[: 2 * n].reshape(n, 2), q[2 * n :]]))
    return np.concatenate([rates[:, :2].ravel(), rates[:, 2]])


@given(n=st.integers(1, 12), seed=st.integers(0, 2**32 - 1), scheme=st.sampled_from(sorted(SCHEMES)), data=st.data())
def test_brackets_equal_numerically_differentiated_ones(n, seed, scheme, data):
    swarm = swarm_of(n, scheme)
    q = np.random.default_rng(seed).uniform(-3, 3, 3 * n)
    make = {"f": f, "g": g, "h": h}
    pick = st.tuples(st.sampled_from("fgh"), st.integers(1, swarm.m))
    (kind, i), (other, j) = data.draw(pick), data.draw(pick)
    exact = as_state_rates(bracket(make[kind](swarm, i), make[other](swarm, j)), q)
    numerical = numerical_bracket(flat_field(swarm, kind, i), flat_field(swarm, other, j), q)
    np.testing.assert_allclose(exact, numerical, atol=1e-8)


@given(seed=st.integers(0, 2**32 - 1))
def test_nested_brackets_equal_numerically_differentiated_ones(seed):
    swarm = swarm_of(6)
    q = np.random.default_rng(seed).uniform(-3, 3, 18)

    def inner(state):
        return numerical_bracket(flat_field(swarm, "h", 2), flat_field(swarm, "g", 1), state)

    exact = as_state_rates(bracket(h(swarm, 3), bracket(h(swarm, 2), g(swarm, 1))), q)
    np.testing.assert_allclose(exact, numerical_bracket(flat_field(swarm, "h", 3), inner, q), atol=1e-4)


def test_left_half_of_table_2():
    swarm = swarm_of(6)
    for (j, i), robots in TABLE_2_PAIRS.items():
        assert bracket_robots(h(swarm, j), g(swarm, i)) == robots


def test_right_half_of_table_2():
    swarm = swarm_of(6)
    h1, h2, h3, f4 = h(swarm, 1), h(swarm, 2), h(swarm, 3), f(swarm, 4)
    g1, g2, g3 = (g(swarm, i) for i in (1, 2, 3))
    rows = [(h1 + h2 - f4, g3), (h1 + h3 - f4, g2), (f4 - h3, g2), (h2 + h3 - f4, g1), (f4 - h3, g1), (f4 - h2, g1)]
    assert [bracket_robots(*row) for row in rows] == [(1,), (2,), (3,), (4,), (5,), (6,)]


@pytest.mark.parametrize("n", [2, 3, 6, 7, 14, 30])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_table_2_for_any_number_of_groups(n, scheme):
    swarm = swarm_of(n, scheme)
    member = swarm.membership
    for i in range(1, swarm.m):
        for j in range(1, swarm.m):
            without = tuple((np.flatnonzero(member[i - 1] & ~member[j - 1]) + 1).tolist())
            both = tuple((np.flatnonzero(member[i - 1] & member[j - 1]) + 1).tolist())
            assert bracket_robots(h(swarm, j), g(swarm, i)) == without
            assert bracket_robots(f(swarm, swarm.m) - h(swarm, j), g(swarm, i)) == both


@pytest.mark.parametrize("n", [2, 6, 7, 14, 30])
def test_commutation_relations(n):
    swarm = swarm_of(n)
    groups = [i for i in range(1, swarm.m) if swarm.group_sizes[i - 1]]
    for i in groups:
        assert bracket(h(swarm, i), g(swarm, i)).is_zero
        assert not bracket(f(swarm, swarm.m), g(swarm, i)).is_zero
        for j in groups:
            assert bracket(h(swarm, i), h(swarm, j)).is_zero
            assert bracket(g(swarm, i), g(swarm, j)).is_zero


def test_f_is_the_sum_of_g_and_h_and_the_generators_are_the_paper_set():
    swarm = swarm_of(6)
    assert len(generators(swarm)) == 2 * (swarm.m - 1) + 1
    poses = np.random.default_rng(0).uniform(-3, 3, (6, 3))
    np.testing.assert_allclose(f(swarm, 1).at(poses), g(swarm, 1).at(poses) + h(swarm, 1).at(poses))
    assert f(swarm, swarm.m).robots == ()


def test_f_1_turns_robots_1_to_3():
    # the paper prints (1/r) [0, 0, 0, 1, 1, 1] for the orientation part, which is that of the members
    np.testing.assert_allclose(f(swarm_of(6), 1).turn, np.array([1, 1, 1, 0, 0, 0]) / 0.7)


def lie_rank(swarm: Swarm, first: int = 1) -> int:
    """Return in how many directions brackets of the fields that are really driven, f_1 … f_m, move positions."""
    fields = [f(swarm, i) for i in range(first, swarm.m + 1)]
    spanned = [bracket(a, b) for a, b in combinations(fields, 2)]  # turns of the f_i commute, so that these only move
    rank = 0
    while True:
        rows = np.array([np.concatenate([field.forward, field.sideways]) for field in spanned])
        _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
        if np.sum(sizes > 1e-9 * sizes[0]) == rank:
            return rank
        rank = int(np.sum(sizes > 1e-9 * sizes[0]))
        kept = [VectorField(np.zeros(swarm.n), row[: swarm.n], row[swarm.n :]) for row in basis[:rank]]
        spanned = kept + [bracket(turn, field) for turn in fields for field in kept]


def test_the_minus_before_f_4_cannot_be_left_out():
    # the paper prints "h_1+h_2 f_4" in the example of M(6, 1)
    swarm = swarm_of(6)
    h1, h2, f4, g3 = h(swarm, 1), h(swarm, 2), f(swarm, 4), g(swarm, 3)
    assert bracket_robots(h1 + h2 - f4, g3) == (1,)
    assert bracket_robots(h1 + h2 + f4, g3) == bracket_robots(h1 + h2, g3) == (1, 3, 5)


def test_only_group_2_completes_the_bracket_that_moves_robots_2_and_6():
    # the paper prints "[h_3, _2]" for a subgroup of IC4; [h_3, f_2] = [h_3, g_2]
    swarm = swarm_of(6)
    moved = {(field.__name__, i): bracket_robots(h(swarm, 3), field(swarm, i)) for field in (f, g, h) for i in (1, 2, 3)}
    assert [which for which, robots in moved.items() if robots == (2, 6)] == [("f", 2), ("g", 2)]


@pytest.mark.parametrize("n", [2, 6, 14])
def test_all_fields_from_f_1_on_are_needed(n):
    # the paper prints {f_i, ..., f_m} for the fields that are driven
    swarm = swarm_of(n)
    assert lie_rank(swarm) == 2 * n
    assert lie_rank(swarm, first=2) < 2 * n


def test_g_has_no_orientation_part_and_f_has_one():
    # the paper prints f_i[2n+1:3n] = 0 where it defines g_i
    swarm = swarm_of(6)
    for i in (1, 2, 3):
        assert not g(swarm, i).turn.any()
        assert f(swarm, i).turn.any()


@pytest.mark.parametrize("radii", [(1.0, 0.7), (1.0, 1 / 3), (1.0, 1 / 3, 0.2), (1.0, 0.5, 0.25), (0.9, 0.3, 0.1, 0.6)])
def test_two_groups_give_full_rank_for_any_radii_that_differ(radii):
    swarm = Swarm(1.0, radii, 0.3, by_radius(radii))
    assert swarm.m == 2
    assert lie_rank(swarm) == 2 * swarm.n
    assert position_rank(swarm, 2 * swarm.n) == 2 * swarm.n


ROBOTS = st.tuples(st.sampled_from(["01", "10", "11"]), st.sampled_from([0.3, 0.9, 1.0]))


@given(st.lists(ROBOTS, min_size=1, max_size=6, unique=True))
def test_robots_that_differ_in_codeword_or_radius_are_controllable(robots):
    words, radii = zip(*robots, strict=True)
    assert lie_rank(Swarm(1.0, radii, 0.3, words)) == 2 * len(robots)


def test_order_m_minus_1_gives_full_rank_and_m_minus_2_one_direction_per_robot():
    # the paper bounds k_max by m
    for n in range(2, 31):
        swarm = Swarm(1.0, 1.0, 0.3, binary(n))
        assert position_rank(swarm, swarm.m - 1) == 2 * n, n
        assert position_rank(swarm, swarm.m - 2) >= n, n
    six = Swarm(1.0, 1.0, 0.3, binary(6))
    assert [position_rank(six, order) for order in (1, 2, 3)] == [3, 9, 12]
