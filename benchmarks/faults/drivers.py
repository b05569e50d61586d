"""The driver is stopped, ended, killed or frozen."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

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
    """The substrate, which is the gate's, must be at rest, and nothing of the driver be left."""
    stage.running()
    (gate,) = stage.children("driver")
    since = stage.kill("driver")
    zero = stage.watch.at_rest(since)
    stage.until(lambda: not Path(f"/proc/{gate}").exists(), "the gate's end")
    return Outcome("driver_status falls silent", zero, "none; zero volts seen by the substrate", restarted_driver(stage))


def driver_frozen(stage: Stage) -> Outcome:
    """Half a second; the sequencer may seem lost afterwards too, since nothing of it was heard."""
    stage.running()
    since = stage.signal("driver", signal.SIGSTOP)
    try:
        zero = stage.watch.at_rest(since)
        time.sleep(0.5)
    finally:
        again = stage.signal("driver", signal.SIGCONT)
    lost = (ErrorCode.NO_HEARTBEAT, ErrorCode.PEER_LOST)
    fault = stage.first(lambda s: s.state == DriverStatus.FAULT and s.error_code in lost, again, "the fault")[1]
    assert fault.output_level == 0.0
    return Outcome(fault.error_msg, zero, "FAULT NO_HEARTBEAT or PEER_LOST", stage.recover())


def gate_ended(number: signal.Signals) -> Callable[[Stage], Outcome]:
    """The simulated substrate dies with its gate; the driver starts another one."""

    def fault(stage: Stage) -> Outcome:
        stage.running()
        (gate,) = stage.children("driver")
        since = time.monotonic()
        os.kill(gate, number)
        _, status = stage.at_rest(since, DriverStatus.FAULT, ErrorCode.BACKEND_FAILURE)
        return Outcome(status.error_msg, None, "FAULT BACKEND_FAILURE", stage.recover())

    return fault


FAULTS = {
    "stop call": (simulated, stop_called),
    "driver: SIGINT": (simulated, driver_signalled(signal.SIGINT)),
    "driver: SIGTERM": (simulated, driver_signalled(signal.SIGTERM)),
    "driver: SIGHUP": (simulated, driver_signalled(signal.SIGHUP)),
    "driver: kill -9": (simulated, driver_killed),
    "driver: frozen, goes on": (simulated, driver_frozen),
    "gate: kill -9": (simulated, gate_ended(signal.SIGKILL)),
    "gate: frozen": (simulated, gate_ended(signal.SIGSTOP)),
}
