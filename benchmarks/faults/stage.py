"""A running system to which faults happen: what it says, what it is told, and how it gets going again."""

import os
import random
import signal
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from rclpy.duration import Duration
from std_srvs.srv import Trigger
from stressbot_msgs.msg import DriverStatus, ErrorCode, MotionPlan, Primitive, SwarmPoses, VoltageSequence
from stressbot_msgs.srv import PlanMotion
from system_rig import ENTRIES, System, asking_again

from stressbot_planner.ros.bringup import command
from stressbot_planner.ros.qos import LATCHED, ORDERS

UNIT = 1e-4  # m
STATES = {getattr(DriverStatus, name): name for name in ("IDLE", "LOADED", "RUNNING", "DONE", "STOPPED", "FAULT")}
PATIENCE = 120.0
ENDS = (DriverStatus.DONE, DriverStatus.FAULT)
MOST_FALSE_ALARMS = 20
RESEND = 1.0
"""s"""

WORK = 10
"""Ticks of the processor, which are 0.01 s on Linux."""


@dataclass(frozen=True)
class Start:
    """How a node is started: its parameters, a command before its own, and remappings as `from:=to`."""

    parameters: dict = field(default_factory=dict)
    prefix: tuple[str, ...] = ()
    remaps: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came of one fault: what the user saw, s to zero volts (None: nothing had to stop), the state, and that it runs again."""

    seen: str
    zero: float | None
    state: str
    recovered: str


class Stage:
    """A running system, with every driver status that was heard and when, s.

    Attributes:
        ahead: of the clock of this process, s, is the clock of those who plan.
        false_alarms: how often the driver took a living sequencer for lost.
        moved: when robots were last seen somewhere else than before.
    """

    def __init__(self, system: System, rng: random.Random, starts: dict[str, Start]):
        """Start nodes, in this order, and wait until they know each other."""
        self.system, self.rng, self._starts = system, rng, starts
        self.heard: list[tuple[float, DriverStatus]] = []
        self.ahead = self.moved = 0.0
        self.false_alarms = 0
        self._poses: SwarmPoses | None = None
        for name in starts:
            self.start(name)
        client = system.client
        known = client.is_system_ready if "planner" in starts else lambda: client.driver_status and client.description
        system.wait_for(known, "the nodes")
        self.node = client.node
        self.node.create_subscription(DriverStatus, "driver_status", self._hear, LATCHED)
        self.node.create_subscription(SwarmPoses, "swarm_poses", self._see, 50)
        self.plans = self.node.create_publisher(MotionPlan, "motion_plan", ORDERS)
        self.sequences = self.node.create_publisher(VoltageSequence, "voltage_sequence", ORDERS)
        self.until(lambda: self.heard and self.plans.get_subscription_count() and self.sequences.get_subscription_count())

    def _hear(self, message: DriverStatus) -> None:
        if message.state in STATES:  # else it is somebody's flood
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

    def rested(self, since: float) -> float:
        """Return how long after `since`, s, the substrate saw its last volts end: a sequence rests now and then by itself."""
        levels = self.watch.levels()
        last = max(index for index, (_, level) in enumerate(levels) if level)
        return self.until(lambda: self.watch.levels()[last + 1 :], "rest")[0][0] - since

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

    def children(self, name: str) -> list[int]:
        """Return the processes that a node has started."""
        tasks = Path(f"/proc/{self.pid(name)}/task").glob("*/children")
        children = [int(child) for task in tasks for child in task.read_text().split()]
        assert children, f"{name} has no process of its own"
        return children

    def kill_children(self, name: str) -> None:
        for child in self.children(name):
            os.kill(child, signal.SIGKILL)

    def wait_for_work(self, name: str) -> None:
        """Wait until the processes that a node has started use the processor."""

        def ticks() -> int:
            spent = (Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split() for child in self.children(name))
            return sum(int(fields[11]) + int(fields[12]) for fields in spent)

        before = ticks()
        self.until(lambda: ticks() > before + WORK, f"work of {name}")

    def start(self, name: str) -> None:
        start = self._starts[name]
        line = command(ENTRIES[name], start.parameters, namespace=self.system.namespace)
        remaps = [item for remap in start.remaps for item in ("-r", remap)]
        self.system.processes.start(name, [*start.prefix, *line, *remaps])

    def plan(self, lengths, stamp=None, **fields) -> MotionPlan:
        """A plan of activations of random groups, lengths in units; made from poses measured now."""
        groups = [self.rng.randint(1, 4) for _ in lengths]
        steps = [
            Primitive(kind=Primitive.ACTIVATE, group=group, distance=float(length) * UNIT)
            for group, length in zip(groups, lengths, strict=True)
        ]
        description = self.until(lambda: self.system.client.description, "the description")
        values = {"plan_id": uuid.uuid4().hex, "swarm_id": description.swarm_id, "planner": "faults"}
        message = MotionPlan(**{**values, "primitives": steps, **fields})
        message.header.stamp = stamp or (self.node.get_clock().now() + Duration(seconds=self.ahead)).to_msg()
        return message

    def loaded(self, plan: MotionPlan) -> None:
        """Publish a plan until the driver has loaded it: a node that has just started may not have met us yet."""

        def known() -> bool:
            return (self.status.plan_id, self.status.state) == (plan.plan_id, DriverStatus.LOADED)

        self.until(asking_again(lambda: self.plans.publish(plan), known, RESEND), "loading")

    def call(self, service: str) -> Trigger.Response:
        return self.system.client.trigger(service, PATIENCE)

    def meet_driver(self) -> None:
        """Call until a driver that has just started answers: the first answer is lost if it does not know its client yet."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                self.system.client.trigger("stop", RESEND)
                return
            except TimeoutError:
                if time.monotonic() > deadline:
                    raise

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
        """Return whether a living sequencer or driver was taken for lost, and reset then."""
        if self.status.state != DriverStatus.FAULT or self.status.error_code not in (ErrorCode.PEER_LOST, ErrorCode.NO_HEARTBEAT):
            return False
        self.false_alarms += 1
        assert self.false_alarms < MOST_FALSE_ALARMS, "this machine is too busy: raise peer_timeout and gate_timeout"
        assert self.call("reset").success
        return True

    def recover(self) -> str:
        """Reset, and run a short sequence to its end."""
        self.until(lambda: not self.status.missing, "the driver's sight of the sequencer")
        answer = self.call("reset")
        assert answer.success, answer.message
        return f"reset, {self.short_run()}"

    def refused_plan(self, code: int) -> str:
        """Ask for plans until one is refused with this code, and return the sentence."""
        deadline = time.monotonic() + PATIENCE
        while (answer := self.system.plan(first=True)).error_code != code:
            assert time.monotonic() < deadline, f"{answer.error_code} {answer.error_msg}"
        return answer.error_msg

    def planned(self) -> None:
        """Ask for a plan until the planner answers, and wait for its sequence: a dead server stays listed for some 20 s."""
        service = self.system.client._services["plan_motion"]
        deadline = time.monotonic() + PATIENCE
        while True:
            asked = service.call_async(PlanMotion.Request(first=True))
            try:
                self.until(asked.done, "the plan", 5.0)
                if asked.result().error_code != ErrorCode.BUSY:  # with the request before this one
                    break
                time.sleep(0.1)
                assert time.monotonic() < deadline, asked.result().error_msg
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
