"""Planning for robots of different turning radii that share codewords (paper, section 4, and its remark on sets of equal radii)."""

import numpy as np
import pytest

from stressbot_planner.model.allocation import by_radius
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.problem.definition import Problem


def problem_of(radii, seed=0, tolerance=1e-6) -> Problem:
    """Robots in a column, each to a place of its own some way off, with random headings."""
    rng = np.random.default_rng(seed)
    n = len(radii)
    starts = np.column_stack([np.zeros(n), 3.0 * np.arange(n), rng.uniform(-np.pi, np.pi, n)])
    goals = np.column_stack([np.full(n, 7.0), 3.0 * rng.permutation(n)])
    return Problem(Swarm(1.0, radii, 0.3, by_radius(radii)), Environment(), starts, goals, tolerance)


def assert_solved(problem: Problem, planner: str):
    """By one of some seeds: tries may be unlucky."""
    for seed in range(10):
        result = solve(problem, planner, Settings(seed=seed, max_tries=2000, first=True))
        if result.success:
            break
    assert result.success, result.reason
    assert result.plan.goal_error <= problem.tolerance and result.plan.clearance.gap >= 0


@pytest.mark.parametrize("planner", ["optimize", "optimize_paper"])
@pytest.mark.parametrize("radii", [(1.0, 0.7), (1.0, 0.8, 0.6)])
def test_two_groups_bring_robots_of_different_radii_to_exact_goals(radii, planner):
    problem = problem_of(radii)
    assert problem.swarm.m == 2
    assert_solved(problem, planner)


@pytest.mark.parametrize("ratio", [3, 5])
@pytest.mark.parametrize("planner", ["optimize", "optimize_paper"])
def test_two_groups_suffice_at_odd_ratios_of_radii_too(ratio, planner):
    # where the three steps of the paper's proof send both robots back
    assert_solved(problem_of((1.0, 1.0 / ratio)), planner)


@pytest.mark.parametrize("n", [2, 4, 6])
def test_the_original_tree_finds_a_way_with_two_groups(n):
    assert_solved(problem_of(np.linspace(1.0, 0.5, n).tolist(), tolerance=1.5), "rrt")


def test_sets_of_equal_radii_take_as_many_groups_as_the_largest_needs():
    problem = problem_of((1.0, 1.0, 0.6, 0.6, 0.6))
    assert (problem.swarm.m, problem.swarm.codewords) == (3, ("01", "10", "01", "10", "11"))
    assert_solved(problem, "optimize")


@pytest.mark.parametrize("planner", ["pure_control", "sequential", "parallel", "rrt_rotation"])
@pytest.mark.parametrize("radii", [(1.0, 0.7), (1.0, 1.0, 0.6, 0.6, 0.6)])
def test_planners_that_move_subgroups_take_sets_of_equal_radii(planner, radii):
    assert_solved(problem_of(radii, tolerance=1.5), planner)
