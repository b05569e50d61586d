"""Whole numbers of pulses: near the plan, and the robots near their goals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.model.whole_pulses import LEEWAY, is_whole, whole
from stressbot_planner.planners import Settings, in_whole_pulses, solve
from stressbot_planner.primitives.expansion import Activate, TurnAll, as_primitives
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan

STEP = 1.2e-4


def make_swarm(n):
    return Swarm(1.0, 1.0, 0.3, binary(n))


def make_plan(n, count, seed):
    rng = np.random.default_rng(seed)
    starts = np.column_stack([np.zeros(n), 3.0 * np.arange(n), rng.uniform(-3, 3, n)])
    swarm = make_swarm(n)
    return swarm, starts, rng.integers(1, swarm.m + 1, count), rng.uniform(0.0, 4.0, count)


def missed(swarm, starts, groups, lengths, counts):
    ends = [replay(swarm, starts, groups, driven)[-1, :, :2] for driven in (lengths, STEP * counts)]
    return np.hypot(*(ends[0] - ends[1]).T) / STEP


@pytest.mark.parametrize(("n", "count", "most", "median"), [(1, 20, 3.0, 1.0), (6, 60, 5.0, 2.0), (14, 150, 5.0, 2.0)])
def test_robots_end_within_a_few_steps_of_where_the_plan_leads(n, count, most, median):
    found = []
    for seed in range(20):
        plan = make_plan(n, count, seed)
        counts = whole(*plan, STEP)
        assert np.array_equal(counts, np.rint(counts)) and counts.min() >= 0
        assert np.abs(counts - plan[3] / STEP).max() <= 11  # the plan goes where it went
        found.append(missed(*plan, counts))
    assert np.max(found) <= most
    assert np.median(found) <= median
    alone = np.max([missed(*plan, np.rint(plan[3] / STEP)) for plan in (make_plan(n, count, seed) for seed in range(20))])
    assert n == 1 or np.max(found) < 0.5 * alone  # rounding each by itself is worse


@pytest.mark.parametrize(("n", "count", "seeds"), [(6, 12, 60), (6, 14, 60), (6, 16, 60), (14, 30, 20), (14, 40, 20)])
def test_few_activations_leave_few_choices_and_still_enough(n, count, seeds):
    """Robots need two activations each; of so few the first roundings miss by more than five steps now and then."""
    for seed in range(seeds):
        swarm, starts, groups, lengths = make_plan(n, count, seed)
        points = replace(swarm, body_radius=0.0)
        goals = replay(swarm, starts, groups, lengths)[-1, :, :2]
        problem = Problem(points, Environment(None, ()), starts, goals)
        plan = in_whole_pulses(Plan(problem, as_primitives(groups, lengths)), STEP)
        assert plan.goal_error <= plan.problem.tolerance
        assert len(plan.groups) <= count + 3 * swarm.m


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(1, 4), st.integers(0, 2**40)), max_size=20))
def test_what_is_whole_stays_as_it_is(drawn):
    groups, counts = np.array([g for g, _ in drawn], dtype=int), np.array([c for _, c in drawn], dtype=float)
    assert is_whole(counts)
    np.testing.assert_array_equal(whole(make_swarm(6), np.zeros((6, 3)), groups, counts * STEP, STEP), counts)


@settings(deadline=None)
@given(st.integers(1, 7), st.lists(st.floats(0.0, 30.0), max_size=12), st.integers(0, 10**6))
def test_any_plan_gets_whole_twice_as_once(n, lengths, seed):
    rng = np.random.default_rng(seed)
    swarm = make_swarm(n)
    groups, lengths = rng.integers(1, swarm.m + 1, len(lengths)), np.array(lengths, dtype=float)
    counts = whole(swarm, np.zeros((n, 3)), groups, lengths, STEP)
    np.testing.assert_array_equal(counts, np.rint(counts))
    np.testing.assert_array_equal(whole(swarm, np.zeros((n, 3)), groups, counts * STEP, STEP), counts)


def test_sums_of_a_group_stay_right_however_long_the_plan_is_and_however_many_the_robots():
    swarm = Swarm(1.0, 1.0, 0.0, binary(1022))
    rng = np.random.default_rng(0)
    groups, lengths = rng.integers(1, swarm.m + 1, 3000), rng.uniform(0.0, 1.0, 3000)
    counts = whole(swarm, np.zeros((1022, 3)), groups, lengths, STEP)
    for group in range(1, swarm.m + 1):
        rows = groups == group
        assert np.abs(np.cumsum(counts[rows]) - np.cumsum(lengths[rows]) / STEP).max() <= 0.5 + 1e-6


def test_a_plan_in_whole_pulses_is_the_same_problem_with_a_wider_goal():
    problem = Problem(make_swarm(2), Environment(), [[0, 0, 0], [0, 3, 0]], [[1, 0], [1, 3]], 1e-6)
    plan = in_whole_pulses(Plan(problem, (Activate(1, 1.0), TurnAll(0.5), Activate(2, STEP / 3))), STEP)
    assert plan.problem.tolerance == pytest.approx(1e-6 + LEEWAY * STEP)
    assert [primitive.group for primitive in plan.primitives] == [1, 3]  # a third of a pulse is none
    assert is_whole(plan.lengths / STEP)


def test_a_plan_keeps_the_clearance_that_was_asked_for_in_whole_pulses_too():
    swarm = make_swarm(6)
    starts = [[0, 3.2 * k, 0] for k in range(6)]
    goals = [[12, 3.2 * k] for k in (3, 5, 1, 0, 2, 4)]
    problem = Problem(swarm, Environment(), starts, goals)
    for seed in range(3):
        found = solve(problem, "optimize", Settings(max_tries=20, first=True, seed=seed, min_clearance=0.05, pulse_length=STEP))
        assert found.success, found.reason
        assert found.plan.clearance.gap >= 0.05
        assert found.plan.goal_error <= LEEWAY * STEP + 1e-6
