"""Newton steps of the central path against plain linear algebra, and where robots aim in goal balls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space

from stressbot_planner import scenario
from stressbot_planner.collision import Shapes
from stressbot_planner.kinematics import replay
from stressbot_planner.planners.central_path import CentralPath, Order
from stressbot_planner.planners.sensitivity import goal_functionals, rows_of, weighted_hessian
from stressbot_planner.reproduce import instances

PROBLEM = scenario.parse(instances.paper(True)).problem
GROUPS = np.tile(np.arange(1, PROBLEM.swarm.m + 1), 15)


def path_from(problem, seed, ends=None):
    slides = problem.swarm.slides[GROUPS - 1]
    order = Order(GROUPS, slides, np.maximum(slides.sum(axis=1), 0.1))
    path = CentralPath(problem, Shapes.of(problem.environment), order, 0.1, ends=ends)
    t = path.restore(np.random.default_rng(seed).uniform(0.5, 2.5, len(GROUPS)), patient=True)
    assert t is not None
    return path, t


@pytest.mark.parametrize("seed", range(4))
def test_a_step_is_newtons_in_the_null_space_of_the_goals(seed):
    path, t = path_from(PROBLEM, seed)
    here, mu, rho = path.evaluate(t), 1.0, 3.0
    assert len(here.gaps)
    dual = mu / t
    step, gradient, multipliers, shift = path._newton_step(here, dual, mu, rho, 0.0)
    about = path.order.slides, path.turning_length, here.poses
    goals = goal_functionals(here.poses)
    rows, gap_rows = rows_of(12, goals, *about) * t, rows_of(len(here.gaps), here.near, *about) * t
    push = -rho * (path.margin - here.gaps)
    hessian = weighted_hessian(-multipliers, goals, push, here.near, *about, t) + rho * gap_rows.T @ gap_rows
    hessian += np.diag(dual * t + shift)
    free = null_space(rows)
    expected = -free @ np.linalg.solve(free.T @ hessian @ free, free.T @ (gradient * t))
    np.testing.assert_allclose(step / t, expected, atol=1e-6 * np.abs(expected).max())
    slope = rows @ (gradient * t)
    np.testing.assert_allclose(rows @ rows.T @ multipliers, slope, atol=1e-8 * np.abs(slope).max())


def test_robots_aim_at_the_places_in_their_balls_nearest_to_where_they_ended():
    problem = replace(PROBLEM, tolerance=1.0)
    near, far = np.array([0.5, 0.0]), np.array([0.0, -4.0])
    ends = problem.goals + np.where(np.arange(6)[:, None] % 2, near, far)
    path, t = path_from(problem, 1, ends)
    reached = replay(problem.swarm, problem.starts, GROUPS, t)[-1, :, :2] - problem.goals
    np.testing.assert_allclose(reached[1::2], np.tile(near, (3, 1)), atol=1e-6)
    np.testing.assert_allclose(reached[::2], np.tile([0.0, -0.999], (3, 1)), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_goals_are_restored_from_near_by(seed):
    path, t = path_from(PROBLEM, seed)
    changed = t * np.random.default_rng(seed).uniform(0.99, 1.01, len(t))
    restored = path.restore(changed)
    assert restored is not None and np.all(restored > 0)
    np.testing.assert_allclose(restored, changed, rtol=0.3)
    reached = replay(PROBLEM.swarm, PROBLEM.starts, GROUPS, restored)[-1, :, :2]
    np.testing.assert_allclose(reached, PROBLEM.goals, atol=1e-8)


def test_goals_too_far_away_are_not_restored():
    path, t = path_from(PROBLEM, 0)
    assert path.restore(t[::-1].copy()) is None


def test_exact_goals_stay_the_aims():
    path, _ = path_from(PROBLEM, 1, PROBLEM.goals + 0.1)
    np.testing.assert_array_equal(path.aims, PROBLEM.goals)
