"""The paper's own numerical optimisation."""

import numpy as np
import pytest

from stressbot_planner import scenario
from stressbot_planner.errors import ErrorCode
from stressbot_planner.kinematics import execution_time, path_length, replay
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.optimize_paper import CONTROL_STEPS, shortest_lengths
from stressbot_planner.reproduce import instances

PAPER = scenario.parse(instances.paper(discs=False)).problem


def draws(count: int, objective="path"):
    """Yield groups and lengths of first draws, None where the solver ends elsewhere."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        groups = rng.integers(1, 5, CONTROL_STEPS)
        yield groups, shortest_lengths(PAPER, groups, objective, rng.uniform(0, 2 * np.pi, CONTROL_STEPS))


def test_most_draws_of_35_groups_reach_the_goals_of_the_paper_with_paths_like_its_own():
    solved = [(groups, lengths) for groups, lengths in draws(20) if lengths is not None]
    assert 12 <= len(solved) < 20  # K = 35 is at the edge
    for groups, lengths in solved:
        assert np.all(lengths >= 0)
        assert PAPER.goal_error(replay(PAPER.swarm, PAPER.starts, groups, lengths)[-1, :, :2]) <= 1e-6
    paths = [path_length(PAPER.swarm, *activations) for activations in solved]
    assert min(paths) >= PAPER.lower_bounds.path_length
    assert np.median(paths) == pytest.approx(181.04, rel=0.15)


def test_the_objective_is_path_or_time():
    both = [
        (path_length(PAPER.swarm, groups, one), path_length(PAPER.swarm, groups, two),
         execution_time(PAPER.swarm, one), execution_time(PAPER.swarm, two))
        for (groups, one), (_, two) in zip(draws(12), draws(12, "time"), strict=True) if one is not None and two is not None
    ]
    path, longer_path, longer_time, time = np.median(both, axis=0)
    assert path < longer_path and time < longer_time


@pytest.mark.parametrize("seed", range(4))
def test_groups_are_drawn_until_a_plan_is_exact_and_free_of_collisions(seed):
    result = solve(PAPER, "optimize_paper", Settings(time_limit=30.0, seed=seed))
    assert result.success, result.reason
    assert result.plan.goal_error <= 1e-6 and result.plan.clearance.gap >= 0
    assert len(result.plan.groups) <= CONTROL_STEPS
    assert 1 <= result.details["exact_draws"] <= result.details["draws"]


@pytest.mark.parametrize(("text", "exact"), [(instances.paper(discs=True), True), (instances.random(20, False, 0), False)])
def test_where_no_draw_will_do_it_says_what_was_tried(text, exact):
    # discs are not looked at while optimising; 40 goal coordinates are too many for 35 lengths
    result = solve(scenario.parse(text).problem, "optimize_paper", Settings(time_limit=0.5))
    assert not result.success and result.code == ErrorCode.NO_PLAN_FOUND
    assert f"draws of {CONTROL_STEPS} groups" in result.reason
    assert ("bodies overlapping" in result.reason) == (result.plan is not None) == exact


def test_nothing_to_do_is_an_empty_plan():
    problem = scenario.parse(instances.paper(discs=False), tolerance=50.0).problem
    assert solve(problem, "optimize_paper", Settings()).plan.groups.size == 0
