"""A system under test: node processes, a client, and what one does with them. Everything waits on conditions."""

import math
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus
from stressbot_msgs.srv import PlanMotion

from stressbot_planner.ros import conversion
from stressbot_planner.ros.bringup import NODES, command
from stressbot_planner.ros.child_processes import ChildProcesses
from stressbot_planner.ros.client import SwarmClient

SCENARIOS = Path(__file__).parents[2] / "scenarios"

NEAR = 1e-6 + 5 * 1.2e-4
"""Of a goal of the shipped scenarios, units: exact, but for five pulses."""

DEADLINE = 120.0
"""For anything that should happen soon, s, on however busy a machine."""

TIMEOUTS = {"peer_timeout": 2.0, "gate_timeout": 2.0}
"""A busy machine is no reason for a test to fail, s: what the defaults do is for `make faults` to show."""

RESEND = 5.0
"""s after which what a server may have lost, since it did not know its client yet, is asked for again."""

ENTRIES = {entry.executable: entry for entry in NODES}


class System:
    """Nodes in a namespace of their own.

    Attributes:
        client: hears and calls everything.
        processes: by name of the executable.
    """

    def __init__(self, folder: Path, nodes=("driver", "sequencer", "planner"), **driver_parameters):
        self.namespace = f"/test_{random.getrandbits(48):x}"
        self.processes = ChildProcesses(folder, {**os.environ, "ROS_LOG_DIR": str(folder)})
        self.client = SwarmClient("test_client", self.namespace)
        self._ordered = ""  # plan whose sequence will reach the driver
        try:
            for name in nodes:
                self.start(name, **(driver_parameters if name == "driver" else {}))
            if {"driver", "sequencer", "planner"} <= set(nodes):
                self.wait_for(self.client.is_system_ready, "all nodes")
            elif "driver" in nodes:
                self.wait_for(lambda: self.client.has_met("driver"), "driver")
        except BaseException:
            self.close()
            raise

    def close(self):
        self.processes.close()
        self.client.close()

    def start(self, name, *arguments, **parameters):
        """Start a node; its parameters as keywords."""
        if name == "driver":
            parameters = TIMEOUTS | parameters
        return self.processes.start(name, [*command(ENTRIES[name], parameters, namespace=self.namespace), *arguments])

    def log(self, name):
        return self.processes.log(name).read_text()

    def wait_for(self, condition, what, timeout=DEADLINE):
        try:
            return self.client.wait_for(condition, timeout, what, self._alive)
        except TimeoutError as error:
            raise TimeoutError(f"{error}; {self.client.driver_status}; {self.client.sequencer_status}") from None

    def _alive(self):
        for name in self.processes.ended():
            raise AssertionError(f"{name} ended: {self.log(name)}")

    def asked(self, request):
        """Do something on the client's own thread, see `SwarmClient.asked`."""
        return self.client.asked(request, DEADLINE)

    def is_known_to_mover(self, actions):
        """Return a condition: the mover has answered this client of its action."""
        answers = []

        def ask():
            answers.append(self.asked(lambda: actions.send_goal_async(MoveSwarm.Goal(tolerance=0.0))))

        return asking_again(ask, lambda: any(answer.done() for answer in answers))

    def plan(self, timeout=DEADLINE, **request):
        """Call plan_motion."""
        return self.expected(self.client.call("plan_motion", PlanMotion.Request(**request), timeout, self._alive))

    def expected(self, answer):
        """Return an answer whose plan will reach the driver, if it is one, before `reset` is called."""
        if answer.success and answer.plan.primitives:
            self._ordered = answer.plan.plan_id
        return answer

    def wait_until_loaded(self, plan_id):
        def loaded():
            sequencer, driver = self.client.sequencer_status, self.client.driver_status
            assert not (sequencer.plan_id == plan_id and sequencer.error_code), sequencer.error_msg
            return driver.plan_id == plan_id and driver.state == DriverStatus.LOADED

        self.wait_for(loaded, "loading")

    def execute(self, plan):
        """Put a plan on the substrate and return the poses after its end, (n, 3) in units, and the scene."""
        scene = conversion.scene_from_description(self.client.description)
        if plan.primitives:
            self.wait_until_loaded(plan.plan_id)
            answer = self.client.trigger("start")
            assert answer.success, answer.message
            self.wait_for(self.has_reached(DriverStatus.DONE, plan.plan_id), "end of the sequence", 3 * DEADLINE)
        return self.poses_after(self.client.driver_status.header.stamp), scene

    def reset(self):
        """Put the robots back to their starts and forget every sequence, one that is still on its way too."""
        if self._ordered:
            self.wait_for(lambda: self.client.driver_status.plan_id == self._ordered, "the last sequence")
        self._ordered = ""
        answer = self.client.trigger("reset")
        assert answer.success, answer.message
        self.wait_for(lambda: self.client.driver_status.state == DriverStatus.IDLE, "reset")

    def has_reached(self, state, plan_id):
        return lambda: (self.client.driver_status.state, self.client.driver_status.plan_id) == (state, plan_id)

    def poses_after(self, stamp):
        """Return poses (n, 3), units, measured after a time."""
        moment = (stamp.sec, stamp.nanosec)

        def newer():
            last = self.client.poses[-1]
            return (last.header.stamp.sec, last.header.stamp.nanosec) >= moment and last

        message = self.wait_for(newer, "poses")
        self.client.forget_poses()
        return conversion.starts_from_poses(message, conversion.scene_from_description(self.client.description))


def asking_again(ask: Callable[[], object], holds: Callable[[], object], every: float = RESEND) -> Callable[[], object]:
    """Return a condition that asks for something each few seconds until it holds."""
    asked_at = -math.inf

    def condition():
        nonlocal asked_at
        if time.monotonic() > asked_at + every:
            asked_at = time.monotonic()
            ask()
        return holds()

    return condition


def largest_error(poses, predicted):
    """Return the largest distance (units) or turn (rad) between poses (n, 3)."""
    turned = poses[:, 2] - predicted[:, 2]
    return max(np.hypot(*(poses - predicted)[:, :2].T).max(), np.abs(np.arctan2(np.sin(turned), np.cos(turned))).max())
