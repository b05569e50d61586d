"""The action `move_swarm` against running nodes: imperfect robots reach their goals, and every way out leaves them at rest."""

import json
from pathlib import Path

import numpy as np
import pytest
from rclpy.action import ActionClient
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus
from system_rig import DEADLINE
from three_robots import SCENARIO

from stressbot_planner.errors import ErrorCode
from stressbot_planner.ros import conversion

FLAWS = {"seed": 3, "speed_error": 0.03, "heading_bias": 0.087, "heading_noise": 0.035}


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(SCENARIO)
    flaws = {f"imperfections.{name}": value for name, value in FLAWS.items()}
    system = new_system(nodes=("driver", "sequencer"), scenario=path, real_time_factor=50.0, pose_rate=200.0, **flaws)
    start_mover(system, **{"assumed.speed_error": 0.06})
    return system


def start_mover(system, **parameters):
    # A file of parameters is for the start of a node: launch files delete theirs.
    file = Path(system.processes.log("mover")).with_suffix(".yaml")
    file.write_text(json.dumps({"/**": {"ros__parameters": parameters}}) if parameters else "{}")
    system.start("mover", "--params-file", str(file))
    system.wait_for(lambda: system.client.node.count_services("move_swarm/_action/send_goal"), "mover")
    file.unlink()
    system.actions = ActionClient(system.client.node, MoveSwarm, "move_swarm")
    system.wait_for(system.actions.server_is_ready, "mover")
    system.wait_for(system.is_known_to_mover(system.actions), "first answer of the mover")


def send(system, heard=None, **goal):
    """Return the handle of a goal."""
    tell = None if heard is None else lambda message: heard.append(message.feedback)
    answer = system.asked(lambda: system.actions.send_goal_async(MoveSwarm.Goal(**goal), feedback_callback=tell))
    system.wait_for(answer.done, "acceptance")
    return answer.result()


def result_of(system, handle):
    answer = system.asked(handle.get_result_async)
    system.wait_for(answer.done, "result", 3 * DEADLINE)
    return answer.result().result


def is_at_rest(system):
    status = system.client.driver_status
    return status.state != DriverStatus.RUNNING and status.output_level == 0.0


def test_imperfect_robots_come_to_their_goals(system):
    heard = []
    result = result_of(system, send(system, heard))
    assert result.success and result.error_code == 0, result.error_msg
    scene = conversion.scene_from_description(system.client.description)
    poses = system.poses_after(system.client.driver_status.header.stamp)
    errors = np.hypot(*(poses[:, :2] - scene.goals).T)
    assert errors.max() <= 0.3
    np.testing.assert_allclose(np.array(result.errors) / scene.unit, errors, atol=1e-9)
    assert list(result.robots) == [1, 2, 3] and list(result.stuck) == []
    assert result.activations > 3
    assert [entry.activations for entry in heard] == sorted(entry.activations for entry in heard)
    assert heard[0].progress < 0.1 < heard[-1].progress <= 1.0
    assert is_at_rest(system)


def test_robots_that_may_take_any_goal_take_those_at_hand(system):
    answer = system.client.trigger("reset")
    assert answer.success, answer.message
    goals = np.array([[4.0, 10.0], [4.0, 2.0], [3.5, 5.0]])
    x, y = 1e-4 * goals.T
    result = result_of(system, send(system, robots=[1, 2, 3], goal_x=x.tolist(), goal_y=y.tolist(), assign=True))
    assert result.success and max(result.errors) <= 3e-5, result.error_msg
    places = system.poses_after(system.client.driver_status.header.stamp)[:, :2]
    taken = np.hypot(*(places[:, None] - goals[None]).transpose(2, 0, 1)) <= 0.3
    assert np.argwhere(taken).tolist() == [[0, 1], [1, 2], [2, 0]]  # nobody passes another


def test_calibrated_robots_need_few_looks(new_system, tmp_path):
    bias = [0.2, -0.15, 0.1]
    path = tmp_path / "three.yaml"
    robots = "".join(
        f"    - {{robot: {k}, now: {k}, speed: [1, 1e-3], turning_radius: [1, 1e-3], heading_bias: [{b}, 1e-3], "
        "selections: 9, missed: 0}\n"
        for k, b in enumerate(bias, start=1)
    )
    path.write_text(f"{SCENARIO}calibration:\n  confidence: 0.95\n  robots:\n{robots}")
    parameters = {"imperfections.heading_bias": bias, "real_time_factor": 50.0, "pose_rate": 200.0}
    other = new_system(nodes=("driver", "sequencer"), scenario=path, **parameters)
    start_mover(other, **{"assumed.heading_noise": 1e-3, "planning_time": 1})
    heard = []
    result = result_of(other, send(other, heard))
    assert result.success and max(result.errors) <= 3e-5, result.error_msg
    assert len(heard) < result.activations / 2  # where it knows nothing it looks after each move, that is two activations


def test_cancel_leaves_the_substrate_at_rest(system):
    answer = system.client.trigger("reset")
    assert answer.success, answer.message
    heard = []
    handle = send(system, heard)
    system.wait_for(lambda: heard, "the first plan")
    busy = result_of(system, send(system))
    assert busy.error_code == ErrorCode.BUSY and busy.error_msg.startswith("move_swarm: ")
    cancelled = system.asked(handle.cancel_goal_async)
    system.wait_for(cancelled.done, "cancel")
    result = result_of(system, handle)
    assert not result.success and result.error_code == ErrorCode.CANCELLED
    system.wait_for(lambda: is_at_rest(system), "rest")


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        ({"tolerance": 0.0}, ErrorCode.OUT_OF_RANGE),
        ({"time_limit": -1.0}, ErrorCode.OUT_OF_RANGE),
        ({"time_limit": 1e-3}, ErrorCode.TIMED_OUT),
        ({"robots": [9], "goal_x": [1e-4], "goal_y": [1e-4]}, ErrorCode.UNKNOWN_ROBOT),
        ({"robots": [1], "goal_x": [5e-4], "goal_y": [6e-4]}, ErrorCode.INSIDE_OBSTACLE),
    ],
)
def test_refusals_say_why(system, goal, code):
    result = result_of(system, send(system, **goal))
    assert not result.success and result.error_code == code, result.error_msg
    assert result.error_msg


def test_goals_with_headings_are_refused_by_name_and_places_alone_are_not(new_system, tmp_path):
    path = tmp_path / "three.yaml"
    path.write_text(SCENARIO.replace("goal: [8, 2]", "goal: [8, 2, 1.0]"))
    other = new_system(nodes=("driver", "sequencer"), scenario=path, pose_rate=200.0, real_time_factor=50.0)
    start_mover(other)
    result = result_of(other, send(other))
    assert not result.success and result.error_code == ErrorCode.UNSUPPORTED
    assert "goal of robot 2: has a heading" in result.error_msg and "plan_motion" in result.error_msg
    assert result_of(other, send(other, robots=[1], goal_x=[3e-4], goal_y=[2e-4])).success


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("goal: [8, 2]", "goal: [8, 2], waypoints: [[5, 2]]", "stages"),
        ("goal: [8, 2]", "goal: parked", "goal of robot 2: is parked"),
    ],
)
def test_stages_and_parked_robots_are_refused(new_system, tmp_path, old, new, text):
    path = tmp_path / "three.yaml"
    path.write_text(SCENARIO.replace(old, new).replace("binary", '["0110", "1001", "1100"]'))
    other = new_system(nodes=("driver", "sequencer"), scenario=path, pose_rate=200.0, real_time_factor=50.0)
    start_mover(other)
    result = result_of(other, send(other))
    assert not result.success and result.error_code == ErrorCode.UNSUPPORTED
    assert text in result.error_msg and "plan_motion" in result.error_msg


def test_a_stuck_robot_becomes_an_obstacle_and_the_rest_carry_on(new_system, tmp_path):
    path = tmp_path / "three.yaml"
    path.write_text(SCENARIO)
    parameters = {"imperfections.always_turn": [2], "imperfections.heading_noise": 0.035, "real_time_factor": 50.0}
    other = new_system(nodes=("driver", "sequencer"), scenario=path, pose_rate=200.0, **parameters)
    start_mover(other)
    result = result_of(other, send(other))
    assert result.success and list(result.stuck) == [2], result.error_msg
    assert result.error_msg == "robots 2 do not move: they became obstacles, their goals were dropped"
    assert max(result.errors[0], result.errors[2]) <= 3e-5 < result.errors[1]


def test_a_mover_that_is_ended_stops_the_driver(system):
    answer = system.client.trigger("reset")
    assert answer.success, answer.message
    send(system)
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.RUNNING, "a motion")
    assert system.processes.stop("mover") == 0
    system.wait_for(lambda: is_at_rest(system), "rest")
