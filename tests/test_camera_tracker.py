"""Six robots, a simulated microscope and the tracker: the loop is closed through pictures alone; without them it stops."""

import subprocess

import numpy as np
import pytest
from filmed import filmed, moved
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus
from system_rig import DEADLINE, ENTRIES

from stressbot_planner.ros import conversion
from stressbot_planner.ros.bringup import BENCH, command

pytestmark = pytest.mark.timing  # a loop through pictures is as good as their times, which a busy machine tells late

TOLERANCE = 3e-5
FLAWS = {"seed": 3, "speed_error": 0.03, "heading_bias": 0.087, "heading_noise": 0.035}


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    flaws = {f"imperfections.{name}": value for name, value in FLAWS.items()}
    optics = {"drift_x": 3e-7, "drift_y": -2e-7, "wander": 2e-7, "latency": 0.02}
    system = filmed(new_system(nodes=()), tmp_path_factory.mktemp("scenario"), {"pose_timeout": 2.0, **flaws}, optics, {})
    system.start("mover")
    system.wait_for(lambda: system.client.poses, "poses from pictures")
    system.actions = ActionClient(system.client.node, MoveSwarm, "move_swarm")
    system.wait_for(system.actions.server_is_ready, "mover")
    system.wait_for(system.is_known_to_mover(system.actions), "first answer of the mover")
    system.camera = AsyncParameterClient(system.client.node, "simulated_camera")
    system.wait_for(system.camera.services_are_ready, "parameters of the camera")
    return system


def true_poses(system):
    message = system.truth[-1]
    return conversion.measured_poses(message, conversion.scene_from_description(system.client.description))


def set_camera(system, **values):
    changes = [Parameter(name, value=value) for name, value in values.items()]
    answer = system.asked(lambda: system.camera.set_parameters(changes))
    system.wait_for(answer.done, "parameters")
    assert all(result.successful for result in answer.result().results)


def test_poses_are_those_of_the_robots(system):
    system.wait_for(lambda: system.truth and len(system.client.poses[-1].ids) == 6, "all robots")
    scene = conversion.scene_from_description(system.client.description)
    told = conversion.measured_poses(system.client.poses[-1], scene)
    off = told - true_poses(system)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.1 * 0.3
    assert np.abs(off[:, 2]).max() < 0.1


def test_six_robots_reach_their_goals_by_what_the_camera_shows(system):
    result = moved(system, TOLERANCE)
    assert result.success, result.error_msg
    goals = conversion.scene_from_description(system.client.description).goals
    assert np.hypot(*(true_poses(system)[:, :2] - goals).T).max() <= TOLERANCE / 1e-4 + 0.03


@pytest.mark.parametrize(
    ("fault", "mended", "word"),
    [
        ({"frozen": True}, {"frozen": False}, "frozen"),
        ({"lamp": 0.0}, {"lamp": 150.0}, "is the light on"),
        ({"lost": 1.0}, {"lost": 0.0}, "no picture has come"),
    ],
)
def test_without_pictures_there_are_no_poses_and_nothing_runs(system, fault, mended, word):
    before = system.log("camera_tracker").count(word)
    set_camera(system, **fault)
    system.wait_for(lambda: system.log("camera_tracker").count(word) > before, "a word of the tracker")
    system.wait_for(lambda: "swarm_poses" in system.client.driver_status.missing, "loss of the poses")
    system.client.forget_poses()
    status = system.client.driver_status
    assert status.state != DriverStatus.RUNNING and status.output_level == 0.0
    assert not system.client.poses
    set_camera(system, **mended)
    system.wait_for(lambda: any(len(message.ids) == 6 for message in system.client.poses), "poses again")
    system.wait_for(lambda: not system.client.driver_status.missing, "nothing missing any more")


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({}, "camera: is not set"),
        ({"camera": "/none/camera.yaml"}, "camera: /none/camera.yaml cannot be read"),
        ({"camera": BENCH, "start": "here"}, "start: is 'here': give known or unknown"),
        ({"camera": BENCH, "speed": 1.0}, "speed: is no parameter of this node"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(parameters, said):
    done = subprocess.run(command(ENTRIES["camera_tracker"], parameters), capture_output=True, text=True, timeout=DEADLINE)
    assert done.returncode == 2
    assert done.stderr.startswith(f"camera_tracker: {said}") and done.stderr.count("\n") == 1
