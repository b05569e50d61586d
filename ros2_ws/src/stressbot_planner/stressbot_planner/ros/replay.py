"""Replays a recording onto its topics, with the times between messages that they had, or a factor of them.

Headers get times of the replay: nodes refuse poses and orders of the past, and there is no clock to set back. Between two of them
is as much time as there was, to the nanosecond, so that pictures belong to the same moments of a sequence again.
"""

import struct
import threading
import time
from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path

import rclpy
from rclpy.duration import Duration
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden
from stressbot_msgs.process import ProcessNode, run

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import recording
from stressbot_planner.formats.recording import Recorded
from stressbot_planner.ros import endpoints, interfaces
from stressbot_planner.system.streams import BAD_INPUT, complain

LISTENERS = 3.5
"""s in which who wants to hear a topic is found"""

OLDEST = 2_000_000_000
"""ns; what was stamped longer before it was heard, or after that, gets the time at which it was heard."""

OF_ROS = ("/rosout", "/parameter_events")
"""Topics that every node has, which nobody wants to hear twice."""


class ReplayNode(ProcessNode):
    """Publishes what a file holds.

    Attributes:
        sent: messages so far.
        failure: why it has ended early, or None.
    """

    def __init__(self, path: Path, names: Iterable[str], factor: float, ended: Callable[[], None]):
        """Start to publish.

        Args:
            path: of the recording.
            names: of the topics to replay; all but hidden ones and those of ROS if empty.
            factor: recorded seconds per second; 0: as fast as possible.
            ended: is called once all is sent.

        Raises:
            StressbotError: the file cannot be read, a topic is not in it, or somebody else publishes it.
        """
        super().__init__("replay")
        self.sent = 0
        self.failure: StressbotError | None = None
        self._factor = factor
        self._halt = threading.Event()
        try:
            names = {self.resolve_topic_name(name) for name in names}
            messages = recording.read(path)
            topics = {message.topic.name: message.topic for message in recording.read(path) if _is_chosen(message, names)}
            if missing := sorted(names - set(topics)) or ([] if topics else ["any topic to replay"]):
                raise StressbotError(ErrorCode.OUT_OF_RANGE, "topic", f"{path} does not hold {', '.join(missing)}")
            self._check_nobody_else(topics, names)
            self._outlets = {name: self._publisher(topic) for name, topic in topics.items()}
        except BaseException:
            self.destroy_node()
            raise
        self._thread = threading.Thread(target=self._play, args=(messages, ended), name="replay")
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._halt.set()
        self._thread.join()

    def _publisher(self, topic: recording.Topic):
        try:
            kind = interfaces.load(topic.type)
        except LookupError:
            message = f"has the type {topic.type}, which is not installed here: name the topics to replay"
            raise StressbotError(ErrorCode.UNSUPPORTED, topic.name, message) from None
        return self.create_publisher(kind, topic.name, endpoints.offering(topic.qualities, topic.type))

    def _check_nobody_else(self, topics: Iterable[str], names: set[str]) -> None:
        """Two that publish the same poses, or the same order, are a danger; who names a topic knows what it does."""
        deadline = time.monotonic() + 0.5
        while time.monotonic() < deadline:
            taken = sorted(name for name in topics if name not in names and self.count_publishers(name))
            if taken:
                message = "is published by somebody else already: end that, or name the topics to replay"
                raise StressbotError(ErrorCode.BUSY, taken[0], message)
            time.sleep(0.05)

    def _play(self, messages: Iterable[Recorded], ended: Callable[[], None]) -> None:
        try:
            chosen = (message for message in messages if message.topic.name in self._outlets)
            first = next(iter(chosen))
            self._wait_for_listeners()
            begin, stamped_from = time.monotonic(), time.time_ns()
            for message in chain([first], chosen):
                after = message.heard - first.heard
                due = begin + after * 1e-9 / self._factor if self._factor else 0.0
                if self._halt.wait(max(0.0, due - time.monotonic())):
                    return
                if self._factor:
                    stamp = max(stamped_from, stamped_from + int((after - _age(message)) / self._factor))
                else:
                    stamp = time.time_ns()
                self._outlets[message.topic.name].publish(_stamped(message, stamp))
                self.sent += 1
            for publisher in self._outlets.values():
                publisher.wait_for_all_acked(Duration(seconds=1))
        except StressbotError as error:
            self.failure = error
        finally:
            ended()

    def _wait_for_listeners(self) -> None:
        deadline, unheard = time.monotonic() + LISTENERS, list(self._outlets)
        while time.monotonic() < deadline and not self._halt.wait(0.02):
            unheard = [name for name, publisher in self._outlets.items() if not publisher.get_subscription_count()]
            if not unheard:
                return
        self.get_logger().info(f"nobody hears {', '.join(unheard)}")


def _age(message: Recorded) -> int:
    """Return how long before it was heard a message was stamped, ns; 0 if it has no header, or cannot be so old."""
    if not _has_header(message):
        return 0
    seconds, rest = struct.unpack_from(f"{_order(message)}iI", message.data, 4)
    age = message.heard - (seconds * 10**9 + rest)
    return age if 0 <= age <= OLDEST else 0


def _stamped(message: Recorded, stamp: int) -> bytes:
    """Return a serialized message whose header, if it begins with one, has another stamp, ns."""
    if not _has_header(message):
        return message.data
    return message.data[:4] + struct.pack(f"{_order(message)}iI", *divmod(stamp, 10**9)) + message.data[12:]


def _has_header(message: Recorded) -> bool:
    fields = list(interfaces.load(message.topic.type).get_fields_and_field_types().values())
    return bool(fields) and fields[0] == "std_msgs/Header" and len(message.data) >= 12


def _order(message: Recorded) -> str:
    return "<" if message.data[1] & 1 else ">"


def _is_chosen(message: Recorded, names: set[str]) -> bool:
    name = message.topic.name
    return name in names if names else name not in OF_ROS and not topic_or_service_is_hidden(name)


def replay(path: Path, names: list[str], factor: float) -> int:
    """Replay a file; return the exit code. Raises StressbotError as the node does."""
    nodes: list[ReplayNode] = []

    def make() -> ReplayNode:
        nodes.append(ReplayNode(path, names, factor, lambda: rclpy.try_shutdown()))
        return nodes[0]

    code = run("replay", make, [])
    if nodes and nodes[0].failure is not None:
        complain("replay", str(nodes[0].failure))
        return BAD_INPUT
    return code
