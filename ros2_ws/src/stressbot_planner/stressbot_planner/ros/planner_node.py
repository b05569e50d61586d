"""The planner node: asked by a service or an action, it plans from the measured poses and publishes `motion_plan`."""

import sys
import threading
import time
import traceback
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.task import Future
from stressbot_msgs.action import PlanMotion as PlanMotionAction
from stressbot_msgs.bounds import within
from stressbot_msgs.described import Described
from stressbot_msgs.health import OK, WARN, Health, tell_health
from stressbot_msgs.msg import DriverStatus, MotionPlan, SequencerStatus, SwarmPoses
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.srv import PlanMotion
from stressbot_msgs.stamps import nanoseconds

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.execution.worker import Worker, WorkerEnded
from stressbot_planner.planners import Progress
from stressbot_planner.ros.conversion import Scene, check_size, plan_to_message, scene_of
from stressbot_planner.ros.goals import in_words, named_for_request
from stressbot_planner.ros.orders import publish_order
from stressbot_planner.ros.parameters import Text, declare
from stressbot_planner.ros.qos import EVENTS, LATCHED, NEWEST, ORDERS
from stressbot_planner.ros.tasks import task_of_request

PARAMETERS = (
    Text(
        "planner",
        "optimize",
        "Planner of requests that name none.",
        f"one of {', '.join(planners.names())}",
        planners.check_known,
    ),
)

INFORMED_WITHIN = 5.0
"""The swarm's description, and fresh poses measured after the last motion, must arrive within this time of a request, s."""

FRESH = 2.0
FRESH_PERIODS = 3.0
"""Age up to which poses are fresh: s, or in intervals between the last two, whichever is longer."""

HEARD_WITHIN = 10.0
"""The sequencer must say what became of a plan within this time, s."""

LONG_PLAN = 3600.0
"""A plan that takes longer on the substrate, s, is answered with a warning."""

FEEDBACK_EVERY, LOOK_EVERY = 0.5, 0.5
"""s from one feedback to the next, and from one look at whether the client is still there."""

_SLICE = 0.1
"""s that a waiting thread may be deaf to being cancelled."""

Asked = PlanMotion.Request | PlanMotionAction.Goal
Answer = PlanMotion.Response | PlanMotionAction.Result


@dataclass(frozen=True)
class _Motion:
    """State of the driver, since when (ROS time, ns), and the plan that it is about."""

    state: int
    plan_id: str
    since: int


class PlannerNode(ProcessNode):
    """ROS around `planners.solve`, which runs in a process of its own."""

    def __init__(self, worker: Worker) -> None:
        """Raises StressbotError if a parameter is refused."""
        super().__init__("planner")
        try:
            declare(self, PARAMETERS)
        except BaseException:
            self.destroy_node()
            raise
        self._news = threading.Condition()  # the executor's thread tells the one that answers; guards the eight below
        self._scene: Scene | None = None
        self._refusal: StressbotError | None = None  # of the description
        self._poses: SwarmPoses | None = None
        self._poses_since = self._poses_interval = 0.0  # when they came, and how long after those before; monotonic, s
        self._motion: _Motion | None = None
        self._sequencer: SequencerStatus | None = None
        self._status_time = 0  # of the driver's last word, ROS time, ns
        self._planning = threading.Lock()
        self._busy: tuple[str, float] | None = None  # for whom, and since when
        self._closing = threading.Event()
        self._worker = worker
        self._publisher = self.create_publisher(MotionPlan, "motion_plan", ORDERS)
        self._described = Described(self, self._on_described)
        self.create_subscription(SwarmPoses, "swarm_poses", within(self, "swarm_poses", self._on_poses), NEWEST)
        self.create_subscription(DriverStatus, "driver_status", within(self, "driver_status", self._on_status), LATCHED)
        self.create_subscription(SequencerStatus, "sequencer_status", within(self, "sequencer_status", self._on_sequencer), LATCHED)
        worker.wait_until_ready()
        group = ReentrantCallbackGroup()
        # rclpy awaits what a callback returns, though its types do not say so
        answer: Any = self._on_request
        service = self.create_service(PlanMotion, "plan_motion", answer, callback_group=group)
        service.configure_introspection(self.get_clock(), EVENTS, ServiceIntrospectionState.CONTENTS)
        self._server = ActionServer(
            self,
            PlanMotionAction,
            "plan_motion_action",
            self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )
        tell_health(self, self._health)
        self.get_logger().info(f"ready; planner {self.get_parameter('planner').value!r} unless a request names another")

    def _health(self) -> Health:
        busy, scene, refusal = self._busy, self._scene, self._refusal
        figures = {"swarm_id": scene.swarm_id if scene else "", "planner": self.get_parameter("planner").value}
        if refusal is not None:
            return WARN, str(refusal), figures
        if scene is None:
            return WARN, "waits for the driver's description", figures
        return OK, f"plans for {busy[0]} since {time.monotonic() - busy[1]:.0f} s" if busy else "ready", figures

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
                since = known.since if known and message.state == DriverStatus.LOADED else nanoseconds(message.header.stamp)
                self._motion = _Motion(message.state, message.plan_id, since)
            self._status_time = nanoseconds(message.header.stamp)
            self._news.notify_all()

    def _on_sequencer(self, message: SequencerStatus) -> None:
        with self._news:
            self._sequencer = message
            self._news.notify_all()

    # Requests

    async def _on_request(self, request: PlanMotion.Request, response: PlanMotion.Response) -> PlanMotion.Response:
        gone = _Gone(lambda: self.count_clients("plan_motion"))

        def meanwhile(_progress: Progress) -> None:
            if gone():
                raise StressbotError(ErrorCode.CANCELLED, "plan_motion", "nobody waits for an answer any more")

        who = f"a call of plan_motion ({_summary(request)})"
        return await self._on_thread(lambda: self._answer(who, request, response, meanwhile))

    async def _on_goal(self, handle: ServerGoalHandle) -> PlanMotionAction.Result:
        result = PlanMotionAction.Result()
        name = "plan_motion_action"
        gone = _Gone(lambda: self.count_subscribers(f"{name}/_action/status"))
        begin = told = time.monotonic()

        def meanwhile(progress: Progress) -> None:
            nonlocal told
            if handle.is_cancel_requested:
                raise StressbotError(ErrorCode.CANCELLED, name, "was cancelled on request")
            if gone():
                raise StressbotError(ErrorCode.CANCELLED, name, "nobody waits for a result any more")
            now = time.monotonic()
            if now - told >= FEEDBACK_EVERY:
                told = now
                handle.publish_feedback(self._feedback(progress, now - begin))

        def answer() -> PlanMotionAction.Result:
            who = f"a goal of {name} ({_summary(handle.request)})"
            try:
                self._answer(who, handle.request, result, meanwhile)
            finally:
                _end(handle, result)
            return result

        return await self._on_thread(answer)

    async def _on_thread(self, answer: Callable[[], Any]) -> Any:
        # A thread waits for the planning process, so that the executor's stays free. rclpy's multi-threaded executor
        # would do so too, but it queues a waiting callback over and over, and answers get seconds late.
        answered = Future()

        def work() -> None:
            try:
                answered.set_result(answer())
            except BaseException as error:
                answered.set_exception(error)
            finally:
                self.wake()

        threading.Thread(target=work, name="plan_motion", daemon=True).start()
        return await answered

    def _answer(self, who: str, request: Asked, response: Answer, meanwhile: Callable[[Progress], None]) -> Answer:
        """Fill in a response; `meanwhile` is called some times a second with the progress, and may raise to give up."""
        if not self._planning.acquire(blocking=False):
            busy = self._busy
            return _refused(
                response,
                ErrorCode.BUSY,
                "plan_motion: another plan is being made"
                + (f", for {busy[0]} since {time.monotonic() - busy[1]:.1f} s" if busy else "")
                + ": ask again when it is done, or cancel it",
            )
        self._busy = who, time.monotonic()
        try:
            self._plan(request, response, meanwhile)
        except StressbotError as error:
            _refused(response, error.code, str(error))
        except WorkerEnded:
            _refused(response, ErrorCode.CANCELLED, "plan_motion: the planner node is closing")
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            _refused(response, ErrorCode.INTERNAL, f"planner: a defect ({error!r}): please report it")
        finally:
            self._busy = None
            self._planning.release()
        if response.error_code == ErrorCode.INTERNAL:
            self.get_logger().error(f"no plan: {response.error_msg}")
        elif not response.success:
            self.get_logger().warning(f"no plan: {response.error_msg}")
        return response

    def _plan(self, request: Asked, response: Answer, meanwhile: Callable[[Progress], None]) -> None:
        progress = Progress(0)

        def check() -> None:
            if self._closing.is_set():
                raise WorkerEnded
            meanwhile(progress)

        def on_progress(news: Progress) -> None:
            nonlocal progress
            progress = news

        check_size(request)
        scene, poses = self._present(check)
        usual: Any = self.get_parameter("planner").value  # a text, see `Text.problem`
        task = task_of_request(request, scene, poses, usual)
        try:
            report = self._worker.solve(task, check, on_progress)
        except StressbotError as error:
            raise named_for_request(error, scene, request, task.exchangeable) from error
        response.planning_time = report.planning_time
        if not report.success:
            _refused(response, report.code, f"{task.planner}: {in_words(report.reason, scene, task.exchangeable)}")
            return
        check()
        with self._news:
            if self._scene is None or self._scene.swarm_id != scene.swarm_id:
                raise self._refusal or StressbotError(
                    ErrorCode.WRONG_SWARM, "swarm_description", "came anew meanwhile: ask again, for the swarm that lies there now"
                )
        plan_id = uuid.uuid4().hex
        response.plan = plan_to_message(report, task.starts, scene, plan_id, task.planner, request.seed)
        response.plan.header.stamp = poses.header.stamp
        response.warning = _warning(response.plan)
        connected = publish_order(self, self._publisher, response.plan)
        self.get_logger().info(
            f"plan {plan_id} by {task.planner}: {len(report.primitives)} primitives, {report.execution_time:.3f} s of "
            f"driving, made in {report.planning_time:.3f} s"
        )
        if response.warning:
            self.get_logger().warning(response.warning)
        self._check_heard(plan_id, connected, check)
        response.success = True

    def _feedback(self, progress: Progress, elapsed: float) -> PlanMotionAction.Feedback:
        feedback = PlanMotionAction.Feedback(elapsed=elapsed, tries=progress.tries, found=isfinite(progress.path_length))
        with self._news:
            scene = self._scene
        if feedback.found and scene is not None:
            feedback.path_length = scene.unit * progress.path_length
            feedback.execution_time = progress.execution_time
        return feedback

    def _check_heard(self, plan_id: str, connected: bool, check: Callable[[], None]) -> None:
        """Wait for the sequencer's word on a plan.

        Raises:
            StressbotError: NOT_HEARD, or why the sequencer refuses it.
        """
        again = "; the plan is in this answer, and may be published on motion_plan as long as the robots stay where they are"
        if not connected or not self.count_publishers("sequencer_status"):
            raise StressbotError(
                ErrorCode.NOT_HEARD, "motion_plan", f"was heard by no sequencer: start one, then plan again{again}"
            )

        def taken() -> SequencerStatus | None:
            status = self._sequencer
            return status if status is not None and status.plan_id == plan_id else None

        self._wait(taken, HEARD_WITHIN, check)
        status = taken()
        if status is None:
            raise StressbotError(
                ErrorCode.NOT_HEARD,
                "motion_plan",
                f"was not taken by the sequencer within {HEARD_WITHIN:g} s: see whether it runs, then plan again{again}",
            )
        if status.error_code:
            raise StressbotError(ErrorCode(status.error_code), "sequencer", status.error_msg)

    def _wait(self, condition: Callable[[], Any], timeout: float, check: Callable[[], None]) -> None:
        """Wait for news until a condition holds or the time is over, and check whether to give up; `_news` is not held."""
        deadline = time.monotonic() + timeout
        while True:
            check()
            with self._news:
                left = deadline - time.monotonic()
                if self._news.wait_for(condition, min(_SLICE, max(left, 0.0))) or left <= 0:
                    return

    def _present(self, check: Callable[[], None]) -> tuple[Scene, SwarmPoses]:
        """Return the scene and poses measured since the robots last moved."""
        asked = self.get_clock().now().nanoseconds
        # Who asks may have heard already that a motion has ended, so the driver's word from before does not count.
        self._wait(lambda: self._running() is None or self._status_time >= asked, INFORMED_WITHIN, check)
        with self._news:
            self._refuse_while_running()
        self._wait(self._is_informed, INFORMED_WITHIN, check)
        with self._news:
            if self._scene is None:
                missing = StressbotError(ErrorCode.NO_SWARM, "swarm_description", "has not arrived: start the driver first")
                raise self._refusal or missing
            if self._poses is not None and not self._is_fresh():
                raise StressbotError(
                    ErrorCode.STALE_POSES,
                    "swarm_poses",
                    f"last came {time.monotonic() - self._poses_since:.1f} s ago: does the tracker still see the robots?",
                )
            if self._poses is None or not self._is_informed():
                raise StressbotError(
                    ErrorCode.NO_SWARM, "swarm_poses", "has none since the last motion: does the tracker see the robots?"
                )
            self._refuse_while_running()
            return self._scene, self._poses

    def _running(self) -> "_Motion | None":
        # A driver that is gone may have said last that it runs.
        motion = self._motion
        return motion if motion and motion.state == DriverStatus.RUNNING and self._described.drivers else None

    def _refuse_while_running(self) -> None:
        if motion := self._running():
            raise StressbotError(
                ErrorCode.BUSY, "driver", f"plan {motion.plan_id} is running: wait for its end or call stop"
            )

    def _is_informed(self) -> bool:
        """Return whether there are a scene and fresh poses measured since the robots last moved."""
        if self._scene is None or self._poses is None or not self._is_fresh():
            return False
        return self._motion is None or nanoseconds(self._poses.header.stamp) >= self._motion.since

    def _is_fresh(self) -> bool:
        return time.monotonic() - self._poses_since <= max(FRESH, FRESH_PERIODS * self._poses_interval)


class _Gone:
    """Whether those who were there have gone: they must have been seen, since discovery takes a while."""

    def __init__(self, count: Callable[[], int]):
        self._count, self._seen, self._look = count, False, 0.0

    def __call__(self) -> bool:
        now = time.monotonic()
        if now < self._look:
            return False
        self._look = now + LOOK_EVERY
        there = self._count() > 0
        self._seen |= there
        return self._seen and not there


def _summary(request: Asked) -> str:
    robots = f"{len(request.robots)} robots" if len(request.robots) else "the scenario's goals"
    return f"{robots}, time_limit {request.time_limit:g} s"


def _warning(plan: MotionPlan) -> str:
    """Return what is odd about a plan, or nothing."""
    if not plan.primitives:
        return (
            f"nothing to do: every robot is within the tolerance of its goal already, the farthest {plan.goal_error:.3g} m away"
        )
    duration = plan.execution_time + plan.selection_time
    if duration > LONG_PLAN:
        return (
            f"the plan takes {duration / 3600:.1f} h on the substrate: look whether the goals are what was meant, "
            "give more time_limit, or take another planner"
        )
    return ""


def _end(handle: ServerGoalHandle, result: PlanMotionAction.Result) -> None:
    if result.success:
        handle.succeed()
    elif handle.is_cancel_requested:
        handle.canceled()
    else:
        handle.abort()


def _refused(response: Answer, code: ErrorCode, text: str) -> Answer:
    response.success, response.error_code, response.error_msg = False, int(code), text
    return response


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner planner`."""
    worker = Worker()  # starts while ROS does
    try:
        code = run("planner", lambda: PlannerNode(worker), args)
    finally:
        worker.close()
    sys.exit(code)
