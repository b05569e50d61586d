"""Parked robots stay where they start, and are obstacles for the others; refused where groups do not allow it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file, plan_text, read_plan_file
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.moving import Moving
from stressbot_planner.primitives.expansion import Activate
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.parking import check_parked, groups_left, words_left
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances

STEP = 1.2e-4


def with_complements(words) -> list[str]:
    """Each group once more, inverted."""
    return [word + word.translate({48: "1", 49: "0"}) for word in words]


def paper(*parked: int) -> Problem:
    """Return the paper's six robots among two discs, in seven groups, some of them parked (rows)."""
    problem = scenario.parse(instances.paper(True)).problem
    swarm = problem.swarm
    goals = problem.goals.copy()
    goals[list(parked)] = problem.starts[list(parked), :2]
    swarm = Swarm(swarm.speed, swarm.turning_radius, swarm.body_radius, tuple(with_complements(swarm.codewords)))
    return replace(problem, swarm=swarm, goals=goals, parked=parked)


# Which groups are left


@given(st.integers(2, 40), st.data())
@settings(deadline=None, max_examples=40)
def test_any_one_robot_can_be_parked_where_each_group_has_its_complement(n, data):
    swarm = Swarm(1.0, 1.0, 0.0, tuple(with_complements(binary(n))))
    row = data.draw(st.integers(0, n - 1))
    check_parked(swarm, (row,))
    assert len(groups_left(swarm, (row,))) == len(binary(n)[0]) + 1


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=60)
def test_what_is_left_moves_no_parked_robot_and_is_refused_exactly_where_it_does_not_tell_the_others_apart(seed):
    rng = np.random.default_rng(seed)
    n, bits = int(rng.integers(2, 9)), int(rng.integers(4, 9))
    words = tuple(format(code, f"0{bits}b") for code in rng.choice(2**bits - 1, n, replace=False) + 1)
    swarm = Swarm(1.0, 1.0, 0.0, words)
    parked = tuple(sorted(rng.choice(n, int(rng.integers(1, n)), replace=False).tolist()))
    groups = groups_left(swarm, parked)
    assert groups[-1] == swarm.m and not swarm.membership[groups - 1][:, list(parked)].any()
    left = list(words_left(swarm, parked).values())
    possible = all("1" in word for word in left) and len(set(left)) == len(left)
    if possible:
        check_parked(swarm, parked)
    else:
        with pytest.raises(StressbotError) as caught:
            check_parked(swarm, parked)
        assert (caught.value.code, caught.value.field) == (ErrorCode.INFEASIBLE, f"robots[{parked[0]}].goal")


def test_the_fewest_groups_let_nobody_be_parked():
    problem = scenario.parse(instances.paper(True)).problem
    for row in range(6):
        goals = problem.goals.copy()
        goals[row] = problem.starts[row, :2]
        with pytest.raises(StressbotError, match=f"leaves? out robot {row + 1}") as caught:
            replace(problem, goals=goals, parked=(row,))
        assert caught.value.code == ErrorCode.INFEASIBLE


def test_refusals_name_the_robot():
    with pytest.raises(StressbotError, match="all others"):
        check_parked(Swarm(1.0, 1.0, 0.0, ("01", "10")), (0, 1))
    with pytest.raises(StressbotError, match="robot 2 is in no group that leaves out robot 1"):
        check_parked(Swarm(1.0, 1.0, 0.0, ("11", "10")), (0,))
    with pytest.raises(StressbotError, match="is not where robot 1 starts") as caught:
        replace(paper(), parked=(0,))
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "robots[0].goal")


# Plans


@pytest.mark.parametrize(
    ("planner", "tolerance"),
    [("optimize", 1e-6), ("pure_control", 1e-6), ("sequential", 1.5), ("parallel", 1.5), ("rrt_rotation", 3.0)],
)
@pytest.mark.parametrize("seed", range(2))
def test_planners_go_around_the_parked(planner, tolerance, seed):
    row = (2 * seed + 1) % 6
    problem = replace(paper(row), tolerance=tolerance)
    result = solve(problem, planner, Settings(seed=seed, max_tries=3000, first=True, time_limit=100, pulse_length=STEP))
    assert result.success, result.reason
    plan = result.plan
    assert plan.valid and plan.clearance.gap >= 0 and plan.problem.swarm.n == 6
    np.testing.assert_array_equal(plan.poses[:, row, :2], np.broadcast_to(problem.starts[row, :2], (len(plan.poses), 2)))
    assert np.hypot(*(plan.poses[-1, :, :2] - problem.goals).T).max() <= tolerance + 5 * STEP + problem.slack


def test_the_checker_refuses_a_plan_that_moves_a_parked_robot():
    problem = Problem(
        Swarm(1.0, 1.0, 0.1, ("0110", "1001")), Environment(), [[0, 0, 0], [5, 0, 0]], [[0, 0], [7, 0]], parked=(0,)
    )
    assert Plan(problem, (Activate(1, 2.0),)).valid
    circled = (Activate(2, 1e-9), Activate(1, 2.0))  # within all tolerances, but driven
    assert not Plan(problem, circled).valid
    assert Plan(problem, circled).straying == [1] and "robot 1 is parked and slides" in Plan(problem, circled).account


@pytest.mark.parametrize("seed", range(5))
def test_lengths_are_those_of_the_whole_where_the_fastest_is_parked(seed):
    rng = np.random.default_rng(seed)
    swarm = Swarm(2.0, [1.0, 0.7, 1.3], 0.1, tuple(with_complements(binary(3))), [0.4, 1.0, 0.8])
    starts = np.column_stack([8.0 * np.arange(3), np.zeros(3), rng.uniform(-3, 3, 3)])
    goals = starts[:, :2] + rng.uniform(-2, 2, (3, 2))
    goals[1] = starts[1, :2]
    problem = Problem(swarm, Environment(), starts, goals, parked=(1,))
    assert Moving(problem).stretch == pytest.approx(1.25)
    result = solve(problem, "optimize", Settings(seed=seed, max_tries=20, first=True, pulse_length=STEP))
    assert result.success and result.plan.valid, result.reason
    counts = result.plan.lengths / STEP
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


@pytest.mark.parametrize("radius", [0.0, 1e-3, 1.0])
def test_bodies_may_touch_who_is_parked_point_or_not_at_start_and_goal(radius):
    swarm = Swarm(1.0, 1.0, [0.3, radius, 0.2], tuple(with_complements(binary(3))))
    starts = [[-0.3 - radius, 0, 0], [0, 0, 0], [0, 3, 0]]
    problem = Problem(swarm, Environment(), starts, [[-2, 2], [0, 0], [0, 0.2 + radius]], parked=(1,))
    result = solve(problem, "optimize", Settings(max_tries=20, first=True))
    assert result.success and result.plan.valid, result.reason


@pytest.mark.parametrize("row", range(6))
def test_bounds_know_which_groups_are_left(row):
    problem = paper(row)
    free = replace(problem, parked=())
    moving = Moving(problem).problem.lower_bounds
    assert problem.lower_bounds == pytest.approx(moving) and moving.execution_time >= free.lower_bounds.execution_time


def test_reasons_and_refusals_name_robots_as_the_whole_does():
    moving = Moving(paper(1))
    known = len(moving.whole.environment.obstacles)
    assert moving.in_words("not at their goals: robots 1, 2, 5") == "not at their goals: robots 1, 3, 6"
    assert moving.in_words(f"between robot 4 and obstacles[{known}], not obstacles[0]") == (
        "between robot 5 and parked robot 2, not obstacles[0]"
    )
    assert moving.in_words("walls and obstacles leave no way") == "walls, obstacles and parked robots leave no way"
    headed = replace(paper(1), tolerance=3.0, goal_headings=[np.nan, np.nan, 1.0, np.nan, np.nan, np.nan])
    with pytest.raises(StressbotError) as caught:
        solve(headed, "rrt", Settings(max_tries=1))
    assert caught.value.field == "robots[2].goal"


# Files


def test_a_scenario_and_a_plan_file_keep_the_parked(tmp_path):
    text = instances.paper(True).replace("goal: [14.0, 18.0]", "goal: parked")
    text = text.replace("groups: binary", "groups: " + str(with_complements(binary(6))).replace("'", '"'))
    loaded = scenario.parse(text)
    (row,) = loaded.problem.parked
    np.testing.assert_array_equal(loaded.problem.goals[row], loaded.problem.starts[row, :2])
    result = solve(loaded.problem, "pure_control", Settings(max_tries=50))
    assert result.success, result.reason
    path = tmp_path / "plan.json"
    path.write_text(plan_text(plan_file(result, loaded.name, 0.1)))
    assert read_plan_file(path, loaded.problem, loaded.name).plan.valid
