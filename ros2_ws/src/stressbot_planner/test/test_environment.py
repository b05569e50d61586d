"""Walls and obstacles that mean something."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "vertices",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],
        [(0, 0), (4, 0), (4, 4), (2, -1), (0, 4)],
        [(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)],
        [(0, 0), (4, 0), (4, 4), (2, 4), (2, 2), (2, 4), (0, 4)],
        [(0, 0), (2, 0), (1, 0), (1, 1)],
        [(0, 0), (1, 0), (2, 0)],
        [(0, 0), (1, 0), (1, 0), (0, 1)],
        [(0, 0), (1, 0), (0, 1), (0, 0)],
        [(0, 0), (0, 0), (0, 0)],
    ],
    ids=["bow-tie", "crossing", "vertex-on-edge", "slit", "spike", "line", "double-vertex", "closed-by-hand", "point"],
)
@pytest.mark.parametrize("backward", [False, True])
def test_polygons_that_touch_or_cross_themselves_are_refused(vertices, backward):
    with pytest.raises(StressbotError) as caught:
        Polygon(vertices[::-1] if backward else vertices)
    assert (caught.value.code, caught.value.field) == (ErrorCode.OUT_OF_RANGE, "polygon")


@given(st.integers(3, 12), st.integers(0, 2**32 - 1), st.booleans())
def test_star_shaped_polygons_are_taken(count, seed, backward):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    gaps = np.diff(np.append(angle, angle[0] + 2 * np.pi))
    if gaps.min() < 1e-3 or gaps.max() > 3.1:
        return
    radius = rng.uniform(0.5, 3, count)
    vertices = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    Polygon(vertices[::-1] if backward else vertices)


@given(st.integers(0, 2**32 - 1), st.integers(4, 8))
def test_the_check_agrees_with_pairwise_intersection(seed, count):
    vertices = np.random.default_rng(seed).uniform(0, 1, (count, 2))

    def turn(a, b, c):
        return np.sign((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])

    crossing = False
    for k in range(count):
        for other in range(k + 2, count - (k == 0)):
            a, b, c, d = vertices[k], vertices[(k + 1) % count], vertices[other], vertices[(other + 1) % count]
            crossing |= turn(a, b, c) != turn(a, b, d) and turn(c, d, a) != turn(c, d, b)
    if crossing:
        with pytest.raises(StressbotError, match="edges"):
            Polygon(vertices)
    else:
        Polygon(vertices)


def test_vertices_in_line_and_concave_corners_are_fine():
    Polygon([(0, 0), (1, 0), (2, 0), (2, 1), (1, 0.2), (0, 1)])


@pytest.mark.parametrize(
    ("make", "code", "field"),
    [
        (lambda: Circle((0, NAN), 1), ErrorCode.NOT_FINITE, "circle.center"),
        (lambda: Circle((0, 1e300), 1), ErrorCode.OUT_OF_RANGE, "circle.center"),
        (lambda: Circle((0, 0), 0), ErrorCode.OUT_OF_RANGE, "circle.radius"),
        (lambda: Circle((0, 0), INF), ErrorCode.NOT_FINITE, "circle.radius"),
        (lambda: Polygon([(0, 0), (1, INF), (2, 0)]), ErrorCode.NOT_FINITE, "polygon[1]"),
        (lambda: Polygon([(0, 0), (1, 0)]), ErrorCode.WRONG_COUNT, "polygon"),
        (lambda: Polygon([(0, 0, 0), (1, 0, 0), (0, 1, 0)]), ErrorCode.WRONG_COUNT, "polygon"),
        (lambda: Workspace(0, NAN, 0, 1), ErrorCode.NOT_FINITE, "workspace.x"),
        (lambda: Workspace(0, 1, 2, 2), ErrorCode.OUT_OF_RANGE, "workspace.y"),
        (lambda: Workspace(1, 0, 0, 1), ErrorCode.OUT_OF_RANGE, "workspace.x"),
    ],
)
def test_refused_walls_and_obstacles_name_the_field(make, code, field):
    with pytest.raises(StressbotError) as caught:
        make()
    assert (caught.value.code, caught.value.field) == (code, field)


def test_an_open_plane_has_nothing_to_hit():
    assert Environment().is_open_plane
    assert not Environment(Workspace(0, 1, 0, 1)).is_open_plane
    assert not Environment(None, (Circle((0, 0), 1),)).is_open_plane
