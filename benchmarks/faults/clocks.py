"""Clocks of nodes jump by an hour, ahead or back, while a sequence runs or waits."""

import time

from stressbot_msgs.msg import DriverStatus, ErrorCode, MotionPlan

from faults.drivers import driver_killed, restarted_driver
from faults.messages import refused
from faults.movers import driving, result_of, send
from faults.settings import moving_with_shifted_clocks, shifted_clocks
from faults.stage import Outcome, Stage

HOUR = 3600.0
LONG_ENOUGH = 0.3
"""s of a sequence, in which every watch that trusted the date would have struck."""


def all_while_running(ahead: float):
    """Return a fault: all nodes are on one machine, and its clock is set."""

    def fault(stage: Stage) -> Outcome:
        early = stage.plan([0.1])
        stage.running()
        _set(stage, ahead)
        zero = _goes_on_and_stops(stage)
        seen, recovered = _after(stage, early, outdated=ahead < 0.0)
        return Outcome(f"the run goes on; then {seen}", zero, "RUNNING, STOPPED OUTDATED", recovered)

    return fault


def all_while_loaded(ahead: float):
    """Return a fault: as `all_while_running`, before the start."""

    def fault(stage: Stage) -> Outcome:
        early = stage.plan([0.1])
        stage.loaded(stage.plan([0.1, 0.2]))
        _set(stage, ahead)
        assert stage.call("start").success
        stage.until(lambda: stage.status.state == DriverStatus.DONE, "its end")
        seen, recovered = _after(stage, early, outdated=False)
        return Outcome(f"what is loaded runs; then {seen}", None, "DONE OUTDATED", recovered)

    return fault


def driver_alone(ahead: float):
    """Return a fault: the clock of the driver's machine is set, that of who plans is not."""

    def fault(stage: Stage) -> Outcome:
        stage.running()
        stage.clocks.set(ahead, "driver")
        zero = _goes_on_and_stops(stage)
        assert stage.call("reset").success
        status = refused(stage, stage.plan([0.1]), ErrorCode.OUTDATED)
        assert (status.state, status.output_level) == (DriverStatus.IDLE, 0.0)
        stage.clocks.set(0.0)
        return Outcome(f"the run goes on; then {status.error_msg}", zero, "IDLE OUTDATED", f"clock mended, {stage.recover()}")

    return fault


def all_under_the_mover(ahead: float):
    """Return a fault: as `all_while_running`, while the mover drives. What it plans after a jump back is outdated."""

    def fault(stage: Stage) -> Outcome:
        goal = driving(stage)
        _set(stage, ahead)
        result = result_of(stage, goal)
        if ahead > 0.0:
            assert result.success, result.error_msg
        else:
            assert result.error_code == ErrorCode.OUTDATED, result.error_msg
        stage.until(lambda: stage.status.state != DriverStatus.RUNNING and stage.status.output_level == 0.0, "rest")
        assert stage.call("reset").success
        again = result_of(stage, send(stage))
        assert again.success, again.error_msg
        recovered = stage.recover()
        _set(stage, 0.0)
        assert stage.call("reset").success
        seen = result.error_msg or "nothing: the goal is reached"
        return Outcome(seen, None, "DONE" if result.success else "DONE OUTDATED", f"reset, new goal reached; {recovered}")

    return fault


def driver_killed_after_a_jump_back(stage: Stage) -> Outcome:
    """What a killed node leaves behind is dated an hour ahead: nobody may wait until then."""
    _set(stage, HOUR)
    stage.kill("driver")
    restarted_driver(stage)
    _set(stage, 0.0)
    assert stage.call("reset").success
    return driver_killed(stage)


def _set(stage: Stage, ahead: float) -> None:
    stage.clocks.set(ahead)
    stage.ahead = ahead


def _goes_on_and_stops(stage: Stage) -> float:
    """Return the time from a stop call to zero volts, after the sequence has gone on for a while, s."""
    reached = stage.status.sequence_time
    stage.until(lambda: stage.status.sequence_time > reached + LONG_ENOUGH, "progress")
    assert stage.status.state == DriverStatus.RUNNING, stage.status.error_msg
    since = time.monotonic()
    assert stage.call("stop").success
    return stage.at_rest(since, DriverStatus.STOPPED)[0]


def _after(stage: Stage, early: MotionPlan, outdated: bool) -> tuple[str, str]:
    """Return what the user sees, and what it takes to go on: a reset, if every plan is outdated by the clock that was set back."""
    if outdated:
        seen, needed = f"every plan: {refused(stage, stage.plan([0.1]), ErrorCode.OUTDATED).error_msg}", "reset, "
        assert stage.call("reset").success
        refused(stage, early, ErrorCode.OUTDATED)
    else:
        seen, needed = f"a plan from before: {refused(stage, early, ErrorCode.OUTDATED).error_msg}", ""
    stage.planned()
    recovered = stage.recover()
    _set(stage, 0.0)  # a jump as well
    assert stage.call("reset").success
    return seen, f"{needed}plans again; {recovered}"


FAULTS = {
    "clocks: all 1 h ahead while a sequence runs": (shifted_clocks, all_while_running(HOUR)),
    "clocks: all 1 h back while a sequence runs": (shifted_clocks, all_while_running(-HOUR)),
    "clocks: all 1 h ahead while one is loaded": (shifted_clocks, all_while_loaded(HOUR)),
    "clocks: all 1 h back while one is loaded": (shifted_clocks, all_while_loaded(-HOUR)),
    "clocks: the driver's alone 1 h ahead": (shifted_clocks, driver_alone(HOUR)),
    "clocks: the driver's alone 1 h back": (shifted_clocks, driver_alone(-HOUR)),
    "clocks: all 1 h back, then driver kill -9": (shifted_clocks, driver_killed_after_a_jump_back),
    "clocks: all 1 h ahead while the mover drives": (moving_with_shifted_clocks, all_under_the_mover(HOUR)),
    "clocks: all 1 h back while the mover drives": (moving_with_shifted_clocks, all_under_the_mover(-HOUR)),
}
