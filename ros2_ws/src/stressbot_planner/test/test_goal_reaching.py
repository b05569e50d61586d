"""The Jacobian of end positions, and steps of least norm to goals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.model.goal_reaching import end_jacobian, least_norm_step, restore_goals, share_of_step, step_to_goals
from stressbot_planner.model.kinematics import trajectory

PRECISION = 1e-9
FREE = np.full(4, np.nan)


def some_motion(seed, count=30, n=4):
    rng = np.random.default_rng(seed)
    slides = (rng.random((count, n)) < 0.5) * rng.uniform(0.9, 1.0, n)
    starts = np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-3, 3, n)])
    return slides, rng.uniform(0.8, 1.2, n), starts, rng.uniform(0.2, 1.5, count), rng


def ends_of(slides, turning_length, starts, t):
    return trajectory(slides, turning_length, starts, t)[-1, :, :2]


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_derivatives_agree_with_differences(seed):
    slides, turning_length, starts, t, _ = some_motion(seed, count=12)
    ends, rows = end_jacobian(slides, turning_length, starts, t, np.ones_like(t))
    np.testing.assert_allclose(ends, ends_of(slides, turning_length, starts, t), atol=1e-12)
    for k, change in enumerate(1e-6 * np.eye(len(t))):
        ahead, behind = (ends_of(slides, turning_length, starts, t + sign * change) for sign in (1, -1))
        np.testing.assert_allclose(rows[:, k], ((ahead - behind) / 2e-6).ravel(), atol=1e-6)


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_columns_are_scaled(seed):
    slides, turning_length, starts, t, rng = some_motion(seed)
    scale = rng.uniform(0, 2, len(t))
    plain = end_jacobian(slides, turning_length, starts, t, np.ones_like(t))[1]
    np.testing.assert_allclose(end_jacobian(slides, turning_length, starts, t, scale)[1], plain * scale, rtol=1e-13, atol=1e-15)


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(6, 12))
@settings(deadline=None, max_examples=30)
def test_the_step_is_the_one_of_least_norm(seed, rows, columns):
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(rows, columns)) * 10.0 ** rng.uniform(-3, 3, (rows, 1))
    miss = rng.normal(size=rows)
    step = least_norm_step(jacobian, miss, 0.0)
    np.testing.assert_allclose(step, -np.linalg.pinv(jacobian, rcond=1e-12) @ miss, rtol=1e-4, atol=1e-6 * np.abs(step).max())
    size = np.sum(jacobian**2) / rows
    damped = -jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 0.1 * size * np.eye(rows), miss)
    np.testing.assert_allclose(least_norm_step(jacobian, miss, 0.1), damped, rtol=1e-6, atol=1e-6 * np.abs(damped).max())


def test_rows_of_nobody_and_equal_rows_ask_for_nothing():
    row = np.array([1.0, 2.0, 0.0])
    step = least_norm_step(np.array([row, row, 0 * row]), np.array([1.0, 1.0, 1.0]), 0.0)
    np.testing.assert_allclose(step, -row / (row @ row), rtol=1e-6)
    assert np.isnan(least_norm_step(row[None], np.array([np.inf]), 0.0)).all()


@given(st.floats(-1e6, 1e6))
def test_lengths_stay_positive(steepest):
    share = share_of_step(steepest)
    assert 0 < share <= 1 and share * steepest <= 0.9 * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_goals_near_by_are_restored_and_goals_afar_are_reached(seed):
    slides, turning_length, starts, t, rng = some_motion(seed, count=60)
    near = ends_of(slides, turning_length, starts, t) + rng.normal(0, 0.02, (4, 2))
    restored, there = restore_goals(slides, turning_length, starts, near, FREE, t, PRECISION)
    assert there and np.all(restored > 0)
    np.testing.assert_allclose(ends_of(slides, turning_length, starts, restored), near, atol=PRECISION)
    far = near + rng.normal(0, 1.0, (4, 2))
    for _ in range(200):
        t, error = step_to_goals(slides, turning_length, starts, far, FREE, t, PRECISION)
        assert np.all(t > 0)
        if error < PRECISION:
            break
    np.testing.assert_allclose(ends_of(slides, turning_length, starts, t), far, atol=PRECISION)
