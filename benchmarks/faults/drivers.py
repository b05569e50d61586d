"""The driver is stopped, ended, killed or frozen."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from stressbot_msgs.msg import DriverStatus, ErrorCode
from system_rig import ENTRIES, SCENARIOS

from faults.settings import simulated
from faults.stage import PATIENCE, Outcome, Stage
from stressbot_planner.ros.bringup import command

RIVAL = "second driver"


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


def demo_killed(stage: Stage) -> Outcome:
    """It has nodes of its own, beside those of the stage: they end with it, at zero volts first."""
    line = [sys.executable, "-m", "stressbot_planner.cli.tool", "demo", "--real-time-factor", "1", "--output", str(stage.folder)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as demo:
        told = iter(demo.stdout.readline, "")
        assert any(text.startswith("driving") for text in told), "the demo did not drive"
        nodes = _descendants(demo.pid)
        since = time.monotonic()
        demo.kill()
    took = stage.until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in nodes) and time.monotonic() - since, "their end")
    return Outcome(f"its {len(nodes)} processes have ended after {took:.1f} s", None, "none", stage.recover())


def _descendants(pid: int) -> list[int]:
    children = [int(child) for task in Path(f"/proc/{pid}/task").glob("*/children") for child in task.read_text().split()]
    return children + [one for child in children for one in _descendants(child)]


def driver_killed_then_asked(stage: Stage) -> Outcome:
    """While it runs: its last words are that it runs, and poses."""
    stage.running()
    stage.kill("driver")
    killed = time.monotonic()
    stage.until(lambda: stage.system.client.description is None, "the end of its description")
    noticed = time.monotonic() - killed
    text = stage.refused_plan(ErrorCode.NO_SWARM)
    return Outcome(f"{text} (noticed after {noticed:.1f} s)", None, "none; NO_SWARM", restarted_driver(stage))


def two_drivers(number: signal.Signals) -> Callable[[Stage], Outcome]:
    """A second driver, of another scenario, comes while a sequence is loaded, and ends by a signal."""

    def fault(stage: Stage) -> Outcome:
        client, processes = stage.system.client, stage.system.processes
        stage.loaded(stage.plan([1.0]))
        mine = client.description.swarm_id
        line = command(ENTRIES["driver"], {"scenario": SCENARIOS / "paper-six-two-discs.yaml"}, namespace=stage.system.namespace)
        processes.start(RIVAL, line)
        stage.until(lambda: client.drivers == 2, "the second driver")
        text = stage.refused_plan(ErrorCode.AMBIGUOUS_SWARM)
        answer = stage.call("start")
        assert not answer.success, answer.message
        processes.stop(RIVAL, number)
        stage.until(lambda: client.description and client.description.swarm_id == mine, "the first driver's swarm")
        assert stage.call("stop").success
        return Outcome(text, None, "LOADED AMBIGUOUS_SWARM", stage.recover())

    return fault


FAULTS = {
    "stop call": (simulated, stop_called),
    "driver: SIGINT": (simulated, driver_signalled(signal.SIGINT)),
    "driver: SIGTERM": (simulated, driver_signalled(signal.SIGTERM)),
    "driver: SIGHUP": (simulated, driver_signalled(signal.SIGHUP)),
    "driver: kill -9": (simulated, driver_killed),
    "driver: kill -9, then a plan is asked for": (simulated, driver_killed_then_asked),
    "driver: frozen, goes on": (simulated, driver_frozen),
    "demo: kill -9": (simulated, demo_killed),
    "gate: kill -9": (simulated, gate_ended(signal.SIGKILL)),
    "gate: frozen": (simulated, gate_ended(signal.SIGSTOP)),
    "two drivers, the second ends": (simulated, two_drivers(signal.SIGTERM)),
    "two drivers, the second is killed": (simulated, two_drivers(signal.SIGKILL)),
}
