"""The recorder: all topics of a ROS domain into a file, as they were sent.

Only it is in the way of a disk that is slow or full: nobody waits for it, and what it cannot write ends the record alone.
"""

import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from stressbot_msgs.process import ProcessNode, run

from stressbot_planner.formats.recording import Recorded, Topic, Writer
from stressbot_planner.ros import endpoints, interfaces
from stressbot_planner.ros.parameters import Text, declare
from stressbot_planner.system.streams import FAILED

LOOK, FLUSH = 0.2, 1.0
"""s between looks for new topics, and between writes to the disk"""

NEVER = ("/_ros2cli",)
OUTPUT = Text(
    "output",
    "",
    "File to record to; empty: recording-<date>-<time>.mcap in the working directory.",
    "a name that no file has yet",
    lambda text: text,
)
TOPICS = "topics"


class RecorderNode(ProcessNode):
    """Hears every topic that somebody publishes, but for raw pictures, or those that are asked for.

    Attributes:
        failure: why the record has ended early, or empty.
    """

    def __init__(self, output: str = "", topics: Sequence[str] = ()) -> None:
        """Raises StressbotError if a parameter is refused or the file cannot be made."""
        super().__init__("recorder")
        self.failure = ""
        self._writer: Writer | None = None
        try:
            described = ParameterDescriptor(description="Names of topics to record; empty: all.", read_only=True)
            self.declare_parameter(TOPICS, list(topics) or [""], described)
            declare(self, (OUTPUT,))
            self._path = Path(output or self.get_parameter("output").value or time.strftime("recording-%Y%m%d-%H%M%S.mcap"))
            self._writer = Writer(self._path, os.environ.get("ROS_DISTRO", "jazzy"))
        except BaseException:
            self.destroy_node()
            raise
        named = [name for name in self.get_parameter(TOPICS).value or () if name]
        self._named = {self.resolve_topic_name(name) for name in named}
        self._subscriptions_of: dict[str, tuple[Subscription, QoSProfile]] = {}
        self._strange: set[str] = set()
        self.create_timer(LOOK, self._look)
        self.create_timer(FLUSH, self._flush)
        self._look()
        self.get_logger().info(f"records {', '.join(sorted(self._named)) or 'all topics'} to {self._path}")

    def close(self) -> None:
        """End the record."""
        writer, self._writer = self._writer, None
        if writer is None:
            return
        try:
            writer.close()
            self.get_logger().info(f"{self._path}: {writer.messages} messages of {len(self._subscriptions_of)} topics")
        except OSError as error:
            self._failed(writer, error)

    def _look(self) -> None:
        for name, types in self.get_topic_names_and_types():
            if name in self._strange or (self._named and name not in self._named) or name.startswith(NEVER):
                continue
            publishers = [end for end in self.get_publishers_info_by_topic(name) if end.node_name != self.get_name()]
            if not publishers:
                continue
            if types[0] == endpoints.RAW and not self._named:  # 30 MB/s
                self._strange.add(name)
                self.get_logger().info(f"{name} is not recorded, as raw pictures are large: name it, or send them compressed")
                continue
            wanted = endpoints.hearing([end.qos_profile for end in publishers], types[0])
            subscription, present = self._subscriptions_of.get(name, (None, None))
            if present is not None and not _asks_more(present, wanted):
                continue
            try:
                self._hear(name, types[0], publishers, wanted)
            except LookupError:
                self._strange.add(name)
                self.get_logger().warning(f"{name} is not recorded: its type {types[0]} is not installed here")
                continue
            if subscription is not None:
                self.destroy_subscription(subscription)

    def _hear(self, name: str, kind: str, publishers: list, wanted: QoSProfile) -> None:
        topic = Topic(
            name,
            kind,
            interfaces.definition(kind),
            str(publishers[0].topic_type_hash),
            endpoints.written([end.qos_profile for end in publishers]),
        )

        def heard(data: bytes, info: dict) -> None:
            if self._writer is None:
                return
            now = time.time_ns()
            try:
                self._writer.add(Recorded(topic, info["received_timestamp"] or now, info["source_timestamp"] or now, data))
            except OSError as error:
                self._failed(self._writer, error)

        raw: Any = heard  # rclpy's types know callbacks of messages only
        subscription = self.create_subscription(interfaces.load(kind), name, raw, wanted, raw=True)
        self._subscriptions_of[name] = subscription, wanted

    def _flush(self) -> None:
        if self._writer is not None:
            try:
                self._writer.flush()
            except OSError as error:
                self._failed(self._writer, error)

    def _failed(self, writer: Writer, error: OSError) -> None:
        self._writer = None
        writer.give_up()
        self.failure = f"the record has ended: {self._path}: {error.strerror}; its first {writer.messages} messages are kept"
        self.get_logger().error(self.failure)
        os.kill(os.getpid(), signal.SIGTERM)


def _asks_more(present: QoSProfile, wanted: QoSProfile) -> bool:
    """Whether a subscription asks for more than all publishers offer."""
    reliable = present.reliability == ReliabilityPolicy.RELIABLE != wanted.reliability
    return reliable or present.durability == DurabilityPolicy.TRANSIENT_LOCAL != wanted.durability


def record(output: str = "", topics: Sequence[str] = (), args: list[str] | None = None) -> int:
    """Record until a signal ends it; return the exit code."""
    nodes: list[RecorderNode] = []

    def make() -> RecorderNode:
        nodes.append(RecorderNode(output, topics))
        return nodes[0]

    code = run("recorder", make, args)
    return FAILED if nodes and nodes[0].failure else code


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner recorder`."""
    sys.exit(record(args=args))
