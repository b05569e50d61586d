"""The tracker relay: `geometry_msgs/PoseArray` of any tracker in, `swarm_poses` out.

A pose array has no ids: pose k is the robot k of `swarm_description`. A robot that the tracker does not see has a NaN
position. Only for backends that see nothing by themselves.
"""

import math
import sys

from geometry_msgs.msg import PoseArray
from stressbot_msgs.bounds import within
from stressbot_msgs.described import AMBIGUOUS, TOPIC, Described
from stressbot_msgs.msg import DriverStatus, SwarmPoses
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.wording import quoted

from stressbot_planner.ros.conversion import FRAME, heading_of
from stressbot_planner.ros.parameters import declare
from stressbot_planner.ros.qos import LATCHED, NEWEST


class TrackerRelayNode(ProcessNode):
    """Gives each pose the id, the swarm and the sequence time that it belongs to."""

    def __init__(self) -> None:
        """Raises StressbotError if a parameter is refused."""
        super().__init__("tracker_relay")
        try:
            declare(self)
        except BaseException:
            self.destroy_node()
            raise
        self._sequence_time = 0.0
        self._wrong = ""
        self._publisher = self.create_publisher(SwarmPoses, "swarm_poses", NEWEST)
        self._described = Described(self, self._on_described)
        self.create_subscription(DriverStatus, "driver_status", within(self, "driver_status", self._on_status), LATCHED)
        self.create_subscription(PoseArray, "tracked_poses", within(self, "tracked_poses", self._on_poses), NEWEST)
        self.get_logger().info("up: poses on tracked_poses are handed on to swarm_poses as soon as a driver describes a swarm")

    def _on_described(self) -> None:
        if self._described.description is not None:
            self.get_logger().info(f"poses are those of swarm {quoted(self._described.description.swarm_id)}")
        elif self._described.is_ambiguous:
            self.get_logger().warning(f"no poses are handed on: {TOPIC} {AMBIGUOUS}")
        else:
            self.get_logger().warning("no poses are handed on: the driver is gone")

    def _on_status(self, message: DriverStatus) -> None:
        self._sequence_time = message.sequence_time

    def _on_poses(self, message: PoseArray) -> None:
        described = self._described.description
        if described is None:
            return
        wrong = ""
        if message.header.frame_id != FRAME:
            wrong = f"frame_id is {quoted(message.header.frame_id)}: give poses in frame '{FRAME}'"
        elif len(message.poses) != len(described.ids):
            wrong = f"has {len(message.poses)} poses for {len(described.ids)} robots: give one each, NaN where one is not seen"
        if wrong and wrong != self._wrong:
            self.get_logger().warning(f"tracked_poses: {wrong}")
        self._wrong = wrong
        if wrong:
            return
        found = [(robot, pose) for robot, pose in zip(described.ids, message.poses, strict=True) if _is_seen(pose)]
        poses = SwarmPoses(swarm_id=described.swarm_id, sequence_time=self._sequence_time)
        poses.header = message.header
        poses.ids = [robot for robot, _ in found]
        poses.x = [pose.position.x for _, pose in found]
        poses.y = [pose.position.y for _, pose in found]
        poses.heading = [heading_of(pose.orientation) for _, pose in found]
        self._publisher.publish(poses)


def _is_seen(pose) -> bool:
    return math.isfinite(pose.position.x) and math.isfinite(pose.position.y) and math.isfinite(heading_of(pose.orientation))


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner tracker_relay`."""
    sys.exit(run("tracker_relay", TrackerRelayNode, args))
