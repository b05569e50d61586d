"""The recognise command against running nodes: a tracker that knows nobody knows everybody, by pictures alone."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from filmed import filmed
from system_rig import DEADLINE

from stressbot_planner.ros import conversion
from stressbot_planner.system.streams import FAILED, SOLVED

COMMAND = Path(get_package_prefix("stressbot_planner"), "lib/stressbot_planner/recognise")

pytestmark = pytest.mark.timing  # a loop through pictures is as good as their times, which a busy machine tells late


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    system = filmed(new_system(nodes=()), tmp_path_factory.mktemp("scenario"), {}, {}, {"start": "unknown"})
    system.wait_for(lambda: system.truth, "true poses")
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
