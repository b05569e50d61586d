"""Windows: their derivatives, that what they return is safe for every robot anywhere in its cone, and brings the swarm nearer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.beam_search.cost_to_go import distance_maps
from stressbot_planner.beam_search.situation import Situation
from stressbot_planner.collision.clearance import Shapes, clearance
from stressbot_planner.execution.windows import ACTIVATIONS, NO_WINDOW, _evaluated, _trajectory, best_window
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm

ENVIRONMENT = Environment(
    Workspace(0, 8, 0, 8),
    (Circle(np.array([4.0, 2.5]), 0.7), Polygon(np.array([[3.5, 5.0], [4.5, 5.0], [4.0, 6.0]]))),
)
WORDS = ("001", "010", "011", "100", "101", "110")
LEAST, RIPE, ROOM = 0.02, 0.1, 0.02
SEEDS = st.integers(0, 2**32 - 1)


def swarm_of(n: int, body: float = 0.2) -> Swarm:
    return Swarm(1.0, 0.5, body, WORDS[:n])


def lined_up(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return starts (n, 3) on the left and goals (n, 2) on the right, in another order."""
    heights = np.linspace(1.0, 7.0, n)
    return np.column_stack([np.full(n, 1.0), heights, np.linspace(0.0, 5.0, n)]), np.column_stack([np.full(n, 7.0), heights[::-1]])


def situation(swarm: Swarm, goals: np.ndarray, cone: float, environment: Environment = ENVIRONMENT) -> Situation:
    shapes = Shapes.of(environment)
    maps = distance_maps(shapes, swarm.body_radius, goals + swarm.turning_radius[:, None], goals)
    robots = swarm.slides, swarm.turning_length, np.full(swarm.n, cone), swarm.body_radius
    return Situation.of(*robots, LEAST, 1e-9, False, shapes, maps)


SWARM = swarm_of(6)
STARTS, GOALS = lined_up(6)
SCENE = situation(SWARM, GOALS, 0.15)
ROUND = [situation(SWARM, GOALS, cone, Environment(ENVIRONMENT.workspace, ENVIRONMENT.obstacles[:1])) for cone in (0.0, 0.15)]


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_gradients_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    start = np.column_stack([rng.uniform(0.5, 7.5, (6, 2)), rng.uniform(0, 2 * np.pi, 6)])
    scene = ROUND[int(rng.integers(2))]  # how deep a body is in a polygon is known roughly
    order, t = rng.integers(0, SWARM.m, ACTIVATIONS), rng.uniform(0.05, 0.6, ACTIVATIONS)
    square, slope = np.zeros((ACTIVATIONS, ACTIVATIONS)), np.zeros(ACTIVATIONS)

    def value(lengths: np.ndarray, derive: bool = False) -> float:
        poses = _trajectory(scene, start, order, lengths)
        return _evaluated(scene, order, lengths, poses, 10.0, 0.3, RIPE, ROOM, square, slope, derive)

    step = 1e-6
    there = np.array([[value(t + sign * step * one) for sign in (-1, 0, 1)] for one in np.eye(ACTIVATIONS)])
    value(t, True)
    sides = np.diff(there, axis=1) / step
    # where maps and closest approaches have corners the two sides differ
    smooth = np.abs(sides[:, 1] - sides[:, 0]) < 1e-3 * (1.0 + np.abs(sides).max())
    assert np.count_nonzero(smooth) >= ACTIVATIONS // 2
    np.testing.assert_allclose(-slope[smooth], sides[smooth].mean(axis=1), rtol=2e-3, atol=2e-3 * (1.0 + np.abs(slope).max()))
    np.testing.assert_allclose(square, square.T, rtol=1e-12, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_what_is_driven_first_is_clear_wherever_headings_jump(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(0.5, 7.5, (6, 2)), rng.uniform(0, 2 * np.pi, 6)])
    now = clearance(SWARM, ENVIRONMENT, poses, np.array([1]), np.array([0.0])).gap
    window = best_window(SCENE, poses, NO_WINDOW, rng, RIPE, ROOM)
    if now <= 0 or not len(window.groups):
        return
    assert clearance(SWARM, ENVIRONMENT, poses, *window).gap >= min(LEAST, now) - 1e-6
    for _ in range(20):
        jumped = poses + np.array([0, 0, 2 * np.arcsin(0.15 / 2)]) * rng.choice([-1, 0, 1], (6, 1))
        assert clearance(SWARM, ENVIRONMENT, jumped, window.groups[:1], window.lengths[:1]).gap >= min(LEAST, now) - 1e-6


@pytest.mark.parametrize("n", [1, 2, 3, 6])
@pytest.mark.parametrize("seed", range(3))
def test_windows_bring_a_swarm_step_by_step_to_its_goals(n, seed):
    swarm, (poses, goals) = swarm_of(n), lined_up(n)
    scene, rng, window = situation(swarm, goals, 0.05), np.random.default_rng(seed), NO_WINDOW
    for _ in range(25 * n + 25):
        window = best_window(scene, poses, window, rng, RIPE, ROOM)
        assert len(window.groups) and np.all(window.lengths > 0) and len(window.groups) <= ACTIVATIONS
        assert window.groups.min() >= 1 and window.groups.max() <= swarm.m
        first = window.groups[:1], window.lengths[:1]
        assert clearance(swarm, ENVIRONMENT, poses, *first).gap > 0.0
        poses = replay(swarm, poses, *first)[-1]
        window = window._replace(groups=window.groups[1:], lengths=window.lengths[1:])
        if np.hypot(*(poses[:, :2] - goals).T).max() < RIPE:
            return
    pytest.fail("not at the goals")


def test_the_same_draws_give_the_same_window():
    one, other = (best_window(SCENE, STARTS, NO_WINDOW, np.random.default_rng(5), RIPE, ROOM) for _ in range(2))
    np.testing.assert_array_equal(one.groups, other.groups)
    np.testing.assert_array_equal(one.lengths, other.lengths)


def test_nobody_can_slide():
    crowd = Swarm(1.0, 0.5, 0.2, ("01", "10"))
    places = np.array([[0.2, 0.205, 0.0], [0.6001, 0.205, np.pi]])
    stuck = situation(crowd, places[::-1, :2], 5.0, Environment(Workspace(0, 0.8, 0, 0.41)))
    window = best_window(stuck, places, NO_WINDOW, np.random.default_rng(0), 0.01, ROOM)
    assert np.all(window.groups == crowd.m)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.sampled_from([1e-8, 1e-3, 1.0, 1e6]), st.sampled_from([0.0, 0.2]), st.sampled_from([1e-6, 0.1, 1e3]))
def test_any_scale_cone_and_tolerance_ends_in_a_window_or_none(seed, unit, body, ripe):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    swarm = Swarm(unit, 0.5 * unit, body * unit, WORDS[:n])
    poses, goals = lined_up(n)
    poses[:, :2] *= unit
    if rng.random() < 0.3:
        goals = poses[:, :2] / unit + 1e-6
    scene = situation(swarm, goals * unit, float(rng.choice([0.0, 0.1, 10.0])), Environment())
    window = best_window(scene, poses, NO_WINDOW, rng, ripe * unit, ROOM * unit)
    assert np.all(np.isfinite(window.lengths)) and np.all(window.lengths > 0)
