from stressbot_msgs.msg import ErrorCode as Message

from stressbot_driver.errors import BenchError, ErrorCode


def test_codes_equal_the_message():
    constants = {name: getattr(Message, name) for name in dir(type(Message)) if name[0].isalpha() and name.isupper()}
    assert constants
    assert {code.name: int(code) for code in ErrorCode} == constants


def test_text_names_the_field():
    error = BenchError(ErrorCode.OUT_OF_RANGE, "swarm.speed", "must be positive")
    assert str(error) == "swarm.speed: must be positive"
