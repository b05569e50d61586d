"""The least squares of the receding horizon: its kernels against the plain ones, its derivatives, its descents."""

import numpy as np
import pytest
from fields import field
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners.optimization.gaps import near_gaps
from stressbot_planner.planners.optimization.receding_horizon.soft_goals import Crowd, SoftGoals, levenberg_marquardt


def order(problem, seed, count=40):
    rng = np.random.default_rng(seed)
    return rng.integers(1, problem.swarm.m + 1, count), rng.uniform(0.05, 1.5, count)


def _at(found, places):
    """Return whether both points of gaps are those of their robots at rest at places (n, 2), shape (g, 2)."""
    away = [np.hypot(*(found.points[:, 2 * k : 2 * k + 2] - places[found.robots[:, k]]).T) for k in range(2)]
    return np.column_stack([away[0] < 1e-9, (found.robots[:, 1] < 0) | (away[1] < 1e-9)])


@pytest.mark.parametrize("seed", range(20))
def test_gaps_are_those_of_the_plain_kernel(seed):
    problem = field()
    shapes, (groups, t) = Shapes.of(problem.environment), order(problem, seed)
    crowd = Crowd.of(problem.swarm, shapes)
    slides = crowd.slides_of(groups)
    start = problem.starts / [crowd.unit, crowd.unit, 1.0]
    motion = crowd.trajectory(slides, start, t / crowd.unit)
    poses = replay(problem.swarm, problem.starts, groups, t)
    assert np.allclose(crowd.unit * motion.x.T, poses[:, :, 0], atol=1e-9)
    assert np.allclose(np.arctan2(motion.sine, motion.cosine).T, np.angle(np.exp(1j * poses[:, :, 2])), atol=1e-9)
    found = crowd.gaps(motion, slides, t / crowd.unit, 0.4 / crowd.unit, meetings=False)
    plain, _ = near_gaps(0.4, slides.T.copy(), poses, t, problem.swarm.body_radius, shapes)
    # the plain kernel leaves out gaps between the places where robots start, or end
    there = [np.all(_at(found, places / crowd.unit), axis=1) for places in (poses[0, :, :2], poses[-1, :, :2])]
    assert np.allclose(np.sort(crowd.unit * found.size[~np.any(there, axis=0)]), np.sort(plain), atol=1e-9)
    meetings = crowd.gaps(motion, slides, t / crowd.unit, 0.4 / crowd.unit)
    assert len(meetings.size) <= len(found.size)
    if len(plain):
        assert meetings.size.min() == pytest.approx(found.size.min())


@pytest.mark.parametrize("seed", range(10))
def test_derivatives_are_those_of_differences(seed):
    problem = field()
    groups, t = order(problem, seed, 25)
    crowd = Crowd.of(problem.swarm, Shapes.of(problem.environment))
    start = problem.starts / [crowd.unit, crowd.unit, 1.0]
    soft = SoftGoals(
        crowd, start, crowd.slides_of(groups), problem.goals / crowd.unit, np.array([1.0, 2.0, 0.5, 1.0]),
        np.linspace(0.2, 1.0, 25), 10.0, 0.3, 0.0, 25,
    )
    here = soft.evaluate(t, 0.7, 0.2, meetings=False)
    rows, missing = soft.rows(here, 0.7, 0.2)
    slope = -(rows.T @ missing)  # of the value with respect to s
    s = np.sqrt(t)
    for k in range(len(t)):
        step = np.zeros(len(t))
        step[k] = 1e-5
        there, back = (soft.evaluate((s + sign * step) ** 2, 0.7, 0.2, meetings=False).value for sign in (1, -1))
        assert slope[k] == pytest.approx((there - back) / 2e-5, rel=5e-3, abs=5e-3)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_a_descent_never_goes_up(seed):
    problem = field()
    groups, t = order(problem, seed)
    crowd = Crowd.of(problem.swarm, Shapes.of(problem.environment))
    start = problem.starts / [crowd.unit, crowd.unit, 1.0]
    soft = SoftGoals(crowd, start, crowd.slides_of(groups), problem.goals / crowd.unit, np.ones(4), np.ones(40), 20.0, 0.3, 0.0, 40)
    here = levenberg_marquardt(soft, t, 0.1, 0.1, 10)
    assert np.all(here.t > 0)
    assert here.value <= soft.evaluate(t, 0.1, 0.1, True).value
