"""Qualities of service, each chosen for a reason."""

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

# What a late subscriber must still hear: the swarm's description, the driver's and the sequencer's status.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# The sequencer's status, which also shows that its process lives: the driver stops when it does not. AUTOMATIC, so that the
# DDS library asserts it every two thirds of the lease whatever the interpreter does. See docs/safety.md for the figure.
LIVING = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=0.03),
)
# Only the newest poses are the present. Reliable all the same: at rest a slow tracker may say them once.
NEWEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
# A plan or a sequence is an order to move from where the robots were. Volatile, so that a node that starts again is
# never handed one from before, when the robots lay elsewhere: whoever misses it needs a new plan. Depth 1: of two
# that wait only the newer starts from the present poses, and the driver would replace the older one anyway.
ORDERS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
# Requests and answers of a service, which a recorder keeps: nobody's move depends on them.
EVENTS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
