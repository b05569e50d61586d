"""The driver is flooded, held up or deaf to its own words, and told to stop meanwhile; or everybody is suspended."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults import flooder
from faults.settings import blocked, simulated
from faults.stage import Outcome, Stage

RIVAL_FOR = 1.2
"""s for which the driver may take who flooded `driver_status` for another driver."""

WATCHES = (ErrorCode.NO_HEARTBEAT, ErrorCode.PEER_LOST)

SETTLED_AFTER = 0.5
"""s after which everybody has noticed"""

SEEN_AGAIN = 1.0
"""s that all are suspended for"""


def flooded(what: str) -> Callable[[Stage], Outcome]:
    """Stop while one topic or service is flooded: zero volts are those that the substrate saw."""

    def fault(stage: Stage) -> Outcome:
        stage.running()
        before = time.monotonic()
        with subprocess.Popen(
            [sys.executable, flooder.__file__, stage.system.namespace, what], stdout=subprocess.PIPE, text=True
        ) as flood:
            try:
                assert "flooding\n" in iter(flood.stdout.readline, "")  # Fast DDS may complain before
                time.sleep(stage.rng.uniform(0.1, 0.5))
                running = stage.status.state == DriverStatus.RUNNING
                since = time.monotonic()
                answer = stage.call("stop")
                took = time.monotonic() - since
                zero = stage.rested(since) if running else None
            finally:
                flood.kill()
        time.sleep(RIVAL_FOR)
        assert answer.success, answer.message
        if running:
            return Outcome(f"stop is answered after {1e3 * took:.0f} ms", zero, "STOPPED", stage.recover())
        # Flood and flooder together were too much for a watch before anybody called `stop`.
        assert stage.status.output_level == 0.0 and (stage.status.state == DriverStatus.FAULT or what == "reset")
        told = stage.first(lambda s: s.state == DriverStatus.FAULT, before, "the fault")[1]
        assert told.error_code in WATCHES, told.error_msg
        stage.false_alarms += 1
        return Outcome(told.error_msg, None, "FAULT by a watch", stage.recover())

    return fault


def all_suspended(stage: Stage) -> Outcome:
    """As a computer that sleeps: a watch ends the run, unless everybody shows life again before anybody looks; then it goes on."""
    stage.running()
    everybody = [stage.pid(name) for name in ("driver", "sequencer", "planner")] + stage.children("driver")
    for pid in everybody:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(SEEN_AGAIN)
    again = time.monotonic()
    for pid in everybody:
        os.kill(pid, signal.SIGCONT)
    time.sleep(SETTLED_AFTER)
    if stage.status.state == DriverStatus.RUNNING:
        since = time.monotonic()
        assert stage.call("stop").success
        return Outcome("it goes on, and stops", stage.rested(since), "RUNNING, STOPPED", stage.recover())
    assert stage.status.state == DriverStatus.FAULT and stage.status.error_code in WATCHES, stage.status.error_msg
    return Outcome(stage.status.error_msg, max(stage.rested(again), 0.0), "FAULT NO_HEARTBEAT or PEER_LOST", stage.recover())


def blocked_and_stopped(stage: Stage) -> Outcome:
    stage.running()
    since = time.monotonic()
    assert stage.call("stop").success
    return Outcome("stopped", stage.rested(since), "STOPPED", stage.recover())


def blocked_and_alone(stage: Stage) -> Outcome:
    stage.running()
    since = stage.kill("sequencer")
    status = stage.first(lambda s: s.state == DriverStatus.FAULT, since, "the fault")[1]
    zero = stage.rested(since)
    stage.start("sequencer")
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", stage.recover())


def blocked_and_signalled(stage: Stage) -> Outcome:
    """Its end takes a little longer than its volts: half a second it waits for who does not read its last words."""
    stage.running()
    since = stage.signal("driver", signal.SIGTERM)
    code = stage.system.processes._running["driver"].wait(30.0)
    stage.system.processes.stop("driver")
    assert code == 0, f"exit code {code}"
    zero = stage.rested(since)
    stage.start("driver")
    stage.until(lambda: stage.status.state == DriverStatus.IDLE and not stage.status.missing, "the new driver")
    stage.meet_driver()
    return Outcome("exit code 0", zero, "STOPPED", stage.recover())


FAULTS = {
    **{f"flood of {what}": (simulated, flooded(what)) for what in (*flooder.TOPICS, *flooder.SERVICES)},
    "all suspended for a second": (simulated, all_suspended),
    "nobody reads the driver's log: stop call": (blocked, blocked_and_stopped),
    "nobody reads the driver's log: sequencer kill -9": (blocked, blocked_and_alone),
    "nobody reads the driver's log: SIGTERM": (blocked, blocked_and_signalled),
}
