"""One exception for all refusals; its codes are the constants of the message."""

import pickle

from hypothesis import given
from hypothesis import strategies as st
from stressbot_msgs.errors import ErrorCode, StressbotError
from stressbot_msgs.msg import ErrorCode as Message

from stressbot_driver import errors as driver_errors
from stressbot_planner import errors as planner_errors


def test_codes_equal_the_message():
    constants = {name: getattr(Message, name) for name in dir(type(Message)) if name[0].isalpha() and name.isupper()}
    assert constants
    assert {code.name: int(code) for code in ErrorCode} == constants


def test_planner_and_driver_refuse_with_the_same():
    assert driver_errors.StressbotError is planner_errors.StressbotError is StressbotError
    assert driver_errors.ErrorCode is planner_errors.ErrorCode is ErrorCode


def test_an_error_names_the_field_first():
    error = StressbotError(ErrorCode.OUT_OF_RANGE, "swarm.speed", "is 0: give a number greater than 0")
    assert str(error) == "swarm.speed: is 0: give a number greater than 0"
    assert (error.code, error.field) == (ErrorCode.OUT_OF_RANGE, "swarm.speed")
    assert str(StressbotError(ErrorCode.BUSY, "", "is busy")) == "is busy"


@given(st.sampled_from(ErrorCode), st.text(), st.text())
def test_an_error_is_short_and_printable_and_the_same_in_another_process(code, field, message):
    error = StressbotError(code, field, message)
    assert str(error).isprintable() and len(str(error)) < 20_100
    other = pickle.loads(pickle.dumps(error))
    assert (other.code, other.field, other.message) == (error.code, error.field, error.message)
