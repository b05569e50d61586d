"""Interchangeable robots: the assignment is legal, whatever the problem, and better than what knows no coupling."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings
from stressbot_planner.planners.assignment import assigned, solve
from stressbot_planner.problem.definition import Problem

PLANE = Environment()


def random_problem(seed: int, n: int, exchangeable=None, environment=PLANE, side: float = 40.0, slowest=1.0) -> Problem:
    rng = np.random.default_rng(seed)

    def scattered():
        cells = rng.permutation(int(side // 2) ** 2)[:n]
        return 2.0 * np.column_stack(np.divmod(cells, int(side // 2))) + rng.uniform(0.5, 1.5, (n, 2))

    starts = np.column_stack([scattered(), rng.uniform(-np.pi, np.pi, n)])
    free = tuple(range(n)) if exchangeable is None else exchangeable
    goals = scattered()
    pace = rng.uniform(slowest, 1.0, n)
    swarm = Swarm(1.0, 1.0, 0.2, binary(n), pace / pace.max())
    return Problem(swarm, environment, starts, goals, exchangeable=free)


def bound(problem: Problem, objective: str) -> float:
    return problem.lower_bounds.path_length if objective == "path" else problem.lower_bounds.execution_time


def with_goals(problem: Problem, order) -> Problem:
    return replace(problem, goals=problem.goals[list(order)])


def least_sum_of_distances(problem: Problem) -> Problem:
    distance = np.hypot(*(problem.starts[:, None, :2] - problem.goals).T).T
    return with_goals(problem, linear_sum_assignment(distance)[1])


@given(
    seed=st.integers(0, 10**6), n=st.integers(1, 12), objective=st.sampled_from(planners.OBJECTIVES),
    fixed=st.sets(st.integers(0, 11)), slowest=st.sampled_from([0.3, 1.0]),
)
@settings(deadline=None, max_examples=60)
def test_goals_are_exchanged_among_those_that_may_and_the_bound_never_rises(seed, n, objective, fixed, slowest):
    problem = random_problem(seed, n, tuple(k for k in range(n) if k not in fixed), slowest=slowest)
    result = assigned(problem, objective)
    kept = [k for k in range(n) if k in fixed]
    np.testing.assert_array_equal(result.goals[kept], problem.goals[kept])
    assert sorted(result.goals.tolist()) == sorted(problem.goals.tolist())
    assert result.exchangeable == problem.exchangeable
    assert bound(result, objective) <= bound(problem, objective) * (1 + 1e-9)


@pytest.mark.parametrize("objective", planners.OBJECTIVES)
@pytest.mark.parametrize("slowest", [0.3, 1.0])
@pytest.mark.parametrize("seed", range(6))
def test_five_robots_get_the_best_of_all_assignments(seed, objective, slowest):
    problem = random_problem(seed, 5, slowest=slowest)
    best = min(bound(with_goals(problem, order), objective) for order in permutations(range(5)))
    assert bound(assigned(problem, objective), objective) == pytest.approx(best, rel=1e-6)


def test_knowing_the_coupling_is_far_better_than_the_least_sum_of_distances():
    ratios = []
    for seed in range(5):
        problem = random_problem(seed, 30)
        ours, plain = (bound(p, "time") for p in (assigned(problem, "time"), least_sum_of_distances(problem)))
        assert ours <= plain * (1 + 1e-9)
        ratios.append(ours / plain)
    assert np.mean(ratios) < 0.75


def test_the_order_in_which_goals_are_listed_makes_no_difference():
    problem = random_problem(3, 8)
    again = with_goals(problem, np.random.default_rng(0).permutation(8))
    np.testing.assert_array_equal(assigned(problem, "path").goals, assigned(again, "path").goals)


def test_a_slow_robot_goes_nearby_however_short_the_sum_of_distances_would_be():
    swarm = Swarm(1.0, 1.0, 0.2, ("01", "10"), [0.1, 1.0])
    problem = Problem(swarm, PLANE, [[0, 0, 0], [0, 5, 0]], [[6, 0], [0, 3]], exchangeable=(0, 1))
    assert assigned(problem, "time").goals.tolist() == [[0, 3], [6, 0]]
    alike = replace(problem, swarm=replace(swarm, pace=1.0))
    assert assigned(alike, "path").goals.tolist() == [[6, 0], [0, 3]]


def test_paths_around_obstacles_count_not_straight_distances():
    wall = Polygon([[4.9, -20], [5.1, -20], [5.1, 20], [4.9, 20]])
    problem = Problem(
        Swarm(1.0, 1.0, 0.2, ("01", "10")), Environment(None, (wall,)), [[4, 0, 0], [0, 20.5, 0]], [[6, 0], [-1, 0]],
        exchangeable=(0, 1),
    )
    assert assigned(problem, "path").goals.tolist() == [[-1, 0], [6, 0]]
    assert assigned(replace(problem, environment=PLANE), "path").goals.tolist() == [[6, 0], [-1, 0]]


def test_a_goal_that_only_one_robot_can_reach_goes_to_that_robot():
    wall = Polygon([[4.9, -1], [5.1, -1], [5.1, 11], [4.9, 11]])
    rooms = Environment(Workspace(0, 10, 0, 10), (wall,))
    problem = Problem(
        Swarm(1.0, 1.0, 0.2, ("01", "10")), rooms, [[4, 5, 0], [9, 5, 0]], [[6, 5], [1, 5]], exchangeable=(0, 1)
    )
    assert assigned(problem, "time").goals.tolist() == [[1, 5], [6, 5]]
    # both goals in one room: somebody cannot get there, which is the planner's to say
    assert assigned(replace(problem, goals=[[6, 5], [8, 5]]), "time").goals.shape == (2, 2)


@given(seed=st.integers(0, 10**6), radii=st.lists(st.floats(0.05, 0.9), min_size=2, max_size=7))
@settings(deadline=None, max_examples=60)
def test_no_goal_gets_a_body_that_has_no_room_there(seed, radii):
    rng = np.random.default_rng(seed)
    n, at, gap = len(radii), 0.0, rng.uniform(0, 0.5, len(radii))
    goals = []
    for k, radius in enumerate(radii):
        at += radius + gap[k]
        goals.append([at, 6.0])
        at += radius
    corridor = Environment(Workspace(0, at + 1, 0, 7), (Circle((at / 2, 8.0), 1.0 + rng.uniform(0, 0.05)),))
    starts = [[1 + 2 * k, 2.0, 0.0] for k in range(n)]
    swarm = Swarm(1.0, 1.0, np.array(radii), binary(n))
    environment = replace(corridor, workspace=Workspace(-1, max(at, 2 * n) + 2, 0, 7))
    problem = Problem(swarm, environment, starts, goals, exchangeable=tuple(range(n)))
    result = assigned(problem, "path")  # a problem refuses bodies that overlap
    assert sorted(result.goals.tolist()) == sorted(problem.goals.tolist())


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_the_unit_of_length_makes_no_difference(factor):
    problem = random_problem(5, 6)
    scaled = Problem(
        Swarm(1.0, factor, 0.2 * factor, binary(6)), PLANE, problem.starts * (factor, factor, 1), problem.goals * factor,
        1e-6 * factor, problem.exchangeable,
    )
    np.testing.assert_allclose(assigned(scaled, "path").goals, assigned(problem, "path").goals * factor)


def test_solve_plans_to_the_assigned_goals():
    problem = random_problem(1, 4)
    result = solve(problem, "pure_control", Settings(max_tries=100))
    assert result.success, result.reason
    np.testing.assert_array_equal(result.plan.problem.goals, assigned(problem, "path").goals)


def test_the_time_of_assigning_counts():
    now = [0.0]

    def slow(problem):
        now[0] += 3.0
        return problem

    result = planners.solve(random_problem(1, 4), "optimize", Settings(max_tries=3, first=True, clock=lambda: now[0]), slow)
    assert result.planning_time == 3.0
    assert [seconds for seconds, _, _ in result.history] == [3.0]


def test_solve_leaves_fixed_goals_alone():
    problem = random_problem(1, 4, exchangeable=())
    result = solve(problem, "pure_control", Settings(max_tries=100))
    assert result.code == ErrorCode.NONE
    assert result.plan.problem is problem
