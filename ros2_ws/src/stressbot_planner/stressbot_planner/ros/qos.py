"""Qualities of service, each chosen for a reason."""

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from stressbot_msgs.qos import LATCHED as LATCHED
from stressbot_msgs.qos import living

# The sequencer's status, which also shows that its process lives: the driver stops when it does not. See docs/safety.md for the
# figure.
LIVING = living(0.03)
# Only the newest poses are the present. Reliable all the same: at rest a slow tracker may say them once.
NEWEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
# A plan or a sequence is an order to move from where the robots were. Volatile, so that a node that starts again is
# never handed one from before, when the robots lay elsewhere: whoever misses it needs a new plan. Depth 1: of two
# that wait only the newer starts from the present poses, and the driver would replace the older one anyway.
ORDERS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
# Requests and answers of a service, which a recorder keeps: nobody's move depends on them.
EVENTS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
