"""Qualities of service of a topic's publishers: what hears them all, and how rosbag2 writes them down."""

from collections.abc import Sequence

import yaml
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSDurabilityPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
    ReliabilityPolicy,
)

DEPTH, PICTURES = 1000, 30
"""Messages that may wait for a recorder, or for those who hear a replay; and of pictures, which are large."""

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
"""Types of pictures."""

FOREVER = {"sec": 9223372036, "nsec": 854775807}


def depth(kind: str) -> int:
    """Return how many messages of a type may wait."""
    return PICTURES if kind in (RAW, COMPRESSED) else DEPTH


def hearing(offered: Sequence[QoSProfile], kind: str) -> QoSProfile:
    """Return what hears all publishers of a type: no more is asked for than each of them offers."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth(kind),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def written(offered: Sequence[QoSProfile]) -> str:
    """Return profiles as rosbag2 writes them."""
    return yaml.safe_dump(
        [
            {
                "history": profile.history.short_key,
                "depth": profile.depth,
                "reliability": profile.reliability.short_key,
                "durability": profile.durability.short_key,
                "deadline": _duration(profile.deadline),
                "lifespan": _duration(profile.lifespan),
                "liveliness": profile.liveliness.short_key,
                "liveliness_lease_duration": _duration(profile.liveliness_lease_duration),
                "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
            }
            for profile in offered
        ],
        sort_keys=False,
    )


def _duration(duration: Duration) -> dict[str, int]:
    seconds, rest = divmod(duration.nanoseconds, 10**9)
    return FOREVER if seconds >= FOREVER["sec"] else {"sec": seconds, "nsec": rest}


def offering(text: str, kind: str) -> QoSProfile:
    """Return what a replay of a type offers: as the first publisher did that a recording knows of, or else as the default does."""
    profile = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth(kind))
    try:
        first = yaml.safe_load(text)[0]
        profile.reliability = QoSReliabilityPolicy.get_from_short_key(first["reliability"])
        profile.durability = QoSDurabilityPolicy.get_from_short_key(first["durability"])
        lease = first["liveliness_lease_duration"]
        if lease != FOREVER:
            profile.liveliness = QoSLivelinessPolicy.get_from_short_key(first["liveliness"])
            profile.liveliness_lease_duration = Duration(seconds=int(lease["sec"]), nanoseconds=int(lease["nsec"]))
    except (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError):
        return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth(kind))
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        profile.depth = 1
    return profile
