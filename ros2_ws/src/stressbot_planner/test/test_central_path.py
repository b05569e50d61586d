"""Newton steps of the central path against plain linear algebra, and where robots aim in goal balls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners.optimization.central_path import CentralPath, Order
from stressbot_planner.planners.optimization.derivatives import goal_functionals, jacobian, weighted_hessian
from stressbot_planner.reproduce import instances

PROBLEM = scenario.parse(instances.paper(True)).problem
GROUPS = np.tile(np.arange(1, PROBLEM.swarm.m + 1), 15)


def path_of(problem, ends=None):
    slides = problem.swarm.slides[GROUPS - 1]
    order = Order(GROUPS, slides, np.maximum(slides.sum(axis=1), 0.1))
    return CentralPath(problem, Shapes.of(problem.environment), order, 0.1, ends=ends)


def restored(path, guesses, patient=False):
    """Return the durations that guesses lead to, None where they lead nowhere; each is checked."""
    found = [path.restore(guess, patient) for guess in guesses]
    for t in found:
        if t is not None:
            reached = replay(path.problem.swarm, path.problem.starts, GROUPS, t)[-1, :, :2]
            np.testing.assert_allclose(reached, path.aims, atol=1e-8)
            assert np.all(t > 0)
    return found


def some_durations(path, count=60):
    """Return durations with every robot at its goal: the most that random guesses lead to, three quarters of them at least."""
    guesses = [np.random.default_rng(seed).uniform(0.5, 2.5, len(GROUPS)) for seed in range(count)]
    found = [t for t in restored(path, guesses, patient=True) if t is not None]
    assert len(found) >= 0.75 * count
    return found


@pytest.fixture(scope="module")
def exact():
    """A path and many durations with every robot at its goal."""
    path = path_of(PROBLEM)
    return path, some_durations(path)


@pytest.mark.parametrize("number", range(4))
def test_a_step_is_newtons_in_the_null_space_of_the_goals(exact, number):
    path, t = exact[0], exact[1][number]
    here, mu, rho = path.evaluate(t), 1.0, 3.0
    assert len(here.gaps)
    dual = mu / t
    step, gradient, multipliers, shift = path._newton_step(here, dual, mu, rho, 0.0)
    about = path.order.slides, path.turning_length, here.poses
    goals = goal_functionals(here.poses)
    rows, gap_rows = jacobian(12, goals, *about) * t, jacobian(len(here.gaps), here.near, *about) * t
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
    for t in some_durations(path_of(problem, ends), 8):
        reached = replay(problem.swarm, problem.starts, GROUPS, t)[-1, :, :2] - problem.goals
        np.testing.assert_allclose(reached[1::2], np.tile(near, (3, 1)), atol=1e-6)
        np.testing.assert_allclose(reached[::2], np.tile([0.0, -0.999], (3, 1)), atol=1e-6)


@pytest.mark.parametrize(("size", "least"), [(1e-2, 0.6), (1e-3, 0.85)])
def test_goals_are_restored_from_near_by(exact, size, least):
    path, durations = exact
    changed = [t * np.random.default_rng(k).uniform(1 - size, 1 + size, len(t)) for k, t in enumerate(durations)]
    found = restored(path, changed)
    for before, after in zip(changed, found, strict=True):
        if after is not None:
            np.testing.assert_allclose(after, before, rtol=0.3)
    assert sum(after is not None for after in found) >= least * len(found)


def test_goals_too_far_away_are_hardly_ever_restored(exact):
    path, durations = exact
    found = restored(path, [t[::-1].copy() for t in durations])
    assert sum(after is not None for after in found) < 0.2 * len(found)


def test_exact_goals_stay_the_aims():
    np.testing.assert_array_equal(path_of(PROBLEM, PROBLEM.goals + 0.1).aims, PROBLEM.goals)
