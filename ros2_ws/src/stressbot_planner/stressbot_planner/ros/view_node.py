"""`stressbot view` on live nodes: what they say goes onto the board, what pages ask for goes to them."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
import rclpy
from action_msgs.msg import GoalStatusArray
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import qos_profile_action_status_default
from std_srvs.srv import Trigger
from stressbot_msgs.action import MoveSwarm, PlanMotion
from stressbot_msgs.bounds import within
from stressbot_msgs.described import Described
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses, VoltageSequence
from stressbot_msgs.process import ProcessNode, run

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.problem.bounds import bounds_of_stages, in_all
from stressbot_planner.ros import view_words as words
from stressbot_planner.ros.conversion import Scene, scene_of
from stressbot_planner.ros.in_order import InOrder
from stressbot_planner.ros.parameters import declare
from stressbot_planner.ros.qos import LATCHED, NEWEST, ORDERS
from stressbot_planner.ros.stop_line import StopLine
from stressbot_planner.ros.under_way import is_under_way
from stressbot_planner.ros.view_pictures import PictureFeed
from stressbot_planner.view import asks
from stressbot_planner.view.board import Board
from stressbot_planner.view.scene import MICRO
from stressbot_planner.view.server import Desk, PageServer
from stressbot_planner.view.trail import Trail

FRAME_RATE, KEEP_RATE = 30.0, 5.0
"""Hz; of poses to pages, and of looks at what a page that comes later has missed."""

MOST_LINES = 30
EXACT = 1e-10
"""m; the tolerance that means exact, see PlanMotion.action."""

_IDLE_PLANNING: dict[str, Any] = {"active": False, "elapsed": 0.0, "tries": 0, "found": False, "history": [], "bounds": None}
_IDLE_MOVING: dict[str, Any] = {
    "active": False, "progress": 0.0, "errors": {}, "stuck": [], "activations": 0, "plans": 0, "corrections": 0,
}


class ViewNode(ProcessNode, Desk):
    """Looks on, and asks for what pages ask for. All of its state belongs to the executor's thread.

    Attributes:
        address: of the page.
    """

    def __init__(self, namespace: str = "", port: int = 0, read_only: bool = False) -> None:
        """Serve the page. Raises StressbotError if the port is taken or a parameter is refused."""
        super().__init__("view", namespace=namespace)
        self._board = Board()
        self._scene: Scene | None = None
        self._poses: SwarmPoses | None = None
        self._shown: np.ndarray | None = None  # the newest poses that pages have, (n, 3), µm and rad
        self._status: DriverStatus | None = None
        self._plan: MotionPlan | None = None
        self._sequence: VoltageSequence | None = None
        self._goals: dict[int, tuple[float, float]] = {}  # µm, by id
        self._settings = asks.Chosen()
        self._planning, self._moving = dict(_IDLE_PLANNING), dict(_IDLE_MOVING)
        self._handles: dict[str, ClientGoalHandle] = {}  # of what this page has asked for, by "plan" and "move"
        self._asked: set[str] = set()
        self._said: list[str] = []
        self._is_watched = False  # whether a page wants the camera's pictures
        self._trail = Trail()
        self._in_order = InOrder()
        try:
            declare(self)
            self._callers = {name: self.create_client(Trigger, name) for name in ("start", "reset")}
            self._planner = ActionClient(self, PlanMotion, "plan_motion_action")
            self._mover = ActionClient(self, MoveSwarm, "move_swarm")
            self._listen()
            for kind, content in (
                ("status", words.NO_DRIVER), ("scene", None), ("motion", None), ("planning", self._planning),
                ("moving", self._moving), ("settings", self._settings_told()), ("said", []), ("services", []),
            ):
                self._board.put(kind, content)
            self._stop_line = StopLine(self.get_namespace(), self._say_from_elsewhere)
            self._feed = PictureFeed(self, lambda picture: self._server.show(picture), self._say_from_elsewhere)
            try:
                self._server = PageServer(self._board, self, port, read_only)
            except BaseException:
                self._end_stop_line()
                raise
        except BaseException:
            self.destroy_node()
            raise
        self.address = self._server.address

    def close(self) -> None:
        """End the server. What runs goes on: a page that is closed is no stop."""
        self._feed.close()
        self._server.close()
        self._end_stop_line()

    def _end_stop_line(self) -> None:
        rclpy.try_shutdown()
        self._stop_line.close()

    def _listen(self) -> None:
        self._described = Described(self, self._on_described)
        for kind, topic, hear, quality in (
            (SwarmPoses, "swarm_poses", self._on_poses, NEWEST),
            (DriverStatus, "driver_status", self._on_status, LATCHED),
            (MotionPlan, "motion_plan", self._on_plan, ORDERS),
            (MotionPlan, "accepted_plan", self._on_plan, LATCHED),
            (VoltageSequence, "voltage_sequence", self._on_sequence, ORDERS),
            (PlanMotion.Impl.FeedbackMessage, "plan_motion_action/_action/feedback", self._on_planning, 10),
            (MoveSwarm.Impl.FeedbackMessage, "move_swarm/_action/feedback", self._on_moving, 10),
            (GoalStatusArray, "plan_motion_action/_action/status", self._on_planning_status, qos_profile_action_status_default),
            (GoalStatusArray, "move_swarm/_action/status", self._on_moving_status, qos_profile_action_status_default),
        ):
            self.create_subscription(kind, topic, within(self, topic, hear), quality)
        self.create_timer(1 / FRAME_RATE, self._show_poses)
        self.create_timer(1 / KEEP_RATE, self._keep)

    # What nodes say

    def _on_described(self) -> None:
        if self._scene is not None:
            self._plan = self._sequence = None
        self._scene = self._poses = self._shown = None
        self._trail.clear()
        for kind in ("motion", "frame", "trail"):
            self._board.put(kind, None)
        try:
            self._scene = scene_of(self._described)
        except StressbotError as error:
            self._board.put("scene", None)
            self._board.put("status", words.AMBIGUOUS if self._described.is_ambiguous else words.NO_DRIVER)
            if self._described.description is not None:
                self._say(str(error))
            return
        self._board.put("scene", words.scene_of(self._scene))
        self._set_goals(self._scene.goals * self._scene.unit * MICRO)
        self._show_motion()
        if self._status is not None:
            self._on_status(self._status)

    def _on_status(self, message: DriverStatus) -> None:
        before, self._status = self._status, message
        if message.state == DriverStatus.IDLE and before is not None and before.state != DriverStatus.IDLE:
            self._trail.clear()
            self._board.put("trail", None, quietly=True)
        if self._scene is not None:
            self._board.put("status", words.status_of(message))

    def _on_poses(self, message: SwarmPoses) -> None:
        if self._scene is not None and message.swarm_id == self._scene.swarm_id:
            self._poses = message

    def _show_poses(self) -> None:
        message, self._poses = self._poses, None
        if message is None or self._scene is None:
            return
        try:
            self._shown = words.poses_of(message, self._scene)
        except StressbotError as error:
            self._say(str(error))
            return
        self._board.put("frame", words.frame_of(self._shown, message.sequence_time))

    def _keep(self) -> None:
        """Bring up to date what a page that comes later has missed, and what the graph alone tells."""
        if self._shown is not None and self._trail.add(self._shown):
            self._board.put("trail", self._trail.told(), quietly=True)
        offered = [name for name, client in self._callers.items() if client.service_is_ready()]
        offered += [name for name, client in (("plan", self._planner), ("move", self._mover)) if client.server_is_ready()]
        offered += ["pictures"] * self._feed.is_there
        self._feed.look(self._is_watched)
        if offered != self._board.get("services"):
            self._board.put("services", offered)
        if self._planning["active"] and "plan" not in offered:  # its server ended without a word
            self._set_planning(False)
        if self._moving["active"] and "move" not in offered:
            self._set_moving(False)

    def _on_plan(self, message: MotionPlan) -> None:
        if self._plan is not None and message.plan_id == self._plan.plan_id:
            return  # the copy of what was heard as an order
        self._plan = message
        if self._planning["active"]:  # what a search ends with, which it told nobody before
            found = {"path": round(MICRO * message.path_length, 2), "driving": round(message.execution_time, 2), "found": True}
            history = [*self._planning["history"], [self._planning["elapsed"], found["path"], found["driving"]]]
            self._planning = {**self._planning, **found, "history": history}
            self._board.put("planning", self._planning)
        self._show_motion()

    def _on_sequence(self, message: VoltageSequence) -> None:
        self._sequence = message
        self._show_motion()

    def _show_motion(self) -> None:
        if self._scene is None or self._plan is None or self._plan.swarm_id != self._scene.swarm_id:
            return
        try:
            motion = words.motion_of(self._plan, self._sequence, self._scene)
        except StressbotError as error:
            self._say(f"the plan cannot be shown: {error}")
            return
        self._board.put("motion", motion)
        if not self._moving["active"]:
            self._set_goals(np.array(motion["goals"]))

    def _on_planning(self, message: Any) -> None:
        if not self._planning["active"]:
            return  # the status, which may overtake it, says what is under way
        news = words.planning_of(message.feedback)
        history = list(self._planning["history"]) if news["elapsed"] >= self._planning["elapsed"] else []
        if news["found"] and (not history or history[-1][1:] != [news["path"], news["driving"]]):
            history.append([news["elapsed"], news["path"], news["driving"]])
        self._planning = {**self._planning, **news, "history": history[-200:]}
        self._board.put("planning", self._planning)

    def _on_planning_status(self, message: GoalStatusArray) -> None:
        self._set_planning(is_under_way(message))

    def _set_planning(self, is_active: bool) -> None:
        if is_active and not self._planning["active"]:
            self._planning = {**_IDLE_PLANNING, "active": True, "limit": self._settings.time_limit}
            self._find_bounds()
        elif not is_active:
            self._planning = {**self._planning, "active": False}
        self._board.put("planning", self._planning)

    def _on_moving(self, message: Any) -> None:
        if self._moving["active"]:
            self._moving = {**words.moving_of(message.feedback), "active": True}
            self._board.put("moving", self._moving)

    def _on_moving_status(self, message: GoalStatusArray) -> None:
        self._set_moving(is_under_way(message))

    def _set_moving(self, is_active: bool) -> None:
        if is_active != self._moving["active"]:
            self._moving = {**(_IDLE_MOVING if is_active else self._moving), "active": is_active}
            self._board.put("moving", self._moving)

    def _find_bounds(self) -> None:
        """Put the lower bounds of what is planned beside it: a linear program, on a thread of its own."""
        scene, shown = self._scene, self._shown
        if scene is None or shown is None or self._settings.assign or scene.exchangeable or not np.isfinite(shown).all():
            return
        scale = scene.unit * MICRO
        goals = np.array([self._goals[int(robot)] for robot in scene.ids]) / scale
        places = np.stack([shown[:, :2] / scale, *scene.waypoints, goals])
        places[1:, list(scene.parked)] = places[0, list(scene.parked)]

        def find() -> None:
            bounds = in_all(bounds_of_stages(scene.swarm, list(places), self._settings.tolerance / scale, scene.parked))

            def show() -> None:
                self._planning = {**self._planning, "bounds": [round(scale * bounds.path_length, 2), bounds.execution_time]}
                self._board.put("planning", self._planning)

            self._later(show)

        threading.Thread(target=find, name="bounds", daemon=True).start()

    # What pages ask for

    def stop(self) -> None:
        """Stop, by a way of its own; and end what would start again."""
        self._stop_line.press()
        self._later(lambda: self._cancel("move"))

    def ask(self, word: str, data: dict[str, Any]) -> None:
        """Begin what is asked for. Raises StressbotError if it is ill-formed; what nodes refuse is said later, to all pages."""
        if word == "goal":
            wanted = asks.goal(data)
            self._later(lambda: self._set_goal(wanted))
        elif word == "settings":
            chosen = asks.settings(data)
            self._later(lambda: self._set(chosen))
        else:
            work: dict[str, Callable[[], None]] = {
                "goals": self._reset_goals,
                "plan": self._ask_for_plan,
                "move": self._ask_for_move,
                "cancel": lambda: (self._cancel("plan"), self._cancel("move"))[0],
                "start": lambda: self._trigger("start"),
                "reset": lambda: self._trigger("reset"),
            }
            self._later(work[word])

    def watch(self, is_watched: bool) -> None:
        """Hear the camera, or no more."""
        self._is_watched = is_watched

    def _later(self, work: Callable[[], None]) -> None:
        """Do something on the executor's thread, after all that was asked for before."""

        def guarded() -> None:
            try:
                work()
            except StressbotError as error:
                self._say(str(error))

        if (executor := self.executor) is not None:
            self._in_order.add(executor, guarded)

    def _set_goal(self, wanted: asks.Goal) -> None:
        if wanted.robot not in self._goals:
            raise StressbotError(ErrorCode.UNKNOWN_ROBOT, "robot", f"is {wanted.robot}: there is no such robot here")
        if (scene := self._scene) is not None and scene.row(wanted.robot, "robot") in scene.parked:
            raise StressbotError(ErrorCode.DUPLICATE_GOAL, "robot", f"is {wanted.robot}, which is parked: it has no goal")
        self._goals[wanted.robot] = wanted.x, wanted.y
        self._tell_goals()

    def _set_goals(self, places: np.ndarray) -> None:
        if self._scene is not None:
            pairs = zip(self._scene.ids.tolist(), places.tolist(), strict=True)
            self._goals = {robot: (x, y) for robot, (x, y) in pairs}
            self._tell_goals()

    def _reset_goals(self) -> None:
        if self._scene is not None:
            self._set_goals(self._scene.goals * self._scene.unit * MICRO)

    def _tell_goals(self) -> None:
        self._board.put("goals", [[round(x, 2), round(y, 2)] for x, y in self._goals.values()])

    def _set(self, chosen: asks.Chosen) -> None:
        self._settings = chosen
        self._board.put("settings", self._settings_told())

    def _settings_told(self) -> dict[str, Any]:
        return {**asdict(self._settings), "planners": planners.names()}

    def _request(self, request: Any) -> Any:
        """Fill in the goals: none at all where they are the scenario's own, which may be for any robot."""
        scene = self._scene
        if scene is None:
            raise StressbotError(ErrorCode.NO_SWARM, "swarm_description", "has no driver that is alive: start it first")
        own = np.round(scene.goals * scene.unit * MICRO, 2).tolist()
        request.assign = self._settings.assign
        if own != [[round(x, 2), round(y, 2)] for x, y in self._goals.values()]:
            parked = scene.ids[list(scene.parked)].tolist() if isinstance(request, PlanMotion.Goal) else []
            robots = [robot for robot in self._goals if robot not in parked]
            rows = [row for row, robot in enumerate(self._goals) if robot not in parked]
            places = np.array([list(self._goals.values())]) / MICRO
            if isinstance(request, PlanMotion.Goal):
                request.parked = parked
                request.goal_heading = scene.goal_headings[rows].tolist()
                places = np.concatenate([scene.waypoints * scene.unit, places])
            request.robots = robots
            request.goal_x, request.goal_y = (places[:, rows, axis].ravel().tolist() for axis in (0, 1))
        return request

    def _ask_for_plan(self) -> None:
        chosen = self._settings
        tolerance = chosen.tolerance / MICRO or EXACT
        goal = self._request(
            PlanMotion.Goal(
                planner=chosen.planner, objective=chosen.objective, tolerance=tolerance, time_limit=chosen.time_limit
            )
        )
        self._send("plan", self._planner, goal, self._planned)

    def _planned(self, result: PlanMotion.Result) -> None:
        if not result.success:
            self._say(f"no plan: {result.error_msg}")
            return
        plan = result.plan
        self._say(
            f"plan in {result.planning_time:.2f} s: path {MICRO * plan.path_length:.0f} µm, "
            f"{plan.execution_time + plan.selection_time:.1f} s" + (f"; {result.warning}" if result.warning else "")
        )

    def _ask_for_move(self) -> None:
        chosen = self._settings
        goal = self._request(MoveSwarm.Goal(tolerance=chosen.near / MICRO, time_limit=chosen.patience))
        self._send("move", self._mover, goal, self._moved)

    def _moved(self, result: MoveSwarm.Result) -> None:
        self._moving = {**words.moving_of(result), "active": False}
        self._board.put("moving", self._moving)
        far = max(result.errors, default=math.nan)
        ended = f"closed loop: all within {MICRO * far:.1f} µm" if result.success else "closed loop: not all are at their goals"
        self._say(f"{ended}, {result.activations} activations" + (f"; {result.error_msg}" if result.error_msg else ""))

    def _send(self, what: str, client: ActionClient, goal: Any, ended: Callable[[Any], None]) -> None:
        if not client.server_is_ready():
            node = "planner" if what == "plan" else "mover"
            raise StressbotError(ErrorCode.NOT_HEARD, what, f"is served by nobody: start the {node}")
        if what in self._asked:
            raise StressbotError(ErrorCode.BUSY, what, "has been asked for already: wait for its end, or cancel it")
        self._asked.add(what)

        def accepted(future: Any) -> None:
            handle = future.result()
            if handle is None or not handle.accepted:
                self._asked.discard(what)
                self._say(f"{what}: was not accepted")
                return
            self._handles[what] = handle
            handle.get_result_async().add_done_callback(finished)

        def finished(future: Any) -> None:
            self._asked.discard(what)
            self._handles.pop(what, None)
            answer = future.result()
            if answer is not None:
                ended(answer.result)

        client.send_goal_async(goal).add_done_callback(accepted)

    def _cancel(self, what: str) -> None:
        if what in self._handles:
            self._handles[what].cancel_goal_async()

    def _trigger(self, service: str) -> None:
        client = self._callers[service]
        if not client.service_is_ready():
            raise StressbotError(ErrorCode.NO_SWARM, service, "is served by nobody: start the driver")

        def answered(future: Any) -> None:
            result = future.result()
            if result is not None and not result.success:
                self._say(f"{service}: {result.message}")

        client.call_async(Trigger.Request()).add_done_callback(answered)

    # What happens, in lines

    def _say_from_elsewhere(self, line: str) -> None:
        self._later(lambda: self._say(line))

    def _say(self, line: str) -> None:
        line = f"{time.strftime('%H:%M:%S')}  {line}"
        if not self._said or self._said[-1] != line:
            self._said = [*self._said, line][-MOST_LINES:]
            self._board.put("said", self._said)


def serve(namespace: str, port: int, read_only: bool, tell: Callable[[str], None]) -> int:
    """Serve the page of live nodes until a signal; `tell` is told its address. Return the exit code."""

    def make() -> ViewNode:
        node = ViewNode(namespace, port, read_only)
        tell(node.address)
        return node

    return run("view", make, [])
