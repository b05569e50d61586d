"""The paper's primitives do what it says, or what it should say; expansions are exact for any poses."""

from itertools import combinations
from math import ceil, inf, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import SCHEMES, binary
from stressbot_planner.model.kinematics import Activation, execution_time, replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import (
    Activate,
    Extract,
    Isolate,
    Orient,
    Subgroup,
    Translate,
    Turn,
    TurnAll,
    can_orient,
    expand,
    merge,
    orientation_matrix,
    rotation_inputs,
)

EXCURSIONS = st.one_of(st.just(inf), st.floats(0.05, 3.0))
SCHEME_NAMES = st.sampled_from(sorted(SCHEMES))


def swarm_of(n: int, scheme="binary", radius=1.0) -> Swarm:
    return Swarm(1.0, radius, 0.3, SCHEMES[scheme](n))


def random_start(n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-pi, pi, n)])


def run(swarm, start, *primitives) -> np.ndarray:
    """Return poses along the expansion, shape (K + 1, n, 3)."""
    return replay(swarm, start, *expand(swarm, primitives))


def turned_by(poses) -> np.ndarray:
    """Return how far headings ended from where they began, wrapped to (-pi, pi]."""
    return np.angle(np.exp(1j * (poses[-1, :, 2] - poses[0, :, 2])))


def assert_angles(actual, desired, atol=1e-9):
    np.testing.assert_allclose(np.exp(1j * np.asarray(actual)), np.exp(1j * np.asarray(desired, dtype=float)), atol=atol)


@st.composite
def cases(draw, least=1):
    """Return (swarm, start, a group other than G_m)."""
    swarm = swarm_of(draw(st.integers(least, 15)), draw(SCHEME_NAMES), draw(st.floats(0.2, 3.0)))
    return swarm, random_start(swarm.n, draw(st.integers(0, 999))), draw(st.integers(1, swarm.m - 1))


# --- h_i ------------------------------------------------------------------------------------------------------------


@given(cases(), st.floats(0, 3))
def test_h_is_two_slides_with_half_turns_between(case, d):
    swarm, _, i = case
    r = swarm.common_turning_radius()
    groups, lengths = expand(swarm, [Turn(i, 2 * d / r)])
    if 0.01 < 2 * d / r < 2 * pi - 0.01:
        assert groups.tolist() == [i, swarm.m, i, swarm.m]
        np.testing.assert_allclose(lengths, [d, pi * r, d, pi * r])


@given(cases(), st.floats(-20, 20), EXCURSIONS)
def test_h_turns_all_but_the_members_and_displaces_nobody(case, angle, excursion):
    swarm, start, i = case
    poses = run(swarm, start, Turn(i, angle, excursion))
    assert_angles(turned_by(poses), np.where(swarm.membership[i - 1], 0.0, angle))
    np.testing.assert_allclose(poses[-1, :, :2], start[:, :2], atol=1e-8)


@given(cases(), st.floats(0, 2 * pi))
def test_h_backward_is_h_of_the_rest_of_the_turn(case, angle):
    swarm, _, i = case
    np.testing.assert_allclose(expand(swarm, [Turn(i, -angle)])[1], expand(swarm, [Turn(i, 2 * pi - angle)])[1], atol=1e-9)


@given(cases(), st.floats(0, 2 * pi), EXCURSIONS)
def test_members_swing_out_no_farther_than_the_excursion(case, angle, excursion):
    swarm, start, i = case
    poses = run(swarm, start, Turn(i, angle, excursion))
    out = np.hypot(*(poses[:, :, :2] - start[:, :2]).transpose(2, 0, 1)).max(initial=0.0)
    reach = min(excursion, pi * swarm.common_turning_radius())
    assert out <= reach + 1e-9


@given(cases(), st.floats(0.1, 6), st.floats(0.05, 1.0))
def test_small_excursions_cost_the_time_that_the_notes_give(case, angle, excursion):
    # about (phi r / u) (1 + pi r / epsilon): the paper does not say so
    swarm, _, i = case
    r = swarm.common_turning_radius()
    repeats = max(1, ceil(angle * r / 2 / excursion - 1e-9))
    time = execution_time(swarm, expand(swarm, [Turn(i, angle, excursion)])[1])
    assert time == pytest.approx(angle * r + 2 * pi * r * repeats)
    assert time >= angle * r * (1 + pi * r / excursion) - 1e-9


@given(cases(), st.floats(0.01, 6))
def test_h_of_epsilon_over_r_swings_by_half_of_epsilon(case, epsilon):
    # the paper keeps members within a ball of radius epsilon by h_i(epsilon / r): h_i(2 epsilon / r) would do
    swarm, start, i = case
    r = swarm.common_turning_radius()
    for angle, wanted in ((epsilon / r, epsilon / 2), (2 * epsilon / r, epsilon)):
        if angle < 2 * pi:
            out = np.hypot(*(run(swarm, start, Turn(i, angle))[:, :, :2] - start[:, :2]).transpose(2, 0, 1)).max(axis=0)
            np.testing.assert_allclose(out, np.where(swarm.membership[i - 1], wanted, 0.0), atol=1e-9)


# --- g_i ------------------------------------------------------------------------------------------------------------


@given(cases(), st.floats(-6, 6), EXCURSIONS)
def test_g_moves_the_members_along_their_heading_either_way_and_turns_nobody(case, distance, excursion):
    swarm, start, i = case
    poses = run(swarm, start, Translate(i, distance, excursion))
    along = distance * np.column_stack([np.cos(start[:, 2]), np.sin(start[:, 2])])
    expected = start[:, :2] + np.where(swarm.membership[i - 1][:, None], along, 0.0)
    np.testing.assert_allclose(poses[-1, :, :2], expected, atol=1e-8)
    assert_angles(turned_by(poses), np.zeros(swarm.n), atol=1e-8)


@given(cases(), st.floats(0.1, 3))
def test_the_paper_sequence_for_g_backward_leaves_the_members_turned_by_pi(case, d):
    # (f_m(pi), g_i(d), h_i(pi)): right positions, wrong headings
    swarm, start, i = case
    poses = run(swarm, start, TurnAll(pi), Translate(i, d), Turn(i, pi))
    right = run(swarm, start, Translate(i, -d))
    np.testing.assert_allclose(poses[-1, :, :2], right[-1, :, :2], atol=1e-8)
    assert_angles(turned_by(poses), np.where(swarm.membership[i - 1], pi, 0.0), atol=1e-8)


# --- f_m and Rot ----------------------------------------------------------------------------------------------------


@given(cases(), st.floats(-20, 20))
def test_f_m_turns_everyone(case, angle):
    swarm, start, _ = case
    poses = run(swarm, start, TurnAll(angle))
    assert_angles(turned_by(poses), np.full(swarm.n, angle))
    np.testing.assert_array_equal(poses[-1, :, :2], start[:, :2])


def test_orientation_matrix_is_the_printed_one_with_rows_4_and_6_swapped():
    printed = np.array([[1, 1, 0, 1], [1, 0, 1, 1], [1, 0, 0, 1], [0, 0, 1, 1], [0, 1, 0, 1], [0, 1, 1, 1]])
    right = printed[[0, 1, 2, 5, 4, 3]]
    built = orientation_matrix(swarm_of(6))
    np.testing.assert_array_equal(built, right)
    assert not np.array_equal(built, printed)


def test_f_1_turns_the_robots_outside_g_1():
    poses = run(swarm_of(6, radius=2.0), np.zeros((6, 3)), Activate(1, 1.0))
    np.testing.assert_allclose(poses[-1, :, 2], [0.5, 0.5, 0.5, 0, 0, 0])


@pytest.mark.parametrize("n", [6, 14, 30])
def test_the_headings_of_any_three_robots_can_be_set(n):
    swarm = swarm_of(n)
    assert all(can_orient(swarm, three) for three in combinations(range(1, n + 1), 3))


@pytest.mark.parametrize("n", [6, 14, 30])
@pytest.mark.parametrize("excursion", [inf, 0.7])
def test_rot_sets_three_headings_and_displaces_nobody(n, excursion):
    swarm = swarm_of(n)
    rng = np.random.default_rng(n)
    everyone = list(combinations(range(1, n + 1), 3))
    for index in rng.choice(len(everyone), min(len(everyone), 60), replace=False):
        three, angles = everyone[index], rng.uniform(-pi, pi, 3)
        start = random_start(n, int(index))
        poses = run(swarm, start, Orient(three, tuple(angles), excursion))
        assert_angles(turned_by(poses)[np.array(three) - 1], angles)
        np.testing.assert_allclose(poses[-1, :, :2], start[:, :2], atol=1e-8)


@pytest.mark.parametrize(("n", "count", "independent", "all_sets"), [(6, 4, 12, 15), (14, 5, 1360, 2002)])
def test_m_robots_can_only_sometimes_be_set_independently(n, count, independent, all_sets):
    # the paper says "at most m"
    swarm = swarm_of(n)
    assert count == swarm.m
    found = [can_orient(swarm, robots) for robots in combinations(range(1, n + 1), count)]
    assert (sum(found), len(found)) == (independent, all_sets)
    assert not can_orient(swarm, range(1, count + 2))


@given(cases(least=4), st.data())
def test_rot_works_for_every_independent_set(case, data):
    swarm, start, _ = case
    count = data.draw(st.integers(0, swarm.m))
    robots = tuple(data.draw(st.permutations(range(1, swarm.n + 1)))[:count])
    angles = tuple(data.draw(st.lists(st.floats(-9, 9), min_size=count, max_size=count)))
    if count and not can_orient(swarm, robots):
        with pytest.raises(StressbotError, match="independently") as caught:
            rotation_inputs(swarm, robots, angles)
        assert caught.value.code == ErrorCode.INVALID_PLAN
        return
    poses = run(swarm, start, Orient(robots, angles))
    assert_angles(turned_by(poses)[[robot - 1 for robot in robots]], angles, atol=1e-8)


# --- one robot alone ------------------------------------------------------------------------------------------------


@given(cases(), st.floats(0, 5), EXCURSIONS, st.data())
def test_halving_moves_exactly_one_robot_and_restores_the_headings_of_its_group(case, distance, excursion, data):
    swarm, start, _ = case
    robot = data.draw(st.integers(1, swarm.n))
    group = data.draw(st.sampled_from((np.flatnonzero(swarm.membership[:, robot - 1]) + 1).tolist()))
    poses = run(swarm, start, Isolate(robot, distance, group, excursion))
    expected = start[:, :2].copy()
    expected[robot - 1] += distance * np.array([np.cos(start[robot - 1, 2]), np.sin(start[robot - 1, 2])])
    np.testing.assert_allclose(poses[-1, :, :2], expected, atol=1e-8)
    member = swarm.membership[group - 1]
    turned = np.where(member, 0.0, distance / swarm.common_turning_radius())
    assert_angles(turned_by(poses), turned, atol=1e-8)


@given(cases(least=2), st.floats(0.1, 5), st.floats(0.05, 2.0), st.data())
def test_halving_keeps_everyone_else_within_the_excursion(case, distance, excursion, data):
    swarm, start, _ = case
    robot = data.draw(st.integers(1, swarm.n))
    group = int(np.flatnonzero(swarm.membership[:, robot - 1])[0]) + 1
    poses = run(swarm, start, Isolate(robot, distance, group, excursion))
    out = np.hypot(*(poses[:, :, :2] - start[:, :2]).transpose(2, 0, 1))
    # a swing of a half turn may start where a pulse has brought a robot, each at most an excursion away
    assert np.delete(out, robot - 1, axis=1).max() <= 2 * excursion + 1e-9


@pytest.mark.parametrize(("n", "pulses"), [(6, 4), (14, 8), (30, 16)])
def test_halving_takes_2_to_the_m_minus_2_pulses(n, pulses):
    # the recursion of the paper takes 2, 8 and 128: exponentially many in the size of the group
    swarm = swarm_of(n)
    for robot in range(1, n + 1):
        for group in np.flatnonzero(swarm.membership[:, robot - 1]) + 1:
            subgroup = Isolate(robot, 1.0, int(group)).subgroup(swarm)
            assert 2 ** (len(subgroup.inside) + len(subgroup.outside)) <= pulses
            groups, lengths = expand(swarm, [subgroup])
            assert np.sum((groups == group) & np.isclose(lengths, 1.0 / pulses)) in (0, pulses)


def proof_of_stlc(swarm, robot: int, group: int, d: float):
    """The paper's P_k, literally: P_{k+1} = (P_k, Rot_{l, l', robot}(pi - delta, pi - delta', 0), P_k), two more robots a time."""
    others = [int(k) + 1 for k in np.flatnonzero(swarm.membership[group - 1]) if k + 1 != robot]
    sequence = [Translate(group, d)]
    pulses = 1
    while others:
        pair, others = others[:2], others[2:]
        turned = turned_by(run(swarm, np.zeros((swarm.n, 3)), *sequence))
        angles = [pi - turned[k - 1] for k in pair] + [-turned[robot - 1]]
        sequence = [*sequence, Orient((*pair, robot), tuple(angles)), *sequence]
        pulses *= 2
    return sequence, pulses


@pytest.mark.parametrize(("n", "pulses"), [(6, 2), (14, 8)])
@pytest.mark.parametrize("robot", [1, 2, 6])
def test_the_sequence_of_the_stlc_proof_moves_one_robot_alone(n, pulses, robot):
    swarm = swarm_of(n)
    group = int(np.flatnonzero(swarm.membership[:, robot - 1])[0]) + 1
    sequence, count = proof_of_stlc(swarm, robot, group, 0.4)
    assert count == pulses
    start = random_start(n, robot)
    moved = np.hypot(*(run(swarm, start, *sequence)[-1] - start)[:, :2].T)
    np.testing.assert_allclose(moved, np.where(np.arange(1, n + 1) == robot, pulses * 0.4, 0.0), atol=1e-8)


def test_the_proof_doubles_the_pulses_with_every_two_robots():
    # 2, 8 and 128 for n = 6, 14 and 30: exponential in the size of a group
    assert [2 ** ceil((n // 2 - 1) / 2) for n in (6, 14, 30)] == [2, 8, 128]


def test_all_pulses_are_needed_when_a_group_is_full():
    swarm = swarm_of(30)
    assert max(len(s.inside) + len(s.outside) for s in (Isolate(k, 1.0, 1).subgroup(swarm) for k in range(16, 31))) == 4


def test_the_bracket_h2_g1_of_the_paper_moves_robots_4_and_5():
    swarm = swarm_of(6)
    start = random_start(6, 5)
    poses = run(swarm, start, Subgroup(1, 1.0, outside=(2,)))
    moved = np.hypot(*(poses[-1] - start)[:, :2].T)
    np.testing.assert_allclose(moved, [0, 0, 0, 1, 1, 0], atol=1e-9)


# --- expansions -----------------------------------------------------------------------------------------------------


@given(cases(), st.lists(st.tuples(st.integers(1, 9), st.floats(0, 9)), max_size=12))
def test_merging_changes_no_motion(case, pairs):
    swarm, start, _ = case
    activations = [(min(group, swarm.m), length) for group, length in pairs]
    merged = merge(swarm, [Activation(*pair) for pair in activations])
    before = replay(swarm, start, np.array([g for g, _ in activations], dtype=int), np.array([t for _, t in activations]))
    after = replay(swarm, start, np.array([g for g, _ in merged], dtype=int), np.array([t for _, t in merged]))
    np.testing.assert_allclose(after[-1, :, :2], before[-1, :, :2], atol=1e-8)
    assert_angles(after[-1, :, 2], before[-1, :, 2], atol=1e-8)
    assert len(merged) <= len(activations)


@given(cases(), st.floats(-50, 50), st.floats(0, 9), EXCURSIONS)
def test_expansions_only_drive_forward(case, angle, distance, excursion):
    swarm, _, i = case
    groups, lengths = expand(
        swarm, [Turn(i, angle, excursion), Translate(i, -distance, excursion), TurnAll(angle), Activate(i, distance)]
    )
    assert np.all(lengths >= 0)
    assert np.all((groups >= 1) & (groups <= swarm.m))


def test_activations_work_for_any_turning_radii_and_the_other_primitives_do_not():
    swarm = Swarm(1.0, [1.0, 2.0, 1.0], 0.3, binary(3))
    assert expand(swarm, [Activate(1, 2.0)])[1].tolist() == [2.0]
    for primitive in (Turn(1, 1.0), TurnAll(1.0), Translate(1, 1.0), Orient((1,), (1.0,)), Subgroup(1, 1.0, (2,))):
        with pytest.raises(StressbotError, match="turning_radius") as caught:
            primitive.expand(swarm)
        assert caught.value.code == ErrorCode.UNSUPPORTED


NAN, INF = float("nan"), inf


@pytest.mark.parametrize(
    ("primitive", "code", "field"),
    [
        (Activate(0, 1.0), ErrorCode.UNKNOWN_GROUP, "group"),
        (Activate(5, 1.0), ErrorCode.UNKNOWN_GROUP, "group"),
        (Activate(1, -1.0), ErrorCode.OUT_OF_RANGE, "length"),
        (Activate(1, NAN), ErrorCode.NOT_FINITE, "length"),
        (Turn(4, 1.0), ErrorCode.UNKNOWN_GROUP, "group"),
        (Turn(1, NAN), ErrorCode.NOT_FINITE, "angle"),
        (Turn(1, INF), ErrorCode.NOT_FINITE, "angle"),
        (Turn(1, 1.0, 0.0), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Turn(1, 1.0, -1.0), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Turn(1, 1.0, NAN), ErrorCode.NOT_FINITE, "excursion"),
        (Turn(1, 1.0, 1e-12), ErrorCode.OUT_OF_RANGE, "excursion"),
        (TurnAll(NAN), ErrorCode.NOT_FINITE, "angle"),
        (Translate(1, NAN), ErrorCode.NOT_FINITE, "distance"),
        (Translate(4, 1.0), ErrorCode.UNKNOWN_GROUP, "group"),
        (Orient((1, 2), (1.0,)), ErrorCode.WRONG_COUNT, "angles"),
        (Orient((7,), (1.0,)), ErrorCode.UNKNOWN_ROBOT, "robot"),
        (Orient((1, 1), (1.0, 1.0)), ErrorCode.INVALID_PLAN, "robots"),
        (Orient((1,), (NAN,)), ErrorCode.NOT_FINITE, "angles[0]"),
        (Subgroup(1, -1.0), ErrorCode.OUT_OF_RANGE, "distance"),
        (Subgroup(1, 1.0, (1,)), ErrorCode.INVALID_PLAN, "inside/outside"),
        (Subgroup(1, 1.0, (2,), (2,)), ErrorCode.INVALID_PLAN, "inside/outside"),
        (Subgroup(1, 1.0, (2,) * 60), ErrorCode.INVALID_PLAN, "inside/outside"),
        (Subgroup(1, 1.0, (2,), (), 1e-9), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Isolate(1, 1.0, 1), ErrorCode.INVALID_PLAN, "group"),
        (Isolate(0, 1.0, 1), ErrorCode.UNKNOWN_ROBOT, "robot"),
        (Isolate(4, 1e12, 1, 0.1), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Isolate(4, 1.0, 1, 4e-6), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Orient((1, 2, 3), (1.0, 4.0, 2.0), 6e-6), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Extract((4,), 1, 1e5, 0.1), ErrorCode.OUT_OF_RANGE, "excursion"),
        (Extract((1,), 1, 1.0), ErrorCode.INVALID_PLAN, "group"),
    ],
)
def test_refused_primitives_name_the_field(primitive, code, field):
    with pytest.raises(StressbotError) as caught:
        primitive.expand(swarm_of(6))
    assert (caught.value.code, caught.value.field) == (code, field)
