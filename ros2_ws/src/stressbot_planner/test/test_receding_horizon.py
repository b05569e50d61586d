"""The receding horizon for crowds: its parts, and the plans of whole searches."""

from dataclasses import replace

import numpy as np
import pytest
from fields import FIELD, field
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners.optimization.receding_horizon.aims import ShortestPaths, spread, urgency_of
from stressbot_planner.planners.optimization.receding_horizon.ending import find_end, shorten, usual_cost
from stressbot_planner.planners.optimization.receding_horizon.guesses import careful, clearest, random_guess
from stressbot_planner.planners.optimization.receding_horizon.horizon import RecedingHorizon
from stressbot_planner.planners.optimization.receding_horizon.prefixes import Ground
from stressbot_planner.planners.optimization.receding_horizon.schedule import Schedule
from stressbot_planner.planners.optimization.receding_horizon.window import look_ahead, walk
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances


def ground_of(problem, least_gap=0.0):
    body = float(problem.swarm.body_radius.min())
    return Ground(problem, Shapes.of(problem.environment), least_gap + body / 3, least_gap, np.ones(problem.swarm.m))


def never():
    return False


places = st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=12).map(np.array)


@settings(max_examples=50, deadline=None)
@given(places, st.floats(0.0, 1.0))
def test_in_the_open_plane_aims_lie_on_the_straight_way_or_are_pushed_apart(points, share):
    goals = np.zeros_like(points)
    goals[:, 0] = 10.0 * np.arange(len(points))
    body = np.full(len(points), 0.3)
    aims = ShortestPaths(None, body, points, goals).aims(points, share)
    straight = points + share * (goals - points)
    apart = np.hypot(*(straight[:, None] - straight[None]).transpose(2, 0, 1))
    alone = np.all(apart + 1e9 * np.eye(len(points)) > 2.0, axis=1)
    assert np.all(np.isfinite(aims))
    if alone.all():
        assert np.allclose(aims, straight)


@settings(max_examples=50, deadline=None)
@given(places, st.floats(0.1, 3.0))
def test_spread_points_are_apart_and_those_that_were_stay(points, distance):
    moved = spread(points, distance)
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) + 1e9 * np.eye(len(points))
    if apart.min() >= distance:
        assert np.array_equal(moved, points)
    assert np.all(np.isfinite(moved))


@given(st.lists(st.floats(0.0, 100.0), min_size=2, max_size=20), st.integers(0, 100))
def test_urgency_has_mean_square_one_and_grows_with_the_way(ways, seed):
    available = np.full(len(ways), 50.0)
    urgency = urgency_of(np.array(ways), available)
    assert np.mean(urgency**2) == pytest.approx(1.0)
    order = np.argsort(ways)
    assert np.all(np.diff(urgency[order]) >= 0)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_aims_among_obstacles_are_nearer_to_the_goals_by_about_the_share(share):
    problem = field()
    ground = ground_of(problem)
    here = ground.root.poses[:, :2]
    aims = ground.paths.aims(here, share)
    left = ground.paths.left(aims)
    # walls make ways dearer, and aims are pushed apart
    assert np.all(np.abs(left - (1 - share) * ground.root.ways) < 0.25 * ground.root.ways.max())


def test_a_goal_too_close_to_a_disc_for_the_inflated_body_has_a_way():
    # 0.1 from the disc, from which paths of others keep 0.35
    problem = scenario.parse(FIELD.replace("goal: [10, 10]", "goal: [7.4, 6]")).problem
    paths = ground_of(problem).paths
    straight = np.hypot(*(paths.goals - ground_of(problem).root.poses[:, :2]).T)
    assert np.all(paths.left(paths.goals) < 0.6)
    assert np.all(ground_of(problem).root.ways < 2 * straight + 2)


def test_shares_of_the_bound_and_prefixes_add_up():
    problem = field()
    ground = ground_of(problem)
    rng = np.random.default_rng(0)
    node = ground.root
    for _ in range(3):
        groups, t = random_guess(ground, rng, 7, np.ones(problem.swarm.m), 0.2)
        node = ground.after(node, groups, t, 5, 0)
    groups, t = node.activations()
    assert len(groups) == 15 and node.done == pytest.approx(t.sum())
    there = replay(problem.swarm, problem.starts, groups, t * ground.crowd.unit)[-1]
    assert np.allclose(node.poses[:, :2] * ground.crowd.unit, there[:, :2])
    assert np.allclose(np.exp(1j * node.poses[:, 2]), np.exp(1j * there[:, 2]))
    assert [before.parent for before in node.trail()[1:]] == node.trail()[:-1]


@pytest.mark.parametrize("seed", range(10))
def test_the_clearest_of_guesses_touches_nothing_for_longest(seed):
    ground, rng = ground_of(field()), np.random.default_rng(seed)
    guesses = [careful(ground, rng, random_guess(ground, rng, 60, np.ones(ground.crowd.m), 0.4), 1.0) for _ in range(8)]
    chosen = clearest(ground, ground.root, iter(guesses), 60)
    assert ground.clear_until(ground.root, *chosen) == max(ground.clear_until(ground.root, *guess) for guess in guesses)


@pytest.mark.parametrize("least_gap", [0.0, 0.1])
def test_what_is_kept_of_windows_touches_nothing(least_gap):
    problem = scenario.parse(instances.random(24, True, 1)).problem
    ground, kept = ground_of(problem, least_gap), 0
    shapes = Shapes.of(problem.environment)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        node = look_ahead(ground, ground.root, Schedule.of(24), rng, 0, never)
        if node is None:
            continue
        walked = walk(ground, node, 1)
        for prefix in (node, walked) if walked else (node,):
            groups, t = prefix.activations()
            lengths = t * ground.crowd.unit
            poses = replay(problem.swarm, problem.starts, groups, lengths)
            assert clearance_of(problem.swarm, shapes, poses, groups, lengths).gap > least_gap
        assert node.rest < ground.root.rest
        kept += 1
    assert kept >= 3


def test_ends_are_exact_and_clear_and_get_shorter():
    problem = field()
    ground, found = ground_of(problem), 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        end = find_end(ground, ground.root, rng, 2 * usual_cost(ground, ground.root), never)
        if end is None:
            continue
        shorter = shorten(ground, end, never)
        assert shorter.done <= end.done
        for plan in (end, shorter):
            groups, t = plan.activations()
            made = Plan(problem, as_primitives(groups, t * ground.crowd.unit))
            assert made.valid and made.goal_error < 1e-6
        found += 1
    assert found >= 3


def test_a_varied_schedule_is_one_near_by():
    schedule, rng = Schedule.of(30), np.random.default_rng(0)
    others = [schedule.varied(rng) for _ in range(30)]
    assert len({other.pace for other in others}) > 1
    assert all(0.5 < other.turning / schedule.turning < 2 and other.activations == schedule.activations for other in others)


def search(problem, seed, attempts):
    """Return the plans that so many attempts find, and how often the search looked whether it is over."""
    looks = 0

    def over():
        nonlocal looks
        looks += 1
        return looks > 20_000

    shapes, body = Shapes.of(problem.environment), float(problem.swarm.body_radius.min())
    horizon = RecedingHorizon(problem, shapes, body / 3, 0.0, np.ones(problem.swarm.m), np.random.default_rng(seed), over)
    return [found for found in (horizon.attempt() for _ in range(attempts)) if found]


def test_every_plan_is_valid_and_each_is_shorter_than_those_before():
    solved = 0
    for seed in range(3):
        problem = scenario.parse(instances.random(30, True, 200 + seed)).problem
        times = []
        for groups, lengths in search(problem, seed, 3):
            plan = Plan(problem, as_primitives(groups, lengths))
            assert plan.valid and plan.goal_error < 1e-6
            times.append(plan.execution_time)
        assert times == sorted(times, reverse=True)
        solved += bool(times)
    assert solved >= 2


def test_robots_of_different_speeds_and_radii_are_planned_for():
    found = [plan for seed in range(4) for plan in search(field(), seed, 2)]
    assert found
    for groups, lengths in found:
        assert Plan(field(), as_primitives(groups, lengths)).valid


def test_the_same_seed_finds_the_same_plan():
    problem = scenario.parse(instances.random(24, True, 5)).problem
    first, second = (search(problem, 3, 2) for _ in range(2))
    assert len(first) == len(second)
    for (groups, lengths), (other_groups, other_lengths) in zip(first, second, strict=True):
        assert np.array_equal(groups, other_groups) and np.array_equal(lengths, other_lengths)


def test_a_scaled_problem_has_a_scaled_plan():
    problem = scenario.parse(instances.random(24, False, 7)).problem
    swarm = problem.swarm
    larger = replace(
        problem,
        swarm=replace(swarm, turning_radius=64 * swarm.turning_radius, body_radius=64 * swarm.body_radius),
        starts=problem.starts * [64, 64, 1],
        goals=64 * problem.goals,
        tolerance=64 * problem.tolerance,
    )
    for (groups, lengths), (other_groups, other_lengths) in zip(search(problem, 1, 1), search(larger, 1, 1), strict=True):
        assert np.array_equal(groups, other_groups)
        assert np.allclose(64 * lengths, other_lengths)
