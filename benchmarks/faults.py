"""`make faults`: nodes are killed and frozen, messages doubled and late, a disk full and a link cut while a sequence runs.

Every fault must end in the state that docs/safety.md names, at zero volts, and the system must run again afterwards. Prints a
table and writes it to results/ as Markdown and JSON; the last line counts. The time to zero volts is from the fault to the
arrival, in this process, of the `driver_status` that says so.
"""

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from ament_index_python.packages import get_package_prefix
from std_srvs.srv import Trigger
from stressbot_msgs.msg import DriverStatus, ErrorCode, MotionPlan, Primitive, SwarmPoses, VoltageSequence
from stressbot_msgs.srv import PlanMotion

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/support"))

from system_rig import ENTRIES, SCENARIOS, System  # noqa: E402

from stressbot_planner.reproduce.tables import Table  # noqa: E402
from stressbot_planner.ros.bringup import command  # noqa: E402
from stressbot_planner.ros.qos import LATCHED, ORDERS  # noqa: E402

UNIT = 1e-4  # m
LIMIT = 0.1
"""Zero volts must come within this time, s."""

PEER_TIMEOUT = 0.08
"""s, the driver's default; tests of other things wait longer."""

STATES = {getattr(DriverStatus, name): name for name in ("IDLE", "LOADED", "RUNNING", "DONE", "STOPPED", "FAULT")}
PATIENCE = 30.0
ENDS = (DriverStatus.DONE, DriverStatus.FAULT)
MOST_FALSE_ALARMS = 20
RESEND = 1.0
"""s"""


@dataclass(frozen=True)
class Outcome:
    """What came of one fault: what the user saw, s to zero volts (None: nothing had to stop), the state, and that it runs again."""

    seen: str
    zero: float | None
    state: str
    recovered: str


class Stage:
    """A running system, with every driver status that was heard and when, s."""

    def __init__(self, system: System, rng: random.Random, driver_parameters: dict):
        self.system, self.rng, self._parameters = system, rng, driver_parameters
        self.heard: list[tuple[float, DriverStatus]] = []
        self.false_alarms = 0
        self.moved = 0.0  # when robots were last seen somewhere else than before
        self._poses: SwarmPoses | None = None
        self.node = system.client.node
        self.node.create_subscription(DriverStatus, "driver_status", self._hear, LATCHED)
        self.node.create_subscription(SwarmPoses, "swarm_poses", self._see, 50)
        self.plans = self.node.create_publisher(MotionPlan, "motion_plan", ORDERS)
        self.sequences = self.node.create_publisher(VoltageSequence, "voltage_sequence", ORDERS)
        self.until(lambda: self.heard and self.plans.get_subscription_count() and self.sequences.get_subscription_count())

    def _hear(self, message: DriverStatus) -> None:
        self.heard.append((time.monotonic(), message))

    def _see(self, message: SwarmPoses) -> None:
        last, self._poses = self._poses, message
        if last is None or (message.x, message.y, message.heading) != (last.x, last.y, last.heading):
            self.moved = time.monotonic()

    @property
    def status(self) -> DriverStatus:
        return self.heard[-1][1]

    def until(self, condition: Callable, what: str = "", timeout: float = PATIENCE):
        """Wait for a condition and return its value."""
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            known = f"{STATES[self.status.state]}, {self.status.error_msg!r}" if self.heard else "no driver"
            assert time.monotonic() < deadline, f"{what or 'it'} did not come within {timeout:g} s ({known})"
            time.sleep(0.001)
        return value

    def first(self, condition: Callable[[DriverStatus], bool], since: float, what: str) -> tuple[float, DriverStatus]:
        """Return when, s after `since`, the first status came that fulfils a condition, and that status."""
        when, status = self.until(
            lambda: next(((t, status) for t, status in list(self.heard) if t >= since and condition(status)), None), what
        )
        return when - since, status

    def at_rest(self, since: float, state: int, code: int = ErrorCode.NONE) -> tuple[float, DriverStatus]:
        """Return when the first status at zero volts came that is not of a run, and that status; it must be the right one."""
        zero, status = self.first(lambda s: s.state != DriverStatus.RUNNING and s.output_level == 0.0, since, "zero volts")
        assert (status.state, status.error_code) == (state, code), f"{STATES[status.state]}: {status.error_msg}"
        return zero, status

    def pid(self, name: str) -> int:
        return self.system.processes._running[name].pid

    def signal(self, name: str, number: signal.Signals) -> float:
        """Send a signal, and return when."""
        now = time.monotonic()
        os.kill(self.pid(name), number)
        return now

    def kill(self, name: str) -> float:
        now = self.signal(name, signal.SIGKILL)
        self.system.processes.stop(name, signal.SIGKILL)
        return now

    def start(self, name: str) -> None:
        self.system.start(name, **(self._parameters if name == "driver" else {}))

    def plan(self, lengths, stamp=None, **fields) -> MotionPlan:
        """A plan of activations of random groups, lengths in units; made from poses measured now."""
        groups = [self.rng.randint(1, 4) for _ in lengths]
        steps = [
            Primitive(kind=Primitive.ACTIVATE, group=group, distance=float(length) * UNIT)
            for group, length in zip(groups, lengths, strict=True)
        ]
        values = {"plan_id": uuid.uuid4().hex, "swarm_id": self.system.client.description.swarm_id, "planner": "faults"}
        message = MotionPlan(**{**values, "primitives": steps, **fields})
        message.header.stamp = stamp or self.node.get_clock().now().to_msg()
        return message

    def loaded(self, plan: MotionPlan) -> None:
        """Publish a plan until the driver has loaded it: a node that has just started may not have met us yet."""
        sent = -np.inf

        def known() -> bool:
            nonlocal sent
            if time.monotonic() - sent > RESEND:
                self.plans.publish(plan)
                sent = time.monotonic()
            return (self.status.plan_id, self.status.state) == (plan.plan_id, DriverStatus.LOADED)

        self.until(known, "loading")

    def call(self, service: str) -> Trigger.Response:
        return self.system.client.trigger(service, PATIENCE)

    def running(self) -> MotionPlan:
        """Let a long sequence run, until a random moment of it."""
        while True:
            plan = self._started([self.rng.uniform(0.05, 1.5) for _ in range(100)])
            time.sleep(self.rng.uniform(0.0, 0.7))
            if not self._alarmed():
                assert self.status.state == DriverStatus.RUNNING, STATES[self.status.state]
                return plan

    def _started(self, lengths) -> MotionPlan:
        """Let a sequence start, and return its plan."""
        while True:
            self.until(lambda: not self.status.missing, "the driver's sight of the sequencer")
            plan = self.plan(lengths)
            self.loaded(plan)
            answer = self.call("start")
            if answer.success:
                return plan
            assert "sequencer_status" in answer.message, answer.message
            self.false_alarms += 1

    def _alarmed(self) -> bool:
        """Return whether the driver took a living sequencer for lost, and reset it then."""
        if (self.status.state, self.status.error_code) != (DriverStatus.FAULT, ErrorCode.PEER_LOST):
            return False
        self.false_alarms += 1
        assert self.false_alarms < MOST_FALSE_ALARMS, "this machine is too busy: raise peer_timeout"
        assert self.call("reset").success
        return True

    def recover(self) -> str:
        """Reset, and run a short sequence to its end."""
        self.until(lambda: not self.status.missing, "the driver's sight of the sequencer")
        answer = self.call("reset")
        assert answer.success, answer.message
        return f"reset, {self.short_run()}"

    def planned(self) -> None:
        """Ask for a plan until the planner answers, and wait for its sequence: a dead server stays listed for some 20 s."""
        service = self.system.client._services["plan_motion"]
        deadline = time.monotonic() + PATIENCE
        while True:
            asked = service.call_async(PlanMotion.Request(first=True))
            try:
                self.until(asked.done, "the plan", 5.0)
                break
            except AssertionError:
                service.remove_pending_request(asked)
                if time.monotonic() > deadline:
                    raise
        answer = asked.result()
        assert answer.success, answer.error_msg
        self.until(lambda: (self.status.plan_id, self.status.state) == (answer.plan.plan_id, DriverStatus.LOADED), "its sequence")

    def short_run(self) -> str:
        while True:
            started = self._started([0.1, 0.2]).plan_id
            self.until(lambda plan_id=started: self.status.plan_id == plan_id and self.status.state in ENDS, "the end")
            if not self._alarmed():
                assert (self.status.state, self.status.output_level) == (DriverStatus.DONE, 0.0)
                return "DONE"


# Peers


def sequencer_killed(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.kill("sequencer"), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    refused = stage.call("start")
    assert not refused.success
    stage.start("sequencer")
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"sequencer restarted, {stage.recover()}")


def sequencer_frozen(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.signal("sequencer", signal.SIGSTOP), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    assert "sequencer_status" in status.missing
    stage.signal("sequencer", signal.SIGCONT)
    stage.until(lambda: not stage.status.missing, "the sequencer's return")
    assert stage.status.state == DriverStatus.FAULT
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"still FAULT when it goes on; {stage.recover()}")


def sequencer_ended(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.signal("sequencer", signal.SIGTERM), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    stage.system.processes.stop("sequencer")
    stage.start("sequencer")
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"sequencer restarted, {stage.recover()}")


def sequencer_killed_before_start(stage: Stage) -> Outcome:
    stage.loaded(stage.plan([1.0]))
    stage.kill("sequencer")
    stage.until(lambda: stage.status.missing, "its loss")
    answer = stage.call("start")
    assert not answer.success and stage.until(lambda: stage.status.error_code == ErrorCode.PEER_LOST, "the refusal")
    assert (stage.status.state, stage.status.output_level) == (DriverStatus.LOADED, 0.0)
    stage.start("sequencer")
    return Outcome(answer.message, None, "LOADED PEER_LOST", f"sequencer restarted, {stage.recover()}")


def planner_killed(stage: Stage) -> Outcome:
    stage.running()
    stage.kill("planner")
    time.sleep(0.3)
    assert stage.status.state == DriverStatus.RUNNING
    stage.start("planner")
    since = time.monotonic()
    assert stage.call("stop").success
    stage.at_rest(since, DriverStatus.STOPPED)
    recovered = stage.recover()
    stage.planned()
    seen = "nothing: the sequence runs on, whole and checked"
    return Outcome(seen, None, "RUNNING", f"planner restarted, {recovered}, plans again")


def planner_killed_while_planning(stage: Stage) -> Outcome:
    service = stage.system.client._services["plan_motion"]
    hopeless = PlanMotion.Request(planner="rrt", tolerance=0.031 * UNIT, time_limit=60.0)
    asked = service.call_async(hopeless)
    stage.until(lambda: stage.system.plan().error_code == ErrorCode.BUSY or asked.done(), "the plan to be in the making")
    stage.kill("planner")
    stage.start("planner")
    stage.planned()
    assert not asked.done()
    service.remove_pending_request(asked)
    assert stage.status.output_level == 0.0
    return Outcome("no answer: ask again", None, "as before", f"planner restarted, plans again, {stage.recover()}")


def two_planners(stage: Stage) -> Outcome:
    """Both are asked at once, since both offer the service; the driver runs one plan and refuses the other."""
    stage.system.processes.start("second_planner", command(ENTRIES["planner"], {}, namespace=stage.system.namespace))
    try:
        stage.until(lambda: len(stage.node.get_service_names_and_types_by_node("planner", stage.system.namespace)) > 0, "it")
        stage.until(lambda: stage.node.count_publishers("motion_plan") == 3, "the second planner")
        answer = stage.system.plan()
        assert answer.success, answer.error_msg
        stage.until(lambda: stage.status.state == DriverStatus.LOADED, "a sequence")
        assert stage.call("start").success
        ran = stage.until(lambda: stage.status.state == DriverStatus.RUNNING and stage.status.plan_id, "the run")
        late = stage.plan([1.0])  # what the slower planner has made meanwhile
        stage.plans.publish(late)
        _, status = stage.first(lambda s: s.refused_plan_id == late.plan_id, 0.0, "the refusal")
        assert (status.state, status.plan_id, status.error_code) == (DriverStatus.RUNNING, ran, ErrorCode.BUSY)
        since = time.monotonic()
        assert stage.call("stop").success
        stage.at_rest(since, DriverStatus.STOPPED)
    finally:
        stage.system.processes.stop("second_planner")
    return Outcome(status.error_msg.replace(ran, "…"), None, "RUNNING BUSY", stage.recover())


# The driver


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


# Messages


def doubled_plan(stage: Stage) -> Outcome:
    plan = stage.plan([0.1, 0.1])
    stage.loaded(plan)
    stage.loaded(plan)
    assert stage.call("start").success
    stage.until(lambda: stage.status.state == DriverStatus.DONE, "the end")
    status = refused(stage, plan, ErrorCode.OUTDATED)
    assert (status.state, status.output_level) == (DriverStatus.DONE, 0.0)
    return Outcome(status.error_msg, None, "DONE OUTDATED", stage.recover())


def refused(stage: Stage, plan: MotionPlan, code: int) -> DriverStatus:
    """Publish a plan, and return the status that refuses its sequence with a code."""
    since = time.monotonic()
    stage.plans.publish(plan)
    return stage.first(lambda s: (s.refused_plan_id, s.error_code) == (plan.plan_id, code), since, "the refusal")[1]


def reordered_plans(stage: Stage) -> Outcome:
    early, late = stage.plan([0.1]), stage.plan([0.2])
    stage.loaded(late)
    assert stage.call("start").success
    stage.until(lambda: stage.status.state == DriverStatus.DONE, "the end")
    status = refused(stage, early, ErrorCode.OUTDATED)
    assert (status.state, status.output_level) == (DriverStatus.DONE, 0.0)
    assert not stage.call("start").success
    return Outcome(status.error_msg, None, "DONE OUTDATED", stage.recover())


def doubled_plan_while_running(stage: Stage) -> Outcome:
    plan = stage.running()
    status = refused(stage, plan, ErrorCode.BUSY)
    assert status.state == DriverStatus.RUNNING
    since = time.monotonic()
    assert stage.call("stop").success
    stage.at_rest(since, DriverStatus.STOPPED)
    assert refused(stage, plan, ErrorCode.OUTDATED).state == DriverStatus.STOPPED
    return Outcome(status.error_msg.replace(plan.plan_id, "…"), None, "RUNNING BUSY", stage.recover())


def hostile_sequences(stage: Stage) -> Outcome:
    """For another swarm, beyond the volts, with lists that do not match: sent past the sequencer, waiting and running."""
    stage.loaded(stage.plan([5.0]))
    swarm = stage.system.client.description.swarm_id
    cases = {
        ErrorCode.WRONG_SWARM: {"swarm_id": "another"},
        ErrorCode.LIMIT_EXCEEDED: {"levels": [0.0, 1e4]},
        ErrorCode.NOT_FINITE: {"levels": [0.0, float("nan")]},
        ErrorCode.WRONG_COUNT: {"dwells": [1.0]},
        ErrorCode.INVALID_SEQUENCE: {"epoch_ends": [7]},
    }
    good = {"levels": [0.0, 1.0], "dwells": [1.0, 1.0], "epoch_ends": [2], "duration": 2.0, "swarm_id": swarm}
    for running in (False, True):
        loaded = stage.status.plan_id
        for code, fields in cases.items():
            sequence = VoltageSequence(plan_id=uuid.uuid4().hex, **{**good, **fields})
            stage.sequences.publish(sequence)
            _, status = stage.first(lambda s, name=sequence.plan_id: s.refused_plan_id == name, 0.0, "the refusal")
            expected = (DriverStatus.RUNNING, ErrorCode.BUSY) if running else (DriverStatus.LOADED, code)
            assert (status.state, status.error_code) == expected, status.error_msg
            assert status.plan_id == loaded
        if not running:
            assert stage.call("start").success
    since = time.monotonic()
    assert stage.call("stop").success
    stage.at_rest(since, DriverStatus.STOPPED)
    return Outcome("a refusal with its own code each; what is loaded or runs stays", None, "LOADED, RUNNING", stage.recover())


# Instruments


def recording_disk_full(stage: Stage) -> Outcome:
    """The record of what is sent to the instrument may not grow any more: a write fails as on a full disk."""
    stage.running()
    record = max(stage.folder.glob("instrument-*.jsonl"), key=lambda path: path.stat().st_mtime)
    pid, before = stage.pid("driver"), resource.prlimit(stage.pid("driver"), resource.RLIMIT_FSIZE)
    since = time.monotonic()
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (record.stat().st_size, before[1]))
    zero, status = stage.at_rest(since, DriverStatus.FAULT, ErrorCode.BACKEND_FAILURE)
    assert "cannot be written" in status.error_msg
    resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
    seen = re.sub(r"/\S*/", "", status.error_msg)
    return Outcome(f"{seen} (after the epoch that ran, {zero:.1f} s)", None, "FAULT BACKEND_FAILURE", stage.recover())


def driver_killed_at_an_instrument(stage: Stage) -> Outcome:
    stage.running()
    since = stage.kill("driver")
    stage.until(lambda: time.monotonic() - max(stage.moved, since) > LONGEST_EPOCH, "rest")
    still = max(stage.moved - since, 0.0)
    assert still < LONGEST_EPOCH
    return Outcome(
        f"driver_status falls silent; the generator plays its epoch to the end, robots still after {still:.1f} s",
        None, "none; the generator waits at rest for a trigger", restarted_driver(stage),
    )


def instrument_killed(stage: Stage) -> Outcome:
    stage.running()
    stage.kill("instrument_emulator")
    stage.until(lambda: stage.status.state == DriverStatus.FAULT, "the fault")
    message = stage.status.error_msg
    assert "THE OUTPUT MAY BE ON" in message and not stage.call("reset").success
    start_emulator(stage.system, stage.folder, stage.port)
    return Outcome(message, None, "FAULT BACKEND_FAILURE", f"instrument restarted, {stage.recover()}")


LONGEST_EPOCH = 2.0
"""s; see `Stage.running`."""

GAIN = 20.0


def start_emulator(system: System, folder: Path, port: str = "0") -> str:
    """Start an emulated instrument; return its port."""
    executable = Path(get_package_prefix("stressbot_driver"), "lib/stressbot_driver/instrument_emulator")
    parameters = {"scenario": SCENARIOS / "paper-six.yaml", "port": port, "amplifier_gain": GAIN}
    arguments = [item for name, value in parameters.items() for item in ("-p", f"{name}:={value}")]
    said = len(system.log("instrument_emulator")) if port != "0" else 0
    system.processes.start("instrument_emulator", [str(executable), "--ros-args", "-r", f"__ns:={system.namespace}", *arguments])
    return system.wait_for(
        lambda: re.search(r"listens on TCPIP0::127\.0\.0\.1::(\d+)::", system.log("instrument_emulator")[said:]), "the emulator"
    ).group(1)


# Two hosts


class Link:
    """A network namespace as the other host, with an address of its own and one link to this one. Needs root.

    Raises:
        subprocess.CalledProcessError: this machine does not allow it.
    """

    def __init__(self):
        self.name = f"stressbot{os.getpid()}"
        here, there = f"sb{os.getpid()}h", f"sb{os.getpid()}t"
        self._there = there
        try:
            self._ip("netns", "add", self.name)
            self._ip("link", "add", here, "type", "veth", "peer", "name", there, "netns", self.name)
            self._ip("addr", "add", "10.213.77.1/30", "dev", here)
            self._ip("link", "set", here, "up")
            self._ip("-n", self.name, "addr", "add", "10.213.77.2/30", "dev", there)
            self._ip("-n", self.name, "link", "set", "lo", "up")
            self._ip("-n", self.name, "link", "set", there, "up")
            self._ip("-n", self.name, "route", "add", "default", "dev", there)
        except BaseException:
            self.close()
            raise

    @staticmethod
    def _ip(*arguments: str) -> None:
        subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)

    def command(self, line: list[str]) -> list[str]:
        """Return the command that runs another one on the other host."""
        return ["ip", "netns", "exec", self.name, *line]

    def cut(self) -> float:
        """Pull the plug, and return when."""
        now = time.monotonic()
        self._ip("-n", self.name, "link", "set", self._there, "down")
        return now

    def heal(self) -> None:
        self._ip("-n", self.name, "link", "set", self._there, "up")
        self._ip("-n", self.name, "route", "add", "default", "dev", self._there)

    def close(self) -> None:
        with suppress(subprocess.CalledProcessError):
            self._ip("netns", "del", self.name)  # the link goes with it


def link_cut(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.link.cut(), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    assert "sequencer_status" in status.missing
    time.sleep(stage.rng.uniform(0.0, 3.0))
    stage.link.heal()
    stage.until(lambda: not stage.status.missing, "the sequencer's return")
    assert stage.status.state == DriverStatus.FAULT
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"still FAULT when healed; {stage.recover()}")


# Systems to do that to


@contextmanager
def simulated(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Three nodes and the simulated substrate."""
    parameters = {"scenario": SCENARIOS / "paper-six.yaml", "peer_timeout": PEER_TIMEOUT}
    with closing(System(folder, **parameters)) as system:
        yield Stage(system, rng, parameters)


@contextmanager
def instrument(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Sequencer, driver and an emulated generator."""
    with closing(System(folder, nodes=())) as system:
        yield _instrument(system, folder, rng)


def _instrument(system: System, folder: Path, rng: random.Random) -> Stage:
    port = start_emulator(system, folder)
    options = {
        "visa_resource": f"TCPIP0::127.0.0.1::{port}::SOCKET",
        "amplifier_gain": GAIN,
        "amplifier_max_voltage": 200.0,
        "record_folder": folder,
    }
    parameters = {"scenario": SCENARIOS / "paper-six.yaml", "peer_timeout": PEER_TIMEOUT, "backend": "waveform_generator"}
    parameters |= {f"waveform_generator.{name}": value for name, value in options.items()}
    system.start("driver", **parameters)
    system.start("sequencer")
    system.wait_for(lambda: system.client.driver_status and system.client.description, "the driver")
    stage = Stage(system, rng, parameters)
    stage.folder, stage.port = folder, port
    return stage


@contextmanager
def two_hosts(folder: Path, rng: random.Random) -> Iterator[Stage]:
    """Driver here, sequencer on another host: UDP between addresses, no shared memory."""
    local = {name: os.environ.get(name) for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTDDS_BUILTIN_TRANSPORTS")}
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    link = Link()
    try:
        with closing(System(folder, nodes=())) as system:
            parameters = {"scenario": SCENARIOS / "paper-six.yaml", "peer_timeout": PEER_TIMEOUT}
            system.start("driver", **parameters)
            line = command(ENTRIES["sequencer"], {}, namespace=system.namespace)
            system.processes.start("sequencer", link.command(line))
            system.wait_for(lambda: system.client.driver_status and system.client.description, "the driver")
            stage = Stage(system, rng, parameters)
            stage.link = link
            yield stage
    finally:
        link.close()
        for name, value in local.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)


Setting = Callable[[Path, random.Random], AbstractContextManager[Stage]]

FAULTS: dict[str, tuple[Setting, Callable[[Stage], Outcome]]] = {
    "sequencer: kill -9": (simulated, sequencer_killed),
    "sequencer: frozen, goes on": (simulated, sequencer_frozen),
    "sequencer: SIGTERM": (simulated, sequencer_ended),
    "sequencer: kill -9 before start": (simulated, sequencer_killed_before_start),
    "planner: kill -9 while a sequence runs": (simulated, planner_killed),
    "planner: kill -9 while planning": (simulated, planner_killed_while_planning),
    "two planners at once": (simulated, two_planners),
    "stop call": (simulated, stop_called),
    "driver: SIGINT": (simulated, driver_signalled(signal.SIGINT)),
    "driver: SIGTERM": (simulated, driver_signalled(signal.SIGTERM)),
    "driver: SIGHUP": (simulated, driver_signalled(signal.SIGHUP)),
    "driver: kill -9": (simulated, driver_killed),
    "driver: frozen for 0.5 s": (simulated, driver_frozen),
    "plan doubled, and again after its end": (simulated, doubled_plan),
    "plan doubled while it runs": (simulated, doubled_plan_while_running),
    "plans reordered: an older one after a newer one ran": (simulated, reordered_plans),
    "hostile sequences past the sequencer": (simulated, hostile_sequences),
    "instrument: disk full while recording": (instrument, recording_disk_full),
    "instrument: driver kill -9": (instrument, driver_killed_at_an_instrument),
    "instrument: kill -9": (instrument, instrument_killed),
    "two hosts: link cut and healed": (two_hosts, link_cut),
}
"""Each with the system that it happens to, which it leaves as it found it."""


def campaign(names: list[str], repeats: int, seed: int) -> list[dict]:
    """Let faults happen, `repeats` times each; return what came of each, in order. A system that breaks is made anew."""
    results = []
    setting, stage = None, None
    with TemporaryDirectory() as folder, ExitStack() as stack:
        for number, name in enumerate(name for name in names for _ in range(repeats)):
            needed, fault = FAULTS[name]
            rng = random.Random(f"{seed} {number}")
            try:
                if setting is not needed:
                    stack.close()
                    logs = Path(folder, str(number))
                    logs.mkdir()
                    setting, stage = needed, stack.enter_context(needed(logs, rng))
                stage.rng = rng
                outcome = {"fault": name, "documented": True, **asdict(fault(stage)), "false_alarms": stage.false_alarms}
                stage.false_alarms = 0
            except Exception as error:
                outcome = {"fault": name, "documented": False, "error": f"{error!r}", "traceback": traceback.format_exc()}
                setting = None
            print(f"{name}: {_told(outcome)}", flush=True)
            results.append(outcome)
    return results


def _told(outcome: dict) -> str:
    if not outcome["documented"]:
        return f"NOT DOCUMENTED: {outcome['error']}"
    zero = "" if outcome["zero"] is None else f", zero volts after {1e3 * outcome['zero']:.0f} ms"
    return f"{outcome['state']}{zero}; {outcome['recovered']}"


def table(results: list[dict]) -> Table:
    """One row a fault."""
    rows = []
    for name in dict.fromkeys(outcome["fault"] for outcome in results):
        mine = [outcome for outcome in results if outcome["fault"] == name]
        good = [outcome for outcome in mine if outcome["documented"]]
        zeros = [1e3 * outcome["zero"] for outcome in good if outcome["zero"] is not None]
        told = good[-1] if good else {"seen": mine[0]["error"], "state": "?", "recovered": "?"}
        zero = f"{np.median(zeros):.0f} ({max(zeros):.0f})" if zeros else "–"
        rows.append((name, f"{len(good)}/{len(mine)}", told["seen"].replace("|", "/"), zero, told["state"], told["recovered"]))
    header = ("fault", "documented", "what the user sees", "zero volts (ms): median (max)", "state", "after recovery")
    note = (
        "- Each at random moments of a run. Zero volts: from the fault to the arrival, in another process, of the driver_status "
        "that says so; –: nothing has to stop, or the driver cannot say so.\n"
        "- After kill -9 of the driver the simulated substrate is gone with it; at an instrument, zero volts come with the end "
        "of the epoch."
    )
    return Table("Faults", header, tuple(rows), note)


def main() -> int:
    """Let all faults happen, or those asked for; return 1 if one ended undocumented, or zero volts came too late."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("faults", nargs="*", metavar="FAULT", help="part of a name (default: all)")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="times each (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the random moments (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=ROOT / "results", metavar="FOLDER", help="for faults.md and faults.json")
    options = parser.parse_args()
    names = [name for name in FAULTS if not options.faults or any(part in name for part in options.faults)]
    if not names:
        parser.error(f"no such fault: use parts of {'; '.join(FAULTS)}")
    if os.geteuid() != 0 or not shutil.which("ip"):
        print("not tried, since two hosts on one machine need root and ip:", *(n for n in names if FAULTS[n][0] is two_hosts))
        names = [name for name in names if FAULTS[name][0] is not two_hosts]
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 101)))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    results = campaign(names, options.repeats, options.seed)
    text = table(results).markdown()
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "faults.md").write_text(text, encoding="utf-8")
    (options.output / "faults.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    good = sum(outcome["documented"] for outcome in results)
    worst = max((outcome["zero"] for outcome in results if outcome.get("zero") is not None), default=0.0)
    print("\n" + text)
    alarms = sum(outcome.get("false_alarms", 0) for outcome in results)
    print(f"{alarms} times a living sequencer seemed lost for {PEER_TIMEOUT:g} s (load of this machine: {os.getloadavg()[1]:.1f})")
    print(f"faults: {good}/{len(results)} ended in a documented state, worst time to zero volts {1e3 * worst:.0f} ms")
    return 0 if good == len(results) and worst <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
