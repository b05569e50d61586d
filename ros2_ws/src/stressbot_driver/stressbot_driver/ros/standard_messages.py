"""Poses in the messages that everybody's tools know: a pose array, and transforms for tf. In metres, frame `substrate`."""

import importlib
import math
from collections.abc import Iterator

from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion, Transform, TransformStamped, Vector3
from stressbot_msgs.msg import SwarmDescription, SwarmPoses

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.conversions import FRAME

MOST_FRAMES = 100
"""Robots that have a frame each; every listener of tf keeps ten seconds of all frames."""


def pose_array(description: SwarmDescription, poses: SwarmPoses) -> PoseArray:
    """Return the poses of the robots that were seen, in the order of `swarm_poses`; RViz refuses whole arrays for one NaN."""
    message = PoseArray(
        poses=[Pose(position=Point(x=x, y=y), orientation=_about_z(heading)) for _, x, y, heading in _seen(description, poses)]
    )
    message.header.stamp = poses.header.stamp
    message.header.frame_id = FRAME
    return message


def transforms(description: SwarmDescription, poses: SwarmPoses) -> list[TransformStamped]:
    """Return where the frame `robot_N` of each robot that was seen lies."""
    found = []
    for robot, x, y, heading in _seen(description, poses):
        place = Transform(translation=Vector3(x=x, y=y), rotation=_about_z(heading))
        one = TransformStamped(child_frame_id=f"robot_{robot}", transform=place)
        one.header.stamp = poses.header.stamp
        one.header.frame_id = FRAME
        found.append(one)
    return found


def transform_message() -> type:
    """Return `tf2_msgs/msg/TFMessage`. Raises StressbotError UNSUPPORTED where it is not installed: the wheels do not have it."""
    try:
        return importlib.import_module("tf2_msgs.msg").TFMessage
    except ImportError as error:
        raise StressbotError(
            ErrorCode.UNSUPPORTED, "tf", "cannot be true, tf2_msgs is not installed: sudo apt install ros-jazzy-tf2-msgs"
        ) from error


def _seen(description: SwarmDescription, poses: SwarmPoses) -> Iterator[tuple[int, float, float, float]]:
    known = set(description.ids)
    for robot, x, y, heading in zip(poses.ids, poses.x, poses.y, poses.heading, strict=True):
        if robot in known and math.isfinite(x) and math.isfinite(y) and math.isfinite(heading):
            yield robot, x, y, heading


def _about_z(heading: float) -> Quaternion:
    return Quaternion(z=math.sin(heading / 2), w=math.cos(heading / 2))
