"""The lower bounds: no plan is below them, and the paper's instance has the known ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.model.allocation import SCHEMES, binary
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.kinematics import execution_time, path_length, replay
from stressbot_planner.model.swarm import Swarm, fastest
from stressbot_planner.problem.bounds import lower_bounds
from stressbot_planner.problem.definition import Problem

STARTS = np.column_stack([np.zeros(6), np.linspace(2, 18, 6), np.zeros(6)])
GOALS = np.array([(12, 11.6), (12, 18.0), (12, 5.2), (12, 2.0), (12, 8.4), (12, 14.8)])


def test_bounds_of_the_paper_instance():
    bounds = lower_bounds(Swarm(1.0, 1.0, 0.3, binary(6)), STARTS, GOALS)
    assert bounds.path_length == pytest.approx(144.84, abs=0.005)
    assert bounds.execution_time == pytest.approx(48.28, abs=0.005)


def test_execution_scales_with_speed_and_path_length_does_not():
    slow, fast = (lower_bounds(Swarm(u, 1.0, 0.3, binary(6)), STARTS, GOALS) for u in (1.0, 4.0))
    assert fast.execution_time == pytest.approx(slow.execution_time / 4)
    assert fast.path_length == pytest.approx(slow.path_length)


@given(st.integers(1, 30), st.sampled_from(sorted(SCHEMES)), st.integers(0, 2**32 - 1), st.floats(0.2, 4))
def test_no_plan_is_below_the_bounds(n, scheme, seed, speed):
    rng = np.random.default_rng(seed)
    u, pace = fastest(speed * rng.choice([np.ones(n), rng.uniform(0.5, 1.5, n)]))
    swarm = Swarm(u, rng.uniform(0.3, 2), 0.1, SCHEMES[scheme](n), pace)
    start = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-4, 4, n)])
    count = int(rng.integers(1, 30))
    # few turns, so that some plans go nearly straight and come close
    groups, lengths = rng.integers(1, swarm.m + 1, count), rng.exponential(1.0, count) * rng.choice([0.01, 1.0])
    goals = replay(swarm, start, groups, lengths)[-1, :, :2]
    bounds = lower_bounds(swarm, start, goals)
    assert bounds.path_length <= path_length(swarm, groups, lengths) * (1 + 1e-6) + 1e-6
    assert bounds.execution_time <= execution_time(swarm, lengths) * (1 + 1e-6) + 1e-6


@given(st.integers(1, 12), st.sampled_from(sorted(SCHEMES)), st.integers(0, 2**32 - 1), st.floats(1e-9, 3), st.booleans())
def test_no_plan_is_below_the_bound_with_turns(n, scheme, seed, tolerance, headed):
    rng = np.random.default_rng(seed)
    pace = fastest(rng.choice([np.ones(n), rng.uniform(0.5, 1.5, n)]))[1]
    swarm = Swarm(1.0, rng.uniform(0.3, 2, n) if rng.random() < 0.5 else 0.7, 0.0, SCHEMES[scheme](n), pace)
    starts = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-4, 4, n)])
    count = int(rng.integers(1, 12))
    groups, lengths = rng.integers(1, swarm.m + 1, count), rng.exponential(1.0, count) * rng.choice([0.01, 1.0, 4.0])
    ends = replay(swarm, starts, groups, lengths)[-1]
    away = rng.uniform(0, tolerance, n)[:, None] * unit_vectors(rng.uniform(-4, 4, n))
    chosen = [rng.integers(n)] if headed and not swarm.membership.all(axis=0).any() else []
    headings = np.full(n, np.nan)
    headings[chosen] = ends[chosen, 2] + rng.uniform(-0.1, 0.1)
    problem = Problem(swarm, Environment(), starts, ends[:, :2] + away, tolerance, (), headings, 0.1)
    least = problem.turning_time
    assert problem.lower_bounds.execution_time <= least * (1 + 1e-6) + 1e-6
    assert least <= execution_time(swarm, lengths) * (1 + 1e-6) + 1e-6


def unit_vectors(angles):
    return np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize(
    ("goal", "least"),
    [
        ((0.0, 4.0), 4.0 + 0.5 * np.pi),  # a quarter turn of radius 1, then straight
        ((-4.0, 0.0), 4.0 + np.pi),
        ((4.0, 0.0), 4.0),
        ((0.0, 1e-3), 0.5 * np.pi),
    ],
)
def test_a_robot_turns_to_its_goal_before_it_slides(goal, least):
    swarm = Swarm(1.0, 1.0, 0.1, ("10", "01"))
    starts = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    problem = Problem(swarm, Environment(), starts, np.array([goal, (9.0 + least - np.hypot(*goal), 0.0)]), 1e-9)
    assert problem.turning_time == pytest.approx(least, rel=1e-3, abs=2e-3)


def test_to_the_right_it_is_a_detour_or_most_of_a_turn():
    """At -90 degrees: headings 0 and R, half each as far as needed; the shortest by calculus over R in (pi, 3 pi / 2)."""
    swarm = Swarm(1.0, 1.0, 0.1, ("10", "01"))
    starts, goals = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]]), np.array([[0.0, -0.5], [50.0, 0.0]])
    turned = np.linspace(np.pi + 0.01, 1.5 * np.pi, 2000)
    best = (turned - 0.5 * np.tan(0.5 * turned)).min()
    assert Problem(swarm, Environment(), starts, goals, 1e-9).turning_time == pytest.approx(best, rel=0.01)


@given(st.integers(0, 2**32 - 1), st.floats(0, 20))
def test_a_tolerance_lowers_the_bounds(seed, tolerance):
    goals = GOALS + np.random.default_rng(seed).uniform(-1, 1, (6, 2))
    swarm = Swarm(1.0, 1.0, 0.3, binary(6))
    exact, loose = lower_bounds(swarm, STARTS, goals), lower_bounds(swarm, STARTS, goals, tolerance)
    assert -1e-9 <= loose.path_length <= exact.path_length + 1e-6
    assert -1e-9 <= loose.execution_time <= exact.execution_time + 1e-6


def test_a_single_robot_is_bounded_by_its_distance():
    bounds = lower_bounds(Swarm(2.0, 1.0, 0.3, ("1",)), np.zeros((1, 3)), np.array([[3.0, 4.0]]))
    assert bounds == pytest.approx((5.0, 2.5))
