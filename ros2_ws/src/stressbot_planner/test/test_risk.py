"""The risk of a plan that is driven blindly: covariances to first order, probabilities, and what drawn swarms say."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.execution.blind_drive import Noise, drive, risk
from stressbot_planner.execution.first_order_risk import covariances_at, first_order_risk, probability_within
from stressbot_planner.formats import scenario
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.primitives.expansion import Activate, TurnAll
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances

SAMPLES = 4000


@cache
def plan() -> Plan:
    """Return a plan for the paper's six robots among two discs."""
    found = solve(scenario.parse(instances.paper(True)).problem, "optimize", Settings(max_tries=4, first=True))
    assert found.success
    return found.plan


@pytest.mark.parametrize("kind", ["speed_error", "radius_error", "heading_bias", "heading_noise"])
def test_covariances_are_those_of_drawn_swarms(kind):
    noise = Noise(**{kind: 1e-4})
    rng = np.random.default_rng(1)
    poses = drive(plan(), noise, 4000, rng).poses[..., :2]
    n, knots = plan().problem.swarm.n, (7, len(plan().groups) // 2, len(plan().groups))
    for knot in knots:
        expected = covariances_at(plan(), noise, np.arange(n), np.full(n, knot), plan().poses[knot, :, :2])
        for j in range(n):
            drawn = np.cov(poses[:, knot, j].T) / 0.9866  # of what is drawn within three standard deviations
            size = max(np.trace(expected[j]), 1e-14)
            np.testing.assert_allclose(drawn, expected[j], atol=0.1 * size)


def test_covariances_of_places_within_an_activation_lie_on_the_way():
    noise = Noise(0.01, 0.02, 0.03, 0.04)
    k = int(np.argmax(plan().lengths))
    j = int(np.flatnonzero(plan().problem.swarm.membership[plan().groups[k] - 1])[0])
    ends = plan().poses[k : k + 2, j, :2]
    first, second = covariances_at(plan(), noise, np.array([j, j]), np.array([k, k]), ends)
    before, after = covariances_at(plan(), noise, np.array([j, j]), np.array([k, k + 1]), ends)
    np.testing.assert_allclose([first, second], [before, after], rtol=1e-9, atol=1e-12)


@given(st.integers(0, 10**6))
def test_the_probability_of_a_disc_is_that_of_drawn_places(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 2)) * 10.0 ** rng.uniform(-2, 1, (2, 1))
    mean, radius = rng.normal(size=2), float(10.0 ** rng.uniform(-0.5, 0.7))
    drawn = np.hypot(*(mean[:, None] + root @ rng.standard_normal((2, SAMPLES)))) <= radius
    assert abs(drawn.mean() - probability_within(mean, root @ root.T, radius)) < 5 * 0.5 / np.sqrt(SAMPLES)


def test_a_disc_around_the_mean_of_a_round_distribution_has_a_closed_form():
    for ratio in (0.01, 0.5, 1.0, 3.0, 10.0):
        assert probability_within(np.zeros(2), np.eye(2), ratio) == pytest.approx(1 - np.exp(-(ratio**2) / 2), rel=1e-9)
    assert probability_within(np.array([0.5, 0.0]), np.zeros((2, 2)), 1.0) == 1.0
    assert probability_within(np.array([2.0, 0.0]), np.zeros((2, 2)), 1.0) == 0.0


@pytest.mark.parametrize("noise", [Noise(speed_error=0.002), Noise(heading_noise=0.004), Noise(0.001, 0.001, 0.002, 0.002)])
def test_missed_goals_are_as_frequent_as_expected(noise):
    ends = drive(plan(), noise, SAMPLES, np.random.default_rng(2)).poses[:, -1, :, :2]
    errors = np.hypot(*np.moveaxis(ends - plan().problem.goals, -1, 0))
    tolerance = float(np.quantile(errors.max(axis=1), 0.7))
    expected = first_order_risk(plan(), noise, tolerance)
    np.testing.assert_allclose(expected.outside, (errors > tolerance).mean(axis=0), atol=0.03)
    assert expected.misses == pytest.approx(0.3, abs=0.05)


def passing(gap: float) -> Plan:
    """Return a plan in which a robot slides past another at rest, and this one is at its goal already."""
    swarm = Swarm(1.0, 1.0, 0.3, ("01", "10"))
    starts = [[0, 0, 0], [6, 0.6 + gap, 0]]
    problem = Problem(swarm, Environment(), starts, [[12, 0], [6, 0.6 + gap]])
    return Plan(problem, (Activate(2, 12.0),))


@pytest.mark.parametrize(("gap", "noise"), [(0.05, Noise(heading_bias=0.01)), (0.1, Noise(heading_noise=0.012)),
                                            (0.02, Noise(0.01, 0.01, 0.004, 0.004))])
def test_collisions_of_two_robots_are_as_frequent_as_expected(gap, noise):
    drawn = risk(passing(gap), noise, 4000, 3).collisions / 4000
    assert 0.05 < drawn < 0.95
    assert first_order_risk(passing(gap), noise, 1.0).collides == pytest.approx(drawn, abs=0.03)


def test_collisions_among_discs_are_nearly_as_frequent_as_expected():
    for size in (0.001, 0.003):
        drawn = risk(plan(), Noise(speed_error=size), 1000, 4).collisions / 1000
        assert first_order_risk(plan(), Noise(speed_error=size), 1.0).collides == pytest.approx(drawn, abs=0.15)


def test_places_at_the_end_count_too():
    swarm = Swarm(1.0, 1.0, 0.3, ("01", "10"))
    problem = Problem(swarm, Environment(), [[0, 0, 0], [8, 0, 0]], [[7.38, 0], [8, 0]])
    noise = Noise(speed_error=0.01)
    beside = Plan(problem, (Activate(2, 7.38),))
    drawn = risk(beside, noise, 4000, 5).collisions / 4000
    assert 0.3 < drawn < 0.5
    assert first_order_risk(beside, noise, 1.0).collides == pytest.approx(drawn, abs=0.03)


def test_perfect_robots_are_no_risk():
    none = first_order_risk(plan(), Noise(), 1e-6)
    assert none.collides == none.misses == 0.0 and not none.covariances.any()
    still = replace(plan().problem, goals=plan().problem.starts[:, :2])
    assert first_order_risk(Plan(still, ()), Noise(0.03, 0.03, 0.1, 0.1), 0.1).misses == 0.0
    turned = Plan(still, (TurnAll(1.0),))
    assert first_order_risk(turned, Noise(0.03, 0.03, 0.1, 0.1), 0.1).collides == 0.0
