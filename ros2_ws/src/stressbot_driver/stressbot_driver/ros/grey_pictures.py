"""Messages with pictures to grey levels."""

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image
from stressbot_msgs.picture_size import picture_size
from stressbot_msgs.wording import quoted

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.camera_file import SIZE

_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, None),
    "8UC1": (1, None),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    # OpenCV names the second row's second and third pixel.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2GRAY),
}
"""Bytes a pixel, and how to make grey of them."""


def grey_of_image(message: Image, width: int, height: int) -> np.ndarray:
    """Return the picture, shape (height, width), uint8.

    Raises:
        StressbotError: UNSUPPORTED, WRONG_COUNT.
    """
    if message.encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise StressbotError(
            ErrorCode.UNSUPPORTED, "image_raw.encoding", f"is {quoted(message.encoding)}: set the camera to one of {known}"
        )
    _check_size("image_raw", message.width, message.height, width, height)
    size, conversion = _ENCODINGS[message.encoding]
    if message.step < size * width or len(message.data) != message.step * height:
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            "image_raw.data",
            f"has {len(message.data)} bytes and step {message.step} for {width} x {height} pixels of {size}: mend the driver",
        )
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, message.step)[:, : size * width]
    if conversion is None:
        return rows
    return cv2.cvtColor(np.ascontiguousarray(rows.reshape((height, width, size) if size > 1 else (height, width))), conversion)


def grey_of_compressed(message: CompressedImage, width: int, height: int) -> np.ndarray:
    """As `grey_of_image`. What has another size is not decoded. Raises StressbotError MALFORMED_FILE, WRONG_COUNT."""
    size = picture_size(message.data)
    if size is not None:
        _check_size("image_raw/compressed", *size, width, height)
    picture = decoded(message)
    if picture is None:
        raise StressbotError(
            ErrorCode.MALFORMED_FILE, "image_raw/compressed.data", "cannot be decoded: send JPEG or PNG, as image_transport does"
        )
    return picture


def decoded(message: CompressedImage) -> np.ndarray | None:
    """Return the picture, shape (height, width), uint8, as it lies in the file; None if it is none, or larger than any camera's."""
    size = picture_size(message.data)
    if size is None or max(size) > SIZE[1]:
        return None
    try:
        picture = cv2.imdecode(np.frombuffer(message.data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    return picture if picture is not None and picture.shape == size[::-1] else None


def _check_size(topic: str, width: int, height: int, wanted_width: int, wanted_height: int) -> None:
    if (width, height) != (wanted_width, wanted_height):
        raise StressbotError(
            ErrorCode.WRONG_COUNT,
            topic,
            f"has {width} x {height} pixels, the camera file says {wanted_width} x {wanted_height}: calibrate this camera",
        )
