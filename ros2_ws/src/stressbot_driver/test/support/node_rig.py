"""The driver as a process of its own, and a client node in this one, over real DDS."""

import os
import random
import signal
import subprocess
import sys
import threading
import time

import rclpy
from driver_support import DEADLINE
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import Trigger
from stressbot_msgs import lifeline
from stressbot_msgs.domains import reserve
from stressbot_msgs.msg import DriverStatus, SequencerStatus, SwarmDescription, SwarmPoses, VoltageSequence

from stressbot_driver.ros.conversions import doubles
from stressbot_driver.ros.qos import LATCHED, POSES, living

# A busy machine is no reason for a test to fail: what the defaults do is for `make faults` to show.
TIMEOUTS = {"peer_timeout": 2.0, "gate_timeout": 2.0}


_KEPT: list[Node] = []


class NodeRig:
    """A client with everything that it has heard, and processes that it started. `wait` waits on conditions."""

    def __init__(self):
        # A name space of its own besides the domain: somebody may be there who has reserved none.
        self.namespace = f"/test_{random.getrandbits(48):x}"
        self.domain, self._hold = reserve()
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=self.domain)
        self.node = Node("client", context=self.context, namespace=self.namespace, enable_rosout=False)
        self.heard = threading.Condition()
        self.descriptions, self.poses, self.statuses, self.times = [], [], [], []
        self.node.create_subscription(SwarmDescription, "swarm_description", self._keep(self.descriptions), LATCHED)
        self.node.create_subscription(SwarmPoses, "swarm_poses", self._keep(self.poses), POSES)
        self.node.create_subscription(DriverStatus, "driver_status", self._keep_status, LATCHED)
        self.publisher = self.node.create_publisher(VoltageSequence, "voltage_sequence", 10)
        # The rig sends the volts, so it must show life as a sequencer does.
        self.life = self.node.create_publisher(SequencerStatus, "sequencer_status", living(0.03))
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="client")
        self._thread.start()
        self.processes = []
        self._parameters = AsyncParameterClient(self.node, "driver")
        self._clients = {name: self.node.create_client(Trigger, name) for name in ("start", "stop", "reset")}

    def _keep(self, messages):
        def keep(message):
            with self.heard:
                messages.append(message)
                self.heard.notify_all()

        return keep

    def _keep_status(self, message):
        with self.heard:
            self.statuses.append(message)
            self.times.append(time.monotonic())
            self.heard.notify_all()

    def wait(self, condition, what):
        """Wait until `condition()` is true, looking again whenever something is heard."""
        limit = time.monotonic() + DEADLINE
        with self.heard:
            while not (value := condition()):
                assert time.monotonic() < limit, f"{what} did not happen within {DEADLINE} s; {self.statuses[-1:]}"
                self.heard.wait(0.02)
            return value

    def start(self, executable, *arguments, code=None, **parameters):
        """Start a node's process, or the code that stands for it; its parameters as keywords."""
        code = code or f"from stressbot_driver.ros.{executable}_node import main; main()"
        if executable == "driver":
            parameters = TIMEOUTS | parameters
        command = [sys.executable, "-c", code, "--ros-args", "-r", f"__ns:={self.namespace}", *arguments]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
        environment = os.environ | lifeline.environment() | {"ROS_DOMAIN_ID": str(self.domain)}
        process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        self.processes.append(process)
        return process

    def start_driver(self, scenario, **parameters):
        """Start a driver and wait until everything of it has been found."""
        process = self.start("driver", scenario=scenario, **parameters)
        self.wait(lambda: process.poll() is not None or (self.descriptions and self.statuses), "the description")
        assert process.poll() is None, process.stderr.read()
        self.wait(self.publisher.get_subscription_count, "the match of voltage_sequence")
        self.wait(lambda: "sequencer_status" not in self.statuses[-1].missing, "the driver's sight of this rig")
        self.wait(self._parameters.services_are_ready, "the match of the parameter services")
        for name, client in self._clients.items():
            self.wait(client.service_is_ready, f"the match of {name}")
        return process

    def send(self, sequence):
        message = VoltageSequence(
            plan_id=sequence.plan_id,
            swarm_id=sequence.swarm_id,
            levels=doubles(sequence.levels),
            dwells=doubles(sequence.dwells),
            epoch_ends=[int(end) for end in sequence.epoch_ends],
            duration=sequence.duration,
        )
        self.publisher.publish(message)

    def status(self, condition, what):
        """The first status from now on, or the last one before, that fulfils a condition."""
        position = max(len(self.statuses) - 1, 0)
        return self.wait(lambda: next(filter(condition, self.statuses[position:]), None), what)

    def state(self, state):
        return self.status(lambda status: status.state == state, f"state {state}")

    def call(self, service):
        return self._clients[service].call(Trigger.Request(), timeout_sec=DEADLINE)

    def set_parameters(self, parameters):
        """Results of setting parameters of the driver, in order."""
        future = self._parameters.set_parameters(parameters)
        self.wait(future.done, "the answer to set_parameters")
        return future.result().results

    def end(self, process, number=signal.SIGTERM):
        """Send a signal and wait for the end: (exit code, stderr)."""
        process.send_signal(number)
        return self.ended(process)

    def ended(self, process):
        _, errors = process.communicate(timeout=DEADLINE)
        return process.returncode, errors

    def _spin(self):
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        except Exception:  # ROS going down under its feet shows as one of many errors
            if self.context.ok():
                raise

    def close(self):
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.communicate()
        # The context first: shutting the executor down would destroy what its thread still waits on. The node is
        # kept, since to destroy one of many in a process crashes rclpy 7.1 now and then (in rcl's node clean-up).
        self.context.try_shutdown()
        self._thread.join()
        _KEPT.append(self.node)
        self._hold.close()
