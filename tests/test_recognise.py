"""The recognise command against running nodes: a tracker that knows nobody knows everybody, by pictures alone."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from stressbot_msgs.msg import SwarmPoses
from system_rig import DEADLINE

from stressbot_planner.ros import conversion
from stressbot_planner.ros.bringup import BENCH
from stressbot_planner.system.streams import FAILED, SOLVED

COMMAND = Path(get_package_prefix("stressbot_planner"), "lib/stressbot_planner/recognise")

pytestmark = pytest.mark.timing  # a loop through pictures is as good as their times, which a busy machine tells late

SIX = """
name: strangers
length_unit: 1.0e-4
workspace: {x: [0, 12], y: [0, 12]}
swarm: {speed: 1.0, turning_radius: 0.5, body_radius: 0.3, groups: binary}
robots:
  - {start: [2, 2, 0], goal: [3.5, 2.5]}
  - {start: [2, 6, 0], goal: [3.5, 6]}
  - {start: [2, 10, 0], goal: [3.5, 9.5]}
  - {start: [8, 2, 3], goal: [7, 3.5]}
  - {start: [8, 6, 3], goal: [7, 7]}
  - {start: [8, 10, 3], goal: [6.5, 10]}
electrical: {drive: pulses}
"""


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "six.yaml"
    path.write_text(SIX)
    system = new_system(nodes=())
    system.truth = []
    system.client.node.create_subscription(SwarmPoses, "true_poses", system.truth.append, 50)
    system.start("driver", tracked=True, scenario=path, real_time_factor=1.0)
    system.start("sequencer")
    system.start("simulated_camera", camera=BENCH, rate=15.0, lost=0.05)
    system.start("camera_tracker", camera=BENCH, start="unknown")
    system.wait_for(lambda: system.client.has_met("driver") and system.truth, "driver")
    return system


def recognise(system):
    command = [COMMAND, "--ros-args", "-r", f"__ns:={system.namespace}"]
    return subprocess.run(command, capture_output=True, text=True, timeout=3 * DEADLINE)


def test_nobody_is_known_then_everybody_where_they_are(system):
    assert not system.client.poses
    done = recognise(system)
    assert (done.returncode, done.stderr) == (SOLVED, ""), done.stdout + done.stderr
    assert "all robots are known after" in done.stdout.splitlines()[-1]
    system.wait_for(lambda: system.client.poses and len(system.client.poses[-1].ids) == 6, "all robots")
    scene = conversion.scene_from_description(system.client.description)
    told, true = (conversion.measured_poses(messages[-1], scene) for messages in (system.client.poses, system.truth))
    assert np.hypot(*(told - true)[:, :2].T).max() < 0.5 * 0.3


def test_without_a_bench_it_says_what_is_missing(new_system):
    done = recognise(new_system(nodes=()))
    assert done.returncode == FAILED and done.stderr.count("\n") == 1
    assert done.stderr.startswith("recognise: ") and "driver" in done.stderr
