"""The running driver node, in a process of its own, asked from this one over DDS: does it keep time?

The driver that is measured writes down when each level reaches the substrate. Nothing else of it is changed.

    python benchmarks/driver_node.py serve LOG.json --ros-args …     is that driver
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from stressbot_msgs import lifeline

from stressbot_planner.reproduce.tables import Table

SIZES = (6, 1022)
EPOCHS, DRIVE = 80, 0.05
"""Activations of the sequence that is timed, and how long each drives, s."""

POSE_RATE = 50.0
STOPS = 10

LARGEST_DELAY = 2e-3
"""The ninety-ninth percentile of epochs may end this late, s."""


def tables() -> list[Table]:
    """Return when levels and poses came, and how long a stop took, for small and large swarms."""
    rows = [_measure(n) for n in SIZES]
    header = (
        "robots", "levels late (ms): p50", "p99", "max", "epochs late (ms): p99",
        f"poses at {POSE_RATE:g} Hz: wanted", "missing", "stop (ms): p50", "max",
    )
    note = (
        f"- {EPOCHS} epochs in real time; wanted: 99 of 100 at most {1e3 * LARGEST_DELAY:g} ms late, no pose missing.\n"
        "- Stop: from the call of the service to the status that says so, heard in another process."
    )
    return [Table("The running driver node", header, tuple(rows), note)]


def _measure(n: int) -> tuple[str, ...]:
    from driver_support import bench, encode, scenario_text
    from node_rig import NodeRig
    from stressbot_msgs.msg import DriverStatus

    described = bench(n)
    sequence = encode(described, [(1 + k % described.group_count, DRIVE) for k in range(EPOCHS)])
    rig = NodeRig()
    with tempfile.TemporaryDirectory() as folder:
        scenario, log = Path(folder) / "scenario.yaml", Path(folder) / "log.json"
        scenario.write_text(scenario_text(n), encoding="utf-8")
        command = [sys.executable, __file__, "serve", str(log), "--ros-args", "--log-level", "warn", "-r", f"__ns:={rig.namespace}"]
        for name, value in {"scenario": scenario, "auto_start": "true", "pose_rate": POSE_RATE}.items():
            command += ["-p", f"{name}:={value}"]
        process = subprocess.Popen(command, env=os.environ | lifeline.environment() | {"ROS_DOMAIN_ID": str(rig.domain)})
        rig.processes.append(process)
        try:
            rig.wait(lambda: rig.descriptions and rig.statuses, "the description")
            rig.wait(rig.publisher.get_subscription_count, "the match of voltage_sequence")
            rig.wait(lambda: not rig.statuses[-1].missing, "the driver's sight of the sequencer")
            rig.send(sequence)
            done = rig.state(DriverStatus.DONE)
            rig.wait(lambda: rig.poses[-1].sequence_time == done.sequence_time, "the last pose")
            heard = {round(pose.sequence_time * POSE_RATE, 6) for pose in rig.poses}
            wanted = range(1, int(sequence.duration * POSE_RATE))
            missing = sum(k not in heard for k in wanted)
            stops = [_stop(rig, encode(described, [(described.group_count, 600.0)])) for _ in range(STOPS)]
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=30)
            applied = np.array(json.loads(log.read_text(encoding="utf-8"))[1:])  # the first is the rest level of its start
        finally:
            rig.close()
    late = applied[: len(sequence.levels) + 1] - applied[0] - np.concatenate([[0.0], np.cumsum(sequence.dwells)])
    levels, epochs = 1e3 * np.percentile(late, [50, 99, 100]), 1e3 * np.percentile(late[sequence.epoch_ends], 99)
    return (
        str(n), *(f"{value:.2f}" for value in levels), f"{epochs:.2f}", str(len(wanted)), str(missing),
        f"{1e3 * np.median(stops):.0f}", f"{1e3 * max(stops):.0f}",
    )


def _stop(rig, sequence) -> float:
    """Let a long drive begin, stop it, and return how long that took, s."""
    from std_srvs.srv import Trigger
    from stressbot_msgs.msg import DriverStatus

    rig.call("reset")
    rig.send(sequence)
    rig.state(DriverStatus.RUNNING)
    client = rig.node.create_client(Trigger, "stop")
    client.wait_for_service(30.0)
    begin = time.monotonic()
    client.call(Trigger.Request(), timeout_sec=30.0)
    rig.state(DriverStatus.STOPPED)
    rig.node.destroy_client(client)
    return rig.times[-1] - begin


def serve(log: Path, arguments: list[str]) -> int:
    """Be the driver, and write down the times, s, at which levels reached the substrate from its start on."""
    from stressbot_msgs.process import run

    from stressbot_driver.ros.driver_node import DriverNode
    from stressbot_driver.simulation.substrate import Substrate

    times: list[float] = []
    apply = Substrate.apply

    def noted(substrate, level):
        times.append(time.monotonic())
        apply(substrate, level)

    Substrate.apply = noted
    code = run("driver", DriverNode, arguments)
    log.write_text(json.dumps(times), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(serve(Path(sys.argv[2]), sys.argv[3:]))
