"""Cameras and their pictures: camera files, messages with pictures, and what is told of a camera, as tracker and page read them."""

from array import array
from typing import Any

import cv2
import numpy as np
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from stressbot_msgs.stamps import nanoseconds

from fuzzing.files import YAML_TOKENS, as_yaml, written
from fuzzing.interface import ACCEPTED, Interface, Violation, outcome
from fuzzing.strategies import NAMES, NUMBERS, damaged, fields_of, messages, spliced
from stressbot_driver.ros.camera_info import camera_info, projection_of
from stressbot_driver.ros.grey_pictures import _ENCODINGS, decoded, grey_of_compressed, grey_of_image
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import load_camera, parse_camera
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.plausibility import Plausibility, darkness
from stressbot_planner.ros.view_pictures import registration, shown

cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

WIDTH, HEIGHT = 48, 32
CAMERA = Camera(WIDTH, HEIGHT, 4e-6, (1e-3, -2e-3), 0.3, 0.05)
FILE = {
    **vars(CAMERA), "center": list(CAMERA.center), "outline": {"length": 120e-6, "width": 60e-6, "pivot": [-1e-5, 0.0]},
}
GREY = (np.add.outer(np.arange(HEIGHT), 3 * np.arange(WIDTH)) % 200 + 20).astype(np.uint8)
INFO = camera_info(CAMERA, projection_of(CAMERA, lambda poses: poses), Header().stamp)
WHERE = registration(INFO)


def _encoded(suffix: str, picture: np.ndarray, *settings: int) -> bytes:
    return cv2.imencode(suffix, picture, settings)[1].tobytes()


COMPRESSED = [
    _encoded(".jpg", GREY),
    _encoded(".jpg", GREY, cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
    _encoded(".jpg", cv2.cvtColor(GREY, cv2.COLOR_GRAY2BGR)),
    _encoded(".png", GREY),
    _encoded(".png", (GREY.astype(np.uint16) << 8)),
    _encoded(".png", np.dstack([GREY] * 4)),
    *(_encoded(suffix, GREY) for suffix in (".bmp", ".tiff", ".webp", ".pgm")),
]


@st.composite
def _spoilt(draw: Any, most: int = 4) -> bytes:
    """A good compressed picture, cut, doubled, with other bytes here and there, at the beginning most often."""
    data = bytearray(draw(st.sampled_from(COMPRESSED)))
    for _ in range(draw(st.sampled_from([0, 1, 1, 2, most]))):
        at = draw(st.one_of(st.integers(0, min(60, len(data))), st.integers(0, len(data))))
        end = min(len(data), at + draw(st.sampled_from([0, 1, 1, 2, 4, 30])))
        match draw(st.sampled_from(["bytes", "bytes", "cut", "double", "end"])):
            case "bytes":
                data[at:end] = draw(st.one_of(st.sampled_from([b"\xff", b"\xff\xff\xff\xff", bytes(4)]), st.binary(max_size=8)))
            case "cut":
                del data[at:end]
            case "double":
                data[at:at] = data[at:end] * 3
            case _:
                del data[at:]
    return bytes(data)


_data = st.one_of(_spoilt(), _spoilt(), st.binary(max_size=60)).map(lambda data: array("B", data))
compressed = messages(CompressedImage, format=st.sampled_from(["jpeg", "png", "mono8; jpeg compressed"]) | NAMES, data=_data)


@st.composite
def images(draw: Any) -> Image:
    """Messages with pictures that are not compressed, most of them nearly right."""
    encoding = draw(st.sampled_from(sorted(_ENCODINGS)))
    size = _ENCODINGS[encoding][0]
    step = size * WIDTH + draw(st.sampled_from([0, 0, 1, 7]))
    data = array("B", draw(st.sampled_from([bytes(1), b"\x80", b"\xff\x00\x31"])) * (step * HEIGHT))[: step * HEIGHT]
    return draw(messages(Image, width=WIDTH, height=HEIGHT, encoding=encoding, step=step, data=data, is_bigendian=0))


@st.composite
def infos(draw: Any) -> CameraInfo:
    """What is told of a camera: fields of a fixed length are of that length on the wire."""
    changes: dict[str, st.SearchStrategy] = {
        "width": st.integers(0, 3 * WIDTH) | st.just(2**32 - 1),
        "height": st.integers(0, 3 * HEIGHT) | st.just(2**32 - 1),
        "distortion_model": NAMES,
        "d": st.lists(NUMBERS, max_size=9),
        "k": _with_some_changed(list(INFO.k)),
        "p": _with_some_changed(list(INFO.p)),
    }
    values = fields_of(INFO)
    for name in sorted(draw(st.sets(st.sampled_from(sorted(changes)), max_size=3))):
        values[name] = draw(changes[name])
    return CameraInfo(**values)


def _with_some_changed(values: list[float]) -> st.SearchStrategy[list[float]]:
    return st.dictionaries(st.integers(0, len(values) - 1), NUMBERS, max_size=3).map(
        lambda changes: [changes.get(place, value) for place, value in enumerate(values)]
    )


def read_camera(text: str) -> str:
    """As tracker and simulated camera read a camera file, and as the page reads what is told of it."""

    def use() -> None:
        camera, outline = parse_camera(text)
        corners = np.array([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)], dtype=float)
        places = camera.to_substrate(corners)
        if not np.allclose(camera.to_pixels(places), corners, atol=1e-3):
            raise Violation(f"a picture of {camera} is not where it is")
        if not np.isfinite((outline or Outline()).at(np.array([*camera.center, 1.0]))).all():
            raise Violation(f"{outline} is nowhere")
        where = registration(camera_info(camera, projection_of(camera, lambda poses: poses), Header().stamp))
        middle = where.place @ [(where.shrunk[0] - 1) / 2, (where.shrunk[1] - 1) / 2, 1.0]
        if not np.allclose(middle, 1e6 * np.array(camera.center), atol=1e-3):
            raise Violation(f"the page shows {camera} at {middle}")

    return outcome(use)


def read_camera_bytes(content: bytes) -> str:
    """A camera file of any bytes."""
    path = written(content)
    return outcome(lambda: load_camera(path))


def read_image(message: Image) -> str:
    """As the tracker reads a picture."""
    return outcome(lambda: _take(grey_of_image(message, WIDTH, HEIGHT), message))


def read_compressed(message: CompressedImage) -> str:
    """As tracker, calibration and page read a compressed picture."""
    decoded(message)
    result = outcome(lambda: _take(grey_of_compressed(message, WIDTH, HEIGHT), message))
    if outcome(lambda: shown(message.data, WHERE)) != result:
        raise Violation("the page takes what the tracker refuses, or the other way round")
    return result


def _take(picture: np.ndarray, message: Image | CompressedImage) -> None:
    if picture.shape != (HEIGHT, WIDTH) or picture.dtype != np.uint8:
        raise Violation(f"a picture has {picture.shape}, {picture.dtype}")
    plausibility = Plausibility()
    for _ in range(2):
        plausibility.problem(picture, nanoseconds(message.header.stamp))
    darkness(picture)


def read_info(message: CameraInfo) -> str:
    """As the page reads what is told of a camera."""

    def use() -> None:
        where = registration(message)
        if where.size == (WIDTH, HEIGHT):
            shown(COMPRESSED[0], where)

    return outcome(use)


INTERFACES = (
    Interface("camera file", st.one_of(damaged(FILE).map(as_yaml), spliced([as_yaml(FILE)], YAML_TOKENS)), read_camera, 2),
    Interface(
        "camera file, bytes",
        st.one_of(st.binary(max_size=80), spliced([as_yaml(FILE)], YAML_TOKENS).map(lambda text: text.encode("utf-8", "replace"))),
        read_camera_bytes,
        0.5,
    ),
    Interface("image_raw, tracker", images(), read_image, 2),
    Interface("image_raw/compressed, tracker and page", compressed, read_compressed, 2),
    Interface("substrate_camera, page", infos(), read_info),
)
assert read_compressed(CompressedImage(data=array("B", COMPRESSED[0]))) == ACCEPTED
