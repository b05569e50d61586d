"""The mover node: the action `move_swarm` brings robots to their goals in closed loop, over sequencer and driver."""

import sys
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.health import OK, Health, tell_health
from stressbot_msgs.process import ProcessNode, run

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.kalman_filters import Prior
from stressbot_planner.execution.closed_loop import ClosedLoop, PlanRequest, Remainder, State
from stressbot_planner.execution.worker import Task, Worker, WorkerEnded
from stressbot_planner.model.swarm import check_positive
from stressbot_planner.planners import Settings
from stressbot_planner.planners.assignment import assigned
from stressbot_planner.primitives.expansion import expand
from stressbot_planner.problem.definition import Problem
from stressbot_planner.ros.client import NEW_POSES, SwarmClient
from stressbot_planner.ros.conversion import Scene, check_size
from stressbot_planner.ros.goals import check_measured, goals_of_request, named_for_request
from stressbot_planner.ros.parameters import Number, declare, number_of
from stressbot_planner.ros.remote_bench import RemoteBench, stop

PLANNER = "optimize"
_ASSUMED = Prior()
_PREFIX = "assumed."

PARAMETERS = (
    Number(
        "planning_time",
        0.5,
        "[s] Of one attempt at a new plan, more where that was not enough. The substrate rests meanwhile.",
        low=0.01,
        high=60.0,
    ),
    Number(
        "assumed.speed_error",
        float(_ASSUMED.speed_error),
        "Standard deviation of a robot's speed from its description, relative; where a calibration tells, that holds.",
        low=0.0,
        high=0.5,
    ),
    Number(
        "assumed.turning_error",
        float(_ASSUMED.turning_error),
        "Standard deviation of a robot's turning rate from its description, relative; where a calibration tells, that holds.",
        low=0.0,
        high=0.5,
    ),
    Number(
        "assumed.heading_bias",
        float(_ASSUMED.heading_bias),
        "[rad] Standard deviation of the angle from measured heading to the direction of sliding; where a calibration tells, "
        "that holds.",
        low=0.0,
        high=np.pi / 2,
    ),
    Number(
        "assumed.heading_noise",
        _ASSUMED.heading_noise,
        "[rad] Standard deviation of the jump of a heading in each activation; learnt on the way.",
        low=1e-4,
        high=np.pi / 2,
    ),
    Number(
        "assumed.position_noise",
        _ASSUMED.position_noise,
        "Standard deviation of measured positions, in body radii.",
        low=0.0,
        high=1.0,
    ),
    Number(
        "assumed.orientation_noise",
        _ASSUMED.orientation_noise,
        "[rad] Standard deviation of measured headings.",
        low=0.0,
        high=np.pi / 2,
    ),
)

LONGEST = 86400.0
"""Largest time limit of a goal, s."""

REST_FRAMES = 3
SEEN_WITHIN = 2.0
"""Poses that make a measurement at rest, and s to wait for a robot that is out of sight."""


class MoverNode(ProcessNode):
    """ROS around `ClosedLoop`. One goal at a time; another is answered with BUSY."""

    def __init__(self) -> None:
        """Raises StressbotError if a parameter is refused."""
        super().__init__("mover")
        try:
            declare(self, PARAMETERS)
        except BaseException:
            self.destroy_node()
            raise
        self._moving, self._closing = threading.Lock(), threading.Event()
        self._since = 0.0  # when the present goal came, s
        self._worker: Worker | None = None
        self._server = ActionServer(
            self,
            MoveSwarm,
            "move_swarm",
            self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        tell_health(self, self._health)
        self.get_logger().info("ready")

    def _health(self) -> Health:
        if self._moving.locked():
            return OK, f"moves the swarm since {time.monotonic() - self._since:.0f} s", {}
        return OK, "ready", {}

    def close(self) -> None:
        """Break off a motion: the driver is stopped before this returns."""
        self._closing.set()
        if self._worker is not None:
            self._worker.close()
        with self._moving:
            pass

    async def _on_goal(self, handle: ServerGoalHandle) -> MoveSwarm.Result:
        # A thread does the work, so that the executor's stays free for cancel requests.
        answered = Future()

        def answer() -> None:
            result = MoveSwarm.Result()
            try:
                result = self._answer(handle)
            finally:
                answered.set_result(result)
                self.wake()

        threading.Thread(target=answer, name="move_swarm", daemon=True).start()
        result: Any = await answered
        return result

    def _answer(self, handle: ServerGoalHandle) -> MoveSwarm.Result:
        result = MoveSwarm.Result()
        if not self._moving.acquire(blocking=False):
            since = time.monotonic() - self._since
            _refuse(
                result,
                ErrorCode.BUSY,
                f"move_swarm: another goal is being moved to, since {since:.1f} s: cancel it, or wait for its end",
            )
            handle.abort()
            return result
        self._since = time.monotonic()
        try:
            self._move(handle, result)
        except StressbotError as error:
            _refuse(result, error.code, str(error))
        except TimeoutError as error:
            why = "start driver and sequencer, and a tracker if the driver has none"
            _refuse(result, ErrorCode.NO_SWARM, f"move_swarm: {error}: {why}")
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            _refuse(result, ErrorCode.INTERNAL, f"mover: a defect ({error!r}): please report it")
        finally:
            self._moving.release()
        if result.success:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        counts = f"{result.activations} activations, {result.plans} plans, {result.corrections} corrections"
        if result.success:
            self.get_logger().info(f"{result.error_msg or 'all robots are at their goals'}; {counts}")
        elif result.error_code == ErrorCode.INTERNAL:
            self.get_logger().error(f"{result.error_msg}; {counts}")
        else:
            self.get_logger().warning(f"{result.error_msg}; {counts}")
        return result

    def _move(self, handle: ServerGoalHandle, result: MoveSwarm.Result) -> None:
        request = handle.request
        check_size(request)
        check_positive("tolerance", request.tolerance)
        check_positive("time_limit", request.time_limit)
        if request.time_limit > LONGEST:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, "time_limit", f"is {request.time_limit:g} s: give at most {LONGEST:g} s, which is a day"
            )
        deadline = time.monotonic() + request.time_limit

        def check() -> None:
            if self._closing.is_set():
                raise _closing()
            if handle.is_cancel_requested:
                raise StressbotError(ErrorCode.CANCELLED, "move_swarm", "was cancelled on request; the robots are at rest")
            if time.monotonic() > deadline:
                raise StressbotError(
                    ErrorCode.TIMED_OUT, "time_limit", f"of {request.time_limit:g} s is over: give more, or a larger tolerance"
                )

        with SwarmClient("mover_client", self.get_namespace(), NEW_POSES) as client:
            try:
                bench = RemoteBench(client, "move_swarm", REST_FRAMES, SEEN_WITHIN, check)
                # It gets ready while the beam search drives, which seldom needs a plan.
                worker = self._worker = self._worker or Worker()
                self._drive(handle, result, bench, worker, check)
            except WorkerEnded:
                if self._closing.is_set():
                    raise _closing() from None
                raise StressbotError(ErrorCode.INTERNAL, PLANNER, "its process died as it started: send the goal again") from None
            finally:
                stop(client)

    def _drive(
        self, handle: ServerGoalHandle, result: MoveSwarm.Result, bench: RemoteBench, worker: Worker, check: Callable[[], None]
    ) -> None:
        scene, request = bench.scene, handle.request
        starts = bench.measure()
        unseen = np.flatnonzero(np.isnan(starts[:, 0]))
        if unseen.size:
            raise StressbotError(
                ErrorCode.NO_SWARM, "swarm_poses", f"has no pose of robot {scene.ids[unseen[0]]}: bring it into the tracker's view"
            )
        check_measured(scene, starts)
        goals, headings, exchangeable, parked, waypoints = goals_of_request(request, scene, starts)
        for row in np.flatnonzero(~np.isnan(headings))[:1]:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                f"goal of robot {scene.ids[row]}",
                "has a heading, which the closed loop does not see to: name robots and places, or plan by plan_motion",
            )
        for row in parked[:1]:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                f"goal of robot {scene.ids[row]}",
                "is parked, and the closed loop moves everybody: name robots and places, or plan by plan_motion",
            )
        if len(waypoints):
            raise StressbotError(
                ErrorCode.UNSUPPORTED, "goal_x", "are goals in stages, or there are waypoints in the scenario: name robots and one "
                "place each, or plan by plan_motion",
            )
        tolerance = request.tolerance / scene.unit
        if exchangeable:
            try:
                problem = Problem(scene.swarm, scene.environment, starts, goals, tolerance, exchangeable)
            except StressbotError as error:
                raise named_for_request(error, scene, request, exchangeable) from error
            goals = assigned(problem, "path").goals
        solver = self._solver(worker, number_of(self, "planning_time"), check)
        loop = ClosedLoop(scene.swarm, scene.environment, goals, tolerance, starts, solver, self._assumed(scene))
        noise = scene.unit * loop.filters.position_noise
        if request.tolerance <= noise:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                "tolerance",
                f"is {request.tolerance:g} m, but places are taken to be measured to {noise:.3g} m (the mover's parameter "
                "assumed.position_noise, in body radii), so that nobody could tell: give more, or assume less noise",
            )
        first = loop.errors
        while True:
            check()
            decision = loop.decide()
            feedback = _tell(MoveSwarm.Feedback(), loop, scene, result.activations)
            left = loop.errors / np.maximum(first, loop.tolerance)
            feedback.progress = float(np.clip(1.0 - left[loop.moving].max(initial=0.0), 0.0, 1.0))
            handle.publish_feedback(feedback)
            if decision.state is not State.DRIVE:
                break
            for group, length, poses in bench.drive_and_look((decision.groups, decision.lengths)):
                loop.observe(group, length, poses)
                result.activations += 1
            _tell(result, loop, scene, result.activations)
        _tell(result, loop, scene, result.activations)
        result.success = decision.state is State.DONE
        if decision.error is not None:
            raise named_for_request(decision.error, scene, request, exchangeable) from decision.error
        if loop.stuck.any():
            stuck = ", ".join(map(str, scene.ids[loop.stuck]))
            result.error_msg = f"robots {stuck} do not move: they became obstacles, their goals were dropped"

    def _assumed(self, scene: Scene) -> Prior:
        """Return what is assumed of the robots: by calibration, or else by the parameters as they are now."""
        names = [parameter.name for parameter in PARAMETERS if parameter.name.startswith(_PREFIX)]
        assumed = Prior(**{name.removeprefix(_PREFIX): number_of(self, name) for name in names})
        return assumed if scene.calibration is None else assumed.calibrated(scene.swarm, scene.calibration)

    def _solver(self, worker: Worker, planning_time: float, check: Callable[[], None]) -> Callable[[PlanRequest], Remainder]:
        def solve(wanted: PlanRequest) -> Remainder:
            settings = Settings(
                time_limit=wanted.effort * planning_time,
                max_epochs=wanted.max_epochs,
                seed=wanted.seed,
            )
            report = worker.solve(Task.of(wanted.problem, PLANNER, settings), check)
            if not report.success:
                raise StressbotError(report.code, PLANNER, report.reason)
            return expand(wanted.problem.swarm, report.primitives)

        return solve


def _tell(message, loop: ClosedLoop, scene: Scene, activations: int):
    message.robots = scene.ids.tolist()
    message.errors = (scene.unit * loop.errors).tolist()
    message.stuck = scene.ids[loop.stuck].tolist()
    message.activations, message.plans, message.corrections = activations, loop.plans, loop.retimings
    return message


def _closing() -> StressbotError:
    return StressbotError(ErrorCode.CANCELLED, "move_swarm", "was broken off: the mover node is closing")


def _refuse(result: MoveSwarm.Result, code: ErrorCode, text: str) -> None:
    result.success, result.error_code, result.error_msg = False, int(code), text


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner mover`."""
    sys.exit(run("mover", MoverNode, args))
