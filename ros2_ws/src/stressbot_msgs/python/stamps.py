"""Stamps as whole nanoseconds, which a double does not hold."""

from builtin_interfaces.msg import Time

SECOND = 1_000_000_000
"""ns"""


def nanoseconds(stamp: Time) -> int:
    """Return a stamp in ns."""
    return stamp.sec * SECOND + stamp.nanosec


def stamp_of(moment: int) -> Time:
    """Return the stamp of a moment in ns, or the nearest that a stamp can say."""
    sec, nanosec = divmod(min(max(moment, -(2**31) * SECOND), 2**31 * SECOND - 1), SECOND)
    return Time(sec=sec, nanosec=nanosec)
