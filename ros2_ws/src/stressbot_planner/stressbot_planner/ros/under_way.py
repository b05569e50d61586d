"""Whether an action is at work, as its status topic tells everybody."""

from action_msgs.msg import GoalStatus, GoalStatusArray

_UNDER_WAY = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


def is_under_way(message: GoalStatusArray) -> bool:
    """Return whether one of its goals has not come to its end."""
    return any(status.status in _UNDER_WAY for status in message.status_list)
