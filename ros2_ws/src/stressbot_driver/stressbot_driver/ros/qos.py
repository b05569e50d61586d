"""Qualities of service, each chosen for a reason."""

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

# What a late subscriber must still hear: the driver's status.
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


# The swarm's description lasts no longer than the driver that sent it: see `described`.
DESCRIPTION = living(0.5)
# One second of poses at the default rate: a reader may stall that long and lose none.
POSES = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=50, reliability=ReliabilityPolicy.RELIABLE)
# Volatile, so that a restarted driver is never handed a sequence from before.
SEQUENCES = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
# A picture needs the newest poses, not all of them.
NEWEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
MARKERS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
# As tf2_ros has it.
TRANSFORMS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
