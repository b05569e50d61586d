"""Each reason for which the library refuses is provoked by a test."""

from importlib import resources
from pathlib import Path

import pytest

from stressbot_planner.errors import ErrorCode


@pytest.mark.parametrize(
    "code",
    [code for code in ErrorCode if code.name in {
        "UNREADABLE_FILE", "MALFORMED_FILE", "MISSING_FIELD", "UNKNOWN_FIELD", "WRONG_TYPE", "NOT_FINITE", "OUT_OF_RANGE",
        "WRONG_COUNT", "NO_ROBOTS", "TOO_MANY_ROBOTS", "INVALID_CODEWORD", "DUPLICATE_CODEWORD", "EMPTY_CODEWORD", "UNKNOWN_ROBOT",
        "OUTSIDE_WORKSPACE", "INSIDE_OBSTACLE", "STARTS_OVERLAP", "GOALS_TOO_CLOSE", "UNKNOWN_PLANNER", "UNKNOWN_OBJECTIVE",
        "UNSUPPORTED", "NO_PLAN_FOUND", "WRONG_SWARM", "UNKNOWN_GROUP", "INVALID_PLAN", "INVALID_SEQUENCE",
    }],
    ids=lambda code: code.name,
)
def test_every_refusal_of_the_library_is_provoked_by_a_test(code):
    tests = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py") if path.name != "test_errors.py")
    assert f"ErrorCode.{code.name}" in tests


def test_the_schema_is_found_as_data_of_the_messages():
    assert (resources.files("stressbot_msgs") / "scenario.schema.json").is_file()
