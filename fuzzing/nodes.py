"""A share of it over DDS, at running nodes: they stay alive, answer, and run a good sequence to its end afterwards."""

import math
import os
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from geometry_msgs.msg import Point, PointStamped, Pose, PoseArray, PoseStamped, Quaternion
from hypothesis import strategies as st
from nav_msgs.msg import Path as PathMessage
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.action import PlanMotion as PlanMotionAction
from stressbot_msgs.domains import reserve
from stressbot_msgs.msg import DriverStatus, MotionPlan, SequencerStatus, SwarmDescription, SwarmPoses, VoltageSequence
from stressbot_msgs.srv import PlanMotion
from system_rig import SCENARIOS, System, asking_again
from visualization_msgs.msg import MarkerArray

from fuzzing import generated, orders, settings, volts
from fuzzing.generated import Tally
from fuzzing.interface import ACCEPTED, Final, Interface, Violation, check_refusal
from fuzzing.strategies import NAMES, NUMBERS, messages
from stressbot_planner.errors import ErrorCode
from stressbot_planner.planners import LONGEST_REQUEST
from stressbot_planner.ros.bringup import NodeEntry, command
from stressbot_planner.ros.qos import LATCHED, LIVING, NEWEST, ORDERS

PATIENCE = 30.0
"""s for an answer."""

BRISK = {"real_time_factor": 0.0, "auto_start": True}
"""Parameters of the driver: what it accepts it plays at once."""

TRIES = 20

SENT = "sent"


class Nodes:
    """All nodes of the project that have topics, and hands at all of them."""

    def __init__(self, folder: Path) -> None:
        names = ("driver", "sequencer", "planner", "mover", "viewer", "paths", "clicks")
        self.system = System(folder, names, scenario=SCENARIOS / "paper-six-two-discs.yaml", peer_timeout=5.0, **BRISK)
        relay = command(NodeEntry("stressbot_planner", "tracker_relay"), {}, namespace=self.system.namespace)
        self.system.processes.start("tracker_relay", relay)
        self.client, self.node = self.system.client, self.system.client.node
        self.system.wait_for(self.client.is_system_ready, "all nodes")
        self.description = self.client.description
        self.low, self.high = orders.BENCH.electrical.min_level, orders.BENCH.electrical.max_level
        kinds = {
            "swarm_poses": (SwarmPoses, NEWEST),
            "driver_status": (DriverStatus, LATCHED),
            "sequencer_status": (SequencerStatus, LIVING),
            "motion_plan": (MotionPlan, ORDERS),
            "voltage_sequence": (VoltageSequence, ORDERS),
            "tracked_poses": (PoseArray, NEWEST),
            "accepted_plan": (MotionPlan, LATCHED),
            "clicked_point": (PointStamped, ORDERS),
            "goal_pose": (PoseStamped, ORDERS),
        }
        self.publishers = {topic: self.node.create_publisher(kind, topic, quality) for topic, (kind, quality) in kinds.items()}
        self.levels: list[float] = []
        self.node.create_subscription(
            DriverStatus, "driver_status", lambda status: self.levels.append(status.output_level), LATCHED
        )
        for kind, name in ((MarkerArray, "path_markers"), (PathMessage, "robot_1/planned_path"), (MarkerArray, "swarm_markers")):
            self.node.create_subscription(kind, name, lambda _: None, NEWEST)  # else nothing is made
        self.parameters = {name: AsyncParameterClient(self.node, f"{self.system.namespace}/{name}") for name in names}
        self.mover = ActionClient(self.node, MoveSwarm, "move_swarm")
        self.planner = ActionClient(self.node, PlanMotionAction, "plan_motion_action")
        self.wait(lambda: all(publisher.get_subscription_count() for publisher in self.publishers.values()), "subscribers")
        self.wait(lambda: all(client.services_are_ready() for client in self.parameters.values()), "parameter services")
        self.wait(self.mover.server_is_ready, "move_swarm")
        self.wait(self.planner.server_is_ready, "plan_motion_action")

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait for a condition and return its value.

        Raises:
            Final: it does not come, or a node has ended.
        """
        try:
            return self.client.wait_for(condition, PATIENCE, what, self.check_alive)
        except TimeoutError as error:
            raise Final(f"{error}; {self.client.driver_status}") from error

    def check_alive(self) -> None:
        """Raise Final if a node has ended."""
        for name in self.system.processes.ended():
            raise Final(f"{name} is dead: {self.system.log(name)[-1500:]}")

    def call(self, future: Any, what: str) -> Any:
        """Wait for a future and return its result."""
        return self.wait(lambda: future.done() and (future.result(),), what)[0]

    # What arrives

    def publish(self, topic: str, message: Any) -> str:
        """Publish a message, or bytes in place of one."""
        self.publishers[topic].publish(message)
        self.call(self.parameters["planner"].get_parameters(["planner"]), "sign of life of the planner")
        self.check_alive()
        return SENT

    def describe(self, message: SwarmDescription | bytes) -> str:
        """Speak as a second driver, and leave again, so that nobody listens to two."""
        publisher = self.node.create_publisher(SwarmDescription, "swarm_description", LATCHED)
        try:
            self.wait(publisher.get_subscription_count, "who listens to drivers")
            publisher.publish(message)
            self.call(self.parameters["planner"].get_parameters(["planner"]), "sign of life of the planner")
            self.check_alive()
        finally:
            self.system.asked(lambda: self.node.destroy_publisher(publisher))  # not while another thread waits for its events
        return SENT

    def order(self, plan: MotionPlan) -> str:
        """Send a plan; the sequencer says what became of it."""
        plan.plan_id = uuid.uuid4().hex
        self.publishers["motion_plan"].publish(plan)
        status = self.wait(lambda: (s := self.client.sequencer_status).plan_id == plan.plan_id and s, "word of the sequencer")
        return _code(status.error_code, status.error_msg)

    def play(self, sequence: VoltageSequence) -> str:
        """Send a sequence; the driver says what became of it, plays it if it may, and is at rest in the end."""
        self.levels.clear()  # of statuses that others made up
        sequence.plan_id = uuid.uuid4().hex
        self.publishers["voltage_sequence"].publish(sequence)

        def word() -> DriverStatus | None:
            status = self.client.driver_status
            return status if sequence.plan_id in (status.plan_id, status.refused_plan_id) else None

        status = self.wait(word, "word of the driver")
        result = _code(status.error_code, status.error_msg)
        if result == ACCEPTED:
            self.client.trigger("stop", PATIENCE)
        self.wait(lambda: self.client.driver_status.output_level == 0.0, "zero volts")
        if self.client.driver_status.state == DriverStatus.FAULT:
            raise Final(f"a sequence led to FAULT: {self.client.driver_status.error_msg}")
        self._check_volts()
        return result

    def ask(self, request: PlanMotion.Request) -> str:
        """Call plan_motion."""
        _shorten(request)
        answer = self.call(self.client._services["plan_motion"].call_async(request), "answer of plan_motion")
        return _code(answer.error_code, answer.error_msg)

    def ask_and_cancel(self, order: tuple[PlanMotionAction.Goal, bool]) -> str:
        """Send a goal to plan_motion_action; cancel it, or not; wait for its result."""
        goal, cancels = order
        _shorten(goal)
        handle = self.call(self.system.asked(lambda: self.planner.send_goal_async(goal)), "acceptance of a request")
        if cancels and handle.accepted:
            self.call(self.system.asked(handle.cancel_goal_async), "answer to a cancellation")
        result = self.call(self.system.asked(handle.get_result_async), "result of plan_motion_action").result
        return _code(result.error_code, result.error_msg)

    def move(self, goal: MoveSwarm.Goal) -> str:
        """Send a goal to the mover and wait for its result."""
        if math.isfinite(goal.time_limit):
            goal.time_limit = min(goal.time_limit, 0.5)
        handle = self.call(self.system.asked(lambda: self.mover.send_goal_async(goal)), "acceptance of a goal")
        result = self.call(self.system.asked(handle.get_result_async), "result of move_swarm").result
        return _code(result.error_code, result.error_msg if result.error_code else "")

    def set(self, change: tuple[str, dict[str, Any]]) -> str:
        """Set parameters of a node."""
        node, values = change
        parameters = []
        for name, value in values.items():
            try:
                parameters.append(Parameter(name, value=value))
            except (TypeError, ValueError, AssertionError):
                continue  # rclpy does not send it
        future = self.parameters[node].set_parameters(parameters)
        results = self.call(future, f"answer of {node}").results
        self.check_alive()
        if any(not result.successful and not result.reason for result in results):
            raise Violation(f"refused without a reason: {results}")
        return ACCEPTED if all(result.successful for result in results) else "refused"

    def _check_volts(self) -> None:
        wrong = [level for level in self.levels if not self.low <= level <= self.high]
        if wrong:
            raise Violation(f"{wrong[0]} V on the substrate")

    # What must still work

    def run_a_good_one(self) -> None:
        """Put everything back as it was, plan, and play to the end."""
        self.wait(lambda: self.client.drivers == 1, "an end of all other drivers")
        driver = {declaration.name: declaration.default for declaration in settings.PARAMETERS if not declaration.read_only}
        values = {"driver": driver | BRISK, "planner": {"planner": "optimize"}}
        for node, client in self.parameters.items():
            for name, value in ({"use_sim_time": False} | values.get(node, {})).items():
                parameter = Parameter(name, value=list(value) if isinstance(value, tuple) else value)
                self.call(client.set_parameters([parameter]), f"reset of {name}")
        self.client.trigger("stop", PATIENCE)
        self.client.trigger("reset", PATIENCE)
        # The last word may be one of ours: the real sequencer speaks when it refuses a plan.
        refused = MotionPlan(plan_id="refused", swarm_id="-")
        is_right = asking_again(
            lambda: self.publishers["motion_plan"].publish(refused),
            lambda: self.client.sequencer_status.swarm_id == self.description.swarm_id,
        )
        self.wait(is_right, "the sequencer's swarm")
        for _ in range(TRIES):
            answer = self.system.plan(first=True)
            if not answer.success:
                raise Final(f"no plan afterwards: {answer.error_msg}")
            plan_id = answer.plan.plan_id
            status = self.wait(
                lambda plan_id=plan_id: (
                    (
                        (s := self.client.driver_status).refused_plan_id == plan_id
                        or (s.plan_id, s.state) == (plan_id, DriverStatus.DONE)
                    )
                    and s
                ),
                "the end of a good sequence",
            )
            # from poses before the reset, or after statuses that others made up, and rightly refused
            if status.error_code not in (ErrorCode.OUTDATED, ErrorCode.AMBIGUOUS_SWARM):
                break
        if status.state != DriverStatus.DONE or status.error_code:
            raise Final(f"a good sequence was refused: {status.error_msg}")


def _shorten(request: PlanMotion.Request | PlanMotionAction.Goal) -> None:
    if 0.05 < request.time_limit <= LONGEST_REQUEST:
        request.time_limit = 0.05


def _code(code: int, text: str) -> str:
    if code == 0:
        return ACCEPTED
    check_refusal(code, *text.partition(": ")[::2])
    return ErrorCode(code).name


# Inputs that have no counterpart in one process


def _statuses(kind: type) -> st.SearchStrategy:
    return messages(kind, 4, swarm_id=orders.BENCH.swarm_id) if kind is SequencerStatus else messages(kind, 6)


def _tracked() -> st.SearchStrategy[PoseArray]:
    place = st.builds(lambda x, y: Pose(position=Point(x=x, y=y), orientation=Quaternion(w=1.0)), NUMBERS, NUMBERS)
    turned = st.builds(lambda w, z: Pose(orientation=Quaternion(w=w, z=z)), NUMBERS, NUMBERS)
    frame = st.sampled_from(["substrate", "substrate", ""]) | NAMES.map(lambda text: text.replace("\0", ""))
    poses = st.lists(place | turned, min_size=6, max_size=7)
    return st.builds(lambda found, name: PoseArray(header=Header(frame_id=name), poses=found), poses, frame)


def _clicks(kind: type) -> st.SearchStrategy:
    frame = st.sampled_from(["substrate", "substrate_view", "map"])

    def click(x: float, y: float, name: str) -> Any:
        place, header = Point(x=x, y=y), Header(frame_id=name)
        return kind(header=header, point=place) if kind is PointStamped else kind(header=header, pose=Pose(position=place))

    return st.builds(click, NUMBERS, NUMBERS, frame)


def _bytes(good: Any) -> st.SearchStrategy[bytes]:
    """What claims to be a message: cut short, with wrong lengths, or noise."""
    wire = serialize_message(good)

    def changed(edits: dict[int, int], size: int) -> bytes:
        data = bytearray(wire)
        for place, value in edits.items():
            data[place % len(data)] = value
        return bytes(data[:size])

    places = st.integers(0, len(wire) - 1)
    edits = st.dictionaries(places, st.integers(0, 255) | st.just(255), max_size=6)
    return st.builds(changed, edits, places | st.just(len(wire))) | st.binary(min_size=4, max_size=60)


def _changes(nodes: Nodes) -> st.SearchStrategy:
    names = st.sampled_from(["use_sim_time", "planner", "unknown", "", "view_scale", *settings.DRIVER])
    values = st.dictionaries(names, settings.VALUES, min_size=1, max_size=3)
    return st.tuples(st.sampled_from(sorted(nodes.parameters)), values | settings._some(settings.DRIVER, 3))


def campaign(count: int, number: int, only: str = "") -> Iterator[Tally]:
    """Bring about `count` inputs to running nodes."""
    domain, hold = reserve()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with hold, TemporaryDirectory() as folder, _quiet(Path(folder, "stderr")):
        nodes = Nodes(Path(folder))
        try:
            for interface in interfaces(nodes):
                if only in interface.name:
                    yield _one(nodes, interface, max(1, round(count * interface.weight)), number)
        finally:
            nodes.system.close()


@contextmanager
def _quiet(log: Path) -> Iterator[None]:
    """Keep what the DDS library of this process says of malformed messages, which it receives as well, out of the terminal."""
    before = os.dup(2)
    with log.open("wb") as stream:
        os.dup2(stream.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


def _one(nodes: Nodes, interface: Interface, count: int, number: int) -> Tally:
    tally = generated.campaign(interface, count, number, "DDS")
    try:
        nodes.run_a_good_one()
    except Exception as error:
        tally.violations.append(f"afterwards: {error!r}")
    return tally


def interfaces(nodes: Nodes) -> tuple[Interface, ...]:
    """Return where hostile input arrives over DDS; the weights are shares."""

    def topic(name: str) -> Callable[[Any], str]:
        return lambda message: nodes.publish(name, message)

    good = {
        "swarm_description": nodes.description,
        "swarm_poses": orders.POSES,
        "motion_plan": MotionPlan(plan_id="raw", swarm_id=nodes.description.swarm_id),
        "voltage_sequence": volts.good_message(orders.BENCH),
        "driver_status": nodes.client.driver_status,
        "sequencer_status": nodes.client.sequencer_status,
        "tracked_poses": PoseArray(poses=[Pose()] * 6),
        "accepted_plan": MotionPlan(plan_id="raw", swarm_id=nodes.description.swarm_id),
        "clicked_point": PointStamped(),
        "goal_pose": PoseStamped(),
    }
    raw = st.sampled_from(sorted(good)).flatmap(lambda name: st.tuples(st.just(name), _bytes(good[name])))

    def raw_message(pair: tuple[str, bytes]) -> str:
        name, data = pair
        return nodes.describe(data) if name == "swarm_description" else nodes.publish(name, data)

    return (
        Interface("swarm_description", orders.descriptions(), nodes.describe, 0.1),
        Interface("swarm_poses", orders.poses(), topic("swarm_poses"), 0.1),
        Interface("tracked_poses", _tracked(), topic("tracked_poses"), 0.05),
        Interface("accepted_plan", orders.standing_plans(), topic("accepted_plan"), 0.05),
        Interface("clicked_point", _clicks(PointStamped), topic("clicked_point"), 0.02),
        Interface("goal_pose", _clicks(PoseStamped), topic("goal_pose"), 0.02),
        Interface("driver_status", _statuses(DriverStatus), topic("driver_status"), 0.05),
        Interface("sequencer_status", _statuses(SequencerStatus), topic("sequencer_status"), 0.05),
        Interface("malformed messages, bytes", raw, raw_message, 0.15),
        Interface("motion_plan", orders.plans(orders.SCENE), nodes.order, 0.15),
        Interface("voltage_sequence", volts.sequences(orders.BENCH), nodes.play, 0.15),
        Interface("plan_motion", orders.requests(0.05), nodes.ask, 0.1),
        Interface(
            "plan_motion_action",
            st.tuples(orders.requests(0.05, PlanMotionAction.Goal), st.booleans()),
            nodes.ask_and_cancel,
            0.1,
        ),
        Interface("move_swarm", orders.move_goals(), nodes.move, 0.02),
        Interface("set_parameters", _changes(nodes), nodes.set, 0.08),
    )
