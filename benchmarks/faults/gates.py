"""One system call after the other fails or hangs in the gate."""

import time
from collections.abc import Callable

from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.failing_calls import CALLS
from faults.settings import failing_calls
from faults.stage import Outcome, Stage

A_WHILE = 0.5
"""s for which a call fails or hangs before somebody calls `stop`"""

CODES = (ErrorCode.NO_HEARTBEAT, ErrorCode.BACKEND_FAILURE, ErrorCode.INTERNAL, ErrorCode.PEER_LOST)


def call_fails(call: str, hang: bool) -> Callable[[Stage], Outcome]:
    """The run ends by itself, or does without that call until `stop`; then the driver runs again, by a new gate if need be."""

    def fault(stage: Stage) -> Outcome:
        stage.running()
        (gate,) = stage.children("driver")
        since = time.monotonic()
        stage.calls.fail(gate, call, hang)
        try:
            while stage.status.state == DriverStatus.RUNNING and time.monotonic() < since + A_WHILE:
                time.sleep(0.001)
            status = stage.status
            if status.state == DriverStatus.RUNNING:
                stage.call("stop")
                status = stage.until(lambda: stage.status.state != DriverStatus.RUNNING and stage.status, "an end")
        finally:
            stage.calls.work()
        assert status.output_level == 0.0
        if status.state == DriverStatus.STOPPED:
            return Outcome("it goes on without, and stops", None, "STOPPED", stage.recover())
        if status.error_code == ErrorCode.PEER_LOST:  # a false alarm, which the gate had a hand in only if it lasts
            stage.false_alarms += 1
        assert status.state == DriverStatus.FAULT and status.error_code in CODES, (status.state, status.error_msg)
        return Outcome(status.error_msg, None, "FAULT", stage.recover())

    return fault


FAULTS = {
    f"gate: {call} {'hangs' if hang else 'fails'}": (failing_calls, call_fails(call, hang))
    for call in CALLS
    for hang in (False, True)
}
