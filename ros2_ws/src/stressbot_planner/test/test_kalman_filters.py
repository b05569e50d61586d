"""What is learnt of robots from the poses before and after activations, and how far they are expected to drift."""

import numpy as np
import pytest

from stressbot_planner.estimation.kalman_filters import MISSED, Calibration, KalmanFilters, Prior
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.model.swarm import Swarm

SWARM = Swarm(1.0, 1.0, 0.3, ("01", "10", "11"))


def true_motion(rng, poses, group, length, slide, turn, bias, noise):
    poses = poses.copy()
    poses[:, 2] += noise * rng.standard_normal(len(poses))
    member = SWARM.membership[group - 1]
    step = np.where(member, length * slide, 0.0)
    poses[:, 0] += step * np.cos(poses[:, 2] + bias)
    poses[:, 1] += step * np.sin(poses[:, 2] + bias)
    poses[:, 2] += np.where(member, 0.0, length * turn)
    return poses


def test_speeds_turning_rates_biases_and_noise_are_learnt():
    rng = np.random.default_rng(0)
    slide, turn, bias = np.array([0.96, 1.03, 1.0]), np.array([1.04, 0.97, 1.0]), np.array([0.1, -0.08, 0.0])
    filters, poses = KalmanFilters(SWARM, Prior()), np.zeros((3, 3))
    for k in range(60):
        group, length = 1 + k % 3, rng.uniform(0.5, 2.0)
        after = true_motion(rng, poses, group, length, slide, turn, bias, np.radians(1.0))
        wrapped = after.copy()
        wrapped[:, 2] = np.angle(np.exp(1j * after[:, 2]))
        filters.learn(group, length, poses, wrapped)
        poses = wrapped
    np.testing.assert_allclose(filters.slide, slide, atol=2e-3)
    np.testing.assert_allclose(filters.bias, bias, atol=5e-3)
    np.testing.assert_allclose(filters.turn, turn, atol=0.012)
    assert np.radians(0.8) < filters.heading_noise < np.radians(1.5)
    assert np.all(filters.slide_variance < 1e-4)
    expected = filters.advance(poses, 1, 1.5)
    exact = true_motion(rng, poses, 1, 1.5, slide, turn, bias, 0.0)
    np.testing.assert_allclose(expected, exact, atol=0.03)


def test_a_robot_that_does_not_move_and_one_that_strays_are_counted():
    filters, poses = KalmanFilters(SWARM, Prior()), np.zeros((3, 3))
    for _ in range(MISSED):
        # group 1 has robots 2 and 3; 2 stays, 1 slides instead
        filters.learn(1, 1.0, poses, poses + [[1, 0, 0], [0, 0, 1], [1, 0, 0]])
    assert filters.missed.tolist() == [0, MISSED, 0] and filters.strayed.tolist() == [MISSED, 0, 0]
    assert filters.slide[1] == 1.0
    filters.learn(1, 1.0, poses, poses + [[0, 0, 1], [1, 0, 0], [np.nan, np.nan, np.nan]])
    assert filters.missed.tolist() == [0, 0, 0] and filters.strayed.tolist() == [0, 0, 0]


@pytest.mark.parametrize("known", [False, True])
def test_the_expected_drift_is_what_is_drawn(known):
    rng = np.random.default_rng(1)
    unknown = {"speed_error": 0.0, "turning_error": 0.0, "heading_bias": 0.0} if known else {}
    assumed = Prior(position_noise=0.0, **unknown)
    filters = KalmanFilters(SWARM, assumed)
    groups, lengths = np.array([1, 2, 3, 1, 2]), np.array([1.0, 1.5, 0.7, 2.0, 0.5])
    slides = SWARM.slides[groups - 1]
    nominal = trajectory(slides, SWARM.turning_length, np.zeros((3, 3)), lengths)
    ends = []
    for _ in range(1500):
        slide, turn = (1 + assumed.speed_error * rng.standard_normal(3)), 1 + assumed.turning_error * rng.standard_normal(3)
        bias, poses = assumed.heading_bias * rng.standard_normal(3), np.zeros((3, 3))
        for group, length in zip(groups, lengths, strict=True):
            poses = true_motion(rng, poses, group, length, slide, turn, bias, assumed.heading_noise)
        ends.append(poses[:, :2])
    spread = np.sqrt(np.mean(np.sum((np.array(ends) - nominal[-1, :, :2]) ** 2, axis=2), axis=0))
    np.testing.assert_allclose(filters.drift(groups, nominal, lengths)[-1], spread, rtol=0.1)


def test_a_calibration_is_where_beliefs_begin():
    swarm = Swarm(2.0, np.array([0.5, 1.0, 1.0]), 0.3, ("01", "10", "11"), np.array([1.0, 0.5, 1.0]))
    nan = np.nan
    measured = Calibration(
        heading_bias=np.array([0.1, -0.2, nan]),
        heading_bias_sigma=np.array([0.01, 0.0, nan]),
        speed_sigma=np.array([0.02, 0.03, nan]),
        turning_radius_sigma=np.array([0.05 * 0.5, 0.05, nan]),
    )
    assumed = Prior(speed_error=0.07, turning_error=0.08, heading_bias=0.09).calibrated(swarm, measured)
    filters = KalmanFilters(swarm, assumed)
    np.testing.assert_array_equal(filters.bias, [0.1, -0.2, 0.0])
    np.testing.assert_allclose(np.sqrt(filters.bias_variance), [0.01, 0.002, 0.09])  # nothing is known better than that
    np.testing.assert_allclose(np.sqrt(filters.slide_variance), [0.01, 0.03, 0.07])
    np.testing.assert_allclose(np.sqrt(filters.turn_variance), [np.sqrt(0.05**2 - 0.01**2), 0.04, 0.08])
