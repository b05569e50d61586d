"""What the default planner takes besides starts and goals, and how it improves."""

from dataclasses import replace

import numpy as np
import pytest

from stressbot_planner import scenario
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.kinematics import replay
from stressbot_planner.planners import Settings, solve
from stressbot_planner.reproduce import instances

OPEN, DISCS = (scenario.parse(instances.paper(discs)).problem for discs in (False, True))


def solved(problem, **settings):
    result = solve(problem, "optimize", Settings(**{"time_limit": 20.0, **settings}))
    assert result.success, result.reason
    return result


def test_the_first_plan_ends_the_search():
    result = solved(DISCS, first=True)
    assert len(result.history) == 1


@pytest.mark.parametrize("seed", range(3))
def test_the_first_plan_among_seven_discs_for_fourteen_robots(seed):
    solved(scenario.parse(instances.random(14, True, seed)).problem, first=True, seed=seed)


@pytest.mark.parametrize(("n", "limit"), [(30, 120.0), (62, 200.0)])
def test_many_robots_among_obstacles_have_a_short_first_plan(n, limit):
    problem = scenario.parse(instances.random(n, True, 3)).problem
    result = solved(problem, first=True, time_limit=limit)
    assert result.plan.path_length < 5 * problem.lower_bounds.path_length


def test_more_than_a_hundred_robots_are_planned_for_in_the_open_plane():
    problem = scenario.parse(instances.random(126, False, 0)).problem
    slender = replace(problem, swarm=replace(problem.swarm, body_radius=np.full(126, 1e-3)))
    result = solved(slender, first=True, objective="time")
    assert result.plan.goal_error < 1e-6
    assert result.plan.execution_time < 2.5 * slender.lower_bounds.execution_time


def test_few_robots_of_many_groups_are_optimised_as_any():
    alone = tuple("".join("1" if i == j else "0" for i in range(6)) for j in range(6))
    problem = replace(DISCS, swarm=replace(DISCS.swarm, codewords=alone))
    result = solved(problem, time_limit=3.0)
    assert result.details["valid_starts"] > 0
    assert result.plan.path_length < 1.2 * problem.lower_bounds.path_length


def test_short_activations_are_strewn_into_the_rest_of_a_plan_that_has_too_few():
    plan = solved(OPEN, first=True, seed=1).plan
    poses = replay(OPEN.swarm, OPEN.starts, plan.groups[:-6], plan.lengths[:-6])[-1] + np.array([0.02, -0.02, 0.02])
    again = solved(replace(OPEN, starts=poses), first=True, warm_start=(plan.groups[-6:], plan.lengths[-6:]))
    assert again.plan.path_length < 0.5 * plan.path_length


def test_a_weight_trades_path_for_time():
    path, both, time = (solved(OPEN, objective=objective, seed=2).plan for objective in ("path", "0.5", "time"))
    assert path.path_length < both.path_length * 1.001
    assert time.execution_time < both.execution_time * 1.02
    assert both.execution_time < path.execution_time


def test_a_goal_ball_is_made_use_of():
    problem = replace(OPEN, tolerance=1.5)
    result = solved(problem)
    assert 1e-3 < result.plan.goal_error <= 1.5
    assert result.plan.path_length < OPEN.lower_bounds.path_length


def test_all_bodies_keep_the_clearance_asked_for():
    assert solved(DISCS, min_clearance=0.2, first=True).plan.clearance.gap > 0.2


def test_a_clearance_that_the_starts_do_not_leave_is_refused():
    with pytest.raises(StressbotError, match="start leaves only") as caught:
        solve(OPEN, "optimize", Settings(min_clearance=3.0))
    assert caught.value.field == "min_clearance"


def test_a_plan_has_no_more_activations_than_allowed():
    assert len(solved(OPEN, max_epochs=30).plan.groups) <= 30


def test_too_few_activations_are_an_honest_failure():
    result = solve(OPEN, "optimize", Settings(max_epochs=8, time_limit=1.0))
    assert not result.success
    assert "max_epochs" in result.reason


def test_the_selection_of_groups_counts_as_time():
    cheap, dear = (solved(OPEN, objective="time", selection_time=seconds, seed=1).plan for seconds in (0.0, 3.0))
    assert len(dear.groups) < len(cheap.groups)


@pytest.mark.parametrize("seed", range(3))
def test_what_remains_of_a_plan_is_mended_from_where_the_robots_are(seed):
    rng = np.random.default_rng(seed)
    plan = solved(DISCS, first=True, seed=seed).plan
    done = len(plan.groups) // 4
    poses = replay(DISCS.swarm, DISCS.starts, plan.groups[:done], plan.lengths[:done])[-1]
    poses = poses + rng.normal(0, [0.05, 0.05, 0.03], poses.shape)
    rest = replace(DISCS, starts=poses)
    again = solved(rest, first=True, warm_start=(plan.groups[done:], plan.lengths[done:]))
    assert again.details["tries"] == 0
    assert len(again.plan.groups) <= len(plan.groups) - done


def test_two_processes_give_one_plan_with_the_history_of_both():
    result = solved(DISCS, jobs=2, time_limit=3.0)
    assert result.details["jobs"] == 2
    values = [entry[1] for entry in result.history]
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(result.plan.path_length)


@pytest.mark.parametrize(
    ("name", "value"),
    [("objective", "1.2"), ("objective", "nan"), ("min_clearance", -1.0), ("selection_time", np.nan), ("max_epochs", 0),
     ("jobs", 0)],
)
def test_settings_that_will_not_do_are_named(name, value):
    with pytest.raises(StressbotError) as caught:
        Settings(**{name: value})
    assert caught.value.field == name
    assert caught.value.code in (ErrorCode.OUT_OF_RANGE, ErrorCode.UNKNOWN_OBJECTIVE)
