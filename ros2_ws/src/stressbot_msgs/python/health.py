"""What a node says of its health on `/diagnostics`, where monitors of ROS look for it."""

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

PERIOD = 1.0
"""s"""

Health = tuple[bytes, str, Mapping[str, object]]
"""Level, one sentence, and figures by name."""


def tell_health(node: Node, look: Callable[[], Health]) -> None:
    """Publish what `look` finds once a second, under the node's full name."""
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    name = node.get_fully_qualified_name()

    def tell() -> None:
        level, sentence, figures = look()
        values = [KeyValue(key=key, value=str(value)) for key, value in figures.items()]
        message = DiagnosticArray(status=[DiagnosticStatus(level=level, name=name, message=sentence, values=values)])
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    node.create_timer(PERIOD, tell, clock=Clock(clock_type=ClockType.STEADY_TIME))  # somebody may set the date
