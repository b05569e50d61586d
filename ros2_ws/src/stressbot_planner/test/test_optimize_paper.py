"""The paper's own numerical optimisation."""

import numpy as np
import pytest

from stressbot_planner.errors import ErrorCode
from stressbot_planner.formats import scenario
from stressbot_planner.model.environment import Environment, Workspace
from stressbot_planner.model.kinematics import execution_time, path_length, replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.optimization.optimize_paper import CONTROL_STEPS, shortest_lengths
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances

PAPER = scenario.parse(instances.paper(discs=False)).problem


COUNT = 40


def draws(objective="path"):
    """Yield groups and lengths of first draws, None where the solver ends elsewhere."""
    for seed in range(COUNT):
        rng = np.random.default_rng(seed)
        groups = rng.integers(1, 5, CONTROL_STEPS)
        yield groups, shortest_lengths(PAPER, groups, objective, rng.uniform(0, 2 * np.pi, CONTROL_STEPS))


@pytest.fixture(scope="module")
def short():
    return list(draws())


def test_most_draws_of_35_groups_reach_the_goals_of_the_paper_with_paths_like_its_own(short):
    solved = [(groups, lengths) for groups, lengths in short if lengths is not None]
    assert 0.5 * COUNT <= len(solved) < 0.95 * COUNT  # K = 35 is at the edge
    for groups, lengths in solved:
        assert np.all(lengths >= 0)
        assert PAPER.goal_error(replay(PAPER.swarm, PAPER.starts, groups, lengths)[-1, :, :2]) <= 1e-6
    paths = [path_length(PAPER.swarm, *activations) for activations in solved]
    assert min(paths) >= PAPER.lower_bounds.path_length
    assert np.median(paths) == pytest.approx(181.04, rel=0.2)


def test_the_objective_is_path_or_time(short):
    both = [
        (path_length(PAPER.swarm, groups, one), path_length(PAPER.swarm, groups, two),
         execution_time(PAPER.swarm, one), execution_time(PAPER.swarm, two))
        for (groups, one), (_, two) in zip(short, draws("time"), strict=True) if one is not None and two is not None
    ]
    path, longer_path, longer_time, time = np.median(both, axis=0)
    assert path < longer_path and time < longer_time


@pytest.mark.parametrize("seed", range(4))
def test_groups_are_drawn_until_a_plan_is_exact_and_free_of_collisions(seed):
    result = solve(PAPER, "optimize_paper", Settings(max_tries=3000, seed=seed))
    assert result.success, result.reason
    assert result.plan.goal_error <= 1e-6 and result.plan.clearance.gap >= 0
    assert len(result.plan.groups) <= CONTROL_STEPS
    assert 1 <= result.details["exact_draws"] <= result.details["draws"]


CORRIDOR = Environment(Workspace(0, 4, 0, 0.7))
TWO = Problem(Swarm(1.0, 1.0, 0.3, ("01", "10")), CORRIDOR, [[1, 0.35, 0], [3, 0.35, 0]], [[3, 0.35], [1, 0.35]])
TWENTY = scenario.parse(instances.random(20, False, 0)).problem


@pytest.mark.parametrize(("problem", "exact"), [(TWO, True), (TWENTY, False)], ids=["corridor", "twenty"])
def test_where_no_draw_will_do_it_says_what_was_tried(problem, exact):
    # walls and other robots are not looked at while optimising; 40 goal coordinates are too many for 35 lengths
    result = solve(problem, "optimize_paper", Settings(max_tries=6))
    assert not result.success and result.code == ErrorCode.NO_PLAN_FOUND
    assert f"of 6 draws of {CONTROL_STEPS} groups" in result.reason
    assert ("bodies overlapping" in result.reason) == (result.plan is not None) == exact


def test_nothing_to_do_is_an_empty_plan():
    problem = scenario.parse(instances.paper(discs=False), tolerance=50.0).problem
    assert solve(problem, "optimize_paper", Settings()).plan.groups.size == 0
