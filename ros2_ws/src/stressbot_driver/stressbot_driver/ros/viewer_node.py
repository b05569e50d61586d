"""The viewer node: swarm description and poses in, markers for RViz out."""

import sys
from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from stressbot_msgs.bounds import within
from stressbot_msgs.described import AMBIGUOUS, TOPIC, Described
from stressbot_msgs.msg import SwarmDescription, SwarmPoses
from stressbot_msgs.parameters import refuse_others
from stressbot_msgs.process import ProcessNode, run
from visualization_msgs.msg import MarkerArray

from stressbot_driver.errors import StressbotError
from stressbot_driver.ros.markers import check_description, check_poses, fixed_markers, robot_markers
from stressbot_driver.ros.parameters import Declaration, declare, first_problem
from stressbot_driver.ros.qos import MARKERS, NEWEST

FIXED_PERIOD = 2.0  # [s] walls and obstacles again, for an RViz that was started later

PARAMETERS = (
    Declaration("view_scale", 1000.0, "Magnification of lengths in frame substrate_view.", low=1e-3, high=1e9, read_only=True),
    Declaration("view_rate", 20.0, "[Hz] Marker updates per second, at most.", low=0.1, high=100.0, read_only=True),
)


class ViewerNode(ProcessNode):
    """Turns `swarm_description` and `swarm_poses` into `swarm_markers`."""

    def __init__(self) -> None:
        super().__init__("viewer")
        try:
            declare(self, PARAMETERS)
            refuse_others(self, (declaration.name for declaration in PARAMETERS))
        except BaseException:
            self.destroy_node()
            raise
        self._scale = float(self.get_parameter("view_scale").value)
        self._description: SwarmDescription | None = None
        self._poses: SwarmPoses | None = None
        self._publisher = self.create_publisher(MarkerArray, "swarm_markers", MARKERS)
        self._described = Described(self, self._on_described)
        self.create_subscription(SwarmPoses, "swarm_poses", within(self, "swarm_poses", self._on_poses), NEWEST)
        self.create_timer(1.0 / float(self.get_parameter("view_rate").value), self._draw_robots)
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
        elif self._passes(lambda: check_description(message)):
            self._description = message
            self.get_logger().info(f"draws {len(message.ids)} robots of {message.name!r} (swarm {message.swarm_id})")
            self._draw_fixed()

    def _on_poses(self, message: SwarmPoses) -> None:
        if self._description is not None and message.swarm_id == self._description.swarm_id:
            if self._passes(lambda: check_poses(message)):
                self._poses = message

    def _passes(self, check: Callable[[], None]) -> bool:
        try:
            check()
        except StressbotError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return False
        return True

    def _draw_fixed(self) -> None:
        if self._description is not None and self._publisher.get_subscription_count():
            self._publisher.publish(fixed_markers(self._description, self._scale))

    def _draw_robots(self) -> None:
        if self._poses is not None and self._publisher.get_subscription_count():
            self._publisher.publish(robot_markers(self._description, self._poses, self._scale))
            self._poses = None


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver viewer`."""
    sys.exit(run("viewer", ViewerNode, args))
