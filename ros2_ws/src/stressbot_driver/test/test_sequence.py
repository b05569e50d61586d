from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from driver_support import bench, encode, sequence
from stressbot_msgs.msg import VoltageSequence as VoltageSequenceMsg

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.conversions import sequence_from_message
from stressbot_driver.sequence import LONGEST_ID, MOST_SEGMENTS, Limits, check_sequence

SWARM = bench(6)
LIMITS = Limits(min_level=0.0, max_level=200.0, min_dwell=0.001, max_duration=100.0, max_segments=1000)


def check(candidate, limits=LIMITS):
    check_sequence(candidate, SWARM.swarm_id, limits)


def test_a_coded_sequence_passes():
    check(encode(SWARM, [(1, 0.5), (4, 1.0)]))
    check(sequence(SWARM, [0.0, 200.0], [0.001, 99.0]))


def test_what_lies_at_a_limit_passes_and_what_lies_beyond_does_not():
    check(sequence(SWARM, [1.0] * 1000, [0.05] * 1000))
    with pytest.raises(StressbotError, match="1001 segments, the backend takes 1000"):
        check(sequence(SWARM, [1.0] * 1001, [0.05] * 1001))
    assert (MOST_SEGMENTS, Limits(0.0, 1.0).max_segments, LONGEST_ID) == (20_000_000, 20_000_000, 200)
    assert Limits(0.0, 1.0).rest_level == 0.0
    value = sequence(SWARM, [1.0], [1.0])
    assert value.stamp == 0
    with pytest.raises(FrozenInstanceError):
        value.stamp = 1
    check(sequence(SWARM, [1.0], [0.01], duration=0.01 + 0.9e-6))  # a millionth of a second, or of the whole if that is more
    with pytest.raises(StressbotError, match="send their sum"):
        check(sequence(SWARM, [1.0], [0.01], duration=0.01 + 1.1e-6))
    check(sequence(SWARM, [1.0, 2.0], [1.0, 1.0], [1, 2]))
    with pytest.raises(StressbotError, match="3 dwells for 2 levels"):
        check(sequence(SWARM, [1.0, 2.0], [1.0] * 3))
    with pytest.raises(StressbotError, match=r"step of 100 V before it takes 2 s at the largest slew rate of 50 V/s"):
        check(sequence(SWARM, [100.0], [1.0]), replace(LIMITS, max_slew_rate=50.0))
    check(sequence(SWARM, [1.0], [1.0], plan_id="p" * 200))
    with pytest.raises(StressbotError, match="201 characters"):
        check(sequence(SWARM, [1.0], [1.0], plan_id="p" * 201))


@pytest.mark.parametrize(
    ("levels", "dwells", "changes", "code", "field"),
    [
        ([1, 2], [1, 1], {"plan_id": ""}, ErrorCode.MISSING_FIELD, "plan_id"),
        ([1, 2], [1, 1], {"swarm_id": "other"}, ErrorCode.WRONG_SWARM, "swarm_id"),
        ([], [], {}, ErrorCode.INVALID_SEQUENCE, "levels"),
        ([1, 2], [1], {}, ErrorCode.WRONG_COUNT, "dwells"),
        ([1, np.nan], [1, 1], {}, ErrorCode.NOT_FINITE, "levels[1]"),
        ([1, np.inf], [1, 1], {}, ErrorCode.NOT_FINITE, "levels[1]"),
        ([1, 2], [np.nan, 1], {}, ErrorCode.NOT_FINITE, "dwells[0]"),
        ([1, 2], [np.inf, 1], {}, ErrorCode.NOT_FINITE, "dwells[0]"),
        ([1, 2], [1, 0], {}, ErrorCode.OUT_OF_RANGE, "dwells[1]"),
        ([1, 2], [1, -1], {}, ErrorCode.OUT_OF_RANGE, "dwells[1]"),
        ([1, 200.1], [1, 1], {}, ErrorCode.LIMIT_EXCEEDED, "levels[1]"),
        ([-0.1, 2], [1, 1], {}, ErrorCode.LIMIT_EXCEEDED, "levels[0]"),
        ([1, 2], [1, 0.0009], {}, ErrorCode.LIMIT_EXCEEDED, "dwells[1]"),
        ([1, 2], [1, 100], {}, ErrorCode.LIMIT_EXCEEDED, "duration"),
        ([1] * 1001, [0.001] * 1001, {}, ErrorCode.LIMIT_EXCEEDED, "levels"),
        ([1, 2], [1e308, 1e308], {}, ErrorCode.NOT_FINITE, "duration"),
        ([1, 2], [1, 1], {"duration": np.nan}, ErrorCode.NOT_FINITE, "duration"),
        ([1, 2], [1, 1], {"duration": 3.0}, ErrorCode.INVALID_SEQUENCE, "duration"),
        ([1, 2], [1, 1], {"ends": []}, ErrorCode.INVALID_SEQUENCE, "epoch_ends"),
        ([1, 2], [1, 1], {"ends": [0, 2]}, ErrorCode.INVALID_SEQUENCE, "epoch_ends"),
        ([1, 2], [1, 1], {"ends": [1]}, ErrorCode.INVALID_SEQUENCE, "epoch_ends"),
        ([1, 2], [1, 1], {"ends": [3]}, ErrorCode.INVALID_SEQUENCE, "epoch_ends"),
        ([1, 2], [1, 1], {"ends": [2, 2]}, ErrorCode.INVALID_SEQUENCE, "epoch_ends"),
        ([1, 2], [1, 1], {"ends": [2, 1]}, ErrorCode.INVALID_SEQUENCE, "epoch_ends"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_anything_else_is_refused_whole(levels, dwells, changes, code, field):
    with pytest.raises(StressbotError) as refused:
        check(sequence(SWARM, levels, dwells, **changes))
    assert (refused.value.code, refused.value.field) == (code, field)


def test_slew_and_duty_are_limits_too():
    slow = replace(LIMITS, max_slew_rate=100.0, rest_level=10.0)
    check(sequence(SWARM, [110.0, 60.0], [1.0, 0.5]), slow)  # each step is just over
    for levels, dwells, field in (([110.1, 60.0], [1.0, 1.0], "dwells[0]"), ([110.0, 60.0], [1.0, 0.4999], "dwells[1]")):
        with pytest.raises(StressbotError, match="hold it longer") as refused:
            check(sequence(SWARM, levels, dwells), slow)
        assert (refused.value.code, refused.value.field) == (ErrorCode.LIMIT_EXCEEDED, field)
    idle = replace(LIMITS, max_duty=0.25, drive_above=100.0)
    check(sequence(SWARM, [140.0, 100.0], [1.0, 3.0]), idle)
    with pytest.raises(StressbotError, match="max_duty is 0.25") as refused:
        check(sequence(SWARM, [140.0, 100.0], [1.0, 2.999]), idle)
    assert refused.value.code == ErrorCode.LIMIT_EXCEEDED


def test_levels_are_never_clipped_even_by_rounding():
    with pytest.raises(StressbotError):
        check(sequence(SWARM, [np.nextafter(200.0, 201.0)], [1.0]))
    with pytest.raises(StressbotError):
        check(sequence(SWARM, [np.nextafter(0.0, -1.0)], [1.0]))


@pytest.mark.parametrize(("sec", "nanosec"), [(-1, 0), (-(2**31), 5), (0, 10**9), (1, 2**32 - 1)])
def test_a_stamp_that_is_no_time_is_refused(sec, nanosec):
    message = VoltageSequenceMsg()
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    with pytest.raises(StressbotError) as refused:
        sequence_from_message(message)
    assert (refused.value.code, refused.value.field) == (ErrorCode.OUT_OF_RANGE, "header.stamp")
