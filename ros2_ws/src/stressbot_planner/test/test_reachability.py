"""Proofs that there is no way: never where there is one, and always where a gap is clearly too narrow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.reachability import walled_in


def beside_a_gap(width: float, tolerance: float = 1e-6) -> Problem:
    """A robot of radius 0.3 left of a wall with a gap, its goal on the right."""
    wall = [Polygon([[4.9, 0], [5.1, 0], [5.1, 5 - width / 2], [4.9, 5 - width / 2]])]
    wall += [Polygon([[4.9, 5 + width / 2], [5.1, 5 + width / 2], [5.1, 10], [4.9, 10]])]
    environment = Environment(Workspace(0, 10, 0, 10), tuple(wall))
    return Problem(Swarm(1.0, 1.0, 0.3, ("1",)), environment, [[2, 3, 0]], [[8, 6]], tolerance)


@pytest.mark.parametrize(("width", "robot"), [(0.2, 1), (0.5, 1), (0.601, None), (1.0, None)])
def test_a_gap_too_narrow_for_the_body_is_found(width, robot):
    assert walled_in(beside_a_gap(width)) == robot


def test_a_goal_ball_may_reach_through_a_wall():
    assert walled_in(beside_a_gap(0.2, tolerance=4.0)) is None


def test_discs_can_wall_a_goal_in():
    ring = np.arange(0, 2 * np.pi, 0.4)
    cage = tuple(Circle((5 + 3 * np.cos(angle), 5 + 3 * np.sin(angle)), 0.6) for angle in ring)
    swarm = Swarm(1.0, 1.0, [0.3, 0.05], ("01", "10"))
    starts, goals = [[-2, 0, 0], [-2, 5, 0]], [[12, 0], [5, 5]]
    assert walled_in(Problem(swarm, Environment(None, cage), starts, goals)) == 2
    goals = [[12, 0], [12, 5]]
    assert walled_in(Problem(swarm, Environment(None, cage), starts, goals)) is None


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), count=st.integers(1, 12), walls=st.booleans())
def test_a_free_path_is_never_denied(seed, count, walls):
    """Discs that all keep away from a random polyline from start to goal."""
    rng = np.random.default_rng(seed)
    way = np.vstack([rng.uniform(1, 9, (4, 2))])
    points = np.vstack([np.linspace(a, b, 200) for a, b in zip(way, way[1:], strict=False)])
    discs = []
    for center in rng.uniform(-1, 11, (count, 2)):
        room = np.hypot(*(points - center).T).min() - 0.3 - 0.03
        if room > 0.05:
            discs.append(Circle(tuple(center), room))
    environment = Environment(Workspace(0.6, 9.4, 0.6, 9.4) if walls else None, tuple(discs))
    problem = Problem(Swarm(1.0, 1.0, 0.3, ("1",)), environment, [[*way[0], 0.0]], [way[-1]])
    assert walled_in(problem) is None
