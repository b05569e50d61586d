"""Estimates from synthetic measurements: true values come back, intervals cover them, faults are named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moving_robots import Robots, wrapped

from stressbot_planner.estimation.calibration import Fault, cut, estimate, look_alikes, rest_poses
from stressbot_planner.model.allocation import SCHEMES, binary
from stressbot_planner.model.swarm import Swarm

SIX = Swarm(1.0, 1.0, 0.3, binary(6))


@given(st.integers(1, 7), st.sampled_from(sorted(SCHEMES)), st.integers(0, 2**32 - 1))
def test_without_noise_the_true_values_come_back(n, scheme, seed):
    rng = np.random.default_rng(seed)
    swarm = Swarm(2.0, rng.uniform(0.7, 1.3, n), 0.3, SCHEMES[scheme](n))
    speed, radius = 2.0 * rng.uniform(0.8, 1.2, n), swarm.turning_radius * rng.uniform(0.8, 1.2, n)
    bias = rng.uniform(-np.pi, np.pi, n)
    found = estimate(swarm, Robots(swarm, speed, radius, bias, seed).rounds(2))
    for j, entry in enumerate(found):
        assert (entry.robot, entry.codeword, entry.fault, entry.missed) == (j + 1, swarm.codewords[j], Fault.NONE, 0)
        assert entry.speed.value == pytest.approx(speed[j], rel=1e-9) and entry.speed.half_width < 1e-9
        assert entry.turning_rate.value == pytest.approx(speed[j] / radius[j], rel=1e-9)
        assert entry.turning_radius.value == pytest.approx(radius[j], rel=1e-9) and entry.turning_radius.half_width < 1e-9
        assert wrapped(entry.heading_bias.value - bias[j]) == pytest.approx(0.0, abs=1e-9)


def test_intervals_cover_the_true_values_as_often_as_they_say():
    rng = np.random.default_rng(1)
    hits, relative = [], []
    for seed in range(60):
        speed, radius, bias = rng.uniform(0.9, 1.1, 6), rng.uniform(0.9, 1.1, 6), rng.uniform(-0.2, 0.2, 6)
        robots = Robots(SIX, speed, radius, bias, seed, position=0.02, orientation=0.02, jump=0.035)
        for entry, true in zip(estimate(SIX, robots.rounds(2)), zip(speed, radius, bias, strict=True), strict=True):
            values = (entry.speed, entry.turning_radius, entry.heading_bias)
            hits.append([abs(interval.value - value) <= interval.half_width for interval, value in zip(values, true, strict=True)])
            relative.append([abs(interval.value / value - 1) for interval, value in zip(values[:2], true, strict=False)])
    # 360 intervals each; three sigma of a share of 0.95 are 0.034, and robots of a swarm share one estimate of the noise
    assert np.mean(hits, axis=0) == pytest.approx([0.95] * 3, abs=0.045)
    assert np.max(relative) < 0.02


def test_more_rounds_make_narrower_intervals():
    widths = []
    for count in (2, 8):
        robots = Robots(SIX, np.ones(6), np.ones(6), np.zeros(6), 5, position=0.02, orientation=0.02)
        widths.append(np.mean([entry.turning_radius.half_width for entry in estimate(SIX, robots.rounds(count))]))
    assert widths[1] < 0.65 * widths[0]


def test_one_slide_and_one_turn_leave_the_width_open():
    lone = Swarm(1.0, 1.0, 0.3, ("1",))
    (entry,) = estimate(lone, Robots(lone, [1.1], [1.0], [0.1]).rounds(1))
    assert entry.speed.value == pytest.approx(1.1) and np.isinf(entry.speed.half_width)
    assert str(entry.speed) == "1.1000 ± ?"


def test_a_robot_that_nobody_sees_is_unknown_and_disturbs_nobody():
    robots = Robots(SIX, np.full(6, 1.05), np.ones(6), np.zeros(6))
    robots.hidden[2] = True
    found = estimate(SIX, robots.rounds(2))
    assert found[2].fault is Fault.NOT_SEEN and found[2].codeword == "011"
    assert (found[2].speed, found[2].turning_rate, found[2].turning_radius, found[2].heading_bias) == (None,) * 4
    assert [entry.fault for entry in found if entry.robot != 3] == [Fault.NONE] * 5
    assert found[1].speed.value == pytest.approx(1.05)


def test_poses_missed_in_between_do_no_harm():
    robots = Robots(SIX, np.full(6, 0.97), np.full(6, 1.04), np.full(6, 0.1), 3)
    records = robots.rounds(2, turn=12.0)  # two turns each
    rng = np.random.default_rng(0)
    for record in records:
        record.poses[rng.random(record.poses.shape[:2]) < 0.7] = np.nan
        record.poses[len(record.times) // 3 : 2 * len(record.times) // 3] = np.nan  # four seconds of darkness
    for entry in estimate(SIX, records):
        assert entry.fault is Fault.NONE
        assert entry.speed.value == pytest.approx(0.97) and entry.turning_radius.value == pytest.approx(1.04)


@pytest.mark.parametrize(
    ("what", "fault"), [(1, Fault.ALWAYS_SLIDES), (-1, Fault.ALWAYS_TURNS), (0, Fault.STANDS_STILL)]
)
def test_stuck_arms(what, fault):
    found = estimate(SIX, Robots(SIX, np.ones(6), np.ones(6), np.zeros(6), always={4: what}).rounds(2))
    assert [entry.fault for entry in found] == [fault if j == 4 else Fault.NONE for j in range(6)]
    assert (found[4].speed is None) == (what <= 0) and (found[4].turning_rate is None) == (what >= 0)
    assert found[4].turning_radius is None


def test_turning_alone_accuses_nobody():
    robots = Robots(SIX, np.ones(6), np.ones(6), np.zeros(6))
    found = estimate(SIX, [robots.drive(4, 1.0) for _ in range(3)])
    assert [entry.fault for entry in found] == [Fault.NONE] * 6
    assert [entry.codeword for entry in found] == list(SIX.codewords)


def test_wrong_groups_are_found_and_single_misses_counted():
    membership = SIX.membership.copy()
    membership[1, 0] = True  # robot 1 (001) answers to G_2 as well
    robots = Robots(SIX, np.ones(6), np.ones(6), np.zeros(6), membership=membership)
    records = robots.rounds(3)
    robots.membership = SIX.membership[[3, 1, 2, 3]]
    records.append(robots.drive(1, 1.5))  # and once nobody answers to G_1
    found = estimate(SIX, records)
    assert (found[0].fault, found[0].codeword, found[0].missed) == (Fault.OTHER_GROUPS, "011", 0)
    assert [(entry.fault, entry.codeword) for entry in found[1:]] == [(Fault.NONE, word) for word in SIX.codewords[1:]]
    assert [entry.missed for entry in found] == [0, 0, 0, 1, 1, 1]


def test_robots_that_nobody_can_tell_apart_are_named():
    membership = SIX.membership.copy()
    membership[:, 2] = membership[:, 1]  # robot 3 answers to the groups of robot 2
    membership[:, 5] = membership[:, 4]
    radius = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.3])
    robots = Robots(SIX, np.ones(6), radius, np.zeros(6), 7, membership=membership, position=0.01, orientation=0.01)
    found = estimate(SIX, robots.rounds(3))
    assert [entry.codeword for entry in found] == ["001", "010", "010", "100", "101", "101"]
    assert look_alikes(found) == [(2, 3)]


def test_cut_takes_what_was_measured_during_each_drive():
    times = np.array([0.9, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0])
    poses = times[:, None, None] * np.ones((1, 2, 3))
    first, second = cut([1, 3], np.array([0.2, 0.7]), np.array([0.5, 0.95]), times, poses)
    assert (first.group, second.group) == (1, 3)
    np.testing.assert_allclose(first.times, [0.1, 0.3])  # not at the very beginning, but at the end
    np.testing.assert_allclose(second.times, [0.2])
    np.testing.assert_allclose(first.poses[:, 1, 2], [0.3, 0.5])


def test_rest_poses_are_means_across_the_cut_of_the_circle():
    frames = np.array([[[1.0, 2.0, np.pi - 0.1]] * 2, [[3.0, 2.0, -np.pi + 0.3]] * 2])
    frames[:, 1] = np.nan
    mean = rest_poses(frames)
    np.testing.assert_allclose(mean[0, :2], [2.0, 2.0])
    assert wrapped(mean[0, 2] - (np.pi + 0.1)) == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(mean[1]).all()
