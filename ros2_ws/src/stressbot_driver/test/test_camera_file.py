"""Camera files: what is written is read, and what cannot be is refused with the field's name."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import load_camera, parse_camera, write_camera
from stressbot_driver.vision.outline import Outline

TEXT = "width: 1000\nheight: 800\npixel: 4e-6\ncenter: [1e-3, 0]\nrotation: 0.1\n"
numbers = st.floats(1e-7, 1e-3)


sizes = st.integers(16, 9000)


@given(st.builds(Camera, sizes, sizes, numbers, st.tuples(numbers, numbers), numbers, numbers, st.floats(0.0, 1.0)))
def test_what_is_written_is_read(tmp_path_factory, camera):
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    for outline in (None, Outline(), Outline(1e-4, 3e-5, (1e-6, -2e-6))):
        write_camera(path, camera, outline)
        assert load_camera(path) == (camera, outline)


def test_what_is_left_out_is_none():
    assert parse_camera(TEXT) == (Camera(1000, 800, 4e-6, (1e-3, 0.0), 0.1, 0.0), None)
    assert parse_camera(TEXT + "latency: 0.085\n")[0].latency == 0.085
    assert parse_camera(TEXT + "outline: {length: 1e-4, width: 5e-5}")[1] == Outline(1e-4, 5e-5)


@pytest.mark.parametrize(
    ("old", "new", "code", "field"),
    [
        ("pixel: 4e-6\n", "", ErrorCode.MISSING_FIELD, "pixel"),
        ("pixel", "pixels", ErrorCode.UNKNOWN_FIELD, "pixels"),
        ("rotation: 0.1", "rotation: 0.1\n'': 1", ErrorCode.UNKNOWN_FIELD, "camera"),
        ("4e-6", "4", ErrorCode.OUT_OF_RANGE, "pixel"),
        ("4e-6", ".nan", ErrorCode.OUT_OF_RANGE, "pixel"),
        ("4e-6", "small", ErrorCode.WRONG_TYPE, "pixel"),
        ("1000", "1000.5", ErrorCode.WRONG_TYPE, "width"),
        ("800", "8", ErrorCode.OUT_OF_RANGE, "height"),
        ("[1e-3, 0]", "[1e-3]", ErrorCode.WRONG_TYPE, "center"),
        ("0.1", "true", ErrorCode.WRONG_TYPE, "rotation"),
        ("rotation: 0.1", "rotation: 0.1\noutline: {length: 1e-4}", ErrorCode.MISSING_FIELD, "outline.width"),
        ("rotation: 0.1", "rotation: 0.1\noutline: 5", ErrorCode.WRONG_TYPE, "outline"),
        ("rotation: 0.1", "rotation: 0.1\ndistortion: 0.2", ErrorCode.OUT_OF_RANGE, "distortion"),
        ("rotation: 0.1", "rotation: 0.1\nlatency: -0.1", ErrorCode.OUT_OF_RANGE, "latency"),
        ("rotation: 0.1", "rotation: 0.1\nlatency: 85", ErrorCode.OUT_OF_RANGE, "latency"),
        ("rotation: 0.1", "rotation: 0.1\nlatency: 85 ms", ErrorCode.WRONG_TYPE, "latency"),
        (TEXT, "- 1", ErrorCode.WRONG_TYPE, "camera"),
        (TEXT, "a: [", ErrorCode.MALFORMED_FILE, "camera"),
        (TEXT, "a: &b 1\nc: *b", ErrorCode.MALFORMED_FILE, "camera"),
    ],
)
def test_what_cannot_be_is_refused(old, new, code, field):
    with pytest.raises(StressbotError) as refusal:
        parse_camera(TEXT.replace(old, new, 1))
    assert (refusal.value.code, refusal.value.field) == (code, field)
    assert ":" in refusal.value.message or "write" in refusal.value.message


def test_files_that_are_not_there_or_are_no_text_are_refused(tmp_path):
    odd, large = tmp_path / "odd", tmp_path / "large"
    odd.write_bytes(b"\xff\xfe\x00")
    large.write_bytes(b"a" * 100_000)
    for path, code in ((tmp_path, ErrorCode.UNREADABLE_FILE), (odd, ErrorCode.UNREADABLE_FILE), (large, ErrorCode.MALFORMED_FILE)):
        with pytest.raises(StressbotError) as refusal:
            load_camera(path)
        assert refusal.value.code == code
    with pytest.raises(StressbotError):
        write_camera(tmp_path / "no" / "camera.yaml", Camera(16, 16, math.pi * 1e-6))
