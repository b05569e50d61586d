"""The calibrate command against running nodes, and the identification over volts: true values come back, faults are named."""

import os
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_prefix
from calibration import IMPERFECTIONS, run
from simulated_bench import SimulatedBench
from stressbot_msgs.msg import DriverStatus
from system_rig import SCENARIOS

from stressbot_driver import bench
from stressbot_driver.ros.conversions import description_message
from stressbot_driver.simulation.imperfections import Flaws, Imperfections
from stressbot_planner.estimation.calibration import Fault
from stressbot_planner.estimation.identification import identify
from stressbot_planner.estimation.kalman_filters import Prior
from stressbot_planner.formats import scenario, swarm_file
from stressbot_planner.reproduce import instances
from stressbot_planner.ros.conversion import scene_from_description

SIX = SCENARIOS / "paper-six-two-discs.yaml"
FAST = {"real_time_factor": 10.0, "pose_rate": 400.0}
COMMAND = Path(get_package_prefix("stressbot_planner"), "lib/stressbot_planner/calibrate")


@pytest.mark.parametrize("text", [instances.paper(True), instances.random(14, True, 0)], ids=["6", "14"])
def test_speeds_and_radii_are_found_to_one_percent_without_a_touch(text):
    found = run(text, seed=1)
    assert found.speed < 0.01 and found.radius < 0.01
    assert found.bias < np.radians(1.0)
    assert found.gap > 0.0
    assert found.seconds < 250.0


def test_symbols_missed_now_and_then_are_counted_and_forgiven():
    text = instances.paper(False)
    simulated = SimulatedBench(text, seed=3, dropped_symbols=0.02, **IMPERFECTIONS)
    swarm = simulated.scenario.swarm
    estimates, _ = identify(swarm, simulated.scenario.problem.environment, simulated.measure, simulated.drive, 0.01)
    assert [found.fault for found in estimates] == [Fault.NONE] * 6
    assert sum(found.missed for found in estimates) > 0
    assert [found.codeword for found in estimates] == list(swarm.codewords)


def test_a_calibrated_file_keeps_who_is_parked_waypoints_and_contacts(tmp_path):
    words = [format(k, "03b") for k in range(1, 7)]
    both = str([word + word.translate({48: "1", 49: "0"}) for word in words]).replace("'", '"')
    text = instances.paper(True).replace("binary", both) + "contacts: [[2, 6], [4, 6]]\n"
    loaded = scenario.parse(text)
    problem = loaded.problem
    goals = problem.goals.copy()
    goals[2] = problem.starts[2, :2]
    waypoints = problem.goals[None].copy()
    waypoints[:, 2] = goals[2]
    loaded = replace(loaded, problem=replace(problem, goals=goals, parked=(2,), waypoints=waypoints))
    simulated = SimulatedBench(text, always_turn=[4], **IMPERFECTIONS)
    estimates, _ = identify(loaded.swarm, problem.environment, simulated.measure, simulated.drive, 0.01)
    path = tmp_path / "swarm.yaml"
    swarm_file.write(path, swarm_file.calibrated(loaded, estimates, simulated.measure()[:, :2], 0.95))
    ours, theirs = scenario.load(path).problem, bench.load_bench(path)
    assert ours.parked == (2,) and theirs.parked.tolist() == [3]
    np.testing.assert_array_equal(ours.waypoints, np.delete(waypoints, 3, axis=1))
    assert ["waypoints" in robot for robot in yaml.safe_load(path.read_text())["robots"]] == [True, True, False, True, True]
    assert ours.contacts == ((1, 4),) and theirs.contact.tolist() == [[2, 5]]


def test_what_was_measured_is_a_scenario_file_for_driver_and_planner(tmp_path):
    text = instances.paper(True)
    simulated = SimulatedBench(text, always_turn=[4], **IMPERFECTIONS)
    loaded = simulated.scenario
    estimates, _ = identify(loaded.swarm, loaded.problem.environment, simulated.measure, simulated.drive, 0.01)
    path = tmp_path / "swarm.yaml"
    swarm_file.write(path, swarm_file.calibrated(loaded, estimates, simulated.measure()[:, :2], 0.95))
    ours, theirs = scenario.load(path), bench.load_bench(path)
    moving = [found for found in estimates if found.robot != 4]
    # Robot 4 is no robot any more but a disc where it lies.
    assert ours.swarm.codewords == tuple(found.codeword for found in moving) == theirs.codewords
    disc = ours.problem.environment.obstacles[-1]
    np.testing.assert_allclose(disc.center, loaded.problem.starts[3, :2], atol=0.05)
    assert disc.radius == loaded.swarm.body_radius[3]
    np.testing.assert_array_equal(ours.problem.goals, np.delete(loaded.problem.goals, 3, axis=0))
    np.testing.assert_allclose(ours.swarm.speed * ours.swarm.pace, [found.speed.value for found in moving], rtol=1e-5)
    np.testing.assert_allclose(ours.swarm.turning_radius, [found.turning_radius.value for found in moving], rtol=1e-5)
    assert ours.electrical == loaded.electrical
    # The closed loop hears from the driver how well each is known, and the biases.
    scene = scene_from_description(description_message(theirs))
    names = ("heading_bias", "speed", "turning_radius")
    halves = np.array([[getattr(found, name).half_width for name in names] for found in moving])
    measured = scene.calibration
    np.testing.assert_allclose(measured.heading_bias, [found.heading_bias.value for found in moving], rtol=1e-5)
    sigmas = np.column_stack([measured.heading_bias_sigma, measured.speed_sigma, measured.turning_radius_sigma])
    np.testing.assert_allclose(sigmas, halves / 1.959964, rtol=1e-5)
    rates = np.array([found.turning_rate.half_width / found.turning_rate.value for found in moving])
    np.testing.assert_allclose(Prior().calibrated(scene.swarm, measured).turning_error, rates / 1.959964, rtol=1e-3)
    record = yaml.safe_load(path.read_text())["calibration"]["robots"]
    assert [entry["robot"] for entry in record] == [1, 2, 3, 4, 5, 6]
    assert [entry.get("now") for entry in record] == [1, 2, 3, None, 4, 5]
    assert record[3]["fault"] == "always turns" and "speed" not in record[3] and "fault" not in record[0]


def test_robots_that_may_take_any_goal_still_may_when_one_has_become_a_disc(tmp_path):
    text = (SCENARIOS / "paper-six-any-goal.yaml").read_text()
    simulated = SimulatedBench(text, always_turn=[4])
    loaded = simulated.scenario
    assert loaded.problem.exchangeable == tuple(range(6))
    estimates, _ = identify(loaded.swarm, loaded.problem.environment, simulated.measure, simulated.drive, 0.01)
    path = tmp_path / "swarm.yaml"
    swarm_file.write(path, swarm_file.calibrated(loaded, estimates, simulated.measure()[:, :2], 0.95))
    ours = scenario.load(path).problem
    assert ours.exchangeable == tuple(range(5))
    np.testing.assert_array_equal(ours.goals, np.delete(loaded.problem.goals, 3, axis=0))
    assert bench.load_bench(path).assign.tolist() == [1, 2, 3, 4, 5]


def calibrate(system, output, *arguments, timeout=200.0):
    command = [COMMAND, "--output", output, *arguments, "--ros-args", "-r", f"__ns:={system.namespace}"]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout)


def test_calibrate_measures_the_robots_of_a_running_driver(new_system, tmp_path):
    settings = {"seed": 5, "speed_error": 0.03, "radius_error": 0.05, "heading_bias": 0.087, "heading_noise": 0.035}
    settings |= {"position_noise": 2e-6, "latency": 0.05, "lost_probability": 0.002, "lost_frames": 10}
    parameters = {f"imperfections.{name}": value for name, value in settings.items()}
    system = new_system(nodes=("driver", "sequencer"), scenario=SIX, **FAST, **parameters)
    done = calibrate(system, tmp_path / "swarm.yaml", "--precision", "0.008")
    assert done.returncode == 0, done.stdout + done.stderr
    flaws = Flaws(Imperfections(**settings), np.arange(1, 7), 2)
    found = scenario.load(tmp_path / "swarm.yaml").swarm
    np.testing.assert_allclose(found.speed * found.pace, flaws.speed_factor, rtol=0.02)
    np.testing.assert_allclose(found.turning_radius, flaws.radius_factor, rtol=0.02)
    for entry, bias in zip(yaml.safe_load((tmp_path / "swarm.yaml").read_text())["calibration"]["robots"], flaws.heading_bias,
                           strict=True):
        assert entry["heading_bias"][0] == pytest.approx(bias, abs=0.02)
    assert "± " in done.stdout and done.stdout.splitlines()[-1].startswith(f"{tmp_path / 'swarm.yaml'}: calibrated in")


def test_steps_are_measured_at_another_frequency_too(new_system, tmp_path):
    slopes = np.array([-0.2, -0.1, 0.0, 0.0, 0.1, -0.05])
    system = new_system(
        nodes=("driver", "sequencer"), scenario=SIX, **FAST, **{"imperfections.frequency_slope": slopes.tolist()}
    )
    frequency = 1.5 * scenario.load(SIX).electrical.drive.frequency
    done = calibrate(system, tmp_path / "swarm.yaml", "--precision", "0.05", "--frequencies", str(frequency))
    assert done.returncode == 0, done.stdout + done.stderr
    steps = [float(line.split()[1]) for line in done.stdout.splitlines()[-6:]]
    np.testing.assert_allclose(steps, 12.0 * (1.0 + 0.5 * slopes), rtol=0.02)
    for value, why in (("1e9", "give at most"), ("-1", "greater than 0")):
        refused = calibrate(system, tmp_path / "swarm.yaml", "--frequencies", value)
        assert refused.returncode == 2 and refused.stderr.count("\n") == 1, refused.stderr
        assert why in refused.stderr


def test_a_robot_that_always_slides_ends_it(new_system, tmp_path):
    system = new_system(nodes=("driver", "sequencer"), scenario=SIX, **FAST, **{"imperfections.always_slide": [3]})
    done = calibrate(system, tmp_path / "swarm.yaml")
    assert done.returncode == 2
    assert done.stderr.startswith("calibrate: robot 3: ") and done.stderr.count("\n") == 1
    assert not (tmp_path / "swarm.yaml").exists()


def test_too_few_poses_and_interruption_leave_the_driver_at_rest(new_system, tmp_path):
    system = new_system(nodes=("driver", "sequencer"), scenario=SIX, real_time_factor=0.0, pose_rate=50.0)
    done = calibrate(system, tmp_path / "swarm.yaml")
    assert done.returncode == 2 and "raise its pose_rate" in done.stderr, done.stderr
    assert calibrate(system, tmp_path / "swarm.yaml", "--precision", "0").returncode == 2
    slow = new_system(nodes=("driver", "sequencer"), scenario=SIX, real_time_factor=0.02)
    command = [COMMAND, "--output", tmp_path / "swarm.yaml", "--ros-args", "-r", f"__ns:={slow.namespace}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        client = slow.client
        slow.wait_for(lambda: client.driver_status and client.driver_status.state == DriverStatus.RUNNING, "the first drive")
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=300.0)
    finally:
        process.kill()
    assert process.returncode == 130 and errors == "calibrate: interrupted\n"
    slow.wait_for(lambda: client.driver_status.state == DriverStatus.STOPPED, "the stop")
    assert client.driver_status.output_level == 0.0
