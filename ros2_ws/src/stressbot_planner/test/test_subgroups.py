"""Subgroups of Lie brackets, and primitives that move them only."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import SCHEMES, binary
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import Extract, Isolate, Subgroup, expand
from stressbot_planner.primitives.subgroups import disjoint_cover, largest_order, subgroups


def swarm_of(n: int, scheme="binary") -> Swarm:
    return Swarm(1.0, 1.0, 0.3, SCHEMES[scheme](n))


def displacements(swarm: Swarm, primitive, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    start = np.column_stack([rng.uniform(-9, 9, (swarm.n, 2)), rng.uniform(-np.pi, np.pi, swarm.n)])
    return np.hypot(*(replay(swarm, start, *expand(swarm, [primitive]))[-1] - start)[:, :2].T)


def test_second_order_subgroups_are_those_of_table_2():
    found = {group.robots for group in subgroups(swarm_of(6), 2)}
    assert {(4, 5), (4, 6), (2, 3), (2, 6), (1, 3), (1, 5)} <= found


def test_the_paper_cover_of_six_robots_by_pairs():
    assert {group.robots for group in disjoint_cover(swarm_of(6), 2)} == {(4, 5), (2, 6), (1, 3)}


@given(n=st.integers(1, 40), scheme=st.sampled_from(sorted(SCHEMES)))
def test_brackets_of_the_largest_order_move_any_robot_alone(n, scheme):
    swarm = swarm_of(n, scheme)
    alone = {group.robots for group in subgroups(swarm, largest_order(swarm))}
    assert alone == {(robot,) for robot in range(1, n + 1)}
    assert sorted(group.robots for group in disjoint_cover(swarm, largest_order(swarm))) == sorted(alone)


@pytest.mark.parametrize("order", [0, 4, -1])
def test_an_order_out_of_range_is_refused(order):
    with pytest.raises(StressbotError, match="1 to 3") as caught:
        subgroups(swarm_of(6), order)
    assert caught.value.code == ErrorCode.OUT_OF_RANGE


@pytest.mark.parametrize(("n", "order", "least", "largest"), [(6, 1, 2, 3), (14, 1, 3, 4), (14, 2, 3, 4), (15, 3, 4, 5)])
def test_an_order_without_a_disjoint_cover_is_refused_with_the_orders_that_have_one(n, order, least, largest):
    swarm = swarm_of(n)
    sentence = f"^order: is {order}, which is too small: .* {n} robots .* use order {least} to {largest}$"
    with pytest.raises(StressbotError, match=sentence) as caught:
        disjoint_cover(swarm, order)
    assert caught.value.code == ErrorCode.UNSUPPORTED
    assert [largest_order(swarm), len({k for s in disjoint_cover(swarm, least) for k in s.robots})] == [largest, n]


def test_subgroups_are_of_robots_of_one_turning_length():
    assert [s.robots for s in disjoint_cover(Swarm(1.0, [1.0, 0.8], 0.3, ("1", "1")), 1)] == [(2,), (1,)]
    swarm = Swarm(1.0, [1.0, 0.8, 1.0, 0.8], 0.3, ("01", "01", "10", "11"))
    for subgroup in (subgroup for order in (1, 2) for subgroup in subgroups(swarm, order)):
        assert len(set(swarm.turning_length[np.array(subgroup.robots) - 1])) == 1


@given(n=st.integers(2, 16), order=st.integers(1, 4), data=st.data())
def test_a_subgroup_primitive_moves_its_robots_and_nobody_else(n, order, data):
    swarm = swarm_of(n)
    group = data.draw(st.sampled_from(subgroups(swarm, min(order, largest_order(swarm)))))
    moved = displacements(swarm, Subgroup(group.group, 0.7, group.inside, group.outside, excursion=0.5))
    members = np.isin(np.arange(1, n + 1), group.robots)
    np.testing.assert_allclose(moved[members], 0.7, atol=1e-9)
    np.testing.assert_allclose(moved[~members], 0.0, atol=1e-9)


@given(n=st.integers(1, 16), data=st.data(), excursion=st.sampled_from([np.inf, 1.0, 0.3]))
def test_the_recursion_of_the_paper_moves_one_robot_alone(n, data, excursion):
    swarm = swarm_of(n)
    robot = data.draw(st.integers(1, n))
    group = data.draw(st.sampled_from((np.flatnonzero(swarm.membership[:, robot - 1]) + 1).tolist()))
    moved = displacements(swarm, Extract((robot,), group, 0.9, excursion))
    assert moved[robot - 1] == pytest.approx(0.9, abs=1e-9)
    np.testing.assert_allclose(np.delete(moved, robot - 1), 0.0, atol=1e-9)


def test_the_hand_designed_primitive_of_the_paper():
    # (f_1, Rot_{4,5,6}(0, 0, pi), f_1) moves robots 4 and 5 with two pulses
    swarm = swarm_of(6)
    moved = displacements(swarm, Extract((4, 5), 1, 1.0))
    np.testing.assert_allclose(moved, [0, 0, 0, 1, 1, 0], atol=1e-12)
    groups, lengths = expand(swarm, [Extract((4, 5), 1, 1.0)])
    assert np.sum((groups == 1) & (lengths == 0.5)) == 2


def test_extracting_a_robot_from_a_group_it_is_not_in_is_refused():
    with pytest.raises(StressbotError, match="does not contain robot 1"):
        expand(swarm_of(6), [Extract((1,), 1, 1.0)])


def test_extracting_too_many_robots_at_once_is_refused():
    with pytest.raises(StressbotError, match="extract fewer") as caught:
        expand(swarm_of(14), [Extract((8, 9, 10, 11, 12), 1, 1.0)])
    assert caught.value.code == ErrorCode.INVALID_PLAN


@pytest.mark.parametrize(("n", "recursion", "halving"), [(6, 2, 4), (14, 4, 8), (30, 16, 16)])
def test_pulses_of_both_forms(n, recursion, halving):
    swarm = Swarm(1.0, 1.0, 0.3, binary(n))
    group = swarm.m - 1  # the only one of robot 1
    for primitive, pulses in ((Extract((1,), group, 1.0), recursion), (Isolate(1, 1.0, group), halving)):
        groups, lengths = expand(swarm, [primitive])
        assert np.min(lengths[groups == group]) == pytest.approx(1.0 / pulses)
        assert np.sum((groups == group) & np.isclose(lengths, 1.0 / pulses)) == pulses
