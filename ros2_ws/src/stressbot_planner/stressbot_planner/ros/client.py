"""A swarm as a user program sees it: the topics that it reads and the services that it calls."""

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger
from stressbot_msgs.bounds import within
from stressbot_msgs.described import Described
from stressbot_msgs.msg import DriverStatus, SequencerStatus, SwarmDescription, SwarmPoses, VoltageSequence
from stressbot_msgs.parameters import refuse_simulated_time
from stressbot_msgs.srv import PlanMotion
from stressbot_msgs.transports import avoid_shared_memory
from stressbot_msgs.wording import why_no_ros

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.qos import LATCHED, ORDERS

ALL_POSES, NEW_POSES = 1000, 50
"""How many poses may queue up: for who wants every one, and for who waits for new ones, which old ones must not keep back for long
on a machine that is too busy to read as many as come."""

_ASK_AGAIN = 1.0
"""s, after a question that stays without an answer."""


def without_parameters(arguments: list[str]) -> list[str]:
    """Return a command line without ROS parameters: a file of them may be gone by the time that a process makes another context."""
    kept, words = [], iter(arguments)
    for word in words:
        if word in ("--params-file", "-p", "--param"):
            next(words, None)
        else:
            kept.append(word)
    return kept


Message = TypeVar("Message")


def _heard(message: Message | None, topic: str) -> Message:
    if message is None:
        raise StressbotError(ErrorCode.NO_SWARM, topic, "is published by nobody: start the driver and the sequencer")
    return message


def command_client(name: str, namespace: str = "", poses_depth: int = NEW_POSES) -> "SwarmClient":
    """Return a client for a process that is a command: it talks as the nodes do, without shared memory."""
    avoid_shared_memory(os.environ)
    return SwarmClient(name, namespace, poses_depth)


class SwarmClient:
    """Keeps what the nodes say, and calls them, from a thread of its own. Use it as a context manager.

    Attributes:
        driver_status, sequencer_status, sequence: the newest message of each topic, or None; `driver`, `sequencer` and `volts` are
            the same for those who have waited for them.
        poses: every pose message since the last `forget_poses`.
    """

    def __init__(self, name: str = "stressbot_client", namespace: str = "", poses_depth: int = ALL_POSES):
        """`poses_depth` is how many may queue up. Raises StressbotError if ROS does not start, or is given a simulated time."""
        self._context = Context()
        arguments = without_parameters(sys.argv)
        try:
            rclpy.init(args=arguments, context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            raise StressbotError(ErrorCode.UNREADABLE_FILE, *why_no_ros(error)) from error
        self.node = rclpy.create_node(name, context=self._context, namespace=namespace)
        try:
            refuse_simulated_time(self.node)
        except StressbotError:
            self._context.try_shutdown()
            self.node.destroy_node()
            raise
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._news = threading.Condition()
        self.driver_status: DriverStatus | None = None
        self.sequencer_status: SequencerStatus | None = None
        self.sequence: VoltageSequence | None = None
        self.poses: list[SwarmPoses] = []
        for kind, topic, quality, keep in (
            (DriverStatus, "driver_status", LATCHED, "driver_status"),
            (SequencerStatus, "sequencer_status", LATCHED, "sequencer_status"),
            (VoltageSequence, "voltage_sequence", ORDERS, "sequence"),
        ):
            self.node.create_subscription(kind, topic, within(self.node, topic, self._keeper(keep)), quality)
        self._described = Described(self.node, self._notify)
        poses = within(self.node, "swarm_poses", self._on_poses)
        self.node.create_subscription(SwarmPoses, "swarm_poses", poses, poses_depth)
        self._services = {
            "plan_motion": self.node.create_client(PlanMotion, "plan_motion"),
            **{name: self.node.create_client(Trigger, name) for name in ("start", "stop", "reset")},
        }
        self._greetings: dict[str, Client] = {}
        for node in ("driver", "planner"):  # after all that this client has else, see `has_met`
            self._greet(node)
        self._greeted: dict[str, tuple[float, Future]] = {}
        self._met: set[str] = set()
        self._thread = threading.Thread(target=self._spin, name="client", daemon=True)
        self._thread.start()

    def __enter__(self) -> "SwarmClient":
        return self

    def __exit__(self, *_):
        self.close()

    def close(self) -> None:
        """Leave ROS."""
        self._context.try_shutdown()
        self._thread.join()
        self._executor.shutdown()  # see `process.run`
        self.node.destroy_node()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except Exception:
            if self._context.ok():  # otherwise it is `close`, which shows as one of many errors
                raise

    def _keeper(self, attribute: str) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            with self._news:
                setattr(self, attribute, message)
                self._news.notify_all()

        return keep

    def _on_poses(self, message: SwarmPoses) -> None:
        with self._news:
            self.poses.append(message)
            self._news.notify_all()

    def forget_poses(self) -> None:
        """Empty the list of poses."""
        with self._news:
            self.poses = []

    def wait_for(self, condition: Callable[[], Any], timeout: float, what: str, meanwhile: Callable[[], None] | None = None):
        """Wait until a condition on this client holds, and return its value.

        Args:
            condition: looked at whenever a message arrives, and a few times a second; no message arrives meanwhile.
            timeout: s.
            what: is waited for; named if it does not come.
            meanwhile: called a few times a second; may raise to give up.

        Raises:
            TimeoutError: it did not come true.
        """
        deadline = time.monotonic() + timeout
        while True:
            with self._news:
                value = condition()
                if not value:
                    self._news.wait(min(0.1, max(0.0, deadline - time.monotonic())))
                    value = condition()
            if value:
                return value
            if meanwhile:
                meanwhile()
            if time.monotonic() >= deadline:
                raise TimeoutError(f"no {what} within {timeout:g} s")

    @property
    def description(self) -> SwarmDescription | None:
        """The description of the one driver that is alive."""
        return self._described.description

    @property
    def drivers(self) -> int:
        """How many drivers are alive."""
        return self._described.drivers

    @property
    def swarm(self) -> SwarmDescription:
        """That description; a StressbotError is raised (NO_SWARM) if its driver has gone."""
        return _heard(self.description, "swarm_description")

    @property
    def driver(self) -> DriverStatus:
        """The driver's newest word; a StressbotError is raised (NO_SWARM) if there was none."""
        return _heard(self.driver_status, "driver_status")

    @property
    def sequencer(self) -> SequencerStatus:
        """The sequencer's newest word; a StressbotError is raised (NO_SWARM) if there was none."""
        return _heard(self.sequencer_status, "sequencer_status")

    @property
    def volts(self) -> VoltageSequence:
        """The newest sequence; a StressbotError is raised (NO_SWARM) if there was none."""
        return _heard(self.sequence, "voltage_sequence")

    def is_bench_ready(self, seen: bool = True) -> bool:
        """Return whether driver and sequencer are up, for the same swarm, and poses come, if robots have to be `seen`."""
        swarm, driver, sequencer = self.description, self.driver_status, self.sequencer_status
        if swarm is None or driver is None or sequencer is None or (seen and not self.poses):
            return False
        if sequencer.swarm_id != swarm.swarm_id or driver.missing:
            return False
        return self.has_met("driver") and all(map(self.is_ready, ("start", "stop", "reset")))

    def is_system_ready(self) -> bool:
        """Return whether the bench is ready, and the planner too."""
        return self.is_bench_ready() and self.is_ready("plan_motion") and self.has_met("planner")

    def is_ready(self, service: str) -> bool:
        """Return whether somebody offers a service."""
        return self._services[service].service_is_ready()

    def has_met(self, node: str) -> bool:
        """Ask a node, such as "driver", for its parameters until it answers, and return whether it has.

        A server drops the answer to a client that it has not discovered yet, though this client sees the service already.
        Discovery tells of the parts of a client in the order in which they were made: a node that could answer here, to the
        last part of this client, knows all of it.
        """
        if node in self._met:
            return True
        now, service = time.monotonic(), self._greetings.get(node) or self._greet(node)
        asked, answer = self._greeted.get(node, (-math.inf, None))
        if answer is not None and answer.done():
            self._met.add(node)
        elif service.service_is_ready() and now > asked + _ASK_AGAIN:
            if answer is not None:
                service.remove_pending_request(answer)
            self._greeted[node] = now, service.call_async(ListParameters.Request())
        return node in self._met

    def _greet(self, node: str) -> Client:
        self._greetings[node] = self.node.create_client(ListParameters, f"{node}/list_parameters")
        return self._greetings[node]

    def call(self, service: str, request: Any, timeout: float, meanwhile: Callable[[], None] | None = None) -> Any:
        """Call a service and return its response.

        Raises:
            TimeoutError: no response.
        """
        future = self._services[service].call_async(request)
        future.add_done_callback(lambda _: self._notify())
        self.wait_for(future.done, timeout, f"answer of {service}", meanwhile)
        return future.result()

    def asked(self, request: Callable[[], Any], timeout: float = 10.0) -> Any:
        """Do something, such as a request of an action, on the thread that hears its answer; return its value, such as a future.

        From another thread, rclpy takes an answer that comes before the request is noted down for somebody else's.
        """
        task = self._executor.create_task(request)
        self.wait_for(task.done, timeout, "request")
        value = task.result()
        if isinstance(value, Future):
            value.add_done_callback(lambda _: self._notify())
        return value

    def _notify(self) -> None:
        with self._news:
            self._news.notify_all()

    def trigger(
        self, service: str, timeout: float = 10.0, meanwhile: Callable[[], None] | None = None
    ) -> Trigger.Response:
        """Call `start`, `stop` or `reset`; the arguments are those of `call`."""
        return self.call(service, Trigger.Request(), timeout, meanwhile)
