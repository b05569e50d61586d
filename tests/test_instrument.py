"""The whole system through the instrument's own language: planner, sequencer, driver, TCP, emulated generator, substrate."""

import json
import re
import signal
from pathlib import Path

import pytest
import yaml
from ament_index_python.packages import get_package_prefix
from stressbot_msgs.msg import DriverStatus
from system_rig import DEADLINE, SCENARIOS, largest_error

from stressbot_planner.ros import conversion

pytestmark = pytest.mark.xdist_group("nodes")

GAIN = 20.0
SPEED = 20.0
STEP = 2.4e-3
"""units, twenty times as long as well: 8333 Hz as at the robots' own speed."""

AGREEMENT = 1e-9
"""units and rad: pulses are counted."""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """The paper's robots, twenty times as fast, since a generator plays in real time."""
    content = yaml.safe_load((SCENARIOS / "paper-six.yaml").read_text())
    content["swarm"]["speed"] = SPEED
    content["electrical"] = {"drive": {"step_length": STEP}}
    path = tmp_path_factory.mktemp("scenario") / "fast-six.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture(scope="module")
def record_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("record")


@pytest.fixture(scope="module")
def system(new_system, scenario, record_folder):
    system = new_system(nodes=())
    start_emulator(system, scenario)
    start_driver(system, scenario, record_folder)
    for name in ("sequencer", "planner"):
        system.start(name)
    system.wait_for(system.client.is_system_ready, "all nodes")
    return system


def start_emulator(system, scenario, port=0, name="instrument_emulator"):
    executable = Path(get_package_prefix("stressbot_driver"), "lib", "stressbot_driver", "instrument_emulator")
    parameters = ["-p", f"scenario:={scenario}", "-p", f"port:={port}", "-p", f"amplifier_gain:={GAIN}"]
    system.processes.start(
        name, [str(executable), "--ros-args", "-r", f"__ns:={system.namespace}", *parameters]
    )
    found = system.wait_for(
        lambda: re.search(r"listens on (TCPIP0::127\.0\.0\.1::(\d+)::SOCKET)", system.log(name)), "the emulator"
    )
    system.address = found.group(1)


def start_driver(system, scenario, record_folder):
    options = {
        "visa_resource": system.address,
        "amplifier_gain": GAIN,
        "amplifier_max_voltage": 200.0,
        "record_folder": record_folder,
        "timeout": 20.0,
    }
    own = {f"waveform_generator.{name}": value for name, value in options.items()}
    system.start("driver", scenario=scenario, backend="waveform_generator", **own)
    system.wait_for(lambda: system.client.driver_status, "the driver")


def scene(system):
    return conversion.scene_from_description(system.client.description)


def newest_poses(system):
    return conversion.starts_from_poses(system.client.poses[-1], scene(system))


def test_robots_end_where_the_plan_says(system, record_folder):
    answer = system.plan()
    assert answer.success, answer.error_msg
    poses, _ = system.execute(answer.plan)
    _, predicted = conversion.poses_from_plan(answer.plan, scene(system))
    assert largest_error(poses, predicted) < AGREEMENT
    status = system.client.driver_status
    assert (status.backend, status.output_level) == ("waveform_generator", 0.0)
    (record,) = record_folder.glob("*.jsonl")
    lines = [json.loads(line) for line in record.read_text().splitlines()]
    sent = [line["sent"] for line in lines if "sent" in line]
    assert sent.count("*TRG") == status.epoch_count == status.epoch
    assert sent[-2:] == ["OUTP1 OFF", "OUTP1?"]


def test_it_warns_of_a_drive_that_moves_a_real_robot_once(new_system, tmp_path, scenario):
    content = yaml.safe_load(scenario.read_text())
    content["electrical"]["drive"] = "constant"
    constant = tmp_path / "constant.yaml"
    constant.write_text(yaml.safe_dump(content))
    system = new_system(nodes=())
    start_emulator(system, constant)
    start_driver(system, constant, tmp_path)
    system.wait_for(lambda: "moves a real robot once" in system.log("driver"), "the warning")


def test_it_says_that_it_was_not_tried_on_an_instrument(system):
    assert "NOT YET BEEN TRIED ON A PHYSICAL INSTRUMENT" in system.log("driver")


def test_stop_and_a_plan_from_where_the_robots_are(system):
    back = {"robots": [1, 2], "goal_x": [5e-4, 5e-4], "goal_y": [-5e-4, 25e-4]}
    first = system.plan(**back)
    assert first.success, first.error_msg
    system.wait_until_loaded(first.plan.plan_id)
    assert system.client.trigger("start").success
    origin, _ = conversion.poses_from_plan(first.plan, scene(system))
    system.wait_for(lambda: system.client.poses and largest_error(newest_poses(system), origin) > 0.1, "motion")
    assert system.client.trigger("stop").success
    system.wait_for(system.has_reached(DriverStatus.STOPPED, first.plan.plan_id), "stop")
    assert system.client.driver_status.output_level == 0.0
    second = system.plan(**back)
    assert second.success, second.error_msg
    poses = system.poses_after(system.client.driver_status.header.stamp)
    start, _ = conversion.poses_from_plan(second.plan, scene(system))
    assert largest_error(start, poses) < 1e-9
    assert largest_error(start, origin) > 0.1


def test_an_instrument_that_dies_is_a_fault_reset_finds_the_next_one_and_all_end_well(system, scenario):
    port = system.address.split("::")[2]
    answer = system.plan(robots=[3], goal_x=[2e-3], goal_y=[2e-3])
    assert answer.success, answer.error_msg
    system.wait_until_loaded(answer.plan.plan_id)
    assert system.client.trigger("start").success
    system.wait_for(lambda: system.client.driver_status.epoch >= 1, "the first epoch")
    assert system.processes.stop("instrument_emulator", signal.SIGKILL) == -signal.SIGKILL
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.FAULT, "the fault", DEADLINE)
    assert "THE OUTPUT MAY BE ON" in system.client.driver_status.error_msg
    assert not system.client.trigger("stop").success
    assert not system.client.trigger("reset").success
    start_emulator(system, scenario, port, "next_instrument_emulator")
    answer = system.client.trigger("reset")
    assert answer.success, answer.message
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.IDLE, "reset")
    for name in ("driver", "next_instrument_emulator"):
        assert system.processes.stop(name) == 0
        assert "Traceback" not in system.log(name)
