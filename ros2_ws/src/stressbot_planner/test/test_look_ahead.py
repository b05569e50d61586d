"""Looking a few moves ahead: slides are safe for every robot anywhere in its cone, and moves bring the swarm nearer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.beam_search.cost_to_go import distance_maps
from stressbot_planner.beam_search.look_ahead import Move, look_ahead
from stressbot_planner.beam_search.situation import Situation, slide_is_clear
from stressbot_planner.collision.clearance import Shapes, clearance
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm

SWARM = Swarm(1.0, 0.5, 0.2, ("001", "010", "011", "100", "101", "110"))
ENVIRONMENT = Environment(
    Workspace(0, 8, 0, 8),
    (Circle(np.array([4.0, 2.5]), 0.7), Polygon(np.array([[3.5, 5.0], [4.5, 5.0], [4.0, 6.0]]))),
)
STARTS = np.column_stack([np.full(6, 1.0), np.linspace(1.0, 7.0, 6), np.linspace(0.0, 5.0, 6)])
GOALS = np.column_stack([np.full(6, 7.0), np.linspace(7.0, 1.0, 6)])
CONE = 0.15


def situation(cone: float = CONE, least: float = 0.02) -> Situation:
    shapes = Shapes.of(ENVIRONMENT)
    maps = distance_maps(shapes, SWARM.body_radius, STARTS[:, :2], GOALS)
    return Situation.of(SWARM.slides, SWARM.turning_length, np.full(6, cone), SWARM.body_radius, least, 1e-9, False, shapes, maps)


SCENE = situation()


def activations(move: Move) -> tuple[np.ndarray, np.ndarray]:
    return np.array([SWARM.m, move.group]), np.array([move.turn, move.length])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_clear_slide_is_clear_wherever_headings_jump(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(0.5, 7.5, (6, 2)), rng.uniform(0, 2 * np.pi, 6)])
    now = clearance(SWARM, ENVIRONMENT, poses, *activations(Move(0.0, 1, 0.0))).gap
    move = Move(0.0, int(rng.integers(1, SWARM.m)), float(rng.uniform(0.05, 3.0)))
    if now <= 0 or not slide_is_clear(SCENE, poses, move.group - 1, move.length):
        return
    for _ in range(20):
        jumped = poses + np.array([0, 0, 2 * np.arcsin(CONE / 2)]) * rng.choice([-1, 0, 1], (6, 1))
        assert clearance(SWARM, ENVIRONMENT, jumped, *activations(move)).gap >= min(0.02, now) - 1e-6


@pytest.mark.parametrize(
    ("at", "heading", "length"),
    [((2.0, 2.5), 0.0, 1.2), ((1.0, 1.0), np.pi, 0.9), ((4.0, 4.0), np.pi / 2, 0.9), ((1.0, 2.0), np.pi / 2, 1.0)],
    ids=["disc", "wall", "polygon", "robot"],
)
def test_a_slide_that_touches_is_not_clear(at, heading, length):
    poses = np.column_stack([np.full(6, 7.0), np.linspace(1.0, 7.0, 6), np.zeros(6)])
    poses[0], poses[1, :2] = (*at, heading), (1.0, 3.2)
    assert not slide_is_clear(SCENE, poses, 2, length)
    assert slide_is_clear(SCENE, poses, 2, 0.3 * length)


def test_a_robot_may_leave_what_it_touches():
    poses = STARTS.copy()
    poses[:, 2], poses[0] = 0.0, (0.201, 1.0, 0.0)
    assert slide_is_clear(SCENE, poses, 2, 0.5)


def test_moves_bring_a_swarm_nearer_step_by_step_to_its_goals():
    rng, poses = np.random.default_rng(0), STARTS
    for _ in range(100):
        groups, lengths = activations(look_ahead(SCENE, poses, rng)[0])
        assert clearance(SWARM, ENVIRONMENT, poses, groups, lengths).gap > 0.0
        poses = replay(SWARM, poses, groups, lengths)[-1]
        if np.hypot(*(poses[:, :2] - GOALS).T).max() < 0.1:
            return
    pytest.fail("not at the goals within 100 moves")


def test_nobody_can_slide():
    crowd = Swarm(1.0, 0.5, 0.2, ("01", "10"))
    shapes = Shapes.of(Environment(Workspace(0, 0.8, 0, 0.41)))
    places = np.array([[0.2, 0.205, 0.0], [0.6001, 0.205, np.pi]])
    maps = distance_maps(shapes, crowd.body_radius, places[:, :2], places[::-1, :2])
    stuck = Situation.of(crowd.slides, crowd.turning_length, np.full(2, 5.0), crowd.body_radius, 0.02, 1e-9, False, shapes, maps)
    assert look_ahead(stuck, places, np.random.default_rng(0)) == []
