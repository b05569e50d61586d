"""The driver is stopped, ended, killed or frozen."""

import signal
import time
from collections.abc import Callable

from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.settings import simulated
from faults.stage import PATIENCE, Outcome, Stage


def stop_called(stage: Stage) -> Outcome:
    stage.running()
    since = time.monotonic()
    answer = stage.call("stop")
    zero, _ = stage.at_rest(since, DriverStatus.STOPPED)
    return Outcome(answer.message, zero, "STOPPED", stage.recover())


def driver_signalled(number: signal.Signals) -> Callable[[Stage], Outcome]:
    def fault(stage: Stage) -> Outcome:
        stage.running()
        zero, _ = stage.at_rest(stage.signal("driver", number), DriverStatus.STOPPED)
        code = stage.system.processes._running["driver"].wait(PATIENCE)
        stage.system.processes.stop("driver")
        assert code == 0, f"exit code {code}"
        return Outcome("the last status, exit code 0", zero, "STOPPED", restarted_driver(stage))

    return fault


def restarted_driver(stage: Stage) -> str:
    before = time.monotonic()
    stage.start("driver")
    _, status = stage.first(lambda s: s.state == DriverStatus.IDLE, before, "the new driver")
    assert (status.plan_id, status.output_level) == ("", 0.0)
    stage.until(lambda: stage.sequences.get_subscription_count() >= 1 and not stage.status.missing, "the driver's peers")
    stage.meet_driver()
    return f"driver restarted in IDLE without a sequence, {stage.recover()}"


def driver_killed(stage: Stage) -> Outcome:
    stage.running()
    stage.kill("driver")
    return Outcome("driver_status falls silent", None, "none: the simulated substrate dies with it", restarted_driver(stage))


def driver_frozen(stage: Stage) -> Outcome:
    """Half a second; the sequencer may seem lost afterwards, since nothing of it was heard."""
    stage.running()
    stage.signal("driver", signal.SIGSTOP)
    time.sleep(0.5)
    since = stage.signal("driver", signal.SIGCONT)
    stage.first(lambda s: True, since, "a status")
    time.sleep(0.2)
    state, message = stage.status.state, stage.status.error_msg
    assert state == DriverStatus.RUNNING or (state, stage.status.error_code) == (DriverStatus.FAULT, ErrorCode.PEER_LOST), message
    if state == DriverStatus.RUNNING:
        assert stage.call("stop").success
    stage.until(lambda: stage.status.state != DriverStatus.RUNNING and stage.status.output_level == 0.0, "zero volts")
    return Outcome(message or "the run goes on", None, "RUNNING or FAULT PEER_LOST", stage.recover())


FAULTS = {
    "stop call": (simulated, stop_called),
    "driver: SIGINT": (simulated, driver_signalled(signal.SIGINT)),
    "driver: SIGTERM": (simulated, driver_signalled(signal.SIGTERM)),
    "driver: SIGHUP": (simulated, driver_signalled(signal.SIGHUP)),
    "driver: kill -9": (simulated, driver_killed),
    "driver: frozen for 0.5 s": (simulated, driver_frozen),
}
