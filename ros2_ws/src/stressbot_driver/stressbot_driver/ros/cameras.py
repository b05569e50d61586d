"""Which camera looks at a described swarm, and what it sees of each robot."""

import numpy as np
from stressbot_msgs.msg import SwarmDescription

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.parameters import Declaration
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import load_camera
from stressbot_driver.vision.outline import Outline

BENCH = "bench"
"""Instead of a camera file: a camera that sees walls, starts and goals from straight above. Only where pictures are simulated."""

_MARGIN = 2.0
"""Around them, in lengths of the largest robot."""

CAMERA = Declaration(
    "camera",
    "",
    f"Path of the camera file, or {BENCH}: simulated pictures of all that the scenario names, 1000 x 1000 pixels. Required.",
    read_only=True,
)


def load(name: str) -> tuple[Camera, Outline | None] | None:
    """Return what the file that the parameter names says; None for `bench`. Raises StressbotError."""
    if not name:
        raise StressbotError(ErrorCode.MISSING_FIELD, CAMERA.name, f"is not set: give the path of a camera file, or {BENCH}")
    return None if name == BENCH else load_camera(name)


def seen(loaded: tuple[Camera, Outline | None] | None, description: SwarmDescription) -> tuple[Camera, list[Outline]]:
    """Return the camera, and an outline per robot in the order of a description that was checked."""
    camera, outline = loaded or (None, None)
    outlines = [outline or Outline.of(radius) for radius in description.body_radius]
    if camera is None:
        corners = np.reshape(description.workspace, (-1, 2)).T
        places = [np.reshape(description.start, (-1, 3))[:, :2], np.reshape(description.goal, (-1, 2)), corners.reshape(-1, 2)]
        camera = Camera.over(np.vstack(places), _MARGIN * max(one.length for one in outlines))
    return camera, outlines
