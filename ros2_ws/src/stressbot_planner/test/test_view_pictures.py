"""Pictures for pages: what is seen at a place of the substrate is shown there; what is no picture of that camera is refused."""

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.view_pictures import MOST_SIDE, registration, shown

MICRO = 1e6


def camera(width=200, height=120, pixel=4e-6, turn=0.0, k1=0.0, offset=(1e-3, 2e-3)):
    """A camera as a tracker tells of it: turned, and with y of the substrate upward."""
    focal, cos, sin = float(np.hypot(width, height)) / 2, np.cos(turn) / pixel, np.sin(turn) / pixel
    u, v = (width - 1) / 2, (height - 1) / 2
    x, y = offset
    info = CameraInfo(width=width, height=height, distortion_model="plumb_bob", d=[k1, 0.0, 0.0, 0.0, 0.0])
    info.k = [focal, 0.0, u, 0.0, focal, v, 0.0, 0.0, 1.0]
    info.p = [cos, sin, 0.0, u - cos * x - sin * y, sin, -cos, 0.0, v - sin * x + cos * y, 0.0, 0.0, 0.0, 1.0]
    return info


def seen_at(info, place):
    """Where a place on the substrate [m] is in the picture, pixels."""
    k = np.reshape(info.k, (3, 3))
    flat = np.reshape(info.p, (3, 4)) @ (*place, 0.0, 1.0)
    ray = np.array([[(flat[0] - k[0, 2]) / k[0, 0], (flat[1] - k[1, 2]) / k[0, 0], 1.0]])
    return cv2.projectPoints(ray, np.zeros(3), np.zeros(3), k, np.array(info.d))[0][0, 0]


def unpacked(picture):
    """The picture that a page draws, and its place, shape (2, 3)."""
    jpeg = np.frombuffer(picture[48:], np.uint8)
    return cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE), np.reshape(struct.unpack("<6d", picture[:48]), (2, 3))


cameras = st.builds(
    camera, st.integers(100, 1500), st.integers(100, 1500), st.floats(1e-6, 1e-5), st.floats(-3, 3), st.floats(-0.1, 0.1)
)


@settings(max_examples=30, deadline=None)
@given(cameras, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_a_speck_is_shown_where_it_lies(info, along, across):
    pixel = 1 / np.hypot(info.p[0], info.p[4])
    place = np.array([1e-3, 2e-3]) + 0.35 * pixel * min(info.width, info.height) * np.array([along, across])
    picture = np.zeros((info.height, info.width), np.uint8)
    v, u = np.mgrid[: info.height, : info.width]
    at = seen_at(info, place)
    picture = np.round(250 * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * 3.0**2))).astype(np.uint8)
    grey, where = unpacked(shown(cv2.imencode(".png", picture)[1].tobytes(), registration(info)))
    assert max(grey.shape) <= MOST_SIDE
    weight = np.where(grey > 40, grey, 0).astype(float)
    v, u = np.mgrid[: grey.shape[0], : grey.shape[1]]
    middle = np.array([(weight * u).sum(), (weight * v).sum(), weight.sum()]) / weight.sum()
    off = where @ middle - MICRO * place
    assert np.hypot(*off) < 0.25 * MICRO * pixel * max(info.width / grey.shape[1], 1.0)


@pytest.mark.parametrize(
    ("changes", "code", "field"),
    [
        ({"width": 0}, ErrorCode.OUT_OF_RANGE, "substrate_camera"),
        ({"height": 20_000}, ErrorCode.OUT_OF_RANGE, "substrate_camera"),
        ({"p": [0.0] * 12}, ErrorCode.UNSUPPORTED, "substrate_camera.p"),
        ({"p": [float("nan")] * 12}, ErrorCode.UNSUPPORTED, "substrate_camera.p"),
        ({"d": [0.1]}, ErrorCode.UNSUPPORTED, "substrate_camera.d"),
        ({"d": [0.1, 0.0, 0.0, 0.0, float("inf")]}, ErrorCode.UNSUPPORTED, "substrate_camera.d"),
        ({"d": [0.1] * 5, "distortion_model": "equidistant"}, ErrorCode.UNSUPPORTED, "substrate_camera.d"),
        ({"d": [0.1] * 5, "k": [0.0] * 9}, ErrorCode.OUT_OF_RANGE, "substrate_camera.k"),
    ],
)
def test_what_is_no_camera_is_refused(changes, code, field):
    info = camera()
    for name, value in changes.items():
        setattr(info, name, value)
    with pytest.raises(StressbotError) as refusal:
        registration(info)
    assert (refusal.value.code, refusal.value.field) == (code, field)


def test_what_is_no_picture_of_that_camera_is_refused():
    where = registration(camera())
    good = cv2.imencode(".jpg", np.zeros((120, 200), np.uint8))[1].tobytes()
    assert unpacked(shown(good, where))[0].shape == (120, 200)
    other = cv2.imencode(".png", np.zeros((200, 120), np.uint8))[1].tobytes()
    for data, code in (
        (b"", ErrorCode.MALFORMED_FILE),
        (good[:30], ErrorCode.MALFORMED_FILE),
        (b"\x89PNG\r\n\x1a\n" + bytes(8) + (200).to_bytes(4, "big") + (120).to_bytes(4, "big"), ErrorCode.MALFORMED_FILE),
        (other, ErrorCode.WRONG_COUNT),
        (b"\x89PNG\r\n\x1a\n" + bytes(8) + b"\xff" * 8, ErrorCode.WRONG_COUNT),
    ):
        with pytest.raises(StressbotError) as refusal:
            shown(data, where)
        assert refusal.value.code == code
