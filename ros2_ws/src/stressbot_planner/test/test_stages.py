"""Goals in stages: all robots at their waypoints at a time, then at the next, in one plan."""

from dataclasses import replace

import numpy as np
import pytest

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file, plan_text, read_plan_file
from stressbot_planner.model.angles import wrapped
from stressbot_planner.planners import Settings, assignment, solve
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.bounds import lower_bounds
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances

STEP = 1.2e-4
PAPER = instances.paper(True)


def paper(stages: int = 1, **changes) -> Problem:
    """Return the paper's six robots among two discs, which go to their goals by way of other robots' goals."""
    problem = scenario.parse(PAPER).problem
    waypoints = [np.roll(problem.goals, stage + 1, axis=0) for stage in range(stages)]
    return replace(problem, waypoints=waypoints, **changes)


@pytest.mark.parametrize(
    ("planner", "tolerance"), [("optimize", 1e-6), ("pure_control", 1e-6), ("sequential", 1.5), ("rrt", 3.0)]
)
@pytest.mark.parametrize("pulse_length", [None, STEP])
def test_all_robots_are_at_their_waypoints_at_a_time_and_then_at_their_goals(planner, tolerance, pulse_length):
    problem = paper(2, tolerance=tolerance)
    result = solve(
        problem, planner, Settings(seed=1, max_tries=20_000, first=True, time_limit=200, pulse_length=pulse_length)
    )
    assert result.success, result.reason
    plan, leeway = result.plan, 5 * (pulse_length or 0.0)
    assert plan.valid and plan.clearance.gap >= 0
    passed = 0
    for waypoints, arrival in zip(problem.waypoints, plan.arrivals, strict=True):
        errors = np.hypot(*(plan.poses[arrival.activations, :, :2] - waypoints).T)
        assert arrival.is_there and arrival.error == errors.max() <= tolerance + leeway + problem.slack
        assert arrival.activations >= passed
        passed = arrival.activations
        assert arrival.time == pytest.approx(plan.lengths[:passed].sum() / problem.swarm.speed)
    assert plan.goal_error <= tolerance + leeway + problem.slack
    bounds = problem.lower_bounds
    assert plan.path_length >= bounds.path_length - 1e-9 and plan.execution_time >= bounds.execution_time - 1e-9


def test_a_stage_is_the_plan_from_where_the_one_before_ends():
    problem, settings = paper(), Settings(seed=3, max_tries=2)
    first = solve(replace(problem, goals=problem.waypoints[0], waypoints=()), "optimize", settings).plan
    starts = first.poses[-1].copy()
    starts[:, 2] = wrapped(starts[:, 2])
    second = solve(replace(problem, starts=starts, waypoints=()), "optimize", settings).plan
    whole = solve(problem, "optimize", settings).plan
    assert whole.primitives == (*first.primitives, *second.primitives)
    np.testing.assert_array_equal(whole.poses[len(first.groups)], first.poses[-1])
    assert whole.arrivals[0].activations <= len(first.groups)  # less a turn of all at the end
    assert whole.path_length == pytest.approx(first.path_length + second.path_length)


def test_bounds_of_stages_add_up():
    problem = paper()
    first = lower_bounds(problem.swarm, problem.starts, problem.waypoints[0], problem.tolerance)
    second = lower_bounds(problem.swarm, problem.waypoints[0], problem.goals, 2 * problem.tolerance)
    assert problem.lower_bounds.path_length == pytest.approx(first.path_length + second.path_length)
    assert problem.lower_bounds.execution_time == pytest.approx(first.execution_time + second.execution_time)
    assert replace(problem, waypoints=()).lower_bounds == scenario.parse(PAPER).problem.lower_bounds


def test_the_checker_refuses_a_plan_that_misses_a_waypoint_or_takes_them_in_another_order():
    problem = paper(2)
    plan = solve(problem, "pure_control", Settings(max_tries=50)).plan
    assert plan.valid
    other = Plan(replace(problem, waypoints=problem.waypoints[::-1]), plan.primitives)
    assert not other.valid and not all(one.is_there for one in other.arrivals)
    assert "waypoint 2 missed by" in other.account
    shifted = Plan(replace(problem, waypoints=problem.waypoints + [0.01, 0.0]), plan.primitives)
    assert not shifted.valid
    assert [round(one.error, 6) for one in shifted.arrivals] == [0.01, 0.01]


def test_robots_pass_a_waypoint_at_the_end_of_an_activation_only():
    problem = paper()
    plan = solve(problem, "pure_control", Settings(max_tries=50)).plan
    end = plan.arrivals[0].activations
    sliding = next(k for k in range(end - 1, -1, -1) if plan.problem.swarm.membership[plan.groups[k] - 1].any())
    lengths = plan.lengths.copy()
    lengths[sliding] += 0.1
    assert not Plan(problem, as_primitives(plan.groups, lengths)).arrivals[0].is_there


def test_exchangeable_robots_take_goals_in_the_last_stage():
    problem = paper(exchangeable=(0, 1, 2, 3, 4, 5))
    result = assignment.solve(problem, "pure_control", Settings(max_tries=50))
    assert result.success, result.reason
    assert sorted(result.plan.problem.goals.tolist()) == sorted(problem.goals.tolist())
    assert result.plan.valid and result.plan.arrivals[0].is_there


def test_headings_are_those_at_the_last_goals():
    problem = paper(goal_headings=[1.0, *[np.nan] * 5])
    plan = solve(problem, "pure_control", Settings(max_tries=50)).plan
    assert plan.valid and plan.heading_error < 1e-7


def test_failures_name_the_stage_and_epochs_are_shared():
    result = solve(paper(), "optimize", Settings(max_tries=1, max_epochs=1))
    assert not result.success and result.reason.startswith("stage 1 of 2: ") and result.code == ErrorCode.NO_PLAN_FOUND
    most = 200
    result = solve(paper(), "optimize", Settings(max_tries=4, max_epochs=most))
    assert result.success and len(result.plan.groups) <= most


def test_refusals_name_the_stage_whose_goals_are_waypoints():
    problem = paper(2)
    waypoints = problem.waypoints.copy()
    waypoints[1, 1] = waypoints[1, 0] + [0.0, 2 * problem.swarm.body_radius[0] + 0.01]
    with pytest.raises(StressbotError, match=r"a goal leaves only 0\.01.*\(in stage 2 of 3, whose goals are waypoints\)") as caught:
        solve(replace(problem, waypoints=waypoints), "optimize", Settings(max_tries=20, first=True, min_clearance=0.1))
    assert (caught.value.code, caught.value.field) == (ErrorCode.OUT_OF_RANGE, "min_clearance")


@pytest.mark.parametrize("planner", ["rrt", "optimize_paper"])
def test_a_planner_that_leaves_headings_free_says_so_before_its_first_try(planner):
    told = []
    problem = paper(2, goal_headings=[1.0, *[np.nan] * 5], tolerance=1.5)
    with pytest.raises(StressbotError, match="leaves headings free") as caught:
        solve(problem, planner, Settings(max_tries=10, on_progress=told.append))
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "robots[0].goal") and not told


def test_progress_counts_the_tries_of_all_stages_and_has_a_plan_in_the_last():
    told = []
    result = solve(paper(), "optimize", Settings(max_tries=3, on_progress=told.append))
    tries = [news.tries for news in told]
    assert tries == sorted(tries) and tries[-1] > 3
    assert told[-1].path_length == pytest.approx(result.plan.path_length)
    assert np.isinf(told[0].path_length)


@pytest.mark.parametrize(
    ("place", "code"),
    [([8.0, 6.0], ErrorCode.INSIDE_OBSTACLE), ([-5.0, 1.0], ErrorCode.OUTSIDE_WORKSPACE)],
)
def test_waypoints_are_places_where_robots_can_be(place, code):
    problem = scenario.parse(PAPER).problem
    waypoints = problem.goals.copy()
    waypoints[0] = place
    with pytest.raises(StressbotError) as caught:
        replace(problem, waypoints=[waypoints])
    assert (caught.value.code, caught.value.field) == (code, "robots[0].waypoints[0]")


def test_two_waypoints_of_a_stage_keep_apart_and_all_robots_have_one():
    problem = scenario.parse(PAPER).problem
    waypoints = problem.goals.copy()
    waypoints[3] = waypoints[1] + 0.1
    with pytest.raises(StressbotError) as caught:
        replace(problem, waypoints=[problem.goals, waypoints])
    assert (caught.value.code, caught.value.field) == (ErrorCode.GOALS_TOO_CLOSE, "robots[3].waypoints[1]")
    with pytest.raises(StressbotError) as caught:
        replace(problem, waypoints=[problem.goals[:4]])
    assert caught.value.code == ErrorCode.WRONG_COUNT


# Files

STAGED = """
name: staged
swarm: {speed: 1.0, turning_radius: 1.0, body_radius: 0.3, groups: ["01", "10"]}
robots:
  - {start: [0, 0, 0], goal: [9, 9], waypoints: [[3, 0], [4, 5]]}
  - {start: [0, 5, 0], goal: [1, 8]}
"""


def test_a_robot_without_waypoints_is_at_its_start_in_the_stages_before_the_last():
    problem = scenario.parse(STAGED).problem
    np.testing.assert_array_equal(problem.waypoints, [[[3, 0], [0, 5]], [[4, 5], [0, 5]]])
    with pytest.raises(StressbotError) as caught:
        scenario.parse(STAGED.replace("goal: [1, 8]", "goal: [1, 8], waypoints: [[0, 6]]"))
    assert (caught.value.code, caught.value.field) == (ErrorCode.WRONG_COUNT, "robots[1].waypoints")


def test_a_plan_file_tells_of_each_stage(tmp_path):
    loaded = scenario.parse(STAGED)
    result = solve(loaded.problem, "optimize", Settings(max_tries=20, first=True))
    assert result.success, result.reason
    data = plan_file(result, loaded.name, 0.1)
    assert [entry["activations"] for entry in data["waypoints"]] == [one.activations for one in result.plan.arrivals]
    path = tmp_path / "plan.json"
    path.write_text(plan_text(data))
    read = read_plan_file(path, loaded.problem, loaded.name).plan
    assert read.valid and read.arrivals == result.plan.arrivals
