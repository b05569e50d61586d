"""Stamps as whole nanoseconds and back."""

from hypothesis import given
from hypothesis import strategies as st
from stressbot_msgs.stamps import nanoseconds, stamp_of

MOST = 2**31 * 1_000_000_000


@given(st.integers(-MOST, MOST - 1))
def test_a_moment_is_the_same_again(moment):
    assert nanoseconds(stamp_of(moment)) == moment


@given(st.integers(MOST, 2 * MOST))
def test_what_no_stamp_can_say_is_the_nearest_that_one_can(moment):
    assert nanoseconds(stamp_of(moment)) == MOST - 1
    assert nanoseconds(stamp_of(-moment - 1)) == -MOST
