"""The paths node: of some robots, where the accepted plan leads them and where they have been; it only looks on."""

import sys

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Path
from stressbot_msgs.bounds import within
from stressbot_msgs.described import Described
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses
from stressbot_msgs.process import ProcessNode, run
from visualization_msgs.msg import MarkerArray

from stressbot_planner.errors import StressbotError
from stressbot_planner.ros.conversion import Scene, measured_poses, scene_of
from stressbot_planner.ros.parameters import Robots, declare, number_of
from stressbot_planner.ros.qos import LATCHED, NEWEST
from stressbot_planner.ros.shown_topic import ShownTopic
from stressbot_planner.ros.standard_messages import VIEW_SCALE, anew, lines, path_message
from stressbot_planner.ros.unfolding import activations_of_plan, ends_of_plan
from stressbot_planner.view.plan_paths import LONGEST, plan_paths
from stressbot_planner.view.scene import MICRO
from stressbot_planner.view.trail import Trail

UNLISTED, MOST_LISTED = 32, 200
"""Robots that have paths if none are listed, and most that may be; each has two topics, of which all nodes on the network learn."""

LONGEST_TRAIL = 500
"""Places of one robot, at most, that are kept of where it has been."""

PLANS_EVERY, TRAILS_EVERY = 0.2, 1.0
"""s"""

THIN = 0.1
"""Width of a line, in girths of a robot."""

PARAMETERS = (
    Robots("robots", f"Ids of robots whose paths are published; empty: the first {UNLISTED}.", MOST_LISTED),
    VIEW_SCALE,
)


class PathsNode(ProcessNode):
    """Turns `accepted_plan` and `swarm_poses` into `robot_N/planned_path`, `robot_N/driven_path` and `path_markers`."""

    def __init__(self) -> None:
        """Raises StressbotError if a parameter is refused."""
        super().__init__("paths")
        try:
            declare(self, PARAMETERS)
        except BaseException:
            self.destroy_node()
            raise
        self._scale = number_of(self, VIEW_SCALE.name)
        self._scene: Scene | None = None
        self._rows: list[int] = []
        self._plan: MotionPlan | None = None
        self._unfolded: list[np.ndarray] | None = None  # of the plan, m and rad
        self._trail = Trail()
        self._been: list[np.ndarray] | None = None  # the trails, m and rad
        self._state = DriverStatus.IDLE
        self._said = ""
        self._markers = ShownTopic(self, MarkerArray, "path_markers", self._marked, lambda: anew([]))
        self._planned: list[ShownTopic] = []
        self._driven: list[ShownTopic] = []
        self._described = Described(self, self._on_described)
        for kind, topic, hear, quality in (
            (MotionPlan, "accepted_plan", self._on_plan, LATCHED),
            (DriverStatus, "driver_status", self._on_status, LATCHED),
            (SwarmPoses, "swarm_poses", self._on_poses, NEWEST),
        ):
            self.create_subscription(kind, topic, within(self, topic, hear), quality)
        self.create_timer(PLANS_EVERY, self._tell_plans)
        self.create_timer(TRAILS_EVERY, self._tell_trails)
        self.get_logger().info("up: shows paths as soon as a driver describes a swarm")

    # What nodes say

    def _on_described(self) -> None:
        for shown in (*self._planned, *self._driven):
            self.destroy_publisher(shown.publisher)
        self._planned, self._driven, self._rows = [], [], []
        self._markers.clear()
        self._scene = self._unfolded = None
        try:
            self._scene = scene = scene_of(self._described)
        except StressbotError as error:
            self.get_logger().warning(f"no paths: {error}")
            return
        self._rows = self._chosen(scene)
        self._trail, self._been = Trail(LONGEST_TRAIL * len(self._rows)), None
        for column, row in enumerate(self._rows):
            name = f"robot_{scene.ids[row]}"
            for what, make, kept in (("planned", self._planned_path, self._planned), ("driven", self._driven_path, self._driven)):
                topic = f"{name}/{what}_path"
                kept.append(ShownTopic(self, Path, topic, lambda make=make, column=column: make(column), self._no_path))
        self.get_logger().info(f"shows paths of {len(self._rows)} of {scene.swarm.n} robots of {scene.name!r}")
        self._change_plan()

    def _chosen(self, scene: Scene) -> list[int]:
        listed = list(self.get_parameter("robots").value or ())
        rows = []
        for robot in dict.fromkeys(listed):
            try:
                rows.append(scene.row(robot, "robots"))
            except StressbotError as error:
                self.get_logger().warning(str(error))
        return rows if listed else list(range(min(UNLISTED, scene.swarm.n)))

    def _on_plan(self, message: MotionPlan) -> None:
        self._plan = message
        self._change_plan()

    def _on_status(self, message: DriverStatus) -> None:
        before, self._state = self._state, message.state
        if message.state == DriverStatus.IDLE != before:  # robots are back at their starts
            self._trail.clear()
            self._been = None
            for shown in self._driven:
                shown.clear()
            self._markers.change()

    def _on_poses(self, message: SwarmPoses) -> None:
        scene = self._scene
        if scene is None or message.swarm_id != scene.swarm_id:
            return
        try:
            poses = measured_poses(message, scene)[self._rows] * (scene.unit * MICRO, scene.unit * MICRO, 1.0)
        except StressbotError as error:
            self._warn(str(error))
            return
        if self._rows and self._trail.add(poses):
            self._been = None
            for shown in (*self._driven, self._markers):
                shown.change()

    def _warn(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self.get_logger().warning(text)

    # What is shown

    def _change_plan(self) -> None:
        self._unfolded = None
        for shown in self._planned:
            shown.clear()
        self._markers.change()
        scene, plan = self._scene, self._plan
        if scene is not None and plan is not None and plan.swarm_id == scene.swarm_id:
            for shown in self._planned:
                shown.change()

    def _tell_plans(self) -> None:
        for shown in self._planned:
            shown.tell()

    def _tell_trails(self) -> None:
        for shown in (*self._driven, self._markers):
            shown.tell()

    def _paths(self) -> list[np.ndarray]:
        """Return the paths of the plan, each (k, 3), m and rad, unfolded when somebody wants to see them first."""
        scene, plan = self._scene, self._plan
        if self._unfolded is None:
            self._unfolded = [np.empty((0, 3))] * len(self._rows)
            if scene is not None and plan is not None and plan.swarm_id == scene.swarm_id:
                try:
                    starts, _ = ends_of_plan(plan, scene)
                    paths = plan_paths(scene.swarm, starts, *activations_of_plan(plan, scene), self._rows)
                    self._unfolded = [path * (scene.unit, scene.unit, 1.0) for path in paths]
                except StressbotError as error:
                    self._warn(f"the plan cannot be shown: {error}")
                if any(len(path) == LONGEST for path in self._unfolded):
                    self._warn(f"the plan is long: the first {LONGEST} poses of its paths are shown")
        return self._unfolded

    def _trails(self) -> list[np.ndarray]:
        """Return where robots have been, each (k, 3), m and rad, without the times when they were not seen."""
        if self._been is None:
            kept = self._trail.poses().reshape(-1, len(self._rows), 3) / (MICRO, MICRO, 1.0)
            self._been = [track[np.isfinite(track).all(axis=1)] for track in kept.swapaxes(0, 1)]
        return self._been

    def _planned_path(self, column: int) -> Path:
        return path_message(self._paths()[column], self._plan.header.stamp if self._plan else self._now())

    def _driven_path(self, column: int) -> Path:
        return path_message(self._trails()[column], self._now())

    def _no_path(self) -> Path:
        return path_message(np.empty((0, 3)), self._now())

    def _marked(self) -> MarkerArray:
        scene = self._scene
        if scene is None:
            return anew([])
        width = THIN * scene.unit * float(scene.swarm.girth.min())
        robots = [int(scene.ids[row]) for row in self._rows]
        planned = lines("planned", dict(zip(robots, self._paths(), strict=True)), self._scale, width, 0.5)
        driven = lines("driven", dict(zip(robots, self._trails(), strict=True)), self._scale, 2 * width, 1.0)
        return anew([*planned, *driven])

    def _now(self) -> Time:
        return self.get_clock().now().to_msg()


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner paths`."""
    sys.exit(run("paths", PathsNode, args))
