"""Messages with pictures become grey levels, or are refused with a sentence."""

from array import array

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import CompressedImage, Image
from stressbot_msgs.picture_size import picture_size

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.grey_pictures import decoded, grey_of_compressed, grey_of_image

SHAPE = HEIGHT, WIDTH = 24, 32
GREY = (np.add.outer(np.arange(HEIGHT), 2 * np.arange(WIDTH)) + 40).astype(np.uint8)


def image(pixels, encoding, padding=0):
    rows = pixels.reshape(HEIGHT, -1)
    rows = np.hstack([rows, np.full((HEIGHT, padding), 7, dtype=np.uint8)])
    return Image(height=HEIGHT, width=WIDTH, encoding=encoding, step=rows.shape[1], data=array("B", rows.tobytes()))


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "rgb8", "bgr8", "rgba8", "bgra8"])
@pytest.mark.parametrize("padding", [0, 5])
def test_grey_is_grey_in_every_encoding(encoding, padding):
    channels = {"m": 1, "8": 1}.get(encoding[0], 4 if "a" in encoding else 3)
    pixels = np.repeat(GREY[..., None], channels, axis=2)
    np.testing.assert_array_equal(grey_of_image(image(pixels, encoding, padding), WIDTH, HEIGHT), GREY)


@pytest.mark.parametrize("encoding, red_at", [("rgb8", 0), ("bgr8", 2)])
def test_colours_are_not_exchanged(encoding, red_at):
    pixels = np.zeros((*SHAPE, 3), dtype=np.uint8)
    pixels[..., red_at] = 200
    assert np.all(np.abs(grey_of_image(image(pixels, encoding), WIDTH, HEIGHT) - 0.299 * 200) < 1.0)


@pytest.mark.parametrize("name, red", [("rggb", (0, 0)), ("bggr", (1, 1)), ("gbrg", (1, 0)), ("grbg", (0, 1))])
def test_a_bayer_pattern_has_its_red_where_its_name_says(name, red):
    pixels = np.zeros(SHAPE, dtype=np.uint8)
    pixels[red[0] :: 2, red[1] :: 2] = 200
    grey = grey_of_image(image(pixels, f"bayer_{name}8"), WIDTH, HEIGHT)
    assert np.all(np.abs(grey[2:-2, 2:-2] - 0.299 * 200) < 2.0)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_pictures_are_read(suffix):
    data = array("B", cv2.imencode(suffix, GREY)[1].tobytes())
    grey = grey_of_compressed(CompressedImage(format=suffix[1:], data=data), WIDTH, HEIGHT)
    assert np.abs(grey.astype(int) - GREY).max() <= (0 if suffix == ".png" else 4)


def bare(width, step, size, encoding="mono8"):
    return Image(height=HEIGHT, width=width, encoding=encoding, step=step, data=bytes(size))


@pytest.mark.parametrize(
    "message, code, word",
    [
        (image(GREY, "mono16"), ErrorCode.UNSUPPORTED, "mono8"),
        (image(GREY, ""), ErrorCode.UNSUPPORTED, "encoding"),
        (bare(31, 31, 31 * HEIGHT), ErrorCode.WRONG_COUNT, "camera file says"),
        (bare(WIDTH, WIDTH, 3), ErrorCode.WRONG_COUNT, "3 bytes"),
        (bare(WIDTH, WIDTH, WIDTH * HEIGHT, "rgb8"), ErrorCode.WRONG_COUNT, "step"),
    ],
)
def test_what_is_no_picture_of_this_camera_is_refused(message, code, word):
    with pytest.raises(StressbotError, match=word) as refused:
        grey_of_image(message, WIDTH, HEIGHT)
    assert refused.value.code is code


@pytest.mark.parametrize("data", [b"", b"no picture"])
def test_what_is_no_compressed_picture_is_refused(data):
    with pytest.raises(StressbotError, match="decoded") as refused:
        grey_of_compressed(CompressedImage(format="jpeg", data=array("B", data)), WIDTH, HEIGHT)
    assert refused.value.code is ErrorCode.MALFORMED_FILE


@given(st.integers(1, 300), st.integers(1, 300), st.sampled_from([".png", ".jpg"]), st.booleans())
def test_the_size_is_in_the_first_bytes(width, height, suffix, is_colour):
    picture = np.zeros((height, width, 3) if is_colour else (height, width), np.uint8)
    data = cv2.imencode(suffix, picture)[1].tobytes()
    assert picture_size(data) == picture_size(array("B", data)) == (width, height)
    assert decoded(CompressedImage(data=array("B", data))).shape == (height, width)


def claiming(width, height):
    """A PNG of 24 bytes that claims a size."""
    return b"\x89PNG\r\n\x1a\n" + bytes(8) + width.to_bytes(4, "big") + height.to_bytes(4, "big")


def test_what_claims_to_be_huge_is_never_decoded(monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", None)  # which would ask for the memory, or raise what nobody expects
    message = CompressedImage(data=array("B", claiming(60_000, 60_000)))
    assert decoded(message) is None
    with pytest.raises(StressbotError, match="60000 x 60000 pixels, the camera file says 32 x 24") as refused:
        grey_of_compressed(message, WIDTH, HEIGHT)
    assert refused.value.code is ErrorCode.WRONG_COUNT


@pytest.mark.parametrize("suffix", [".bmp", ".tiff", ".webp"])
def test_other_formats_are_refused(suffix):
    data = cv2.imencode(suffix, GREY)[1].tobytes()
    with pytest.raises(StressbotError, match="JPEG or PNG"):
        grey_of_compressed(CompressedImage(data=array("B", data)), WIDTH, HEIGHT)
