"""Qualities of service that planner and driver share."""

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

# What a late subscriber must still hear: a status, the swarm's description.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def living(lease: float) -> QoSProfile:
    """What a late subscriber must still hear, from one that shows life at least every `lease` seconds.

    AUTOMATIC: the DDS library asserts it on threads of its own, so that a busy interpreter on either side is no false alarm;
    a process that is killed, frozen or cut off falls silent all the same.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(seconds=lease),
    )
