"""Numbered refusals, of planner and driver alike, without ROS."""

from enum import IntEnum

from stressbot_msgs.wording import sentence


class ErrorCode(IntEnum):
    """The constants of `stressbot_msgs/msg/ErrorCode`, whose text says what each means; a test holds the two equal."""

    NONE = 0

    UNREADABLE_FILE = 1
    MALFORMED_FILE = 2
    MISSING_FIELD = 3
    UNKNOWN_FIELD = 4
    WRONG_TYPE = 5
    NOT_FINITE = 6
    OUT_OF_RANGE = 7
    WRONG_COUNT = 8

    NO_ROBOTS = 20
    TOO_MANY_ROBOTS = 21
    INVALID_CODEWORD = 22
    DUPLICATE_CODEWORD = 23
    EMPTY_CODEWORD = 24
    NO_COMMON_FREQUENCY = 25

    UNKNOWN_ROBOT = 30
    DUPLICATE_GOAL = 31
    OUTSIDE_WORKSPACE = 32
    INSIDE_OBSTACLE = 33
    STARTS_OVERLAP = 34
    GOALS_TOO_CLOSE = 35

    UNKNOWN_PLANNER = 40
    UNKNOWN_OBJECTIVE = 41
    UNSUPPORTED = 42
    NO_PLAN_FOUND = 43
    INFEASIBLE = 44
    NO_SWARM = 45
    BUSY = 46
    AMBIGUOUS_SWARM = 47
    STALE_POSES = 48

    WRONG_SWARM = 60
    UNKNOWN_GROUP = 61
    INVALID_PLAN = 62
    INVALID_SEQUENCE = 63
    LIMIT_EXCEEDED = 64
    UNKNOWN_BACKEND = 65
    NOTHING_LOADED = 66
    BACKEND_FAILURE = 67
    PEER_LOST = 68
    POSES_LOST = 69
    OUTDATED = 70
    NOT_HEARD = 71
    NO_HEARTBEAT = 72

    CANCELLED = 80
    TIMED_OUT = 81
    ROBOT_LOST = 82
    ROBOT_FAULTY = 83

    INTERNAL = 99


class StressbotError(Exception):
    """A refusal: which field is wrong and what to change.

    Attributes:
        code: the reason, as it stands in messages.
        field: name of the field, as the user wrote it (``robots[3].goal``).
        message: what is wrong and what to change. Lengths stand there as "3.2 units", which nodes turn into metres.

    Both texts are short and printable, whatever they quote.
    """

    def __init__(self, code: ErrorCode, field: str, message: str) -> None:
        self.code, self.field, self.message = ErrorCode(code), sentence(field), sentence(message)
        super().__init__(self.code, self.field, self.message)

    def __str__(self) -> str:
        return f"{self.field}: {self.message}" if self.field else self.message
