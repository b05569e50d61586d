"""The driver node: tells what lies on the bench, plays voltage sequences, reports poses and its own state."""

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger
from stressbot_msgs.bounds import excess, within
from stressbot_msgs.described import AMBIGUOUS
from stressbot_msgs.health import ERROR, OK, WARN, Health, tell_health
from stressbot_msgs.msg import DriverStatus, SequencerStatus, SwarmDescription, SwarmPoses, VoltageSequence
from stressbot_msgs.parameters import refuse_others
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.wording import quoted

from stressbot_driver.backends.base import Pacing, backend_class
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.bench import load_bench
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.gate.client import GateClient, GateProcess
from stressbot_driver.gate.hardening import DRIVER, real_time
from stressbot_driver.gate.protocol import PERIOD
from stressbot_driver.ros.conversions import description_message, poses_message, sequence_from_message, status_message
from stressbot_driver.ros.imperfections import PARAMETERS as IMPERFECTION_PARAMETERS
from stressbot_driver.ros.imperfections import imperfections_of
from stressbot_driver.ros.parameters import Declaration, declare, first_problem, number_of, value_of
from stressbot_driver.ros.qos import DESCRIPTION, LATCHED, NEWEST, POSES, SEQUENCES, living
from stressbot_driver.sequence import LONGEST_ID
from stressbot_driver.session import Session, State, Status
from stressbot_driver.simulation.imperfections import PREFIX, Flaws, Imperfections
from stressbot_driver.simulation.substrate import Poses

REST_RATES = {"pose_rate": 50.0}  # [Hz] at most: poses of robots that do not move cost as much as those of a motion

PARAMETERS = (
    Declaration("scenario", "", "Path of the scenario file that says what lies on the bench. Required.", read_only=True),
    Declaration("backend", "simulated", "Output onto the substrate, by its entry-point name.", read_only=True),
    Declaration(
        "real_time_factor",
        1.0,
        "Substrate seconds per wall second; 1: wall clock, 0: as fast as possible. Fixed while a sequence runs.",
        low=0.0,
        high=1e6,
        least=1e-3,
    ),
    Declaration(
        "pose_rate",
        50.0,
        f"[Hz] Poses per second of wall time; at rest at most {REST_RATES['pose_rate']:g}.",
        low=0.1,
        high=1000.0,
    ),
    Declaration(
        "tracked", False, "A tracker tells swarm_poses: what the backend itself sees is told as true_poses.", read_only=True
    ),
    Declaration("status_rate", 10.0, "[Hz] Status messages per second besides those at changes.", low=0.1, high=100.0),
    Declaration("auto_start", False, "Start each accepted voltage sequence at once."),
    Declaration(
        "peer_timeout",
        0.08,
        "[s] A running sequence ends in FAULT when the sequencer shows no life for so long; 0: nobody watches.",
        low=0.0,
        high=60.0,
        read_only=True,
    ),
    Declaration(
        "pose_timeout",
        0.0,
        "[s] A running sequence ends in FAULT when no robot was seen on swarm_poses for so long; 0: nobody watches.",
        low=0.0,
        high=60.0,
        read_only=True,
    ),
    Declaration(
        "gate_timeout",
        0.06,
        "[s] The output goes to rest, in FAULT, when the driver itself hangs for so long while a sequence runs.",
        low=0.03,
        high=10.0,
        read_only=True,
    ),
    Declaration(
        "max_duration", 0.0, "[s] A longer sequence is refused; 0: as the backend allows.", low=0.0, high=1e9, read_only=True
    ),
    Declaration(
        "max_slew_rate",
        0.0,
        "[V/s] A sequence with a step that is not over within its dwell is refused; 0: as the backend allows.",
        low=0.0,
        high=1e15,
        read_only=True,
    ),
    Declaration(
        "max_charge",
        0.0,
        "[V s] A sequence whose volts add up to more, of either sign, is refused; 0: any sum will do.",
        low=0.0,
        high=1e9,
        read_only=True,
    ),
    Declaration(
        "max_duty",
        1.0,
        "A sequence that drives for a larger part of its duration is refused; 0: one that drives at all.",
        low=0.0,
        high=1.0,
        read_only=True,
    ),
    *IMPERFECTION_PARAMETERS,
)

SHORTEST_PEER_TIMEOUT = 0.04  # [s] the sequencer offers 0.03
LISTEN_AGAIN = 1.0  # [s]
RIVAL_WITHIN = 1.0  # [s] since the last word of another driver, unless it has left
LEASE_STEP = 1e-8  # [s]
SWITCH = 5e-4  # [s] after which a busy thread gives way to the one that serves `stop`
TICKS = 4  # looks for poses in one pose_timeout


class DriverNode(ProcessNode):
    """ROS around a `Session`; parameters, topics and services as in the package's documentation.

    Attributes:
        vital: what must go on whatever else there is to do: `stop`, the watch on the sequencer, and the gate's heartbeat.

    Raises StressbotError if the parameters or the scenario file are refused.
    """

    def __init__(self) -> None:
        super().__init__("driver")
        process = None
        self._publishing = threading.Lock()
        self._silent = True  # nothing to tell yet, or any more
        try:
            declare(self, PARAMETERS)
            self._backend_name: str = value_of(self, "backend")
            backend = backend_class(self._backend_name)
            self._simulated = issubclass(backend, SimulatedBackend)
            options = {option.name: option for option in backend.OPTIONS}
            self._declarations = (
                *PARAMETERS,
                *(replace(option, name=f"{self._backend_name}.{name}") for name, option in options.items()),
            )
            declare(self, self._declarations[len(PARAMETERS) :])
            refuse_others(self, (declaration.name for declaration in self._declarations))
            self._check_peer_timeout(number_of(self, "peer_timeout"))
            path = self._scenario()
            process = GateProcess()  # which starts while the file is read
            self._bench = load_bench(path)
            self._sequencer: SequencerStatus | None = None  # its last word
            connect = partial(
                GateClient,
                self._backend_name,
                backend,
                self._bench,
                options={name: value_of(self, f"{self._backend_name}.{name}") for name in options},
                timeout=number_of(self, "gate_timeout"),
                process=process,
                note=lambda text: self.get_logger().info(text),
            )
            caps = {name: number_of(self, name) or math.inf for name in ("max_duration", "max_slew_rate", "max_charge")}
            self._session = Session(
                connect,
                self._publish_status,
                self._publish_poses,
                now=lambda: self.get_clock().now().nanoseconds,
                why_none=self._why_no_sequence,
                max_duty=number_of(self, "max_duty"),
                **caps,
            )
            self._impair(self._imperfections([]))
        except BaseException:
            if process is not None:
                process.close()
            self.destroy_node()
            raise
        self._told = Status()  # what the log knows; guarded by that lock, as what this driver has said
        self._said: deque[tuple[int, int]] = deque(maxlen=1000)
        self._rival_until = -math.inf
        self._drivers: set[bytes] = set()  # publishers of driver_status when another driver was heard last
        self._highest = 0.0  # [V] of the last sequence
        self._description_publisher = self.create_publisher(SwarmDescription, "swarm_description", DESCRIPTION)
        topic = "true_poses" if value_of(self, "tracked") else "swarm_poses"
        self._poses_publisher = self.create_publisher(SwarmPoses, topic, POSES)
        self._status_publisher = self.create_publisher(DriverStatus, "driver_status", LATCHED)
        group, self.vital = MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        self.create_subscription(VoltageSequence, "voltage_sequence", self._on_sequence, SEQUENCES, callback_group=group)
        self.create_service(Trigger, "start", self._on_start, callback_group=group)
        self.create_service(Trigger, "stop", self._on_stop, callback_group=self.vital)
        self.create_service(Trigger, "reset", self._on_reset, callback_group=group)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)  # somebody may set the date
        self._timers_by_rate = {
            name: self.create_timer(_rest_period(name, number_of(self, name)), report, clock=self._steady)
            for name, report in (("pose_rate", self._heartbeat), ("status_rate", self._publish_status))
        }
        self.create_timer(PERIOD, self._session.backend.beat, callback_group=self.vital, clock=self._steady)
        self._watch_sequencer(number_of(self, "peer_timeout"))
        self._watch_poses(number_of(self, "pose_timeout"))
        self._listen(DriverStatus, "driver_status", self._hear_driver, LATCHED)
        tell_health(self, self._health)
        self.add_on_set_parameters_callback(self._may_set)
        self.add_post_set_parameters_callback(self._after_set)

        self._silent = False
        description = description_message(self._bench)
        description.header.stamp = self.get_clock().now().to_msg()
        self._description_publisher.publish(description)
        self._publish_status()
        self.get_logger().info(
            f"{len(self._bench.ids)} robots of {self._bench.name!r} (swarm {self._bench.swarm_id}) "
            f"on backend {self._backend_name!r}"
        )
        if notice := backend_class(self._backend_name).NOTICE:
            self.get_logger().warning(notice)
        if self._bench.electrical.drive is None and not self._simulated:
            self.get_logger().warning(
                "electrical.drive of the scenario is constant: each activation moves a real robot once, by one step; "
                "give `electrical: {drive: pulses}`"
            )

    def close(self) -> None:
        """Zero volts, then the last word on `driver_status`."""
        try:
            self._session.close()
        finally:
            self._publish_status()
            self._silent = True
            # What is still on its way when the process ends is lost. A reader that is gone must not hold us for long.
            self._status_publisher.wait_for_all_acked(Duration(seconds=0.5))

    def _scenario(self) -> str:
        path: str = value_of(self, "scenario")
        if not path:
            raise StressbotError(
                ErrorCode.MISSING_FIELD, "scenario", "is not set: start with --ros-args -p scenario:=/path/to/scenario.yaml"
            )
        return path

    def _listen(self, kind: type, topic: str, callback: Callable[[Any], None], *arguments, **options) -> Subscription:
        return self.create_subscription(kind, topic, within(self, topic, callback), *arguments, **options)

    # Requests

    def _on_sequence(self, message: VoltageSequence) -> None:
        before = self._highest
        try:
            self._refuse_beside_another(message.plan_id[:LONGEST_ID])
            try:
                if (problem := excess(message)) is not None:
                    raise StressbotError(ErrorCode.LIMIT_EXCEEDED, *problem)
                sequence = sequence_from_message(message)
            except StressbotError as error:
                self._session.refuse(error, message.plan_id[:LONGEST_ID])
                raise
            self._highest = float(sequence.levels.max(initial=0.0))
            try:
                self._session.load(sequence)
            except StressbotError:
                self._highest = before
                raise
            if value_of(self, "auto_start"):
                self._session.start(self._pacing())
        except StressbotError as error:
            self.get_logger().warning(f"plan {quoted(message.plan_id)} refused: {error}")

    def _on_start(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def start() -> None:
            self._refuse_beside_another()
            self._session.start(self._pacing())

        return self._answer(response, start, "started")

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._session.reset, "the robots are at their starts")

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            stopped = self._session.stop()
            response.success, response.message = True, "stopped" if stopped else "nothing was running; the output is at rest"
        except StressbotError as error:
            response.success, response.message = False, str(error)
            self.get_logger().fatal(str(error))
        return response

    def _answer(self, response: Trigger.Response, request, done: str) -> Trigger.Response:
        try:
            request()
            response.success, response.message = True, done
        except StressbotError as error:
            response.success, response.message = False, str(error)
            self.get_logger().warning(f"refused: {error}")
        return response

    def _pacing(self) -> Pacing:
        return Pacing(real_time_factor=number_of(self, "real_time_factor"), pose_rate=number_of(self, "pose_rate"))

    # Watches

    def _check_peer_timeout(self, timeout: float) -> None:
        if 0.0 < timeout < SHORTEST_PEER_TIMEOUT:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                "peer_timeout",
                f"is {timeout:g}: the sequencer shows life less often, give at least {SHORTEST_PEER_TIMEOUT:g} s, or 0",
            )

    def _on_sequencer(self, message: SequencerStatus) -> None:
        self._sequencer = message

    def _why_no_sequence(self) -> str:
        """What the sequencer's last word says of it."""
        last = self._sequencer
        if last is None or not self.count_publishers("sequencer_status"):
            return "no sequencer is there: start one, then plan again"
        if last.error_code:
            return f"the sequencer refused plan {last.plan_id} ({last.error_msg}): mend that, then plan again"
        if not last.plan_id:
            return "no plan has been made yet: call plan_motion first"
        if not last.epoch_count:
            return f"plan {last.plan_id} moves nobody: all robots are where they shall be"
        return ""

    def _watch_sequencer(self, timeout: float) -> None:
        if not timeout:
            self._listen(SequencerStatus, "sequencer_status", self._on_sequencer, LATCHED)
            return
        absent = "no sequencer is alive: start one, or set peer_timeout to 0 if something else sends the volts"
        silent = f"the sequencer has shown no life for {timeout:g} s (ended, frozen or cut off): start it again, then call reset"

        def changed(event) -> None:
            if event.alive_count_change < 0 or event.not_alive_count_change > 0:
                self._session.lost(StressbotError(ErrorCode.PEER_LOST, "sequencer_status", silent))
            if event.alive_count > 0:
                self._session.found("sequencer_status")

        def listen(lease: float) -> Subscription:
            return self._listen(
                SequencerStatus,
                "sequencer_status",
                self._on_sequencer,
                living(lease),
                callback_group=self.vital,
                event_callbacks=SubscriptionEventCallbacks(liveliness=changed),
            )

        # Fast DDS matches a new reader with the writers that it knows before it tells that reader of their liveliness: if the first
        # sign of life comes in between (`BuiltinProtocols::addLocalReader`), the reader hears neither of it nor of later ones.
        # A new reader does, if its lease is another one: the writer's state is kept by lease, also when no reader is left.
        def listen_again() -> None:
            nonlocal subscription, lease
            if "sequencer_status" in self._session.status().missing and self.count_publishers("sequencer_status"):
                self.destroy_subscription(subscription)
                lease += LEASE_STEP
                subscription = listen(lease)

        self._session.lost(StressbotError(ErrorCode.PEER_LOST, "sequencer_status", absent))
        lease = timeout
        subscription = listen(lease)
        self.create_timer(LISTEN_AGAIN, listen_again, callback_group=self.vital, clock=self._steady)

    def _watch_poses(self, timeout: float) -> None:
        if not timeout:
            return
        missing = StressbotError(
            ErrorCode.POSES_LOST,
            "swarm_poses",
            f"no robot of swarm {self._bench.swarm_id} was seen for {timeout:g} s: see to the tracker, then call reset",
        )
        ticks = 0  # since poses came: what waits for a busy executor is not lost

        def tick() -> None:
            nonlocal ticks
            ticks += 1
            if ticks > TICKS:
                self._session.lost(missing)

        def seen(message: SwarmPoses) -> None:
            nonlocal ticks
            if message.swarm_id == self._bench.swarm_id and message.ids:
                ticks = 0
                self._session.found("swarm_poses")

        self._session.lost(missing)
        self._listen(SwarmPoses, "swarm_poses", seen, NEWEST)
        self.create_timer(timeout / TICKS, tick, clock=self._steady)

    def _hear_driver(self, message: DriverStatus) -> None:
        stamp = message.header.stamp
        with self._publishing:
            if (stamp.sec, stamp.nanosec) in self._said:
                return
        drivers = {bytes(publisher.endpoint_gid) for publisher in self.get_publishers_info_by_topic("driver_status")}
        if time.monotonic() > self._rival_until or drivers - self._drivers:  # one may follow another within a moment
            self.get_logger().warning(f"sequences and starts are refused: driver_status {AMBIGUOUS}")
        self._rival_until, self._drivers = time.monotonic() + RIVAL_WITHIN, drivers

    def _refuse_beside_another(self, plan_id: str = "") -> None:
        if time.monotonic() < self._rival_until and self.count_publishers("driver_status") > 1:
            error = StressbotError(ErrorCode.AMBIGUOUS_SWARM, "driver_status", AMBIGUOUS)
            self._session.refuse(error, plan_id)
            raise error

    # Reports, from the executor's thread and from the backend's

    def _publish_status(self) -> None:
        # The lock keeps snapshots in order: what was read last is what stays latched.
        with self._publishing:
            if self._silent:
                return
            status = self._session.status()
            message = status_message(self._backend_name, status)
            stamp = message.header.stamp = self.get_clock().now().to_msg()
            self._said.append((stamp.sec, stamp.nanosec))
            self._status_publisher.publish(message)
            before, self._told = self._told, status
        if (before.state, before.plan_id) != (status.state, status.plan_id):
            self._log(status)

    def _health(self) -> Health:
        status = self._session.status()
        level, sentence = OK, f"{status.state.name}: the output is {'on' if status.state == State.RUNNING else 'at rest'}"
        if status.state == State.FAULT:
            level, sentence = ERROR, status.error_msg
        elif status.missing:
            level, sentence = WARN, f"start is refused: {', '.join(status.missing)} is missing"
        figures = {
            "state": status.state.name,
            "backend": self._backend_name,
            "swarm_id": self._bench.swarm_id,
            "plan_id": status.plan_id,
            "epoch": f"{status.epoch} of {status.epoch_count}",
            "missing": ", ".join(status.missing),
            "last refusal": status.error_msg,
        }
        return level, sentence, figures

    def _log(self, status: Status) -> None:
        """Say what the driver does now."""
        whole = f"{status.epoch_count} epochs, {status.duration:.3f} s, up to {self._highest:g} V"
        driven = f"after {status.sequence_time:.3f} s, {status.epoch} of {status.epoch_count} epochs"
        plan = f"plan {quoted(status.plan_id)}"
        text = {
            State.IDLE: "reset: the robots are at their starts, nothing is loaded",
            State.LOADED: f"{plan} loaded: {whole}",
            State.RUNNING: f"{plan} started: {whole}",
            State.DONE: f"{plan} ended {driven}; the output is at rest",
            State.STOPPED: f"{plan} stopped {driven}; the output is at rest",
            State.FAULT: f"FAULT {driven}; the output is at rest: {status.error_msg}",
        }[status.state]
        if status.state == State.FAULT:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)

    def _publish_poses(self, time: float, poses: Poses, stamp: Time | None = None) -> None:
        message = poses_message(self._bench.swarm_id, time, poses)
        message.header.stamp = self.get_clock().now().to_msg() if stamp is None else stamp
        self._poses_publisher.publish(message)

    def _heartbeat(self) -> None:
        # From before the look: a sequence that is loaded meanwhile is younger than poses that belong to the last one.
        stamp = self.get_clock().now().to_msg()
        measured = self._session.poses()
        if measured is not None:
            self._publish_poses(*measured, stamp)

    # Parameters

    def _imperfections(self, changes: list[Parameter]) -> Imperfections:
        """The imperfections that the parameters ask for, with some of them changed. Raises StressbotError."""
        names = [declaration.name for declaration in IMPERFECTION_PARAMETERS]
        values = {name: value_of(self, name) for name in names}
        return imperfections_of(values | {parameter.name: parameter.value for parameter in changes})

    def _check_imperfections(self, imperfections: Imperfections) -> None:
        """Raise StressbotError unless this bench can have them."""
        if imperfections.is_ideal:
            return
        if not self._simulated:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                PREFIX + imperfections.active[0],
                f"backend {self._backend_name!r} drives real robots, which have their own: use backend 'simulated'",
            )
        Flaws(imperfections, self._bench.ids, len(self._bench.electrical.symbol_levels))

    def _impair(self, imperfections: Imperfections) -> None:
        self._check_imperfections(imperfections)
        if self._simulated:
            self._session.backend.impair(imperfections)

    def _may_set(self, parameters: list[Parameter]) -> SetParametersResult:
        problem = first_problem(self._declarations, parameters)
        fixed = [parameter.name for parameter in parameters if parameter.name.startswith(("real_time_factor", PREFIX))]
        if not problem and fixed and self._session.status().state == State.RUNNING:
            problem = f"{fixed[0]}: a sequence is running, change it after the end or after stop"
        if not problem and any(name.startswith(PREFIX) for name in fixed):
            try:
                self._check_imperfections(self._imperfections(parameters))
            except StressbotError as error:
                problem = str(error)
        return SetParametersResult(successful=not problem, reason=problem or "")

    def _after_set(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            timer = self._timers_by_rate.get(parameter.name)
            if timer is not None:
                timer.timer_period_ns = round(1e9 * _rest_period(parameter.name, number_of(self, parameter.name)))
        if any(parameter.name.startswith(PREFIX) for parameter in parameters):
            self._impair(self._imperfections(parameters))


def _rest_period(name: str, rate: float) -> float:
    """Seconds between reports of a kind, by its parameter's name, while nobody moves."""
    return 1.0 / min(rate, REST_RATES.get(name, rate))


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver driver`."""
    real_time(DRIVER)
    sys.setswitchinterval(SWITCH)
    sys.exit(run("driver", DriverNode, args))
