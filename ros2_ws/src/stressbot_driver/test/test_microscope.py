"""Pictures of a simulated microscope: what is drawn lies where the camera says, to a small part of a pixel."""

import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from picture_support import area_and_middle, middle_of

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.microscope import BLACK, Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline

BARE = Optics(contrast=-1.0, blur=0.0, noise=0.0, uneven=0.0, dust=0, stripes=0.0, lamp=200.0)
ROBOT = Outline(120e-6, 60e-6, (20e-6, 5e-6))


def darkness(picture, light=204.0):
    """How much of each pixel is covered, for a black robot on an even substrate."""
    return (light - picture.astype(float)) / (light - BLACK)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(3, 60),
    st.floats(-0.1, 0.1),
    st.floats(-0.1, 0.1),
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi, math.pi),
    st.sampled_from([0.0, 0.7, 1.5]),
)
def test_a_robot_covers_its_polygon(pixels, x, y, heading, rotation, blur):
    """From 3 to 60 pixels a robot length."""
    camera = Camera(200, 160, 120e-6 / pixels, rotation=rotation, distortion=0.02)
    pose = np.array([x * 200 * camera.pixel, y * 200 * camera.pixel, heading])
    bare = Optics(**{**vars(BARE), "blur": blur})
    cover = darkness(Microscope(camera, [ROBOT], bare).picture(pose[None], 0.0))
    area, middle = area_and_middle(camera.to_pixels(ROBOT.at(pose)))
    if blur:  # what is sharp is no better than its pixels
        assert np.hypot(*(middle_of(cover) - middle)) < 0.02 + 0.1 / area  # grey levels are whole numbers
    assert cover.sum() == pytest.approx(area, abs=0.3, rel=0.005)
    if not blur:
        partly = (cover > 0.05) & (cover < 0.95)
        assert partly.sum() >= 4, "edges are smooth"


def test_the_same_seed_gives_the_same_pictures_and_another_one_others():
    camera = Camera(120, 90, 4e-6)
    poses = np.array([[0, 0, 1.0], [1e-4, 5e-5, 2.0]])

    def pictures(seed):
        microscope = Microscope(camera, [Outline()] * 2, Optics(wander=1e-6), seed)
        return [microscope.picture(poses, 0.5 * k) for k in range(4)]

    first, again, other = pictures(3), pictures(3), pictures(4)
    assert all(map(np.array_equal, first, again))
    assert not any(map(np.array_equal, first, other))
    assert not np.array_equal(first[0], first[1]), "noise is new in each picture"


@settings(max_examples=30, deadline=None)
@given(st.floats(-2e-5, 2e-5), st.floats(-2e-5, 2e-5), st.floats(-0.02, 0.02), st.floats(0, 5))
def test_drift_moves_robots_as_said(drift_x, drift_y, turn, when):
    camera = Camera(300, 300, 4e-6, center=(1e-3, -2e-3), rotation=0.4)
    moving = Optics(**{**vars(BARE), "blur": 0.8, "drift_x": drift_x, "drift_y": drift_y, "drift_turn": turn})
    pose = np.array([1e-3 + 5e-5, -2e-3 + 1e-4, 0.3])
    cover = darkness(Microscope(camera, [ROBOT], moving).picture(pose[None], when))
    cos, sin = math.cos(turn * when), math.sin(turn * when)
    place = np.array([[cos, -sin], [sin, cos]]) @ (pose[:2] - camera.center) + camera.center + np.array([drift_x, drift_y]) * when
    expected = area_and_middle(camera.to_pixels(ROBOT.at(np.array([*place, pose[2] + turn * when]))))[1]
    assert np.hypot(*(middle_of(cover) - expected)) < 0.02


def test_stripes_and_dust_move_with_the_stage_and_light_does_not():
    camera = Camera(200, 100, 4e-6)
    drifting = dict(vars(BARE), drift_x=4e-6, drift_y=8e-6)
    stripes = Microscope(camera, [], Optics(**{**drifting, "stripes": 0.5, "pitch": 80e-6}))
    dust = Microscope(camera, [], Optics(**{**drifting, "dust": 40}), seed=2)
    for microscope in (stripes, dust):
        first, later = (microscope.picture(np.empty((0, 3)), t).astype(int) for t in (0.0, 10.0))
        assert np.abs(later[:-20, 10:] - first[20:, :-10]).max() <= 1  # 10 pixels to the right, 20 up
        assert np.abs(later - first).max() > 20
    light = Microscope(camera, [], Optics(**{**drifting, "uneven": 0.5}))
    assert np.array_equal(light.picture(np.empty((0, 3)), 0.0), light.picture(np.empty((0, 3)), 10.0))


@pytest.mark.parametrize(("pitch", "rotation"), [(80e-6, 0.0), (33e-6, 0.3), (24e-6, math.pi / 2)])
def test_stripes_have_their_pitch_along_x_of_the_substrate(pitch, rotation):
    camera = Camera(240, 240, 4e-6, center=(3e-4, 1e-4), rotation=rotation)
    picture = Microscope(camera, [], Optics(**{**vars(BARE), "stripes": 0.5, "pitch": pitch})).picture(np.empty((0, 3)), 0.0)
    columns, rows = np.meshgrid(np.arange(240), np.arange(240))
    x = camera.to_substrate(np.column_stack([columns.ravel(), rows.ravel()]))[:, 0]
    share = x / pitch % 1.0
    sure = np.minimum.reduce([np.abs(share - edge) for edge in (0.0, 0.25, 0.5, 0.75, 1.0)]) * pitch / camera.pixel > 0
    inside = (share > 0.25) & (share < 0.75)
    near = np.minimum(np.abs(share - 0.25), np.abs(share - 0.75)) * pitch < 1.5 * camera.pixel
    sure &= ~near
    grey = picture.ravel().astype(int)
    assert np.all(grey[sure & inside] == 104) and np.all(grey[sure & ~inside] == 204)


def test_noise_grows_with_the_root_of_the_light_and_the_dark_is_noisy_too():
    camera = Camera(200, 200, 4e-6)
    for lamp in (0.0, 50.0, 180.0):
        microscope = Microscope(camera, [], Optics(**{**vars(BARE), "lamp": lamp, "noise": 3.0}))
        grey = np.stack([microscope.picture(np.empty((0, 3)), t).astype(float) for t in range(3)])
        expected = 3.0 * math.sqrt((lamp + BLACK) / 128)
        assert grey.mean() == pytest.approx(lamp + BLACK, abs=0.1)
        assert grey.std() == pytest.approx(math.hypot(expected, math.sqrt(1 / 12)), rel=0.05)
        assert not np.array_equal(grey[0], grey[1])


def test_light_falls_off_to_the_darkest_corner():
    camera = Camera(300, 200, 4e-6)
    picture = Microscope(camera, [], Optics(**{**vars(BARE), "lamp": 100.0, "uneven": 0.4})).picture(np.empty((0, 3)), 0.0)
    light = picture.astype(float) - BLACK
    assert light[100, 150] == pytest.approx(100, abs=1)
    assert light.min() / light.max() == pytest.approx(0.6, abs=0.02) and light[-1, -1] == light.min()


def test_a_hand_hides_the_left_part_of_the_picture():
    camera, robots = Camera(200, 160, 6e-6), np.array([[-3e-4, 0.0, 0.0], [3e-4, 0.0, 0.0]])
    open_, half, all_ = (
        Microscope(camera, [ROBOT, ROBOT], Optics(**{**vars(BARE), "hand": hand})).picture(robots, 0.0).astype(int)
        for hand in (0.0, 0.5, 1.0)
    )
    assert np.array_equal(half[:, 110:], open_[:, 110:]) and half[:, 110:].min() < 50
    assert np.ptp(half[:, :90]) == 0 and np.ptp(all_) == 0 and all_[0, 0] == half[0, 0] < 100


def test_the_walk_of_the_stage_depends_on_the_time_alone():
    camera = Camera(20, 20, 4e-6)
    first, second = (Microscope(camera, [], Optics(wander=1e-6), seed=5) for _ in range(2))
    times = [0.0, 0.3, 7.9, 12.0, 100.5]
    forward = [first.stage(t) for t in times]
    backward = [second.stage(t) for t in reversed(times)][::-1]
    assert np.allclose(forward, backward, rtol=0, atol=1e-18)
    ends = [Microscope(camera, [], Optics(wander=1e-6), seed=k).stage(25.0)[:2] for k in range(200)]
    assert np.std(ends) == pytest.approx(5e-6, rel=0.15)


def test_robots_far_outside_and_at_the_edge_are_no_trouble():
    camera = Camera(100, 100, 4e-6, distortion=-0.1)
    outlines = [Outline(), Outline(), Outline(0.1, 0.05)]
    poses = np.array([[1.0, 1.0, 0.0], [200e-6, 0.0, 0.0], [-10.0, 0.0, 0.0]])
    cover = darkness(Microscope(camera, outlines, BARE).picture(poses, 0.0))
    assert 0 < cover.sum() < 15 * 30 and cover[:, :80].max() < 0.01
    poses[2] = 0.0  # it hides everything
    assert darkness(Microscope(camera, outlines, BARE).picture(poses, 0.0)).min() > 0.99


def test_later_robots_lie_upon_earlier_ones():
    camera = Camera(60, 60, 4e-6)
    poses = np.zeros((2, 3))
    one = Microscope(camera, [Outline()], BARE).picture(poses[:1], 0.0)
    two = Microscope(camera, [Outline()] * 2, BARE).picture(poses, 0.0)
    assert np.all(two <= one) and np.array_equal(two == 204, one == 204)


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("blur", -0.1, ErrorCode.OUT_OF_RANGE),
        ("noise", math.nan, ErrorCode.OUT_OF_RANGE),
        ("dust", 1.5, ErrorCode.WRONG_TYPE),
        ("dust", True, ErrorCode.WRONG_TYPE),
        ("lamp", "bright", ErrorCode.WRONG_TYPE),
    ],
)
def test_settings_that_cannot_be_are_refused(name, value, code):
    with pytest.raises(StressbotError) as refusal:
        Optics(**{name: value})
    assert refusal.value.code == code and refusal.value.field == name


@pytest.mark.timing
def test_it_takes_sixty_pictures_a_second():
    """Of 1000 x 1000 pixels with 14 robots, on one core."""
    camera = Camera(1000, 1000, 4e-6)
    microscope = Microscope(camera, [Outline()] * 14, Optics())
    poses = np.random.default_rng(0).uniform((-2e-3, -2e-3, -3), (2e-3, 2e-3, 3), (14, 3))
    microscope.picture(poses, 0.0)
    begin = time.process_time()
    for k in range(30):
        microscope.picture(poses, k / 30)
    assert (time.process_time() - begin) / 30 < 1 / 60
