"""The tracker falls silent: nobody sees the robots any more."""

import time

from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.movers import driving, result_of, send
from faults.settings import POSE_TIMEOUT, tracked
from faults.stage import Outcome, Stage

CODES = (ErrorCode.POSES_LOST, ErrorCode.NO_SWARM, ErrorCode.NOTHING_LOADED)
"""Silent while it drives, while it looks, before it starts."""


def silent_while_running(stage: Stage) -> Outcome:
    stage.running()
    since = _falls_silent(stage)
    zero, status = stage.at_rest(since, DriverStatus.FAULT, ErrorCode.POSES_LOST)
    assert not stage.call("start").success
    _speaks_again(stage)
    assert stage.status.state == DriverStatus.FAULT
    seen = f"{status.error_msg} (zero volts {1e3 * zero:.0f} ms after the last pose, pose_timeout {1e3 * POSE_TIMEOUT:.0f} ms)"
    return Outcome(seen, None, "FAULT POSES_LOST", f"still FAULT when it speaks again; {stage.recover()}")


def silent_under_the_mover(stage: Stage) -> Outcome:
    """At a random moment of its work, so that the driver may be running, and in FAULT afterwards, or not."""
    goal = driving(stage)
    _falls_silent(stage)
    result = result_of(stage, goal)
    assert not result.success and result.error_code in CODES, f"{result.error_code} {result.error_msg}"
    stage.until(lambda: stage.status.state != DriverStatus.RUNNING and stage.status.output_level == 0.0, "zero volts")
    state = stage.status.state
    assert state != DriverStatus.FAULT or stage.status.error_code == ErrorCode.POSES_LOST
    _speaks_again(stage)
    assert stage.call("reset").success
    heard: list = []
    again = send(stage, heard)
    stage.until(lambda: heard and heard[-1].activations, "a motion", 120.0)
    stage.system.asked(again.cancel_goal_async)
    assert result_of(stage, again).error_code == ErrorCode.CANCELLED
    return Outcome(result.error_msg, None, "FAULT POSES_LOST, or at rest", f"a new goal is driven to; {stage.recover()}")


def _falls_silent(stage: Stage) -> float:
    stage.silence.append(True)
    return time.monotonic()


def _speaks_again(stage: Stage) -> None:
    stage.silence.clear()
    stage.until(lambda: not stage.status.missing, "the tracker's return")


FAULTS = {
    "tracker: silent while a sequence runs": (tracked, silent_while_running),
    "tracker: silent while the mover drives": (tracked, silent_under_the_mover),
}
