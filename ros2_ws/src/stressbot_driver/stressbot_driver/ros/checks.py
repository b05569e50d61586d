"""Checks of messages that anybody may have published, for nodes that draw, show and track."""

from collections.abc import Callable
from typing import TypeVar

from rclpy.node import Node
from stressbot_msgs.msg import SwarmDescription, SwarmPoses

from stressbot_driver.errors import ErrorCode, StressbotError

Message = TypeVar("Message")


def check_description(description: SwarmDescription) -> None:
    """Raise StressbotError unless there is all that is drawn and tracked: who publishes a description may be anybody."""
    count = len(description.ids)
    wanted = {"body_radius": count, "turning_radius": count, "start": 3 * count, "goal": 2 * count}
    wanted["workspace"] = 4 * bool(description.workspace)
    for name, length in wanted.items():
        if len(getattr(description, name)) != length or count == 0:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, name, f"has {len(getattr(description, name))} entries for {count} robots: send {length}"
            )
    for index, obstacle in enumerate(description.obstacles):
        if len(obstacle.x) != len(obstacle.y) or len(obstacle.x) == 0:
            raise StressbotError(ErrorCode.WRONG_COUNT, f"obstacles[{index}]", "needs as many y as x, at least one")


def check_poses(poses: SwarmPoses) -> None:
    """Raise StressbotError unless each robot has a place and a heading."""
    for name in ("x", "y", "heading"):
        if len(getattr(poses, name)) != len(poses.ids):
            raise StressbotError(ErrorCode.WRONG_COUNT, name, f"has {len(getattr(poses, name))} entries: send {len(poses.ids)}")


def passes(node: Node, check: Callable[[Message], None], message: Message) -> bool:
    """Whether a message passes a check. Why it does not is a warning, once a second."""
    try:
        check(message)
    except StressbotError as error:
        node.get_logger().warning(str(error), throttle_duration_sec=1.0)
        return False
    return True
