"""Publishing what somebody must hear: a volatile message to a subscriber that is not connected yet is lost."""

import time

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher

CONNECTED_WITHIN = 1.0
_POLL = 0.005


def publish_order(node: Node, publisher: Publisher, message) -> bool:
    """Publish a message once every subscriber that is known of is connected; return whether there is one.

    It is stamped now unless it has a stamp. Subscribers get `CONNECTED_WITHIN` seconds: nodes that have just started see each
    other before they can talk.
    """
    deadline = time.monotonic() + CONNECTED_WITHIN
    while publisher.get_subscription_count() < max(1, node.count_subscribers(publisher.topic_name)):
        if time.monotonic() > deadline:
            break
        time.sleep(_POLL)
    if message.header.stamp == Time():
        message.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(message)
    return publisher.get_subscription_count() > 0
