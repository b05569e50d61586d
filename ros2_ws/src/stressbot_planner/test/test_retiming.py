"""New durations for the rest of a plan: goals met from wrong places, as well as possible with too few."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.execution.retiming import retime
from stressbot_planner.model.kinematics import trajectory


def some_motion(seed, count=30, n=4):
    rng = np.random.default_rng(seed)
    slides = (rng.random((count, n)) < 0.5) * rng.uniform(0.9, 1.0, n)
    starts = np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-3, 3, n)])
    return slides, rng.uniform(0.8, 1.2, n), starts, rng.uniform(0.2, 1.5, count), rng


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_goals_are_met_from_places_a_little_off(seed):
    slides, turning_length, starts, t, rng = some_motion(seed)
    goals = trajectory(slides, turning_length, starts, t)[-1, :, :2]
    off = starts + rng.normal(0, [0.1, 0.1, 0.02], starts.shape)
    new, poses = retime(slides, turning_length, off, goals, t)
    assert np.all(new > 0)
    np.testing.assert_array_equal(poses, trajectory(slides, turning_length, off, new))
    np.testing.assert_allclose(poses[-1, :, :2], goals, atol=1e-5)


def test_too_few_activations_bring_robots_closer_all_the_same():
    slides, turning_length, starts, t, rng = some_motion(5, count=5)
    goals = trajectory(slides, turning_length, starts, t)[-1, :, :2]
    off = starts + rng.normal(0, [0.1, 0.1, 0.05], starts.shape)

    def miss(t):
        return np.linalg.norm(trajectory(slides, turning_length, off, t)[-1, :, :2] - goals)

    new, _ = retime(slides, turning_length, off, goals, t)
    assert miss(new) < 0.9 * miss(t) and np.all(new > 0)


@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 3))
@settings(deadline=None, max_examples=30)
def test_a_rest_that_can_move_nobody_or_few_is_answered_all_the_same(seed, count, n):
    slides, turning_length, starts, t, rng = some_motion(seed, count, n)
    goals = rng.uniform(-5, 5, (n, 2))
    for kept in (slides, np.zeros_like(slides)):
        new, poses = retime(kept, turning_length, starts, goals, t)
        assert np.all(new > 0) and np.all(np.isfinite(poses))
