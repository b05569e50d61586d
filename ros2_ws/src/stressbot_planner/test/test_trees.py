"""The tree planners of the paper."""

import numpy as np
import pytest

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.trees.tree import Tree
from stressbot_planner.primitives.subgroups import largest_order
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances

TREES = ("rrt", "rrt_rotation", "parallel", "sequential")
GOAL_ORDER = (11.6, 18.0, 5.2, 2.0, 8.4, 14.8)


def paper_problem(tolerance: float, discs: bool, radii=1.0) -> Problem:
    environment = Environment(Workspace(0, 20, 0, 20), (Circle((8, 6), 1.5), Circle((8, 14), 1.5))) if discs else Environment()
    starts = np.column_stack([np.full(6, 2.0), np.linspace(2, 18, 6), np.zeros(6)])
    goals = np.column_stack([np.full(6, 14.0), GOAL_ORDER])
    return Problem(Swarm(1.0, radii, 0.3, binary(6)), environment, starts, goals, tolerance)


def solved(problem: Problem, planner: str, **settings):
    """Return the first result of some seeds: a tree may be unlucky, `rrt` among discs with two seeds of three."""
    for seed in range(30):
        result = solve(problem, planner, Settings(seed=seed, max_tries=4000, **settings))
        assert result.plan.clearance.gap >= 0
        if result.success:
            assert result.plan.goal_error <= problem.tolerance
            return result
        assert "4000 tries" in result.reason
    pytest.fail("no seed finds a plan")


@pytest.mark.parametrize(("tolerance", "discs"), [(2.0, False), (1.5, True)])
@pytest.mark.parametrize("planner", TREES)
def test_trees_solve_the_paper_problems(planner, tolerance, discs):
    assert solved(paper_problem(tolerance, discs), planner).details["nodes"] > 0


@pytest.mark.parametrize("planner", TREES)
def test_exact_goals_are_refused_with_advice(planner):
    with pytest.raises(StressbotError, match="optimize") as caught:
        solve(paper_problem(1e-6, False), planner, Settings())
    assert caught.value.code == ErrorCode.UNSUPPORTED
    assert caught.value.field == "tolerance"


def test_rrt_takes_different_turning_radii():
    solved(paper_problem(2.0, False, radii=[0.7, 0.8, 0.9, 1.0, 1.1, 1.2]), "rrt")


@pytest.mark.parametrize("planner", ["parallel", "sequential", "rrt_rotation"])
@pytest.mark.parametrize("order", [2, 3])
def test_motion_planning_problem_of_every_order(planner, order):
    solved(paper_problem(2.0, False), planner, order=order)


@pytest.mark.parametrize("planner", ["parallel", "sequential"])
@pytest.mark.parametrize("n", [6, 14])
def test_a_lower_order_costs_neither_more_nodes_nor_a_longer_path(planner, n):
    """The paper: cost grows exponentially as the order falls. Medians over seeds of M(n, k_max - 1) and M(n, k_max)."""
    text = instances.paper(discs=True) if n == 6 else instances.random(n, False, 0)
    loaded = scenario.parse(text, tolerance=1.5)
    highest = largest_order(loaded.swarm)

    def cost(order):
        found = [solve(loaded.problem, planner, Settings(order=order, max_tries=4000, seed=seed)) for seed in range(7)]
        assert sum(result.success for result in found) >= 5
        figures = [(result.details["nodes"], result.plan.path_length) for result in found if result.success]
        return np.median(figures, axis=0)

    lower, higher = cost(highest - 1), cost(highest)
    assert lower[0] < 3 * higher[0]
    assert lower[1] < higher[1]


@pytest.mark.parametrize("planner", ["parallel", "sequential", "rrt_rotation"])
def test_an_order_beyond_the_largest_is_refused(planner):
    with pytest.raises(StressbotError, match="order") as caught:
        solve(paper_problem(2.0, False), planner, Settings(order=9))
    assert caught.value.code == ErrorCode.OUT_OF_RANGE


@pytest.mark.parametrize("planner", TREES)
def test_an_unreachable_goal_ends_at_either_limit_with_the_closest_plan(planner):
    """The gaps of the cage are 0.05 narrower than a body: too little for the proof on a grid."""
    ring = np.arange(0, 2 * np.pi, 0.4)
    cage = tuple(Circle((14 + 3 * np.cos(angle), 8.4 + 3 * np.sin(angle)), 0.32) for angle in ring)
    problem = paper_problem(0.5, False)
    goals = np.column_stack([np.full(6, 18.5), GOAL_ORDER])
    goals[4] = (14, 8.4)
    caged = Problem(problem.swarm, Environment(None, cage), problem.starts, goals, 0.5)
    for limits, text in (({"time_limit": 0.5}, "within 0.5 s"), ({"max_tries": 40}, "within 40 tries")):
        result = solve(caged, planner, Settings(**limits))
        assert not result.success
        assert result.code == ErrorCode.NO_PLAN_FOUND
        assert text in result.reason
        assert result.plan is not None
        assert result.plan.clearance.gap >= 0


@pytest.mark.parametrize("planner", TREES)
def test_trees_repeat_themselves_for_the_same_seed(planner):
    plans = [solve(paper_problem(2.0, False), planner, Settings(seed=5, max_tries=500)).plan for _ in range(2)]
    assert plans[0].primitives == plans[1].primitives


def test_nearest_neighbours_are_those_of_a_full_search():
    rng = np.random.default_rng(0)
    tree = Tree(rng.normal(size=(2, 3)), lambda poses: poses[:, :2].ravel())
    for _ in range(500):
        sample = rng.normal(size=(2, 3))
        features = np.array([poses[:, :2].ravel() for poses in tree.poses])
        assert tree.nearest(sample) == int(np.argmin(np.linalg.norm(features - sample[:, :2].ravel(), axis=1)))
        tree.add(int(rng.integers(len(tree))), (), rng.normal(size=(2, 3)))
