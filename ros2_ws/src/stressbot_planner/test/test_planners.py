"""Every planner returns checked plans, or says why not."""

import itertools

import numpy as np
import pytest

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Outcome, Settings, names, solve
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Failed

GOAL_ORDER = (11.6, 18.0, 5.2, 2.0, 8.4, 14.8)
TWO_DISCS = Environment(Workspace(0, 20, 0, 20), (Circle((8, 6), 1.5), Circle((8, 14), 1.5)))
OPEN_PLANE = Environment()


def paper_problem(environment=OPEN_PLANE, shift=0.0, **swarm) -> Problem:
    """The six robots of the paper, moved along x."""
    heights = np.linspace(2, 18, 6)
    return Problem(
        Swarm(1.0, swarm.get("turning_radius", 1.0), 0.3, binary(6)),
        environment,
        starts=np.column_stack([np.full(6, shift), heights, np.zeros(6)]),
        goals=np.column_stack([np.full(6, 12 + shift), GOAL_ORDER]),
    )


def random_problem(n: int, seed: int) -> Problem:
    """An open plane at the density of the paper, random headings."""
    rng = np.random.default_rng(seed)
    side = 20 * np.sqrt(n / 6)

    def places():
        found = []
        while len(found) < n:
            place = rng.uniform(0, side, 2)
            if all(np.hypot(*(place - other)) > 2 for other in found):
                found.append(place)
        return np.array(found)

    starts = np.column_stack([places(), rng.uniform(-np.pi, np.pi, n)])
    return Problem(Swarm(1.0, 1.0, 0.3, binary(n)), Environment(), starts, places())


def assert_valid(result, problem):
    assert result.success, result.reason
    assert result.code == ErrorCode.NONE
    assert result.plan.goal_error <= problem.tolerance
    assert result.plan.clearance.gap >= 0
    assert np.all(result.plan.lengths >= 0)
    bounds = problem.lower_bounds
    assert result.plan.path_length >= bounds.path_length * (1 - 1e-9)
    assert result.plan.execution_time >= bounds.execution_time * (1 - 1e-9)


def test_entry_points_list_the_planners():
    assert {"optimize", "pure_control"} <= set(names())


def test_unknown_planner_lists_the_known_ones():
    with pytest.raises(StressbotError, match="optimize.*pure_control") as caught:
        solve(paper_problem(), "magic", Settings())
    assert caught.value.code == ErrorCode.UNKNOWN_PLANNER


@pytest.mark.parametrize(
    ("settings", "code"),
    [({"objective": "beauty"}, ErrorCode.UNKNOWN_OBJECTIVE), ({"time_limit": 0.0}, ErrorCode.OUT_OF_RANGE),
     ({"time_limit": -1.0}, ErrorCode.OUT_OF_RANGE), ({"time_limit": np.nan}, ErrorCode.NOT_FINITE)],
)
def test_settings_are_checked(settings, code):
    with pytest.raises(StressbotError) as caught:
        Settings(**settings)
    assert caught.value.code == code


def test_optimize_solves_the_paper_problem_near_the_bound_for_20_seeds():
    problem = paper_problem()
    for seed in range(20):
        result = solve(problem, "optimize", Settings(seed=seed, max_tries=8))
        assert_valid(result, problem)
        assert result.plan.path_length <= 1.05 * problem.lower_bounds.path_length


def test_optimize_goes_around_obstacles_for_either_objective():
    problem = paper_problem(TWO_DISCS, shift=2.0)
    by_path = solve(problem, "optimize", Settings("path", max_tries=20))
    by_time = solve(problem, "optimize", Settings("time", max_tries=20))
    assert_valid(by_path, problem)
    assert_valid(by_time, problem)
    assert by_path.plan.path_length < by_time.plan.path_length
    assert by_time.plan.execution_time < by_path.plan.execution_time


def test_optimize_history_improves_and_ends_with_the_plan():
    result = solve(paper_problem(), "optimize", Settings("time", max_tries=10))
    seconds, _, times = zip(*result.history, strict=True)
    assert list(seconds) == sorted(seconds)
    assert all(a > b for a, b in itertools.pairwise(times))
    assert times[-1] == pytest.approx(result.plan.execution_time)


def test_optimize_repeats_itself_for_the_same_seed():
    plans = [solve(paper_problem(), "optimize", Settings(seed=3, max_tries=6)).plan for _ in range(2)]
    np.testing.assert_array_equal(plans[0].groups, plans[1].groups)
    np.testing.assert_array_equal(plans[0].lengths, plans[1].lengths)


def test_optimize_takes_different_turning_radii():
    problem = paper_problem(turning_radius=[0.7, 0.8, 0.9, 1.0, 1.1, 1.2])
    assert_valid(solve(problem, "optimize", Settings(max_tries=10)), problem)


@pytest.mark.parametrize("n", [1, 2, 3, 14])
def test_optimize_for_other_swarm_sizes(n):
    problem = random_problem(n, seed=n)
    assert_valid(solve(problem, "optimize", Settings(max_tries=10)), problem)


def test_optimize_does_not_depend_on_the_unit_of_length():
    def scaled(factor):
        small = paper_problem(TWO_DISCS, shift=2.0)
        environment = Environment(
            Workspace(0, 20 * factor, 0, 20 * factor),
            tuple(Circle(c.center * factor, c.radius * factor) for c in TWO_DISCS.obstacles),
        )
        starts = small.starts * (factor, factor, 1)
        return Problem(Swarm(1.0, factor, 0.3 * factor, binary(6)), environment, starts, small.goals * factor, 1e-6 * factor)

    def length(factor):
        # lengths round otherwise, and searches part from there
        found = [solve(scaled(factor), "optimize", Settings(seed=seed, max_tries=10)) for seed in range(4)]
        return np.median([result.plan.path_length for result in found]) / factor

    assert length(1000.0) == pytest.approx(length(1.0), rel=0.05)


@pytest.mark.parametrize("planner", ["optimize", "pure_control"])
def test_nothing_to_do_is_an_empty_plan(planner):
    problem = paper_problem()
    there = Problem(problem.swarm, problem.environment, problem.starts, problem.starts[:, :2])
    result = solve(there, planner, Settings())
    assert_valid(result, there)
    assert result.plan.groups.size == 0


@pytest.mark.parametrize("planner", ["optimize", "pure_control"])
def test_a_walled_in_goal_is_proved_to_be_out_of_reach(planner):
    walls = [(4, 4), (6, 4), (6, 6), (4, 6)]
    cage = tuple(
        Polygon([a, b, (b[0] * 1.2 - 1, b[1] * 1.2 - 1), (a[0] * 1.2 - 1, a[1] * 1.2 - 1)])
        for a, b in zip(walls, walls[1:] + walls[:1], strict=True)
    )
    problem = Problem(Swarm(1.0, 1.0, 0.3, ("1",)), Environment(None, cage), [[0, 0, 0]], [[5, 5]])
    clock = itertools.count().__next__
    result = solve(problem, planner, Settings(clock=clock))
    assert not result.success
    assert result.code == ErrorCode.INFEASIBLE
    assert "robot 1" in result.reason
    assert clock() == 2  # no planner was asked, which would look at the clock


def test_a_planner_that_says_nothing_has_failed(monkeypatch):
    monkeypatch.setattr(planners, "get", lambda name: lambda problem, settings, rng: Outcome(None))
    monkeypatch.setattr(planners, "prepare", lambda name: None)
    result = solve(paper_problem(), "silent", Settings())
    assert isinstance(result, Failed) and result.plan is None
    assert result.code == ErrorCode.NO_PLAN_FOUND and "neither a plan nor a reason" in result.reason


@pytest.mark.parametrize("n", [6, 14, 30])
def test_pure_control_brings_every_robot_to_its_goal(n):
    problem = random_problem(n, seed=1)
    assert_valid(solve(problem, "pure_control", Settings(max_tries=100)), problem)


def test_pure_control_goes_around_discs_and_polygons():
    environment = Environment(Workspace(0, 20, 0, 20), (Circle((8, 6), 1.5), Polygon([(7, 12), (9, 12), (8, 16)])))
    problem = paper_problem(environment, shift=2.0)
    assert_valid(solve(problem, "pure_control", Settings(max_tries=100)), problem)


def test_pure_control_takes_different_turning_radii():
    problem = paper_problem(turning_radius=[0.7, 0.8, 0.9, 1.0, 1.1, 1.2])
    assert_valid(solve(problem, "pure_control", Settings(max_tries=100)), problem)


def test_every_planner_takes_robots_of_different_speeds():
    swarm = Swarm(1.0, [1.0, 1.2], 0.3, ("01", "10"), pace=[1.0, 0.7])
    problem = Problem(swarm, OPEN_PLANE, [[0, 0, 0], [0, 5, 0]], [[4, 2], [3, 6]], tolerance=0.5)
    for name in names():
        found = [solve(problem, name, Settings(max_tries=500, seed=seed)) for seed in range(3)]
        assert_valid(next((result for result in found if result.success), found[0]), problem)
