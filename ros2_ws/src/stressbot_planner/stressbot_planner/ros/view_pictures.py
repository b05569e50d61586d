"""The microscope's pictures for pages: heard only while somebody looks, some a second, and made small on a thread of their own."""

import struct
import time
from array import array
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage
from stressbot_msgs.bounds import within
from stressbot_msgs.picture_size import picture_size

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.qos import LATCHED
from stressbot_planner.view.scene import MICRO

PICTURES, CAMERA = "image_raw/compressed", "substrate_camera"

APART = 0.25
"""s from one picture to the next, at least"""

MOST_SIDE, MOST_BYTES, LARGEST_SIDE = 1000, 16_000_000, 10_000
"""Pixels of what is shown; bytes and pixels of what is looked at."""

QUALITY = 75
"""Of the JPEG that is shown."""

WITHIN = 3.0
"""s in which somebody must have said where the camera looks."""

# One that is lost is no loss, and a page that is slow must not hold up the camera.
NEWEST_PICTURE = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass(frozen=True, eq=False)
class Registration:
    """Where pictures lie on the substrate.

    Attributes:
        size: width and height of a picture as it comes, pixels.
        shrunk: of the picture as it is shown.
        maps: those of `cv2.remap` that undo the lens; None where it does not distort.
        place: the affine map from pixels that are shown to the substrate, µm, shape (2, 3).
    """

    size: tuple[int, int]
    shrunk: tuple[int, int]
    maps: tuple[np.ndarray, np.ndarray] | None
    place: np.ndarray


def registration(info: CameraInfo) -> Registration:
    """Return what `substrate_camera` says.

    Raises:
        StressbotError: UNSUPPORTED or OUT_OF_RANGE.
    """
    size = int(info.width), int(info.height)
    if not 0 < min(size) <= max(size) <= LARGEST_SIDE:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, CAMERA, f"says {size[0]} x {size[1]} pixels: give 1 to {LARGEST_SIDE}")
    camera, lens, projection = np.reshape(info.k, (3, 3)), np.array(info.d), np.reshape(info.p, (3, 4))
    flat = projection[:2, [0, 1, 3]]
    if not (np.isfinite(projection).all() and np.array_equal(projection[2], (0, 0, 0, 1)) and abs(np.linalg.det(flat[:, :2])) > 0):
        message = "has a projection that is no affine map of the substrate: its last row must be 0, 0, 0, 1"
        raise StressbotError(ErrorCode.UNSUPPORTED, f"{CAMERA}.p", message)
    if lens.any() and not (info.distortion_model == "plumb_bob" and len(lens) == 5 and np.abs(lens).max() < 1):
        raise StressbotError(ErrorCode.UNSUPPORTED, f"{CAMERA}.d", "cannot be undone: use plumb_bob, five numbers below 1")
    if lens.any() and not (np.isfinite(camera).all() and abs(np.linalg.det(camera)) > 0):
        raise StressbotError(ErrorCode.OUT_OF_RANGE, f"{CAMERA}.k", "is no camera: give focal length and middle, in pixels")
    scale = min(1.0, MOST_SIDE / max(size))
    shrunk = max(1, round(scale * size[0])), max(1, round(scale * size[1]))
    # Centres of pixels are whole numbers: those of the shown picture, in the one that comes.
    ratio = np.divide(size, shrunk)
    larger = np.column_stack([np.diag(ratio), (ratio - 1.0) / 2])
    inverse = np.linalg.inv(flat[:, :2])
    back = np.column_stack([inverse, -inverse @ flat[:, 2]])
    place = MICRO * back @ np.vstack([larger, [0.0, 0.0, 1.0]])
    if not np.isfinite(place).all():
        raise StressbotError(ErrorCode.OUT_OF_RANGE, f"{CAMERA}.p", "has a scale that cannot be: give pixels of metres")
    return Registration(size, shrunk, _undoing(camera, lens, larger, shrunk) if lens.any() else None, place)


def _undoing(camera: np.ndarray, lens: np.ndarray, larger: np.ndarray, shrunk: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    small = np.linalg.inv(np.vstack([larger, [0.0, 0.0, 1.0]])) @ camera
    first, second = cv2.initUndistortRectifyMap(small, lens, np.eye(3), small, shrunk, cv2.CV_16SC2)
    return first, second


def shown(data: bytes | array, where: Registration) -> bytes:
    """Return what pages get of a JPEG or PNG: six doubles, which are `place` row by row, and a grey JPEG, small and undistorted.

    Raises:
        StressbotError: MALFORMED_FILE or WRONG_COUNT.
    """
    size = picture_size(data)
    if size is not None and size != where.size:
        told = f"has {size[0]} x {size[1]} pixels, {CAMERA} says {where.size[0]} x {where.size[1]}: calibrate this camera"
        raise StressbotError(ErrorCode.WRONG_COUNT, PICTURES, told)
    grey = None
    if size is not None:
        try:
            grey = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:
            grey = None
    if grey is None:
        raise StressbotError(ErrorCode.MALFORMED_FILE, PICTURES, "cannot be decoded: send JPEG or PNG, as image_transport does")
    if where.shrunk != where.size:
        grey = cv2.resize(grey, where.shrunk, interpolation=cv2.INTER_AREA)
    if where.maps is not None:
        grey = cv2.remap(grey, *where.maps, cv2.INTER_LINEAR)
    _, jpeg = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return struct.pack("<6d", *where.place.ravel()) + jpeg.tobytes()


class PictureFeed:
    """Hears pictures while somebody looks. All of it belongs to the executor's thread, but for the work on a picture."""

    def __init__(self, node: Node, show: Callable[[bytes], None], say: Callable[[str], None]) -> None:
        """`show` takes what `shown` returns, `say` a line; both on a thread of this feed's."""
        cv2.setNumThreads(1)
        self._node, self._show, self._say = node, show, say
        self._heard: tuple[Subscription, Subscription] | None = None
        self._where: Registration | None = None
        self._begun = self._taken = 0.0
        self._problem = ""
        self._worker = ThreadPoolExecutor(1, "pictures")
        self._work: Future | None = None

    @property
    def is_there(self) -> bool:
        """Whether somebody publishes pictures."""
        return bool(self._node.count_publishers(PICTURES))

    def look(self, is_wanted: bool) -> None:
        """Hear pictures from now on, or no more."""
        if is_wanted and self._heard is None:
            self._begun, self._problem, self._where = time.monotonic(), "", None
            self._heard = (
                self._node.create_subscription(CompressedImage, PICTURES, self._on_picture, NEWEST_PICTURE, raw=True),
                self._node.create_subscription(CameraInfo, CAMERA, within(self._node, CAMERA, self._on_camera), LATCHED),
            )
        elif not is_wanted and self._heard is not None:
            for subscription in self._heard:
                self._node.destroy_subscription(subscription)
            self._heard = None

    def close(self) -> None:
        """Wait for the end of the last work."""
        self._worker.shutdown(cancel_futures=True)

    def _on_camera(self, message: CameraInfo) -> None:
        try:
            self._where = registration(message)
        except StressbotError as error:
            self._where = None
            self._tell(str(error))

    def _on_picture(self, data: bytes) -> None:
        now = time.monotonic()
        if now < self._taken + APART or (self._work is not None and not self._work.done()):
            return
        if self._where is None:
            if now > self._begun + WITHIN:
                self._tell(f"{CAMERA}: nobody says where the camera looks: start camera_tracker")
            return
        self._taken = now
        self._work = self._worker.submit(self._make, data, self._where)

    def _make(self, data: bytes, where: Registration) -> None:
        try:
            if len(data) > MOST_BYTES:
                raise StressbotError(ErrorCode.LIMIT_EXCEEDED, PICTURES, f"has {len(data)} bytes, the most is {MOST_BYTES}")
            self._show(shown(deserialize_message(data, CompressedImage).data, where))
            self._problem = ""
        except StressbotError as error:
            self._tell(str(error))

    def _tell(self, problem: str) -> None:
        """Say what is wrong, once."""
        if problem != self._problem:
            self._problem = problem
            self._say(f"no picture: {problem}")
