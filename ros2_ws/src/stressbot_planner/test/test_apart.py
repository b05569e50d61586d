"""Goals at which bodies touch: plans of whole pulses aim a little beside them, and end there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, gap_at_rest
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.model.whole_pulses import ASIDE, LEEWAY, contact_depth
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.apart import NEARBY, aims_apart
from stressbot_planner.problem.definition import Problem

STEP, BODY = 1.2e-4, 0.3
DISC, BLOCK = Circle((5.0, 5.0), 0.8), Polygon([[7.0, 1.0], [9.0, 1.0], [9.0, 3.0]])
ROOM = Environment(Workspace(0.0, 10.0, 0.0, 10.0), (DISC, BLOCK))
KINDS = "wall", "corner", "disc", "edge", "robots"


def touching(kind: str, seed: int, n: int = 3) -> Problem:
    """Return robots of which the first touches something at its goal."""
    rng = np.random.default_rng(seed)
    way = np.array([np.cos(angle := rng.uniform(0, 2 * np.pi)), np.sin(angle)])
    goals = np.array([[1.0 + 2.0 * row, 8.0] for row in range(n)])
    goals[0] = {
        "wall": [BODY, rng.uniform(1, 7)], "corner": [BODY, BODY], "disc": DISC.center + (DISC.radius + BODY) * way,
        "edge": [rng.uniform(7.5, 8.5), 1.0 - BODY], "robots": goals[1] + 2 * BODY * way,
    }[kind]
    starts = np.column_stack([[[1.0 + 2.5 * row, 3.2] for row in range(n)], rng.uniform(-3, 3, n)])
    starts[0, :2] = 4.5, 0.6
    return Problem(Swarm(1.0, 1.0, BODY, binary(n)), ROOM, starts, goals)


def grown(problem: Problem, by: float) -> Swarm:
    return replace(problem.swarm, body_radius=problem.swarm.body_radius + by)


@given(st.sampled_from(KINDS), st.integers(0, 10**6), st.sampled_from([0.0, 0.01]))
@settings(deadline=None, max_examples=60)
def test_aims_are_so_far_apart_that_steps_fit_between_and_so_near_that_goals_are_met(kind, seed, gap):
    problem, shapes = touching(kind, seed), Shapes.of(ROOM)
    here = gap_at_rest(problem.swarm, shapes, problem.goals)
    assert abs(here) < 1e-12
    aims = aims_apart(problem, 0.0, STEP)
    away = np.hypot(*(aims - problem.goals).T)
    assert 0 < away.max() <= (LEEWAY - ASIDE) * STEP * (1 + 1e-9)
    left = gap_at_rest(grown(problem, ASIDE * STEP), shapes, aims)
    assert left >= -2 * NEARBY * STEP
    smaller = replace(problem, swarm=grown(problem, -ASIDE * STEP - gap / 2))
    np.testing.assert_array_equal(aims_apart(smaller, gap / 2, STEP), problem.goals)


def test_robots_in_contact_touch_and_points_pass():
    problem = touching("robots", 1)
    np.testing.assert_array_equal(aims_apart(replace(problem, contacts=((1, 0),)), 0.0, STEP), problem.goals)
    points = replace(problem, swarm=grown(problem, -BODY), goals=np.repeat(problem.goals[:1], 3, axis=0))
    np.testing.assert_array_equal(aims_apart(points, 0.0, STEP), points.goals)
    beside = replace(points, goals=points.goals + [[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
    aims = aims_apart(beside, 0.01, STEP)
    assert np.hypot(*(aims[1:] - aims[0]).T).min() >= 0.01 + (2 * ASIDE - 2 * NEARBY) * STEP


def test_aims_where_bodies_would_overlap_are_not_taken(monkeypatch):
    monkeypatch.setattr("stressbot_planner.planners.apart.aims_apart", lambda problem, *_: 0 * problem.goals)
    asked = Settings(max_tries=20, first=True, pulse_length=STEP)
    assert solve(replace(touching("wall", 1), environment=Environment()), "optimize", asked).success


def test_a_robot_at_a_wall_goes_aside_with_the_one_that_it_touches():
    swarm = Swarm(1.0, 1.0, BODY, ("01", "10"))
    docked = Problem(
        swarm, ROOM, [[1.0, 1.0, 0.0], [4.0, 2.0, 0.0]], [[BODY, 2.0], [3 * BODY, 2.0]], contacts=((0, 1),),
        contact_depth=contact_depth(STEP),
    )
    aims = aims_apart(docked, 0.0, STEP)
    assert aims[0, 0] > BODY and np.hypot(*(aims[1] - aims[0])) >= 2 * BODY
    result = solve(docked, "optimize", Settings(max_tries=20, first=True, pulse_length=STEP))
    assert result.success and result.plan.valid, result.reason


@pytest.mark.parametrize("kind", KINDS)
def test_goals_where_bodies_touch_are_met_by_whole_pulses(kind):
    met = 0
    for seed in range(12):
        problem = touching(kind, seed)
        result = solve(problem, "optimize", Settings(seed=seed, max_tries=30, first=True, time_limit=100, pulse_length=STEP))
        if result.success:
            plan = result.plan
            counts = plan.lengths / STEP
            np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
            assert plan.valid and np.hypot(*(plan.poses[-1, :, :2] - problem.goals).T).max() <= 1e-6 + LEEWAY * STEP + problem.slack
            met += 1
    assert met >= 11, "half of them, where plans aim at the goals themselves"


@pytest.mark.parametrize("n", [1, 2])
def test_few_robots_end_at_goals_anywhere_by_whole_pulses(n):
    """Of one robot that turns and slides, a step more or less of the turn is several steps aside."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        starts = np.column_stack([rng.uniform(0, 5, n), 20.0 * np.arange(n), rng.uniform(-3, 3, n)])
        goals = starts[:, :2] + rng.uniform(-9, 9, (n, 2))
        problem = Problem(Swarm(1.0, 1.0, BODY, binary(n)), Environment(), starts, goals)
        result = solve(problem, "pure_control", Settings(seed=seed, max_tries=20, time_limit=100, pulse_length=STEP))
        assert result.success and result.plan.valid, (seed, result.reason)
