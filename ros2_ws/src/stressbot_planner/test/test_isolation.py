"""One robot alone, in any direction: the construction behind the paper's controllability proof."""

from fractions import Fraction
from math import cos, inf, nan, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import SCHEMES, binary, by_radius
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.brackets import position_rank
from stressbot_planner.primitives.expansion import Extract, Isolate, expand
from stressbot_planner.primitives.isolation import isolate


def swarm_of(n: int, scheme="binary") -> Swarm:
    return Swarm(1.0, 0.8, 0.3, SCHEMES[scheme](n))


def of_radii(*radii) -> Swarm:
    return Swarm(1.0, radii, 0.3, by_radius(radii))


def mixed_swarm(rng: np.random.Generator) -> Swarm:
    """Return robots in sets of equal radius and speed, with any codewords by which those of one set differ."""
    n = int(rng.integers(2, 9))
    radii = rng.uniform(0.5, 2.0, int(rng.integers(1, n + 1)))
    while True:
        sets, bits = rng.integers(0, len(radii), n), int(rng.integers(1, 5))
        words = [format(int(rng.integers(1, 2**bits)), f"0{bits}b") for _ in range(n)]
        if len(set(zip(words, sets.tolist(), strict=True))) == n:
            return Swarm(1.0, radii[sets], 0.1, tuple(words))


def poses_of(swarm: Swarm, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-9, 9, (swarm.n, 2)), rng.uniform(-pi, pi, swarm.n)])


def assert_moves_alone(swarm, poses, robot, direction, distance, form):
    groups, lengths = expand(swarm, isolate(swarm, poses, robot, direction, distance, form))
    assert np.all(lengths >= 0)
    moved = (replay(swarm, poses, groups, lengths)[-1] - poses)[:, :2]
    wanted = np.zeros((swarm.n, 2))
    wanted[robot - 1] = distance * cos(direction), distance * sin(direction)
    np.testing.assert_allclose(moved, wanted, atol=1e-8)


@given(n=st.integers(1, 15), scheme=st.sampled_from(sorted(SCHEMES)), direction=st.floats(-20, 20),
       distance=st.floats(0, 9), form=st.sampled_from(["halving", "recursion"]), data=st.data())
def test_isolate_moves_one_robot_alone_in_any_direction(n, scheme, direction, distance, form, data):
    swarm = swarm_of(n, scheme)
    assert_moves_alone(swarm, poses_of(swarm, n), data.draw(st.integers(1, n)), direction, distance, form)


@given(radii=st.lists(st.sampled_from([0.2, 1 / 3, 0.6, 0.8, 1.0, 1.8, 3.0]), min_size=1, max_size=5, unique=True),
       direction=st.floats(-20, 20), distance=st.floats(0, 9), data=st.data())
def test_two_groups_move_one_robot_alone_whatever_the_ratios_of_radii(radii, direction, distance, data):
    # 0.6 and 0.2, 1 and 1/3, 3 and 1, 1.8 and 0.6 are odd ratios, at which the steps of the paper fail
    swarm = of_radii(*radii)
    assert swarm.m == 2
    assert_moves_alone(swarm, poses_of(swarm), data.draw(st.integers(1, swarm.n)), direction, distance, "radii")


def test_different_speeds_do_as_well_as_different_radii():
    swarm = Swarm(2.0, 1.0, 0.3, ("1", "1", "1"), pace=[1.0, 0.6, 0.35])
    for robot in (1, 2, 3):
        assert_moves_alone(swarm, poses_of(swarm), robot, 1.0, 2.0, "radii")


@pytest.mark.parametrize("radii", [(1.0, 1 / 3), (1.0, 1 / 5), (1.0, 1 / 11), (0.9, 0.3, 0.1)])
def test_odd_ratios_of_radii_take_polygons_of_as_many_corners(radii):
    swarm = of_radii(*radii)
    ratio = Fraction(radii[0] / radii[1]).limit_denominator(20)
    slides = [step for step in isolate(swarm, poses_of(swarm), 2, 0.0, 1.0, "radii") if step.group == 1]
    assert len(slides) % int(ratio) == 0
    assert_moves_alone(swarm, poses_of(swarm), 2, 0.0, 1.0, "radii")


@given(n=st.integers(2, 31), robot=st.integers(1, 31))
def test_the_group_with_the_fewest_pulses_is_taken(n, robot):
    swarm = swarm_of(n)
    robot = min(robot, n)
    groups = (np.flatnonzero(swarm.membership[:, robot - 1]) + 1).tolist()
    _, halving = isolate(swarm, poses_of(swarm), robot, 0.0, 1.0, "halving")
    _, recursion = isolate(swarm, poses_of(swarm), robot, 0.0, 1.0, "recursion")
    assert halving.pulses(swarm) == min(Isolate(robot, 1.0, group).pulses(swarm) for group in groups) <= 2 ** (swarm.m - 2)
    assert recursion.pulses(swarm) == min(Extract((robot,), group, 1.0).pulses(swarm) for group in groups)


@given(n=st.integers(1, 31), distance=st.floats(0.1, 5), data=st.data())
def test_pulses_are_those_of_the_expansion(n, distance, data):
    swarm = swarm_of(n)
    robot = data.draw(st.integers(1, n))
    group = data.draw(st.sampled_from((np.flatnonzero(swarm.membership[:, robot - 1]) + 1).tolist()))
    for primitive in (Isolate(robot, distance, group), Extract((robot,), group, distance)):
        groups, lengths = expand(swarm, [primitive])
        pulses = primitive.pulses(swarm)
        assert np.any((groups == group) & np.isclose(lengths, distance / pulses))
    groups, lengths = expand(swarm, [Isolate(robot, distance, group)])
    assert np.sum(groups == group) == Isolate(robot, distance, group).pulses(swarm)
    assert np.sum(lengths[groups == group]) == pytest.approx(distance)


SIX = swarm_of(6)


@pytest.mark.parametrize(
    ("swarm", "changes", "code", "field"),
    [
        (SIX, {"robot": 7}, ErrorCode.UNKNOWN_ROBOT, "robot"),
        (SIX, {"robot": 0}, ErrorCode.UNKNOWN_ROBOT, "robot"),
        (SIX, {"direction": nan}, ErrorCode.NOT_FINITE, "direction"),
        (SIX, {"direction": inf}, ErrorCode.NOT_FINITE, "direction"),
        (SIX, {"distance": nan}, ErrorCode.NOT_FINITE, "distance"),
        (SIX, {"distance": -1.0}, ErrorCode.OUT_OF_RANGE, "distance"),
        (SIX, {"form": "magic"}, ErrorCode.UNSUPPORTED, "form"),
        (of_radii(1.0, 0.8), {"form": "halving"}, ErrorCode.UNSUPPORTED, "swarm.turning_radius"),
        (of_radii(1.0, 0.8), {"form": "recursion"}, ErrorCode.UNSUPPORTED, "swarm.turning_radius"),
        (Swarm(1.0, [1.0, 0.8, 0.8], 0.3, binary(3)), {"form": "halving"}, ErrorCode.UNSUPPORTED, "swarm.turning_radius"),
        (of_radii(1.0, 1.0 + 1e-8), {"form": "radii"}, ErrorCode.UNSUPPORTED, "swarm.turning_radius"),
    ],
)
def test_what_cannot_be_isolated_is_refused(swarm, changes, code, field):
    arguments = {"robot": 1, "direction": 0.0, "distance": 1.0, "form": "halving"} | changes
    with pytest.raises(StressbotError) as caught:
        isolate(swarm, poses_of(swarm), **arguments)
    assert (caught.value.code, caught.value.field) == (code, field)


def test_sets_of_equal_radii_are_isolated_in_a_group_without_their_like():
    swarm = Swarm(1.0, [1.0, 1.0, 0.6, 0.6], 0.3, ("01", "10", "01", "10"))
    for robot in range(1, 5):
        assert_moves_alone(swarm, poses_of(swarm), robot, 1.0, 2.0, "radii")


@pytest.mark.parametrize("block", range(10))
def test_each_robot_of_mixed_swarms_is_moved_alone_to_1e_9(block):
    rng = np.random.default_rng(block)
    for swarm in (mixed_swarm(rng) for _ in range(10)):
        poses = poses_of(swarm, block)
        for robot in range(1, swarm.n + 1):
            direction, distance = rng.uniform(-4, 4), rng.uniform(0, 5)
            groups, lengths = expand(swarm, isolate(swarm, poses, robot, direction, distance, "radii"))
            assert np.all(lengths >= 0)
            moved = (replay(swarm, poses, groups, lengths)[-1] - poses)[:, :2]
            moved[robot - 1] -= distance * cos(direction), distance * sin(direction)
            assert np.hypot(*moved.T).max() < 1e-9


@pytest.mark.parametrize("seed", range(30))
def test_every_swarm_whose_robots_differ_in_codeword_or_radius_has_full_rank(seed):
    swarm = mixed_swarm(np.random.default_rng(seed))
    assert position_rank(swarm, 2 * swarm.n + 1) == 2 * swarm.n


def test_nearly_equal_radii_take_as_many_whole_turns_as_they_need():
    swarm = of_radii(1.0, 1.0 + 1e-4)
    assert_moves_alone(swarm, poses_of(swarm), 1, 0.3, 1.0, "radii")
