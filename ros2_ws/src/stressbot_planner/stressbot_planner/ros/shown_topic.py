"""Topics for those who look on: nothing is made while nobody listens."""

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from stressbot_planner.ros.qos import LATCHED


class ShownTopic:
    """A latched topic that is made only for those who listen, and emptied as soon as what it says holds no more."""

    def __init__(self, node: Node, kind: type, topic: str, make: Callable[[], Any], empty: Callable[[], Any]) -> None:
        """`make` returns what there is to say, `empty` a message that takes back what was said."""
        # The executor looks at each event of each publisher whenever it wakes: those of 64 cost more than all else here.
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        self.publisher = node.create_publisher(kind, topic, LATCHED, event_callbacks=silent)
        self._make, self._empty = make, empty
        self._is_due, self._is_told = False, False

    def change(self) -> None:
        """There is something new to say."""
        self._is_due = True

    def clear(self) -> None:
        """What was said is wrong now."""
        self._is_due = False
        if self._is_told:
            self._is_told = False
            self.publisher.publish(self._empty())

    def tell(self) -> None:
        """Publish what is new, if somebody listens."""
        if self._is_due and self.publisher.get_subscription_count():
            self._is_due, self._is_told = False, True
            self.publisher.publish(self._make())
