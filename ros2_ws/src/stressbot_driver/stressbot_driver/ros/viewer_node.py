"""The viewer node: swarm description and poses in; markers for RViz, a pose array and transforms out."""

import sys
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from stressbot_msgs.bounds import within
from stressbot_msgs.described import AMBIGUOUS, TOPIC, Described
from stressbot_msgs.msg import SwarmDescription, SwarmPoses
from stressbot_msgs.process import ProcessNode, run
from visualization_msgs.msg import MarkerArray

from stressbot_driver.ros.checks import check_description, check_poses, passes
from stressbot_driver.ros.markers import fixed_markers, robot_markers
from stressbot_driver.ros.parameters import Declaration, declare_all, first_problem, number_of, value_of
from stressbot_driver.ros.qos import MARKERS, NEWEST, TRANSFORMS
from stressbot_driver.ros.standard_messages import MOST_FRAMES, pose_array, transform_message, transforms

FIXED_PERIOD = 2.0  # [s] walls and obstacles again, for an RViz that was started later

PARAMETERS = (
    Declaration("view_scale", 1000.0, "Magnification of lengths in frame substrate_view.", low=1e-3, high=1e9, read_only=True),
    Declaration("view_rate", 20.0, "[Hz] Updates per second, at most.", low=0.1, high=100.0, read_only=True),
    Declaration("tf", False, f"Publish transforms substrate -> robot_N, for up to {MOST_FRAMES} robots.", read_only=True),
)


class _Output:
    """A topic on which the newest poses are told once, as soon as somebody listens: at rest a slow tracker may say them once."""

    def __init__(self, publisher: Publisher, make: Callable[[SwarmDescription, SwarmPoses], Any]) -> None:
        self._publisher, self._make = publisher, make
        self._told: SwarmPoses | None = None

    def tell(self, description: SwarmDescription, poses: SwarmPoses) -> None:
        """Publish poses unless that was done before, or nobody listens."""
        if poses is not self._told and self._publisher.get_subscription_count():
            self._told = poses
            self._publisher.publish(self._make(description, poses))


class ViewerNode(ProcessNode):
    """Turns `swarm_description` and `swarm_poses` into `swarm_markers`, `pose_array` and, if asked to, `/tf`."""

    def __init__(self) -> None:
        super().__init__("viewer")
        try:
            declare_all(self, PARAMETERS)
            transform = transform_message() if value_of(self, "tf") else None
        except BaseException:
            self.destroy_node()
            raise
        self._scale = number_of(self, "view_scale")
        self._description: SwarmDescription | None = None
        self._poses: SwarmPoses | None = None
        self._publisher = self.create_publisher(MarkerArray, "swarm_markers", MARKERS)
        arrays = self.create_publisher(PoseArray, "pose_array", MARKERS)
        self._outputs = [
            _Output(self._publisher, lambda description, poses: robot_markers(description, poses, self._scale)),
            _Output(arrays, pose_array),
        ]
        self._frames: _Output | None = None
        if transform is not None:
            frames = self.create_publisher(transform, "/tf", TRANSFORMS)
            self._frames = _Output(frames, lambda description, poses: transform(transforms=transforms(description, poses)))
        self._described = Described(self, self._on_described)
        self.create_subscription(SwarmPoses, "swarm_poses", within(self, "swarm_poses", self._on_poses), NEWEST)
        self.create_timer(1.0 / number_of(self, "view_rate"), self._show_robots)
        self.create_timer(FIXED_PERIOD, self._draw_fixed)
        self.add_on_set_parameters_callback(self._may_set)
        self.get_logger().info(f"up: markers on swarm_markers, magnified {self._scale:g} times, once a driver describes a swarm")

    def _may_set(self, parameters: list[Parameter]) -> SetParametersResult:
        problem = first_problem(PARAMETERS, parameters)
        return SetParametersResult(successful=not problem, reason=problem or "")

    def _on_described(self) -> None:
        self._description, self._poses = None, None
        message = self._described.description
        if message is None:
            reason = f"{TOPIC} {AMBIGUOUS}" if self._described.is_ambiguous else "the driver is gone"
            self.get_logger().warning(f"nothing is drawn: {reason}")
        elif passes(self, check_description, message):
            self._description = message
            self.get_logger().info(f"draws {len(message.ids)} robots of {message.name!r} (swarm {message.swarm_id})")
            if self._frames is not None and len(message.ids) > MOST_FRAMES:
                self.get_logger().warning(f"no transforms: they are for up to {MOST_FRAMES} robots, read pose_array or swarm_poses")
            self._draw_fixed()

    def _on_poses(self, message: SwarmPoses) -> None:
        if self._description is not None and message.swarm_id == self._description.swarm_id:
            if passes(self, check_poses, message):
                self._poses = message

    def _draw_fixed(self) -> None:
        if self._description is not None and self._publisher.get_subscription_count():
            self._publisher.publish(fixed_markers(self._description, self._scale))

    def _show_robots(self) -> None:
        description, poses = self._description, self._poses
        if description is None or poses is None:
            return
        for output in self._outputs:
            output.tell(description, poses)
        if self._frames is not None and len(description.ids) <= MOST_FRAMES:
            self._frames.tell(description, poses)


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver viewer`."""
    sys.exit(run("viewer", ViewerNode, args))
