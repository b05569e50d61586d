"""The planner node: asked by `plan_motion`, it plans from the measured poses and publishes `motion_plan`."""

import sys
import threading
import time
import traceback
import uuid
from dataclasses import dataclass

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from stressbot_msgs.described import Described
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses
from stressbot_msgs.srv import PlanMotion

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.conversion import Scene, plan_to_message, scene_of
from stressbot_planner.ros.goals import named_for_request, units
from stressbot_planner.ros.orders import publish_order
from stressbot_planner.ros.parameters import Declaration, declare
from stressbot_planner.ros.process import run
from stressbot_planner.ros.qos import LATCHED, NEWEST, ORDERS
from stressbot_planner.ros.tasks import task_of_request
from stressbot_planner.worker import Worker, WorkerEnded

PARAMETERS = (
    Declaration(
        "planner",
        "optimize",
        "Planner of requests that name none.",
        f"one of {', '.join(planners.names())}",
        planners.get,
    ),
)

INFORMED_WITHIN = 5.0
"""The swarm's description, and fresh poses measured after the last motion, must arrive within this time of a request, s."""

FRESH = 2.0
FRESH_PERIODS = 3.0
"""Poses are fresh for so many s after they came, and for so many times the interval from the ones before."""


@dataclass(frozen=True)
class _Motion:
    """State of the driver, since when (ROS time, ns), and the plan that it is about."""

    state: int
    plan_id: str
    since: int


class PlannerNode(Node):
    """ROS around `planners.solve`, which runs in a process of its own."""

    def __init__(self, worker: Worker) -> None:
        """Raises StressbotError if a parameter is refused."""
        super().__init__("planner")
        try:
            declare(self, PARAMETERS)
        except BaseException:
            self.destroy_node()
            raise
        self._news = threading.Condition()  # the executor's thread tells the one that answers; guards the seven below
        self._scene: Scene | None = None
        self._refusal: StressbotError | None = None  # of the description
        self._poses: SwarmPoses | None = None
        self._poses_since = self._poses_interval = 0.0  # when they came, and how long after those before; monotonic, s
        self._motion: _Motion | None = None
        self._status_time = 0  # of the driver's last word, ROS time, ns
        self._planning = threading.Lock()
        self._closing = threading.Event()
        self._worker = worker
        self._publisher = self.create_publisher(MotionPlan, "motion_plan", ORDERS)
        self._described = Described(self, self._on_described)
        self.create_subscription(SwarmPoses, "swarm_poses", self._on_poses, NEWEST)
        self.create_subscription(DriverStatus, "driver_status", self._on_status, LATCHED)
        worker.wait_until_ready()
        self.create_service(PlanMotion, "plan_motion", self._on_request, callback_group=ReentrantCallbackGroup())

    def close(self) -> None:
        """Break off a plan in the making."""
        self._closing.set()
        self._worker.close()
        with self._news:
            self._news.notify_all()

    # What the driver says

    def _on_described(self) -> None:
        with self._news:
            self._scene = self._refusal = self._poses = None
            try:
                self._scene = scene_of(self._described)
                self.get_logger().info(f"swarm {self._scene.swarm_id} of {self._scene.name!r}: {self._scene.swarm.n} robots")
            except StressbotError as error:
                self._refusal = error
                self.get_logger().warning(f"requests are refused: {error}")
            self._news.notify_all()

    def _on_poses(self, message: SwarmPoses) -> None:
        with self._news:
            if self._scene is not None and message.swarm_id == self._scene.swarm_id:
                now = time.monotonic()
                self._poses_interval = now - self._poses_since if self._poses is not None else 0.0
                self._poses, self._poses_since = message, now
                self._news.notify_all()

    def _on_status(self, message: DriverStatus) -> None:
        with self._news:
            known = self._motion
            if known is None or (known.state, known.plan_id) != (message.state, message.plan_id):
                # A sequence that waits in LOADED moves nobody, so poses from before are still good.
                since = known.since if known and message.state == DriverStatus.LOADED else _nanoseconds(message.header.stamp)
                self._motion = _Motion(message.state, message.plan_id, since)
            self._status_time = _nanoseconds(message.header.stamp)
            self._news.notify_all()

    # Requests

    async def _on_request(self, request: PlanMotion.Request, response: PlanMotion.Response) -> PlanMotion.Response:
        if not self._planning.acquire(blocking=False):
            return _refused(response, ErrorCode.BUSY, "plan_motion: another plan is being made: ask again when it is done")
        # A thread waits for the planning process, so that the executor's stays free. rclpy's multi-threaded executor
        # would do so too, but it queues a waiting callback over and over, and answers get seconds late.
        answered = Future()

        def answer() -> None:
            try:
                self._answer(request, response)
            finally:
                self._planning.release()
                answered.set_result(response)
                self.executor.wake()

        threading.Thread(target=answer, name="plan_motion", daemon=True).start()
        return await answered

    def _answer(self, request: PlanMotion.Request, response: PlanMotion.Response) -> None:
        try:
            self._plan(request, response)
        except StressbotError as error:
            _refused(response, error.code, str(error))
        except WorkerEnded:
            _refused(response, ErrorCode.BUSY, "plan_motion: the planner node is closing")
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            _refused(response, ErrorCode.INTERNAL, f"a defect of the planner ({error!r}): please report it")
        if not response.success:
            self.get_logger().warning(f"no plan: {response.error_msg}")

    def _plan(self, request: PlanMotion.Request, response: PlanMotion.Response) -> None:
        scene, poses = self._present()
        task = task_of_request(request, scene, poses, self.get_parameter("planner").value)
        try:
            report = self._worker.solve(task)
        except StressbotError as error:
            raise named_for_request(error, scene, task.exchangeable) from error
        response.planning_time = report.planning_time
        if not report.success:
            _refused(response, report.code, f"{task.planner}: {report.reason} {units(scene)}")
            return
        with self._news:
            if self._scene is None or self._scene.swarm_id != scene.swarm_id:
                raise self._refusal or StressbotError(
                    ErrorCode.WRONG_SWARM, "swarm_description", "came anew meanwhile: ask again, for the swarm that lies there now"
                )
        plan_id = uuid.uuid4().hex
        response.plan = plan_to_message(report, task.starts, scene, plan_id, task.planner, request.seed)
        response.plan.header.stamp = poses.header.stamp
        response.success = True
        heard = publish_order(self, self._publisher, response.plan)
        self.get_logger().info(
            f"plan {plan_id} by {task.planner}: {len(report.primitives)} primitives, {report.execution_time:.3f} s of "
            f"driving, made in {report.planning_time:.3f} s"
        )
        if not heard:
            self.get_logger().warning("nobody heard that plan: start the sequencer, then plan again")

    def _present(self) -> tuple[Scene, SwarmPoses]:
        """Return the scene and poses measured since the robots last moved."""
        asked = self.get_clock().now().nanoseconds
        with self._news:
            # Who asks may have heard already that a motion has ended, so the driver's word from before does not count.
            self._news.wait_for(
                lambda: self._closing.is_set() or not self._is_running() or self._status_time >= asked, INFORMED_WITHIN
            )
            self._refuse_while_running()
            self._news.wait_for(lambda: self._closing.is_set() or self._is_informed(), INFORMED_WITHIN)
            if self._closing.is_set():
                raise WorkerEnded
            if self._scene is None:
                missing = StressbotError(ErrorCode.NO_SWARM, "swarm_description", "has not arrived: start the driver first")
                raise self._refusal or missing
            if self._poses is not None and not self._is_fresh():
                raise StressbotError(
                    ErrorCode.STALE_POSES,
                    "swarm_poses",
                    f"last came {time.monotonic() - self._poses_since:.1f} s ago: does the tracker still see the robots?",
                )
            if not self._is_informed():
                raise StressbotError(
                    ErrorCode.NO_SWARM, "swarm_poses", "has none since the last motion: does the tracker see the robots?"
                )
            self._refuse_while_running()
            return self._scene, self._poses

    def _is_running(self) -> bool:
        # A driver that is gone may have said last that it runs.
        return bool(self._motion and self._motion.state == DriverStatus.RUNNING and self._described.drivers)

    def _refuse_while_running(self) -> None:
        if self._is_running():
            raise StressbotError(
                ErrorCode.BUSY, "driver", f"plan {self._motion.plan_id} is running: wait for its end or call stop"
            )

    def _is_informed(self) -> bool:
        """Return whether there are a scene and fresh poses measured since the robots last moved."""
        if self._scene is None or self._poses is None or not self._is_fresh():
            return False
        return self._motion is None or _nanoseconds(self._poses.header.stamp) >= self._motion.since

    def _is_fresh(self) -> bool:
        return time.monotonic() - self._poses_since <= max(FRESH, FRESH_PERIODS * self._poses_interval)


def _refused(response: PlanMotion.Response, code: ErrorCode, text: str) -> PlanMotion.Response:
    response.success, response.error_code, response.error_msg = False, int(code), text
    return response


def _nanoseconds(stamp) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner planner`."""
    worker = Worker()  # starts while ROS does
    try:
        code = run("planner", lambda: PlannerNode(worker), args)
    finally:
        worker.close()
    sys.exit(code)
