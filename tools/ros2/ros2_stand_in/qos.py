"""Qualities of service, from the command line or as publishers offer them."""

import argparse

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSPresetProfiles,
    QoSProfile,
    QoSReliabilityPolicy,
)

POLICIES = {
    "history": QoSHistoryPolicy,
    "reliability": QoSReliabilityPolicy,
    "durability": QoSDurabilityPolicy,
    "liveliness": QoSLivelinessPolicy,
}


def add_arguments(parser: argparse.ArgumentParser, what: str, preset: str) -> None:
    """Add the options; `what` is done with the profile, subscribe or publish."""
    parser.add_argument(
        "--qos-profile", choices=QoSPresetProfiles.short_keys(), default=preset,
        help=f"Quality of service preset profile to {what} with (default: {preset})",
    )
    parser.add_argument(
        "--qos-depth", metavar="N", type=int,
        help=f"Queue size setting to {what} with (overrides depth value of --qos-profile option)",
    )
    for name, policy in POLICIES.items():
        parser.add_argument(
            f"--qos-{name}", choices=policy.short_keys(),
            help=f"Quality of service {name} setting to {what} with (overrides {name} value of --qos-profile option)",
        )
    parser.add_argument(
        "--qos-liveliness-lease-duration-seconds", type=float,
        help=f"Quality of service liveliness lease duration setting to {what} with (overrides liveliness lease duration value of "
        "--qos-profile option)",
    )


def profile(options: argparse.Namespace) -> QoSProfile:
    """Return the preset with what overrides it."""
    chosen = QoSPresetProfiles.get_from_short_key(options.qos_profile)
    for name, policy in POLICIES.items():
        if key := getattr(options, f"qos_{name}"):
            setattr(chosen, name, policy.get_from_short_key(key))
    lease, depth = options.qos_liveliness_lease_duration_seconds, options.qos_depth
    if lease and lease >= 0:
        chosen.liveliness_lease_duration = Duration(seconds=lease)
    if depth and depth >= 0:
        chosen.depth = depth
    elif chosen.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL and chosen.depth == 0:
        chosen.depth = 1
    return chosen


def profile_to_hear(node: Node, topic: str, options: argparse.Namespace) -> QoSProfile:
    """Return what hears all present publishers of a topic, unless the command line says something else."""
    overrides = [*POLICIES, "depth", "liveliness_lease_duration_seconds"]
    if any(getattr(options, f"qos_{name}") is not None for name in overrides):
        return profile(options)
    chosen = QoSPresetProfiles.get_from_short_key(options.qos_profile)
    offered = [endpoint.qos_profile for endpoint in node.get_publishers_info_by_topic(topic)]
    if offered:
        chosen.reliability = _agreed(
            [profile.reliability for profile in offered], QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT
        )
        chosen.durability = _agreed(
            [profile.durability for profile in offered], QoSDurabilityPolicy.TRANSIENT_LOCAL, QoSDurabilityPolicy.VOLATILE
        )
    return chosen


def _agreed(offered: list, strong, weak):
    if all(policy == strong for policy in offered):
        return strong
    if strong in offered:
        print(
            f"Some, but not all, publishers are offering {type(strong).__name__}.{strong.name}. Falling back to "
            f"{type(weak).__name__}.{weak.name} as it will connect to all publishers"
        )
    return weak
