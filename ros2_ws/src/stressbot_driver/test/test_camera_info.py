"""What is said of a camera leads OpenCV, and whoever multiplies matrices, to the same pixels as the camera's own formula."""

import cv2
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.ros.camera_info import camera_info, farthest, projection_of
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.stage import StageFilter

cameras = st.builds(
    Camera,
    st.integers(16, 2000),
    st.integers(16, 2000),
    st.floats(1e-7, 1e-4),
    st.tuples(st.floats(-1e-2, 1e-2), st.floats(-1e-2, 1e-2)),
    st.floats(-6, 6),
    st.floats(-0.1, 0.1),
)
offsets = st.tuples(st.floats(-1e-4, 1e-4), st.floats(-1e-4, 1e-4), st.floats(-0.1, 0.1))


@given(cameras, offsets, st.integers(0, 2**32 - 1))
def test_a_place_is_seen_where_the_camera_sees_it(camera, offset, seed):
    stage = StageFilter(camera.center, camera.pixel, camera.pixel * camera.width)
    stage.state[:3] = offset
    pixels = np.random.default_rng(seed).uniform((0, 0), (camera.width - 1, camera.height - 1), (20, 2))
    places = stage.to_substrate(np.column_stack([camera.to_substrate(pixels), np.zeros(20)]))[:, :2]
    info = camera_info(camera, projection_of(camera, stage.to_picture), Time())
    matrix = np.reshape(info.p, (3, 4))
    flat = matrix @ np.column_stack([places, np.zeros(20), np.ones(20)]).T
    assert np.all(flat[2] == 1.0)
    k = np.reshape(info.k, (3, 3))
    rays = np.column_stack([(flat[:2].T - k[:2, 2]) / k[0, 0], np.ones(20)])
    seen, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), k, np.array(info.d))
    np.testing.assert_allclose(seen[:, 0], pixels, atol=1e-5)


def test_a_stage_that_moves_is_told_by_pixels():
    camera = Camera(200, 100, 1e-6, (1e-3, 2e-3), 0.3)
    before, after = StageFilter(camera.center, 1e-6, 1e-4), StageFilter(camera.center, 1e-6, 1e-4)
    after.state[:3] = 3e-6, -4e-6, 0.0
    both = [projection_of(camera, stage.to_picture) for stage in (before, after)]
    assert farthest(*both, camera) == pytest.approx(5.0)
    after.state[2] = 0.01
    turned = projection_of(camera, after.to_picture)
    assert farthest(both[1], turned, camera) == pytest.approx(0.01 * np.hypot(99.5, 49.5), rel=1e-3)
