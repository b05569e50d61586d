"""Where a camera looks, as `sensor_msgs/CameraInfo` says it: for those who lay something over its pictures."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo

from stressbot_driver.ros.conversions import FRAME, doubles
from stressbot_driver.vision.camera import Camera

TOPIC = "substrate_camera"


def projection_of(camera: Camera, to_picture: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return where places on the substrate [m] are in the picture [pixels], its distortion undone: an affine map, shape (2, 3).

    `to_picture` takes poses (k, 3) to where the camera would have seen them, had the stage not moved.
    """
    (x, y), step = camera.center, camera.pixel
    seen = to_picture(np.array([[x, y, 0.0], [x + step, y, 0.0], [x, y + step, 0.0]]))
    origin, right, up = replace(camera, distortion=0.0).to_pixels(seen[:, :2])
    linear = np.column_stack([right - origin, up - origin]) / step
    return np.column_stack([linear, origin - linear @ (x, y)])


def farthest(one: np.ndarray, other: np.ndarray, camera: Camera) -> float:
    """Return how far apart two projections, shape (2, 3), take what is in a corner of a camera's picture, pixels."""
    corners = camera.to_substrate(np.array([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)]))
    return float(np.hypot(*((one - other) @ np.column_stack([corners, np.ones(4)]).T)).max())


def camera_info(camera: Camera, projection: np.ndarray, stamp: Time) -> CameraInfo:
    """Return the message of a camera and its projection, shape (2, 3).

    `p` takes x, y, z, 1 [m] of frame `substrate` to pixels of the rectified picture, with a last row of 0, 0, 0, 1: straight down,
    nothing gets smaller with distance. `d` is k1 of `plumb_bob`, with half a diagonal of the picture as the focal length.
    """
    middle = (camera.width - 1) / 2, (camera.height - 1) / 2
    focal = float(np.hypot(camera.width, camera.height)) / 2
    info = CameraInfo(width=camera.width, height=camera.height, distortion_model="plumb_bob")
    info.header.stamp, info.header.frame_id = stamp, FRAME
    info.d = doubles(np.array([camera.distortion, 0.0, 0.0, 0.0, 0.0]))
    info.k = np.array([focal, 0.0, middle[0], 0.0, focal, middle[1], 0.0, 0.0, 1.0])
    info.r = np.eye(3).ravel()
    (a, b, u), (c, d, v) = projection
    info.p = np.array([a, b, 0.0, u, c, d, 0.0, v, 0.0, 0.0, 0.0, 1.0])
    return info
