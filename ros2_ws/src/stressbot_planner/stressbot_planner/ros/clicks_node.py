"""The clicks node: clicks of RViz or Foxglove become goals, and a plan to look at. It starts nothing."""

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatusArray
from geometry_msgs.msg import Point, PointStamped, PoseStamped
from rclpy.action import ActionClient
from rclpy.qos import qos_profile_action_status_default
from stressbot_msgs.action import PlanMotion
from stressbot_msgs.bounds import within
from stressbot_msgs.described import Described
from stressbot_msgs.msg import DriverStatus, SwarmPoses
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.wording import quoted
from visualization_msgs.msg import Marker, MarkerArray

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.conversion import FRAME, Scene, measured_poses, scene_of
from stressbot_planner.ros.parameters import declare, number_of
from stressbot_planner.ros.qos import LATCHED, NEWEST, ORDERS
from stressbot_planner.ros.shown_topic import ShownTopic
from stressbot_planner.ros.standard_messages import VIEW_FRAME, VIEW_SCALE, anew, colour, marker
from stressbot_planner.ros.under_way import is_under_way

PARAMETERS = (VIEW_SCALE,)

AT_REST = (DriverStatus.IDLE, DriverStatus.LOADED, DriverStatus.DONE, DriverStatus.STOPPED)
"""States of the driver in which a plan may be asked for."""

MOVING = "move_swarm/_action/status"

FORGOTTEN_AFTER = 60.0
"""s without an answer of the planner, which takes 20 s at most: then it is taken to be gone."""

SHOWN_EVERY = 0.2
"""s"""

_RING = np.column_stack([wave(np.linspace(0, 2 * np.pi, 25)) for wave in (np.cos, np.sin)])
_CROSS = np.array([[-0.7, -0.7], [0.7, 0.7], [-0.7, 0.7], [0.7, -0.7]])


class ClicksNode(ProcessNode):
    """`clicked_point` selects the robot next to it, `goal_pose` gives that one a goal and asks for a plan of all goals so far.

    Goals are forgotten as soon as robots move: those without a goal keep their place, wherever that is by then.
    """

    def __init__(self) -> None:
        """Raises StressbotError if a parameter is refused."""
        super().__init__("clicks")
        try:
            declare(self, PARAMETERS)
        except BaseException:
            self.destroy_node()
            raise
        self._scale = number_of(self, VIEW_SCALE.name)
        self._scene: Scene | None = None
        self._poses: np.ndarray | None = None  # (n, 3), m and rad
        self._state: int | None = None
        self._is_moving = False  # in closed loop
        self._selected: int | None = None  # a row
        self._goals: dict[int, tuple[float, float]] = {}  # m, by row
        self._asked: float | None = None  # when, of a plan that is being made
        self._markers = ShownTopic(self, MarkerArray, "goal_markers", self._marked, lambda: anew([]))
        self._planner = ActionClient(self, PlanMotion, "plan_motion_action")
        self._described = Described(self, self._on_described)
        for kind, topic, hear, quality in (
            (SwarmPoses, "swarm_poses", self._on_poses, NEWEST),
            (DriverStatus, "driver_status", self._on_status, LATCHED),
            (GoalStatusArray, MOVING, self._on_moving, qos_profile_action_status_default),
            (PointStamped, "clicked_point", self._guarded("clicked_point", self._select), ORDERS),
            (PoseStamped, "goal_pose", self._guarded("goal_pose", self._send), ORDERS),
        ):
            self.create_subscription(kind, topic, within(self, topic, hear), quality)
        self.create_timer(SHOWN_EVERY, self._markers.tell)
        self.get_logger().info(f"up: clicked_point selects a robot, goal_pose plans for it, magnified {self._scale:g} times")

    # What nodes say

    def _on_described(self) -> None:
        self._scene = self._poses = self._selected = self._asked = None
        self._goals = {}
        self._markers.clear()
        try:
            self._scene = scene_of(self._described)
        except StressbotError as error:
            self.get_logger().warning(f"clicks are refused: {error}")
            return
        if self._scene.swarm.n == 1:
            self._selected = 0
        self._markers.change()

    def _on_poses(self, message: SwarmPoses) -> None:
        scene = self._scene
        if scene is None or message.swarm_id != scene.swarm_id:
            return
        try:
            poses = measured_poses(message, scene) * (scene.unit, scene.unit, 1.0)
        except StressbotError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=10.0)
            return
        before, self._poses = self._poses, poses
        row = self._selected
        if row is not None and (before is None or (before[row] != poses[row]).any()):
            self._markers.change()

    def _on_status(self, message: DriverStatus) -> None:
        before, self._state = self._state, message.state
        if message.state in (DriverStatus.RUNNING, DriverStatus.IDLE) and message.state != before:
            self._goals = {}
            self._markers.change()

    def _on_moving(self, message: GoalStatusArray) -> None:
        self._is_moving = is_under_way(message)

    # Clicks

    def _guarded(self, topic: str, work: Callable[[Any], None]) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            try:
                work(message)
            except StressbotError as error:
                self.get_logger().warning(f"{topic}: {error}")

        return hear

    def _place(self, frame: str, point: Point) -> np.ndarray:
        """Return where a click is, m, shape (2,)."""
        scales = {FRAME: 1.0, VIEW_FRAME: self._scale}
        if frame not in scales:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, "header.frame_id", f"is {quoted(frame)}: click in frame '{VIEW_FRAME}' or '{FRAME}'"
            )
        place = np.array([point.x, point.y]) / scales[frame]
        if not np.isfinite(place).all():
            raise StressbotError(ErrorCode.NOT_FINITE, "position", f"is {point.x}, {point.y}: give finite numbers")
        return place

    def _swarm(self) -> tuple[Scene, np.ndarray]:
        if self._scene is None or self._poses is None:
            what = "swarm_description" if self._scene is None else "swarm_poses"
            raise StressbotError(ErrorCode.NO_SWARM, what, "has not arrived: start the driver first")
        return self._scene, self._poses

    def _select(self, message: PointStamped) -> None:
        scene, poses = self._swarm()
        away = np.hypot(*(poses[:, :2] - self._place(message.header.frame_id, message.point)).T)
        if np.isnan(away).all():
            raise StressbotError(ErrorCode.NO_SWARM, "swarm_poses", "show no robot: see to the tracker")
        self._selected = int(np.nanargmin(away))
        self._markers.change()
        self.get_logger().info(f"robot {scene.ids[self._selected]} is selected: goal_pose gives it a goal")

    def _send(self, message: PoseStamped) -> None:
        scene, _ = self._swarm()
        x, y = self._place(message.header.frame_id, message.pose.position).tolist()
        if self._selected is None:
            raise StressbotError(ErrorCode.UNKNOWN_ROBOT, "robot", "is not selected: click on one first (Publish Point)")
        if self._selected in scene.parked:
            robot = int(scene.ids[self._selected])
            raise StressbotError(ErrorCode.DUPLICATE_GOAL, "robot", f"is {robot}, which is parked: click on another")
        if self._is_moving and self.count_publishers(MOVING):
            raise StressbotError(ErrorCode.BUSY, "move_swarm", "moves the swarm in closed loop: wait for its end, or cancel that")
        if self._state not in AT_REST:
            raise StressbotError(ErrorCode.BUSY, "driver", "is running or in FAULT: wait, or call stop or reset, then click again")
        if self._asked is not None and time.monotonic() < self._asked + FORGOTTEN_AFTER:
            raise StressbotError(ErrorCode.BUSY, "plan", "is being made: click again when it is there")
        if not self._planner.server_is_ready():
            raise StressbotError(ErrorCode.NOT_HEARD, "plan_motion_action", "is served by nobody: start the planner")
        self._ask_for_plan(scene, {**self._goals, self._selected: (x, y)})

    def _ask_for_plan(self, scene: Scene, goals: dict[int, tuple[float, float]]) -> None:
        robots = [int(scene.ids[row]) for row in goals]
        request = PlanMotion.Goal(
            robots=robots, goal_x=[x for x, _ in goals.values()], goal_y=[y for _, y in goals.values()],
            parked=scene.ids[list(scene.parked)].tolist(), first=True,
        )
        self._asked = asked = time.monotonic()

        def accepted(future: Any) -> None:
            if (handle := future.result()) is None or not handle.accepted:
                ended("plan_motion_action has not accepted it: click again")
            else:
                handle.get_result_async().add_done_callback(finished)

        def finished(future: Any) -> None:
            answer = future.result()
            ended("the planner has gone" if answer is None else "" if answer.result.success else answer.result.error_msg)

        def ended(problem: str) -> None:
            if self._asked != asked:  # forgotten, or of another swarm
                return
            self._asked = None
            if problem:
                self.get_logger().warning(f"no plan for robot {robots[-1]}: {problem}")
                return
            self._goals = goals
            self._markers.change()
            self.get_logger().info(f"a plan for robot {', '.join(map(str, robots))} is there: call start to drive it")

        self._planner.send_goal_async(request).add_done_callback(accepted)

    # What is shown

    def _marked(self) -> MarkerArray:
        """Return a ring around the selected robot, and a cross at each goal."""
        scene, poses = self._scene, self._poses
        if scene is None:
            return anew([])
        size = self._scale * scene.unit * scene.swarm.girth
        found = [
            marker("goals", int(scene.ids[row]), Marker.LINE_LIST, self._scale * np.array(place) + size[row] * _CROSS,
                   0.15 * size[row], colour(row))
            for row, place in self._goals.items()
        ]
        row = self._selected
        if row is not None and poses is not None and np.isfinite(poses[row]).all():
            ring = self._scale * poses[row, :2] + 1.5 * size[row] * _RING
            found.append(marker("selected", 0, Marker.LINE_STRIP, ring, 0.15 * size[row], colour(row)))
        return anew(found)


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner clicks`."""
    sys.exit(run("clicks", ClicksNode, args))
