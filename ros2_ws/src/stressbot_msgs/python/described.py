"""The description of the one driver that is alive, for planner and driver package."""

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.subscription import Subscription
from stressbot_msgs.msg import SwarmDescription
from stressbot_msgs.qos import LATCHED, living

TOPIC = "swarm_description"
LEASE = 1.5
"""s; a driver that shows no life for so long is gone. Ours show it every third of a second."""

SETTLED_AFTER = 1.0
"""s that a publisher, or a reader of ours, may be new: until then nobody has to have shown life."""

LOOK = 0.2
LEASE_STEP = 1e-8
"""s"""

AMBIGUOUS = "is sent by more than one driver: stop all but one, or give each a namespace or a ROS_DOMAIN_ID of its own"


class Described:
    """Listens to `swarm_description` and to the life of those who send it. All in the thread of the node's executor.

    A driver shows life by DDS liveliness, which needs nothing of its interpreter. Who sends a description without that lives as
    long as ROS lists him: until he leaves, or some 20 s after he was killed. A message does not tell who sent it: when one of
    several drivers is gone, the topic is subscribed to anew, and only those that live are heard again.

    Attributes:
        description: of the one driver; None if there is none, or more than one.
        drivers: number of those that are alive.
    """

    def __init__(self, node: Node, on_change: Callable[[], None]):
        """`on_change` is called after each change of the description, and when several drivers become one or none, or back."""
        self.description: SwarmDescription | None = None
        self.drivers = 0
        self._node, self._on_change = node, on_change
        self._heard: SwarmDescription | None = None
        self._outdated = False  # what was heard may be of a driver that is gone
        self._lease = LEASE
        self._living = 0  # of those who show life
        self._seen: dict[bytes, float] = {}  # when each publisher was listed first
        self._messages = self._listen()
        self._life = self._listen_for_life()
        self._timer = node.create_timer(LOOK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def is_ambiguous(self) -> bool:
        """Whether more than one driver is alive."""
        return self.drivers > 1

    def _listen(self) -> Subscription:
        return self._node.create_subscription(SwarmDescription, TOPIC, self._on_message, LATCHED)

    def _listen_for_life(self) -> Subscription:
        self._alive = self._gone = 0
        self._known = self._living
        self._listening_since = time.monotonic()
        events = SubscriptionEventCallbacks(liveliness=self._on_life, incompatible_qos=lambda _: None)
        return self._node.create_subscription(
            SwarmDescription, TOPIC, lambda _: None, living(self._lease), event_callbacks=events
        )

    def _on_message(self, message: SwarmDescription) -> None:
        is_new = message != self._heard
        if is_new:
            self._heard = message
        self._look()
        self._outdated |= is_new and self.drivers < len(self._seen)  # one of those who do not seem to live may have said it

    def _on_life(self, event) -> None:
        self._alive, self._gone = event.alive_count, event.not_alive_count
        self._outdated |= event.not_alive_count_change > 0
        self._look()

    def _tick(self) -> None:
        leased = self._look()
        if self._outdated:
            self._outdated = False
            self._node.destroy_subscription(self._messages)
            self._messages = self._listen()
        # A new reader may never be told that a publisher lives (see the driver's watch over the sequencer); another one, of another
        # lease, is. Those of whom it was told that they are gone stay listed for a while.
        if self._alive + self._gone < leased and time.monotonic() > self._listening_since + SETTLED_AFTER:
            self._node.destroy_subscription(self._life)
            self._lease += LEASE_STEP
            self._life = self._listen_for_life()

    def _look(self) -> int:
        """Bring the attributes up to date; return how many publishers that show life are listed."""
        now = time.monotonic()
        listed = self._node.get_publishers_info_by_topic(TOPIC)
        gids = {bytes(publisher.endpoint_gid) for publisher in listed}
        self._outdated |= not gids.issuperset(self._seen)
        self._seen = {gid: self._seen.get(gid, now) for gid in gids}
        leased = [
            bytes(publisher.endpoint_gid)
            for publisher in listed
            if publisher.qos_profile.liveliness_lease_duration <= Duration(seconds=LEASE)
        ]
        # Those of whom nothing was told are taken to live if they are new, or if that is what was known before this reader came.
        untold = max(0, len(leased) - self._alive - self._gone)
        trusted = sum(now < self._seen[gid] + SETTLED_AFTER for gid in leased)
        if now < self._listening_since + SETTLED_AFTER:
            trusted += max(0, self._known - self._alive)
        self._living = min(self._alive + min(untold, trusted), len(leased))
        self._conclude(self._living + len(listed) - len(leased))
        return len(leased)

    def _conclude(self, drivers: int) -> None:
        description, ambiguous = self.description, self.is_ambiguous
        if drivers < self.drivers:
            self._heard, self._outdated = None, True
        self.drivers = drivers
        self.description = self._heard if drivers == 1 else None
        if self.description is not description or self.is_ambiguous != ambiguous:
            self._on_change()
