"""The closed form of an activation, against an integration that knows nothing of it, and its algebra."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from stressbot_planner.model.allocation import SCHEMES
from stressbot_planner.model.kinematics import advance, execution_time, path_length, replay
from stressbot_planner.model.swarm import Swarm, fastest


@st.composite
def motions(draw, most=8):
    """Return (swarm, start, groups, lengths); radii differ between robots now and then."""
    n = draw(st.integers(1, 9))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    radius = rng.uniform(0.3, 2.0, n) if draw(st.booleans()) else draw(st.floats(0.1, 5.0))
    u, pace = fastest(draw(st.floats(0.2, 3.0)) * (rng.uniform(0.3, 1.0, n) if draw(st.booleans()) else np.ones(n)))
    swarm = Swarm(u, radius, 0.3, SCHEMES[draw(st.sampled_from(sorted(SCHEMES)))](n), pace)
    count = draw(st.integers(0, most))
    start = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-4, 4, n)])
    return swarm, start, rng.integers(1, swarm.m + 1, count), rng.uniform(0, 4, count)


def integrated(swarm, start, groups, lengths):
    """Integrate the paper's equation of motion (Eq. 1) over time with a general solver."""
    state = np.asarray(start, dtype=float).ravel()
    for group, length in zip(groups, lengths, strict=True):
        active = np.array([group < swarm.m and word[group - 1] == "1" for word in swarm.codewords])

        def rates(_, flat, active=active):
            heading = flat.reshape(-1, 3)[:, 2]
            u = swarm.speed * swarm.pace
            return np.column_stack(
                [active * u * np.cos(heading), active * u * np.sin(heading), (1 - active) * u / swarm.turning_radius]
            ).ravel()

        if length > 0:
            state = solve_ivp(rates, (0, length / swarm.speed), state, rtol=1e-9, atol=1e-10).y[:, -1]
    return state.reshape(-1, 3)


@given(motions(most=4))
def test_replay_equals_a_fine_integration_of_the_equations_of_motion(motion):
    np.testing.assert_allclose(replay(*motion)[-1], integrated(*motion), atol=1e-6)


@given(motions())
def test_replay_returns_every_knot(motion):
    swarm, start, groups, lengths = motion
    poses = replay(swarm, start, groups, lengths)
    assert poses.shape == (len(groups) + 1, swarm.n, 3)
    np.testing.assert_array_equal(poses[0], start)
    for k in range(len(groups)):
        np.testing.assert_allclose(advance(swarm, poses[k], groups[k], lengths[k]), poses[k + 1], atol=1e-9)


@given(motions(), st.floats(0, 1))
def test_lengths_of_one_group_add_up(motion, share):
    swarm, start, groups, lengths = motion
    split_groups = np.repeat(groups, 2)
    split_lengths = np.column_stack([share * lengths, (1 - share) * lengths]).ravel()
    np.testing.assert_allclose(
        replay(swarm, start, split_groups, split_lengths)[-1], replay(swarm, start, groups, lengths)[-1], atol=1e-9
    )


@given(motions(), st.floats(-5, 5), st.floats(-5, 5), st.floats(-4, 4))
def test_motions_move_along_with_the_frame(motion, dx, dy, angle):
    # SE(2) symmetry: the paper concludes from it that STLC somewhere is STLC everywhere
    swarm, start, groups, lengths = motion
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def moved(poses):
        return np.concatenate([poses[..., :2] @ turn.T + (dx, dy), poses[..., 2:] + angle], axis=-1)

    np.testing.assert_allclose(
        replay(swarm, moved(start), groups, lengths), moved(replay(swarm, start, groups, lengths)), atol=1e-8
    )


@given(motions())
def test_nothing_goes_backward_or_clockwise(motion):
    swarm, start, groups, lengths = motion
    poses = replay(swarm, start, groups, lengths)
    steps = np.diff(poses, axis=0)
    assert np.all(steps[:, :, 2] >= 0)
    heading = poses[:-1, :, 2]
    assert np.all(steps[:, :, 0] * np.cos(heading) + steps[:, :, 1] * np.sin(heading) >= -1e-12)


@given(motions())
def test_everyone_slides_or_turns_never_both(motion):
    swarm, start, groups, lengths = motion
    steps = np.diff(replay(swarm, start, groups, lengths), axis=0)
    slid, turned = np.hypot(steps[:, :, 0], steps[:, :, 1]), steps[:, :, 2]
    for k, (group, length) in enumerate(zip(groups, lengths, strict=True)):
        member = swarm.membership[group - 1]
        np.testing.assert_allclose(slid[k], np.where(member, length * swarm.pace, 0), atol=1e-9)
        np.testing.assert_allclose(turned[k], np.where(member, 0, length * swarm.pace / swarm.turning_radius), atol=1e-9)


@given(motions(), st.floats(0.01, 0.999))
def test_in_less_than_the_time_of_a_half_turn_nobody_gets_behind_its_start(motion, share):
    # so that starts are not within what is reachable in any short time T > 0, as the paper's definition of STLC asks
    swarm, start, groups, lengths = motion
    rate = float(np.max(swarm.pace / swarm.turning_radius))
    lengths = share * np.pi / rate * lengths / max(lengths.sum(), 1e-9)
    moved = replay(swarm, start, groups, lengths)[-1, :, :2] - start[:, :2]
    ahead = start[:, 2] + share * np.pi / 2
    assert np.all(moved[:, 0] * np.cos(ahead) + moved[:, 1] * np.sin(ahead) >= -1e-9)


@given(motions())
def test_path_length_and_execution_time_are_those_of_the_poses(motion):
    swarm, start, groups, lengths = motion
    steps = np.diff(replay(swarm, start, groups, lengths)[:, :, :2], axis=0)
    assert path_length(swarm, groups, lengths) == pytest.approx(float(np.hypot(steps[..., 0], steps[..., 1]).sum()))
    assert execution_time(swarm, lengths) == pytest.approx(float(lengths.sum()) / swarm.speed)


def test_the_paper_figures_of_the_original_rrt_imply_unit_speed():
    # Table 3: path 332.10 in 110.70 s, three robots in each group
    swarm = Swarm(1.0, 1.0, 0.3, SCHEMES["binary"](6))
    assert path_length(swarm, [1, 2, 3], [36.9, 36.9, 36.9]) == pytest.approx(332.10)
    assert execution_time(swarm, [36.9, 36.9, 36.9]) == pytest.approx(110.70)


def three_steps(r1: float, r2: float) -> np.ndarray:
    """Return the displacements of two robots under the paper's P_1 = (G_1(d), G_2(pi^{r1}), G_1(d)) with all in G_1."""
    moved = []
    for radius in (r1, r2):
        lone = Swarm(1.0, radius, 0.3, ("1",))
        start = np.zeros((1, 3))
        moved.append(np.hypot(*replay(lone, start, [1, 2, 1], [1.0, np.pi * r1, 1.0])[-1, 0, :2]))
    return np.array(moved)


def test_the_three_steps_of_the_paper_tell_radii_apart_unless_their_ratio_is_odd():
    np.testing.assert_allclose(three_steps(1.0, 0.6)[0], 0, atol=1e-12)
    assert three_steps(1.0, 0.6)[1] > 0.5
    # r2 = r1 / 3: robot 2 turns by 3 pi, so it goes back as well, and the step of the proof fails
    np.testing.assert_allclose(three_steps(1.0, 1 / 3), 0, atol=1e-12)


@pytest.mark.parametrize("odd", [3, 5, 7])
def test_an_odd_ratio_of_radii_is_told_apart_by_a_polygon_of_as_many_corners(odd):
    # robot 1 goes around a regular polygon, robot 2 turns by a whole turn at each corner and goes straight on
    swarm = Swarm(1.0, [1.0, 1.0 / odd], 0.3, ("1", "1"))
    groups, lengths = [1, 2] * odd, [1.0, 2 * np.pi / odd] * odd
    end = replay(swarm, np.zeros((2, 3)), np.array(groups), np.array(lengths))[-1]
    np.testing.assert_allclose(end[:, :2], [[0, 0], [odd, 0]], atol=1e-12)


def test_headings_of_a_plan_of_many_turns_lose_no_digits():
    swarm = Swarm(1.0, 3.0, 0.3, ("01", "10"))
    groups, lengths = np.tile([1, 2], 100_000), np.tile([9.42, 0.7 * np.pi], 100_000)
    poses = replay(swarm, np.zeros((2, 3)), groups, lengths)
    for robot in range(2):
        turns = lengths[~swarm.membership[groups - 1, robot].astype(bool)] / 3.0
        exact = Fraction(0)
        for turn in np.unique(turns):
            exact += Fraction(turn) * int(np.count_nonzero(turns == turn))
        assert abs(float(Fraction(poses[-1, robot, 2]) - exact)) < 1e-9
