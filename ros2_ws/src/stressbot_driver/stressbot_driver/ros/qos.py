"""Qualities of service, each chosen for a reason."""

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from stressbot_msgs.qos import LATCHED as LATCHED
from stressbot_msgs.qos import living as living

# The swarm's description lasts no longer than the driver that sent it: see `described`.
DESCRIPTION = living(0.5)
# One second of poses at the default rate: a reader may stall that long and lose none.
POSES = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=50, reliability=ReliabilityPolicy.RELIABLE)
# Volatile, so that a restarted driver is never handed a sequence from before.
SEQUENCES = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
# A picture needs the newest poses, not all of them.
NEWEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
MARKERS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
# Pictures are large: a reader that asks for it gets each one whole, and who is slow misses the older ones.
PICTURES = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=2, reliability=ReliabilityPolicy.RELIABLE)
# As tf2_ros has it.
TRANSFORMS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE)
