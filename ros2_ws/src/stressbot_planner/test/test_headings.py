"""Headings at goals: met exactly where the rank of the totals allows them, refused by name where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file, plan_text, read_plan_file
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.angles import wrapped
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.goal_reaching import goal_equations, goal_misses, restore_goals, step_to_goals
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, in_whole_pulses, solve
from stressbot_planner.primitives.expansion import can_orient
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.headings import dependent
from stressbot_planner.reproduce import instances

STEP = 1.2e-4
NAN = float("nan")


def headed(headings, starts=None, tolerance=1e-6) -> Problem:
    """Return the paper's six robots among two discs, with headings at their goals."""
    problem = scenario.parse(instances.paper(True)).problem
    changes = {} if starts is None else {"starts": starts}
    return replace(problem, goal_headings=headings, tolerance=tolerance, **changes)


# The equations


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_misses_and_their_derivatives_agree_with_differences(seed):
    rng = np.random.default_rng(seed)
    slides, turning = rng.random((12, 4)) < 0.5, rng.uniform(0.5, 2.0, 4)
    starts, t = rng.uniform(-3, 3, (4, 3)), rng.uniform(0.2, 1.5, 12)
    end = trajectory(slides, turning, starts, t)[-1]
    headings = np.where([True, False, True, False], end[:, 2] + rng.uniform(-1, 1, 4) + 2 * np.pi * rng.integers(-3, 4), NAN)
    motion = slides, turning, starts, rng.uniform(-3, 3, (4, 2)), headings
    misses, rows = goal_equations(*motion, t, np.ones(12))
    np.testing.assert_allclose(misses, goal_misses(*motion, t), atol=1e-12)
    np.testing.assert_allclose(misses[8:], (turning * wrapped(end[:, 2] - headings))[[0, 2]], atol=1e-12)
    for k, change in enumerate(1e-6 * np.eye(12)):
        ahead, behind = (goal_misses(*motion, t + sign * change) for sign in (1, -1))
        np.testing.assert_allclose(rows[:, k], (ahead - behind) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_places_and_headings_are_reached_from_afar_and_restored_from_near_by(seed):
    rng = np.random.default_rng(seed)
    swarm = Swarm(1.0, 1.0, 0.1, binary(6))
    groups = np.tile(rng.permutation(swarm.m), 15)
    slides, t = swarm.slides[groups], rng.uniform(0.2, 1.5, len(groups))
    starts = np.column_stack([rng.uniform(-5, 5, (6, 2)), rng.uniform(-3, 3, 6)])
    aims = trajectory(slides, swarm.turning_length, starts, t)[-1, :, :2] + rng.normal(0, 1.0, (6, 2))
    headings = np.array([*rng.uniform(-np.pi, np.pi, 3), NAN, NAN, NAN])
    motion = slides, swarm.turning_length, starts, aims, headings
    for _ in range(200):
        t, error = step_to_goals(*motion, t, 1e-9)
        assert np.all(t > 0)
        if error < 1e-9:
            break
    assert np.abs(goal_misses(*motion, t)).max() <= 1e-9
    near = slides, swarm.turning_length, starts, aims + 0.01, headings + 0.01
    restored, there = restore_goals(*near, t, 1e-9)
    assert there and np.all(restored > 0) and np.abs(goal_misses(*near, restored)).max() <= 1e-9


# What can be asked for


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=60)
def test_headings_are_refused_exactly_where_the_rank_forbids_them(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 15))
    swarm = Swarm(1.0, 1.0, 0.0, binary(n))
    robots = rng.choice(n, int(rng.integers(1, n + 1)), replace=False)
    found = dependent(swarm, sorted(robots.tolist()))
    assert (found is None) == can_orient(swarm, robots + 1)
    if found is not None:
        row, others = found
        assert can_orient(swarm, [other + 1 for other in others])
        assert not can_orient(swarm, [row + 1, *(other + 1 for other in others)])
        for other in others:  # none of them could be left out
            assert can_orient(swarm, [row + 1, *(one + 1 for one in others if one != other)])


def test_the_refusal_names_the_robots():
    with pytest.raises(StressbotError) as caught:
        headed([0.0] * 6)
    error = caught.value
    assert (error.code, error.field) == (ErrorCode.INFEASIBLE, "robots[4].goal")
    assert "follows from the ones of robots" in error.message and "4 groups" in error.message
    shared = Swarm(1.0, [1.0, 2.0], 0.1, ("1", "1"))
    with pytest.raises(StressbotError, match="follows from the one of robot 1: "):
        Problem(shared, Environment(), [[0, 0, 0], [3, 0, 0]], [[5, 0], [8, 0]], goal_headings=[0.0, 0.0])


def test_a_robot_that_may_take_any_goal_has_no_heading():
    with pytest.raises(StressbotError, match="may take another goal") as caught:
        replace(headed([1.0, *[NAN] * 5]), exchangeable=(0, 1))
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "robots[0].goal")


@pytest.mark.parametrize(("value", "code"), [(np.inf, ErrorCode.NOT_FINITE), (1e10, ErrorCode.OUT_OF_RANGE)])
def test_a_heading_is_a_number(value, code):
    with pytest.raises(StressbotError) as caught:
        headed([NAN, value, *[NAN] * 4])
    assert (caught.value.code, caught.value.field) == (code, "robots[1].goal")


# Plans


@pytest.mark.parametrize(
    ("planner", "tolerance"), [("optimize", 1e-6), ("pure_control", 1e-6), ("sequential", 1.5), ("parallel", 1.5)]
)
@pytest.mark.parametrize("seed", range(3))
def test_planners_meet_three_headings_beside_the_places(planner, tolerance, seed):
    wanted = np.random.default_rng(seed).uniform(-9, 9, 3)
    problem = headed([wanted[0], NAN, wanted[1], NAN, NAN, wanted[2]], tolerance=tolerance)
    result = solve(problem, planner, Settings(seed=seed, max_tries=400, first=True, time_limit=100))
    assert result.success, result.reason
    end = result.plan.poses[-1]
    assert np.hypot(*(end[:, :2] - problem.goals).T).max() <= tolerance + problem.slack
    assert np.abs(wrapped(end[[0, 2, 5], 2] - wanted)).max() <= 1e-7
    assert result.plan.valid and result.plan.clearance.gap >= 0


def test_robots_that_are_at_their_goals_already_turn_there():
    problem = scenario.parse(instances.paper(True)).problem
    starts = np.column_stack([problem.goals, np.zeros(6)])
    result = solve(headed([NAN, 2.0, NAN, -1.0, NAN, NAN], starts), "optimize", Settings(max_tries=10, first=True))
    assert result.success and result.plan.path_length > 0
    assert np.abs(wrapped(result.plan.poses[-1, [1, 3], 2] - [2.0, -1.0])).max() <= 1e-7


@pytest.mark.parametrize("planner", ["rrt", "optimize_paper"])
def test_planners_that_leave_headings_free_say_who_does_not(planner):
    with pytest.raises(StressbotError, match="use 'optimize', 'pure_control'") as caught:
        solve(headed([NAN, 1.0, *[NAN] * 4], tolerance=1.5), planner, Settings(max_tries=1))
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "robots[1].goal")


@pytest.mark.parametrize("seed", range(3))
def test_headings_survive_whole_pulses(seed):
    problem = headed([1.0, NAN, -2.0, 3.0, NAN, NAN])
    plan = solve(problem, "optimize", Settings(seed=seed, max_tries=6, first=True)).plan
    pulsed = in_whole_pulses(plan, STEP)
    assert pulsed.valid
    assert pulsed.heading_error <= 5 * STEP and pulsed.problem.heading_tolerance == pytest.approx(1e-6 + 5 * STEP)


def test_rot_turns_robots_of_one_turning_radius_in_a_mixed_swarm():
    swarm = Swarm(1.0, [1.0, 0.7, 1.0, 0.7], 0.3, ("01", "01", "10", "11"))
    starts = np.column_stack([np.zeros(4), 3.0 * np.arange(4), np.zeros(4)])
    goals = np.column_stack([np.full(4, 7.0), 3.0 * np.array([2, 0, 3, 1])])
    for rows in ([0, 2], [1, 3]):
        headings = np.full(4, NAN)
        headings[rows] = 1.0, -2.0
        problem = Problem(swarm, Environment(), starts, goals, goal_headings=headings)
        result = solve(problem, "pure_control", Settings(max_tries=50))
        assert result.success and result.plan.heading_error < 1e-7, result.reason
    with pytest.raises(StressbotError, match="robot 4 another turning radius ÷ speed than robot 1") as caught:
        mixed = Problem(swarm, Environment(), starts, goals, goal_headings=[0.0, NAN, NAN, 1.0])
        solve(mixed, "pure_control", Settings(max_tries=50))
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "robots[3].goal")
    assert solve(mixed, "optimize", Settings(max_tries=20, first=True)).success


# Files


def test_a_scenario_and_a_plan_file_keep_headings(tmp_path):
    text = instances.paper(True).replace("goal: [14.0, 18.0]", "goal: [14.0, 18.0, 1.5]")
    assert "1.5]" in text
    loaded = scenario.parse(text)
    row = loaded.problem.headed.tolist()
    assert len(row) == 1 and loaded.problem.goal_headings[row[0]] == 1.5
    np.testing.assert_array_equal(loaded.problem.goals, scenario.parse(instances.paper(True)).problem.goals)
    result = solve(loaded.problem, "pure_control", Settings(max_tries=20))
    path = tmp_path / "plan.json"
    path.write_text(plan_text(plan_file(result, loaded.name, 0.1)))
    assert read_plan_file(path, loaded.problem, loaded.name).plan.valid
    free = read_plan_file(path, scenario.parse(instances.paper(True)).problem, loaded.name).plan
    assert free.valid and free.heading_error == 0.0
