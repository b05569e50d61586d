"""Cameras are found again from pictures of them: properties over random ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.calibrating import Unknown, calibrate, fit_electrodes, fit_places, matched, moved
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline

WIDTH, HEIGHT = 480, 400
ROBOT = Outline(120e-6, 60e-6, (15e-6, 0.0))

cameras = st.builds(
    Camera,
    st.just(WIDTH),
    st.just(HEIGHT),
    st.floats(3e-6, 8e-6),
    st.tuples(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3)),
    st.floats(-0.4, 0.4),
    st.floats(-0.06, 0.06),
)


def apart(random, camera, count):
    """Poses of robots that all are in the picture and do not touch."""
    poses = np.empty((0, 3))
    while len(poses) < count:
        pixels = random.uniform((40, 40), (WIDTH - 40, HEIGHT - 40), (1, 2))
        (place,) = camera.to_substrate(pixels)
        if not len(poses) or np.hypot(*(poses[:, :2] - place).T).min() > 160e-6:
            poses = np.vstack([poses, [*place, random.uniform(-math.pi, math.pi)]])
    return poses


def farthest(camera, other):
    """[pixels] between where two cameras see what is anywhere in the picture."""
    pixels = np.stack(np.meshgrid([0, WIDTH / 2, WIDTH - 1], [0, HEIGHT / 2, HEIGHT - 1]), axis=-1).reshape(-1, 2)
    return np.hypot(*(other.to_pixels(camera.to_substrate(pixels)) - pixels).T).max()


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(cameras, st.floats(6, 14), st.integers(0, 1000))
def test_electrodes_tell_scale_rotation_and_distortion(camera, period, seed):
    pitch = period * camera.pixel
    optics = Optics(pitch=pitch, stripes=0.2, noise=3.0)
    poses = apart(np.random.default_rng(seed), camera, 6)
    picture = Microscope(camera, [ROBOT] * 6, optics, seed).picture(poses, 0.0)
    fit = fit_electrodes(picture, pitch)
    assert fit.rms < 0.2 * camera.pixel
    assert farthest(replace(camera, center=(0.0, 0.0)), fit.camera) < 0.5


@settings(max_examples=15, deadline=None)
@given(cameras, st.integers(0, 1000), st.floats(0, 0.1))
def test_places_tell_the_whole_camera_and_a_wrong_one_does_no_harm(camera, seed, noise):
    random = np.random.default_rng(seed)
    pixels = random.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (30, 2))
    places = camera.to_substrate(pixels)
    pixels = pixels + random.normal(0, noise, pixels.shape)
    pixels[0] += 30.0
    about = replace(camera, pixel=camera.pixel * 1.03, rotation=camera.rotation + 0.05, distortion=0.0, center=(0.0, 0.0))
    fit = fit_places(pixels, places, about)
    assert farthest(camera, fit.camera) < 0.05 + 5 * noise
    assert fit.errors[0] > 10 * camera.pixel > fit.errors[1:].max()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.floats(-math.pi, math.pi))
def test_robots_are_told_apart_by_their_formation(seed, turn):
    """After any turn and shift, with some unseen and some that are none."""
    random = np.random.default_rng(seed)
    starts = apart(random, Camera(WIDTH, HEIGHT, 4e-6), 8)
    order = random.permutation(8)[:6]
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    seen = np.column_stack([starts[order, :2] @ rotation + random.uniform(-1e-3, 1e-3, 2), starts[order, 2] - turn])
    seen += random.normal(0, (1e-6, 1e-6, 0.01), (6, 3))
    seen = np.vstack([seen, random.uniform((-1e-3, -1e-3, -3), (1e-3, 1e-3, 3), (2, 3))])
    at, of, _ = matched(seen, starts, 50e-6)
    assert dict(zip(at.tolist(), of.tolist(), strict=True)).items() >= dict(enumerate(order.tolist())).items()


@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(cameras, st.integers(0, 1000), st.booleans(), st.booleans())
def test_a_picture_of_robots_at_their_starts_tells_the_camera(camera, seed, striped, half_turn):
    """With electrodes, also if the picture is upside down; without them from about the right scale."""
    camera = replace(camera, rotation=camera.rotation + math.pi * half_turn, distortion=camera.distortion * striped)
    pitch = 10 * camera.pixel
    starts = apart(np.random.default_rng(seed), camera, 8)
    optics = Optics(pitch=pitch, stripes=0.2 * striped)
    picture = Microscope(camera, [ROBOT] * 8, optics, seed).picture(starts, 0.0)
    about = fit_electrodes(picture, pitch).camera if striped else Camera(WIDTH, HEIGHT, camera.pixel * 1.02)
    fit = calibrate(picture, starts, ROBOT, about, Unknown.PLACE if striped else Unknown.ALL)
    assert np.median(fit.errors) < 0.5 * camera.pixel  # electrodes below robots, and dust beside them, move what is found of them
    assert farthest(camera, fit.camera) < 1.0


def test_what_shows_no_electrodes_or_no_robots_is_refused():
    camera = Camera(WIDTH, HEIGHT, 4e-6)
    starts = apart(np.random.default_rng(0), camera, 6)
    empty = Microscope(camera, [], Optics(stripes=0.0, dust=5)).picture(np.empty((0, 3)), 0.0)
    with pytest.raises(StressbotError, match="shows no electrodes") as refusal:
        fit_electrodes(empty, 40e-6)
    assert refusal.value.code == ErrorCode.INFEASIBLE
    with pytest.raises(StressbotError, match="of 6 robots where they start"):
        calibrate(empty, starts, ROBOT, camera, Unknown.PLACE)


def test_how_far_the_stage_has_moved_is_as_it_was_moved():
    camera = Camera(WIDTH, HEIGHT, 4e-6, (3e-4, 2e-4))
    starts = apart(np.random.default_rng(1), camera, 8)
    optics = Optics(stripes=0.0, drift_x=1e-6, drift_y=-2e-6, drift_turn=1e-3)
    microscope = Microscope(camera, [ROBOT] * 8, optics)
    microscope.picture(starts, 0.0)
    picture = microscope.picture(starts, 10.0)
    x, y, turn = moved(calibrate(picture, starts, ROBOT, camera, Unknown.PLACE_AND_TURN), camera)
    assert turn == pytest.approx(1e-2, abs=5e-4)
    assert math.hypot(x - 1e-5, y + 2e-5) < 1e-6
