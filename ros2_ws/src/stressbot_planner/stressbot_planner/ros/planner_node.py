"""The planner node: asked by `plan_motion`, it plans from the measured poses and publishes `motion_plan`."""

import re
import sys
import threading
import time
import traceback
import uuid
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmDescription, SwarmPoses
from stressbot_msgs.srv import PlanMotion

from stressbot_planner import planners
from stressbot_planner.environment import Environment
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.planners import Settings
from stressbot_planner.problem import Problem
from stressbot_planner.ros.conversion import Scene, plan_to_message, scene_from_description, starts_from_poses
from stressbot_planner.ros.parameters import Declaration, declare
from stressbot_planner.ros.process import run
from stressbot_planner.ros.qos import LATCHED, NEWEST, ORDERS
from stressbot_planner.swarm import Swarm, check_positive

PARAMETERS = (
    Declaration(
        "planner",
        "optimize",
        "Planner of requests that name none.",
        f"one of {', '.join(planners.names())}",
        planners.get,
    ),
)

THREADS = 4
"""One plans, one refuses who else asks, one listens to topics, one is spare."""

INFORMED_WITHIN = 2.0
"""The swarm's description, and poses measured after the last motion, must arrive within this time of a request, s."""

CLOSE_WITHIN = 2.0
"""A planner that is told to end has this long, s, before the process ends without it."""


class _Closing(Exception):
    """Raised by the clock of a planner when the node closes."""


@dataclass(frozen=True)
class _Motion:
    """State of the driver, since when (ROS time, ns), and the plan that it is about."""

    state: int
    plan_id: str
    since: int


class PlannerNode(Node):
    """ROS around `planners.solve`."""

    def __init__(self) -> None:
        super().__init__("planner")
        try:
            declare(self, PARAMETERS)
        except BaseException:
            self.destroy_node()
            raise
        self._news = threading.Condition()  # guards the four below
        self._scene: Scene | None = None
        self._scene_error = ""
        self._poses: SwarmPoses | None = None
        self._motion: _Motion | None = None
        self._planning = threading.Lock()
        self._closing = threading.Event()
        warm_up(self.get_parameter("planner").value)
        self._publisher = self.create_publisher(MotionPlan, "motion_plan", ORDERS)
        topics = MutuallyExclusiveCallbackGroup()
        self.create_subscription(SwarmDescription, "swarm_description", self._on_description, LATCHED, callback_group=topics)
        self.create_subscription(SwarmPoses, "swarm_poses", self._on_poses, NEWEST, callback_group=topics)
        self.create_subscription(DriverStatus, "driver_status", self._on_status, LATCHED, callback_group=topics)
        self.create_service(PlanMotion, "plan_motion", self._on_request, callback_group=ReentrantCallbackGroup())

    def close(self) -> bool:
        """Break off a plan in the making; return whether it ended."""
        self._closing.set()
        with self._news:
            self._news.notify_all()
        ended = self._planning.acquire(timeout=CLOSE_WITHIN)
        if ended:
            self._planning.release()
        return ended

    # What the driver says

    def _on_description(self, message: SwarmDescription) -> None:
        with self._news:
            self._poses = None
            try:
                self._scene, self._scene_error = scene_from_description(message), ""
                self.get_logger().info(f"swarm {message.swarm_id} of {message.name!r}: {self._scene.swarm.n} robots")
            except StressbotError as error:
                self._scene, self._scene_error = None, str(error)
                self.get_logger().error(f"swarm_description refused: {error}")
            self._news.notify_all()

    def _on_poses(self, message: SwarmPoses) -> None:
        with self._news:
            if self._scene is not None and message.swarm_id == self._scene.swarm_id:
                self._poses = message
                self._news.notify_all()

    def _on_status(self, message: DriverStatus) -> None:
        with self._news:
            known = self._motion
            if known is None or (known.state, known.plan_id) != (message.state, message.plan_id):
                # A sequence that waits in LOADED moves nobody, so poses from before are still good.
                since = known.since if known and message.state == DriverStatus.LOADED else _nanoseconds(message.header.stamp)
                self._motion = _Motion(message.state, message.plan_id, since)

    # Requests

    def _on_request(self, request: PlanMotion.Request, response: PlanMotion.Response) -> PlanMotion.Response:
        if not self._planning.acquire(blocking=False):
            return _refused(response, ErrorCode.BUSY, "plan_motion: another plan is being made: ask again when it is done")
        try:
            self._plan(request, response)
        except StressbotError as error:
            _refused(response, error.code, str(error))
        except _Closing:
            _refused(response, ErrorCode.BUSY, "plan_motion: the planner node is closing")
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            _refused(response, ErrorCode.INTERNAL, f"a defect of the planner ({error!r}): please report it")
        finally:
            self._planning.release()
        if not response.success:
            self.get_logger().error(f"no plan: {response.error_msg}")
        return response

    def _plan(self, request: PlanMotion.Request, response: PlanMotion.Response) -> None:
        scene, poses = self._present()
        check_positive("tolerance", request.tolerance)
        name = request.planner or self.get_parameter("planner").value
        settings = Settings(request.objective, request.time_limit, request.seed, self._planning_clock)
        goals = goals_of_request(request, scene, starts := starts_from_poses(poses, scene))
        problem = problem_of_request(scene, starts, goals, request.tolerance / scene.unit)
        result = planners.solve(problem, name, settings)
        response.planning_time = result.planning_time
        if not result.success:
            _refused(response, result.code, f"{name}: {result.reason} {_units(scene)}")
            return
        plan_id = uuid.uuid4().hex
        response.plan = plan_to_message(result.plan, scene, plan_id, name, request.seed)
        response.plan.header.stamp = self.get_clock().now().to_msg()
        response.success = True
        self._publisher.publish(response.plan)
        self.get_logger().info(
            f"plan {plan_id} by {name}: {len(result.plan.primitives)} primitives, {result.plan.execution_time:.3f} s of "
            f"driving, made in {result.planning_time:.3f} s"
        )
        if not self._publisher.get_subscription_count():
            self.get_logger().warning("nobody heard that plan: start the sequencer, then plan again")

    def _planning_clock(self) -> float:
        if self._closing.is_set():
            raise _Closing
        return time.monotonic()

    def _present(self) -> tuple[Scene, SwarmPoses]:
        """Return the scene and poses measured since the robots last moved."""
        with self._news:
            self._refuse_while_running()
            self._news.wait_for(lambda: self._closing.is_set() or self._scene_error or self._is_informed(), INFORMED_WITHIN)
            if self._closing.is_set():
                raise _Closing
            if self._scene_error:
                raise StressbotError(ErrorCode.NO_SWARM, "swarm_description", f"is refused: {self._scene_error}")
            if self._scene is None:
                raise StressbotError(ErrorCode.NO_SWARM, "swarm_description", "has not arrived: start the driver first")
            if not self._is_informed():
                raise StressbotError(
                    ErrorCode.NO_SWARM, "swarm_poses", "has none since the last motion: does the tracker see the robots?"
                )
            self._refuse_while_running()
            return self._scene, self._poses

    def _refuse_while_running(self) -> None:
        # A driver that is gone may have said last that it runs.
        if self._motion and self._motion.state == DriverStatus.RUNNING and self.count_publishers("driver_status"):
            raise StressbotError(
                ErrorCode.BUSY, "driver", f"plan {self._motion.plan_id} is running: wait for its end or call stop"
            )

    def _is_informed(self) -> bool:
        """Return whether there are a scene and poses measured since the robots last moved."""
        if self._scene is None or self._poses is None:
            return False
        return self._motion is None or _nanoseconds(self._poses.header.stamp) >= self._motion.since


def goals_of_request(request: PlanMotion.Request, scene: Scene, starts: np.ndarray) -> np.ndarray:
    """Return goals (n, 2), units: of the request, or the scenario's own if it names none.

    Raises:
        StressbotError: WRONG_COUNT, UNKNOWN_ROBOT, DUPLICATE_GOAL or NOT_FINITE.
    """
    count = len(request.robots)
    for field in ("goal_x", "goal_y"):
        if len(getattr(request, field)) != count:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, field, f"has {len(getattr(request, field))} entries for {count} robots: give one each"
            )
    if count == 0:
        return scene.goals
    goals = starts[:, :2].copy()
    named = set()
    for index, robot in enumerate(request.robots):
        row = scene.row(robot, f"robots[{index}]")
        if row in named:
            raise StressbotError(ErrorCode.DUPLICATE_GOAL, f"robots[{index}]", f"is {robot} again: give each robot one goal")
        named.add(row)
        for axis, field in enumerate(("goal_x", "goal_y")):
            value = getattr(request, field)[index]
            if not np.isfinite(value):
                raise StressbotError(ErrorCode.NOT_FINITE, f"{field}[{index}]", f"is {value}: give a finite number")
            goals[row, axis] = value / scene.unit
    return goals


def problem_of_request(scene: Scene, starts: np.ndarray, goals: np.ndarray, tolerance: float) -> Problem:
    """Return the problem, all in units; errors name robots and say in which unit they count."""
    try:
        return Problem(scene.swarm, scene.environment, starts, goals, tolerance)
    except StressbotError as error:
        field = error.field
        if match := re.fullmatch(r"robots\[(\d+)\]\.(start|goal)", field):
            what = "goal" if match[2] == "goal" else "measured pose"
            field = f"{what} of robot {scene.ids[int(match[1])]}"
        raise StressbotError(error.code, field, f"{error.message} {_units(scene)}") from error


def warm_up(planner: str) -> None:
    """Load and compile what planning needs, so that the first request is as quick as the next."""
    swarm = Swarm(1.0, 1.0, 0.1, ("01", "10"))
    problem = Problem(swarm, Environment(), [[0.0, 0.0, 0.0], [0.0, 3.0, 0.0]], [[2.0, 1.0], [2.0, 2.0]])
    with suppress(StressbotError):  # it may not support this problem
        planners.solve(problem, planner, Settings(time_limit=1.0))


def _refused(response: PlanMotion.Response, code: ErrorCode, text: str) -> PlanMotion.Response:
    response.success, response.error_code, response.error_msg = False, int(code), text
    return response


def _units(scene: Scene) -> str:
    return f"(lengths in units of {scene.unit:g} m)"


def _nanoseconds(stamp) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner planner`."""
    sys.exit(run("planner", PlannerNode, THREADS, args))
