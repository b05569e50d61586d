"""What the default planner takes besides starts and goals, and how it improves."""

import re
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners import LONGEST, Settings, solve
from stressbot_planner.planners.optimization.search import Search
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.reproduce import instances

OPEN, DISCS = (scenario.parse(instances.paper(discs)).problem for discs in (False, True))


def solved(problem, max_tries=40, **settings):
    """Return the result of so many tries, which takes as long as it takes."""
    result = solve(problem, "optimize", Settings(max_tries=max_tries, **settings))
    assert result.success, result.reason
    assert result.plan.goal_error <= problem.tolerance and result.plan.clearance.gap >= 0
    return result


def test_the_first_plan_ends_the_search():
    result = solved(DISCS, first=True)
    assert len(result.history) == 1


@pytest.mark.parametrize("seed", range(5))
def test_the_first_plan_among_seven_discs_for_fourteen_robots(seed):
    solved(scenario.parse(instances.random(14, True, seed)).problem, first=True, seed=seed)


def test_many_robots_among_obstacles_have_a_first_plan_short_for_most():
    """Where everything else fails `pure_control` has one, hundreds of times as long."""
    ratios = []
    for seed in range(4):
        problem = scenario.parse(instances.random(30, True, seed)).problem
        ratios.append(solved(problem, first=True).plan.path_length / problem.lower_bounds.path_length)
    assert np.median(ratios) < 5


@pytest.mark.timeout(1200)
def test_more_robots_than_random_orders_are_tried_for_have_a_first_plan_among_obstacles():
    solved(scenario.parse(instances.random(62, True, 3)).problem, max_tries=8, first=True)


def test_more_than_a_hundred_robots_are_planned_for_in_the_open_plane():
    ratios = []
    for seed in range(3):
        problem = scenario.parse(instances.random(126, False, seed)).problem
        slender = replace(problem, swarm=replace(problem.swarm, body_radius=np.full(126, 1e-3)))
        result = solved(slender, first=True, objective="time", seed=seed)
        ratios.append(result.plan.execution_time / slender.lower_bounds.execution_time)
    assert np.median(ratios) < 3


def test_few_robots_of_many_groups_are_optimised_as_any():
    alone = tuple("".join("1" if i == j else "0" for i in range(6)) for j in range(6))
    problem = replace(DISCS, swarm=replace(DISCS.swarm, codewords=alone))
    found = [solved(problem, 10, seed=seed) for seed in range(3)]
    assert sum(result.details["valid_starts"] for result in found) > 3
    assert min(result.plan.path_length for result in found) < 1.2 * problem.lower_bounds.path_length


def test_short_activations_are_strewn_into_the_rest_of_a_plan_that_has_too_few():
    shares = []
    for seed in range(8):
        plan = solved(OPEN, first=True, seed=seed).plan
        poses = replay(OPEN.swarm, OPEN.starts, plan.groups[:-6], plan.lengths[:-6])[-1] + np.array([0.02, -0.02, 0.02])
        rest = plan.groups[-6:], plan.lengths[-6:]
        again = solved(replace(OPEN, starts=poses), first=True, seed=seed, warm_start=rest)
        shares.append(again.plan.path_length / plan.path_length)
    assert np.median(shares) < 0.5


def test_a_weight_trades_path_for_time():
    def figures(objective):
        plans = [solved(OPEN, 10, objective=objective, seed=seed).plan for seed in range(5)]
        return np.mean([(plan.path_length, plan.execution_time) for plan in plans], axis=0)

    (path, slow), (both, medium), (longer, time) = map(figures, ("path", "0.5", "time"))
    assert path < 1.01 * both and both < longer
    assert time < 1.1 * medium and medium < slow


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
    result = solve(OPEN, "optimize", Settings(max_epochs=8, max_tries=6))
    assert not result.success
    assert "max_epochs" in result.reason


def test_the_selection_of_groups_counts_as_time():
    """Of two plans the one with more activations is better as long as nobody counts them."""
    quick, simple = (np.tile([1, 2, 3], 20), np.full(60, 1.0)), (np.tile([1, 2, 3], 5), np.full(15, 5.0))
    for selection_time, better in ((0.0, quick), (5.0, simple)):
        for offered in ((quick, simple), (simple, quick)):
            settings = Settings(objective="time", selection_time=selection_time)
            search = Search(OPEN, settings, np.random.default_rng(0))
            for motion in offered:
                search.offer(as_primitives(*motion), *motion)
            assert search.outcome().primitives == as_primitives(*better)


def strayed(problem, plan, done, rng):
    """Return the problem from near where the first activations of a plan lead, and what remains of the plan."""
    poses = replay(problem.swarm, problem.starts, plan.groups[:done], plan.lengths[:done])[-1]
    while True:
        with suppress(StressbotError):  # two bodies, or a body and a wall, would overlap
            rest = replace(problem, starts=poses + rng.normal(0, [0.05, 0.05, 0.03], poses.shape))
            return rest, (plan.groups[done:], plan.lengths[done:])


def test_what_remains_of_a_plan_is_mended_from_where_the_robots_are():
    mended, seeds = 0, 20
    for seed in range(seeds):
        plan = solved(DISCS, first=True, seed=seed).plan
        done = len(plan.groups) // 4
        problem, rest = strayed(DISCS, plan, done, np.random.default_rng(seed))
        again = solved(problem, first=True, warm_start=rest)
        mended += again.details["tries"] == 0 and len(again.plan.groups) <= len(plan.groups) - done
    assert mended >= 0.75 * seeds


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


def test_activations_that_are_too_few_for_any_plan_end_the_search_long_before_its_time():
    result = solve(OPEN, "optimize", Settings(max_epochs=1, time_limit=LONGEST))  # which is eleven days
    assert result.code == ErrorCode.NO_PLAN_FOUND
    assert re.fullmatch(r"max_epochs is 1, but the shortest plan found has \d+ activations: allow more", result.reason)
