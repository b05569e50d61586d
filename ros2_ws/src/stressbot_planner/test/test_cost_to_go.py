"""How far robots have to go: straight where they see their goals, around obstacles, and a finite way where there is none."""

import numpy as np
import pytest

from stressbot_planner.beam_search.cost_to_go import distance_maps, way_left
from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace

BODY = np.array([0.2])


WALLS = Workspace(0, 10, 0, 10)


def maps_to(goal, *obstacles, workspace=WALLS):
    shapes = Shapes.of(Environment(workspace, obstacles))
    return distance_maps(shapes, BODY, np.array([[1.0, 5.0]]), np.array([goal]))


@pytest.mark.parametrize("workspace", [None, Workspace(-20, 20, -20, 20)])
def test_an_open_way_is_the_straight_line(workspace):
    maps = maps_to((8.0, 5.0), workspace=workspace)
    rng = np.random.default_rng(0)
    for place in rng.uniform((0, 4), (9, 6), (50, 2)):
        straight = float(np.hypot(*(place - (8.0, 5.0))))
        assert straight - 1e-9 <= maps.ways_left(place[None])[0] <= 1.03 * straight + 0.1


def test_a_way_leads_around_an_obstacle():
    wall = Polygon(np.array([[4.5, 0.0], [5.5, 0.0], [5.5, 8.0], [4.5, 8.0]]))
    maps = maps_to((8.0, 2.0), wall)
    around = np.hypot(3.7, 6.2) + 1.0 + np.hypot(2.7, 6.2)
    assert around - 0.5 < maps.ways_left(np.array([[1.0, 2.0]]))[0] < 1.3 * around
    assert maps.ways_left(np.array([[4.2, 8.2]]))[0] < maps.ways_left(np.array([[4.2, 2.0]]))[0]


def test_no_way_is_longer_than_any_way():
    wall = Polygon(np.array([[4.5, -1.0], [5.5, -1.0], [5.5, 11.0], [4.5, 11.0]]))
    maps = maps_to((8.0, 5.0), wall)
    here, there = maps.ways_left(np.array([[1.0, 5.0]]))[0], maps.ways_left(np.array([[8.0, 9.0]]))[0]
    assert np.isfinite(here) and here > there + 10


def test_slopes_are_derivatives():
    maps = maps_to((8.0, 5.0), Circle(np.array([5.0, 5.0]), 1.5))
    rng, step = np.random.default_rng(1), 1e-6
    for x, y in rng.uniform(0.5, 9.5, (50, 2)):
        _, gx, gy = way_left(0, x, y, *maps)
        numeric = [
            (way_left(0, x + dx, y + dy, *maps)[0] - way_left(0, x - dx, y - dy, *maps)[0]) / (2 * step)
            for dx, dy in ((step, 0), (0, step))
        ]
        np.testing.assert_allclose((gx, gy), numeric, atol=1e-4)
