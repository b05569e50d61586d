"""`stressbot status|start|stop|reset|move` against running nodes: what an operator sees and does from a terminal."""

import json
import signal
import subprocess
from pathlib import Path

import pytest
from stressbot_msgs.msg import DriverStatus
from system_rig import DEADLINE
from three_robots import SCENARIO

from stressbot_planner.ros import conversion

STRESSBOT = Path(__file__).parents[1] / ".venv/bin/stressbot"


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(SCENARIO)
    system = new_system(nodes=("driver", "sequencer", "planner", "mover"), scenario=path, real_time_factor=10.0)
    system.wait_for(lambda: system.client.node.count_services("move_swarm/_action/send_goal"), "mover")
    return system


def words(system, *arguments):
    return [str(word) for word in (STRESSBOT, *arguments, "--namespace", system.namespace, "--timeout", DEADLINE)]


def operate(system, *arguments):
    done = subprocess.run(words(system, *arguments), capture_output=True, text=True, check=False, timeout=3 * DEADLINE)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_status_says_what_the_driver_does_and_where_robots_are(system):
    done = operate(system, "status")
    assert done.returncode == 0, done.stderr
    assert "driver:         IDLE (simulated substrate)" in done.stdout and "three: 3 robots, 3 of them seen" in done.stdout
    assert " 2   200.00  600.00   0.000" in done.stdout
    told = json.loads(operate(system, "status", "--json").stdout)
    assert (told["state"], told["output_level"], told["sequencer"]) == ("IDLE", 0.0, "ready")
    assert [(robot["id"], round(1e6 * robot["y"])) for robot in told["robots"]] == [(1, 200), (2, 600), (3, 1000)]


def test_a_plan_is_started_stopped_and_reset(system):
    refused = operate(system, "start", "--json")
    assert refused.returncode == 1 and not json.loads(refused.stdout)["success"] and "start: " in refused.stderr
    answer = system.plan(first=True)
    system.wait_until_loaded(answer.plan.plan_id)
    assert operate(system, "start").returncode == 0
    told = json.loads(operate(system, "stop", "--json").stdout)
    assert told["success"]
    assert system.client.driver_status.state in (DriverStatus.STOPPED, DriverStatus.DONE)
    assert system.client.driver_status.output_level == 0.0
    assert operate(system, "reset").returncode == 0
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.IDLE, "reset")


def test_robots_are_moved_and_the_errors_are_those_measured(system):
    done = operate(system, "move", "--goal", 1, 300, 300, "--goal", 3, 300, 1000, "--tolerance", 20, "--json")
    told = json.loads(done.stdout)
    assert done.returncode == 0 and told["success"] and max(told["errors"]) <= 20e-6
    system.client.forget_poses()
    system.wait_for(lambda: system.client.poses, "poses")
    scene = conversion.scene_from_description(system.client.description)
    poses = conversion.starts_from_poses(system.client.poses[-1], scene)
    assert abs(poses[[0, 2], :2] - [[3, 3], [3, 10]]).max() <= 0.2
    assert operate(system, "reset").returncode == 0


def test_ctrl_c_ends_a_motion_at_rest(system):
    process = subprocess.Popen(words(system, "move", "--tolerance", 1), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.RUNNING, "motion")
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=DEADLINE)
    assert process.returncode == 130 and said.startswith("stressbot: move: ")
    assert system.client.driver_status.state != DriverStatus.RUNNING
    assert operate(system, "reset").returncode == 0


def test_a_robot_that_does_not_exist_is_refused(system):
    done = operate(system, "move", "--goal", 9, 300, 300)
    assert done.returncode == 1 and "robots" in done.stderr and len(done.stderr.splitlines()) == 1
    done = operate(system, "move", "--goal", 1.5, 300, 300)
    assert done.returncode == 2 and done.stderr == "stressbot: --goal: is for robot 1.5: give an id, a whole number\n"


@pytest.mark.parametrize("word", ["status", "stop", "move"])
def test_nobody_there_is_one_line(word):
    line = [STRESSBOT, word, "--namespace", "/nobody_here", "--timeout", "0.5"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=DEADLINE)
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1
    assert "does a driver run in namespace '/nobody_here'" in done.stderr
