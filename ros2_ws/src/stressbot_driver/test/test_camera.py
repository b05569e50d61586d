"""The camera: pixels and places on the substrate are one another's inverse; and the outline that it looks at."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.vision.camera import MOST_DISTORTION, Camera
from stressbot_driver.vision.outline import LENGTH, Outline

cameras = st.builds(
    Camera,
    width=st.integers(16, 4000),
    height=st.integers(16, 4000),
    pixel=st.floats(1e-7, 1e-4),
    center=st.tuples(st.floats(-1e-2, 1e-2), st.floats(-1e-2, 1e-2)),
    rotation=st.floats(-math.pi, math.pi),
    distortion=st.floats(-MOST_DISTORTION, MOST_DISTORTION),
)
shares = st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=20)


@given(cameras, shares)
def test_pixels_and_places_are_inverse_within_the_picture(camera, shares):
    pixels = np.array(shares) * (camera.width - 1, camera.height - 1)
    places = camera.to_substrate(pixels)
    assert np.allclose(camera.to_pixels(places), pixels, rtol=0, atol=1e-8)
    centred = Camera(camera.width, camera.height, 1.0, rotation=camera.rotation, distortion=camera.distortion)
    assert np.allclose(centred.to_pixels(centred.to_substrate(pixels)), pixels, rtol=0, atol=1e-9)


@given(cameras, st.floats(0, 2 * math.pi), st.floats(1.3, 100))
def test_what_lies_outside_is_never_seen_inside(camera, direction, far):
    """Also where the lens's formula, taken as it stands, would lead back to the middle."""
    reach = far * 0.5 * math.hypot(camera.width, camera.height) * camera.pixel
    place = camera.center + reach * np.array([math.cos(direction), math.sin(direction)])
    ((u, v),) = camera.to_pixels(place[None])
    assert not (-0.5 < u < camera.width - 0.5 and -0.5 < v < camera.height - 0.5)


def test_the_picture_is_turned_and_upright():
    camera = Camera(101, 51, 2e-6, center=(1e-3, 2e-3))
    assert np.allclose(camera.to_pixels(np.array([[1e-3, 2e-3], [1e-3 + 4e-6, 2e-3 + 2e-6]])), [[50, 25], [52, 24]])
    turned = Camera(101, 51, 2e-6, center=(1e-3, 2e-3), rotation=math.pi / 2)
    assert np.allclose(turned.to_pixels(np.array([[1e-3, 2e-3 + 4e-6]])), [[52, 25]])


def test_a_lens_moves_corners_by_its_distortion():
    camera = Camera(200, 200, 1.0, distortion=0.05)
    half = 0.5 * math.hypot(200, 200)
    ((u, _),) = camera.to_pixels(np.array([[half, 0.0]]))
    assert u - 99.5 == pytest.approx(half * 1.05)


@given(st.floats(1e-9, 1.0))
def test_the_outline_of_a_body_fills_its_disc(radius):
    outline = Outline.of(radius)
    assert np.hypot(*outline.corners().T).max() == pytest.approx(radius, rel=1e-12)
    assert outline.width == pytest.approx(outline.length / 2)


def test_a_point_has_the_outline_of_a_microstressbot():
    assert Outline.of(0.0) == Outline(120e-6, 60e-6) and LENGTH == 120e-6


@given(
    st.floats(1e-6, 1e-3),
    st.tuples(st.floats(-1e-4, 1e-4), st.floats(-1e-4, 1e-4)),
    st.tuples(st.floats(-1e-2, 1e-2), st.floats(-1e-2, 1e-2), st.floats(-7, 7)),
)
def test_a_robot_turns_about_its_pivot(length, pivot, pose):
    """The middle of its bounding box lies opposite of the pivot, and distances between corners stay."""
    outline = Outline(length, length / 3, pivot)
    corners = outline.at(np.array(pose))
    box = corners[[0, 4]].mean(axis=0) + length / 2 * np.array([math.cos(pose[2]), math.sin(pose[2])])
    back = np.array([[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]]) @ pivot
    assert np.allclose(box + back, pose[:2], rtol=0, atol=1e-9 * (1 + length))
    sides = np.diff(outline.corners(), axis=0)
    assert np.allclose(np.hypot(*np.diff(corners, axis=0).T), np.hypot(*sides.T), rtol=1e-9, atol=1e-12)
