"""The driver as users meet it: a process, topics, services, signals, exit codes."""

import math
import os
import re
import signal
import time

import numpy as np
import pytest
from driver_support import bench, closed_form, encode, play, scenario_text, sequence
from node_rig import NodeRig
from rclpy.parameter import Parameter
from stressbot_msgs.msg import DriverStatus, ErrorCode, SequencerStatus, SwarmPoses

from stressbot_driver.ros.conversions import description_message
from stressbot_driver.ros.driver_node import PARAMETERS, REST_RATES
from stressbot_driver.ros.qos import LATCHED, POSES, living
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Substrate

pytestmark = pytest.mark.xdist_group("driver_processes")
GENERATOR = {
    "backend": "waveform_generator",
    "waveform_generator.visa_resource": "TCPIP0::127.0.0.1::1::SOCKET",  # where nobody listens
    "waveform_generator.amplifier_gain": 20,
    "waveform_generator.amplifier_max_voltage": 200,
}
PLAN = [(1, 0.5), (4, 1.0), (2, 0.7), (3, 2.0), (4, 0.1), (1, 1.5)]


@pytest.fixture
def rig():
    rig = NodeRig()
    yield rig
    rig.close()


@pytest.fixture
def scenario_path(tmp_path):
    def write(count=6, **changes):
        path = tmp_path / "scenario.yaml"
        path.write_text(scenario_text(count, **changes))
        return path

    return write


def deviation(swarm, message, plan):
    """Largest distance [length units] and heading difference [rad] between poses and the closed form."""
    expected = closed_form(swarm, plan)
    distance = np.hypot(np.array(message.x) - expected[:, 0], np.array(message.y) - expected[:, 1]).max()
    heading = np.angle(np.exp(1j * (np.array(message.heading) - expected[:, 2])))
    return distance / swarm.length_unit, np.abs(heading).max()


def test_description_tells_the_whole_bench(rig, scenario_path):
    changes = {
        "workspace": {"x": [-1, 20], "y": [-1, 20]},
        "obstacles": [{"circle": {"center": [8, 8], "radius": 1}}, {"polygon": [[9, 9], [11, 9], [10, 11]]}],
        "swarm.turning_radius": [1.0, 1.5, 2.0, 1.0, 1.0, 1.0],
        "electrical.symbol_levels": [40.0, 50.0, 65.0],
        "robots.1.goal": "assign",
        "robots.4.goal": "assign",
        "goals": [[12.0, 2.0], [12.0, 8.0]],
    }
    swarm = bench(6, **changes)
    rig.start_driver(scenario_path(6, **changes))
    message = rig.descriptions[-1]
    assert message.header.frame_id == "substrate" and message.header.stamp.sec > 0
    assert (message.name, message.swarm_id, message.group_count) == ("test", swarm.swarm_id, 4)
    assert list(message.ids) == [1, 2, 3, 4, 5, 6]
    assert message.codewords == ["001", "010", "011", "100", "101", "110"]
    assert (message.length_unit, list(message.speed)) == (swarm.length_unit, swarm.speed.tolist())
    assert list(message.turning_radius) == swarm.turning_radius.tolist()
    assert list(message.body_radius) == swarm.body_radius.tolist()
    assert list(message.start) == swarm.start.ravel().tolist()
    assert list(message.goal) == swarm.goal.ravel().tolist()
    assert list(message.assign) == [2, 5]
    assert list(message.workspace) == swarm.workspace.tolist()
    circle, polygon = message.obstacles
    assert (circle.kind, circle.radius, list(circle.x)) == (circle.CIRCLE, pytest.approx(1e-4), pytest.approx([8e-4]))
    assert (polygon.kind, list(polygon.y)) == (polygon.POLYGON, pytest.approx([9e-4, 9e-4, 11e-4]))
    electrical = message.electrical
    assert list(electrical.symbol_levels) == [40.0, 50.0, 65.0] and len(electrical.thresholds) == 5
    assert electrical.code_length == 2 and list(electrical.codes) == [0, 0, 0, 1, 0, 2, 1, 0]
    for name, value in vars(swarm.electrical).items():
        if isinstance(value, float):
            assert getattr(electrical, name) == value
    assert electrical.frequency == 0.0


def test_pulses_are_described_too():
    swarm = bench(6, **{"electrical.drive": {"polarity": "alternating", "duty": 0.4}, "electrical.min_level": -150.0})
    electrical = description_message(swarm).electrical
    for name, value in vars(swarm.electrical.drive).items():
        assert getattr(electrical, name) == value
    assert len(electrical.thresholds) == len(electrical.symbol_levels) + 3


def test_from_volts_to_poses(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), real_time_factor=0)
    assert rig.state(DriverStatus.IDLE).backend == "simulated"
    played = encode(swarm, PLAN)
    rig.send(played)
    loaded = rig.state(DriverStatus.LOADED)
    assert (loaded.plan_id, loaded.epoch_count, loaded.duration) == ("plan", 6, pytest.approx(played.duration))
    answer = rig.call("start")
    assert answer.success, answer.message
    done = rig.state(DriverStatus.DONE)
    assert (done.epoch, done.output_level, done.error_code) == (6, 0.0, 0)
    assert done.sequence_time == pytest.approx(played.duration, abs=1e-9)
    last = rig.wait(lambda: rig.poses and rig.poses[-1].sequence_time == done.sequence_time and rig.poses[-1], "the final poses")
    assert last.swarm_id == swarm.swarm_id and last.header.frame_id == "substrate"
    assert list(last.ids) == [1, 2, 3, 4, 5, 6]
    assert max(deviation(swarm, last, PLAN)) < 1e-6
    # A sequence is spent, and the answer says what to do.
    again = rig.call("start")
    assert not again.success and "that of plan plan has run to its end, and each serves once" in again.message
    assert rig.status(lambda s: s.error_code, "the refusal").error_code == ErrorCode.NOTHING_LOADED
    # The next one starts where the robots are.
    rig.send(encode(swarm, PLAN[:2], plan_id="second"))
    rig.status(lambda s: s.state == DriverStatus.LOADED and s.plan_id == "second", "the second plan")
    assert rig.call("start").success
    rig.status(lambda s: s.state == DriverStatus.DONE and s.plan_id == "second", "the second end")
    rig.wait(lambda: max(deviation(swarm, rig.poses[-1], PLAN + PLAN[:2])) < 1e-6, "the poses after both")
    # Reset brings everybody home.
    assert rig.call("reset").success
    idle = rig.state(DriverStatus.IDLE)
    assert (idle.plan_id, idle.sequence_time, idle.error_code) == ("", 0.0, 0)
    rig.wait(lambda: rig.poses[-1].sequence_time == 0.0 and max(deviation(swarm, rig.poses[-1], [])) == 0.0, "home")


def test_auto_start_and_paced_poses(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True, pose_rate=20.0)
    played = encode(swarm, [(4, 1.0)])
    rig.send(played)
    done = rig.state(DriverStatus.DONE)
    rig.wait(lambda: rig.poses[-1].sequence_time == done.sequence_time, "the final poses")
    times = {round(message.sequence_time, 9) for message in rig.poses}
    assert {round(k / 20.0, 9) for k in range(1, int(played.duration * 20.0) + 1)} <= times
    for message in rig.poses:
        driven = min(max(message.sequence_time - float(played.dwells[:-2].sum()), 0.0), 1.0)
        assert list(message.heading) == pytest.approx([driven] * 6, abs=1e-6)


def test_poses_at_rest_leave_the_processor_to_others(rig, scenario_path):
    rig.start_driver(scenario_path(6), pose_rate=1000.0)
    rig.wait(lambda: len(rig.poses) > 30, "poses")
    stamps = [message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in rig.poses]
    assert np.median(np.diff(stamps)) > 0.9 / REST_RATES["pose_rate"]


def test_stop_is_exact(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True)
    rig.send(encode(swarm, [(4, 600.0)]))
    rig.status(lambda s: s.output_level == 140.0, "the drive")
    answer = rig.call("stop")
    assert answer.success and answer.message == "stopped"
    stopped = rig.state(DriverStatus.STOPPED)
    assert stopped.output_level == 0.0 and 0.0 < stopped.sequence_time < 600.0
    rig.wait(lambda: rig.poses[-1].sequence_time == stopped.sequence_time, "the poses where it stopped")
    expected = stopped.sequence_time - (0.01 + 0.005 + 2 * 0.015)
    assert rig.poses[-1].heading[0] == pytest.approx(math.remainder(expected, 2 * math.pi), abs=1e-6)
    assert rig.call("stop").success
    assert not rig.call("start").success
    assert rig.call("reset").success


@pytest.mark.timing
def test_stop_is_quick(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True)
    taken = []
    for plan_id in "abcde":  # the best of some: this machine may have other work
        rig.send(encode(swarm, [(4, 600.0)], plan_id=plan_id))
        rig.status(lambda s, name=plan_id: s.plan_id == name and s.output_level == 140.0, "the drive")
        called = time.monotonic()
        assert rig.call("stop").success
        stopped = rig.state(DriverStatus.STOPPED)
        taken.append(rig.times[rig.statuses.index(stopped)] - called)
    assert min(taken) < 0.2


def test_refusals_leave_the_running_sequence_alone(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True)
    first = encode(swarm, [(1, 4.0)], plan_id="first")
    rig.send(first)
    rig.state(DriverStatus.RUNNING)
    rig.send(encode(swarm, PLAN, plan_id="second"))
    busy = rig.status(lambda s: s.refused_plan_id == "second", "the refusal")
    assert (busy.state, busy.plan_id, busy.error_code) == (DriverStatus.RUNNING, "first", ErrorCode.BUSY)
    for service, word in (("start", "already running"), ("reset", "call stop first")):
        answer = rig.call(service)
        assert not answer.success and word in answer.message
    (result,) = rig.set_parameters([Parameter("real_time_factor", value=2.0)])
    assert not result.successful and "running" in result.reason
    rig.state(DriverStatus.DONE)
    rig.wait(lambda: max(deviation(swarm, rig.poses[-1], [(1, 4.0)])) < 1e-6, "the end of the first")


def test_bad_sequences_are_refused_whole_with_their_codes(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True, real_time_factor=0)
    cases = {
        "volts": (sequence(swarm, [0.0, 200.5], [1.0, 1.0], plan_id="volts"), ErrorCode.LIMIT_EXCEEDED),
        "nan": (sequence(swarm, [0.0, math.nan], [1.0, 1.0], plan_id="nan"), ErrorCode.NOT_FINITE),
        "count": (sequence(swarm, [0.0, 1.0], [1.0], plan_id="count"), ErrorCode.WRONG_COUNT),
        "dwell": (sequence(swarm, [0.0, 1.0], [1.0, 0.0], plan_id="dwell"), ErrorCode.OUT_OF_RANGE),
        "ends": (sequence(swarm, [0.0, 1.0], [1.0, 1.0], [1], plan_id="ends"), ErrorCode.INVALID_SEQUENCE),
        "swarm": (sequence(swarm, [0.0], [1.0], plan_id="swarm", swarm_id="?"), ErrorCode.WRONG_SWARM),
        "empty": (sequence(swarm, [], [], plan_id="empty"), ErrorCode.INVALID_SEQUENCE),
    }
    for plan_id, (bad, code) in cases.items():
        rig.send(bad)
        refused = rig.status(lambda s, plan_id=plan_id: s.refused_plan_id == plan_id, f"the refusal of {plan_id}")
        assert (refused.state, refused.error_code, refused.output_level) == (DriverStatus.IDLE, code, 0.0)
        assert refused.error_msg
    rig.send(encode(swarm, PLAN))
    assert rig.state(DriverStatus.DONE).error_code == ErrorCode.NONE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_at_zero_volts(rig, scenario_path, number):
    process = rig.start_driver(scenario_path(6), auto_start=True)
    rig.send(encode(bench(6), [(4, 600.0)]))
    rig.status(lambda s: s.output_level == 140.0, "the drive")
    code, errors = rig.end(process, number)
    assert code == 0 and "Traceback" not in errors
    last = rig.state(DriverStatus.STOPPED)
    assert last.output_level == 0.0


def test_signals_in_a_row_end_at_zero_volts_too(rig, scenario_path):
    process = rig.start_driver(scenario_path(6), auto_start=True)
    rig.send(encode(bench(6), [(4, 600.0)]))
    rig.status(lambda s: s.output_level == 140.0, "the drive")
    for _ in range(50):
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            process.send_signal(number)
        if rig.statuses[-1].state == DriverStatus.STOPPED:
            break
    assert rig.state(DriverStatus.STOPPED).output_level == 0.0
    rig.ended(process)


def test_a_defect_of_the_node_ends_at_zero_volts(rig, scenario_path):
    """The executor's thread dies of an exception while the sequence drives."""
    defect = """
from stressbot_driver.ros import driver_node
def broken(self):
    if self._session.status().output_level == 140.0:
        raise RuntimeError("a defect")
driver_node.DriverNode._heartbeat = broken
driver_node.main()
"""
    process = rig.start_driver(scenario_path(6), auto_start=True, code=defect)
    rig.send(encode(bench(6), [(4, 600.0)]))
    last = rig.status(lambda s: s.plan_id and s.state != DriverStatus.RUNNING and s.state != DriverStatus.LOADED, "the end")
    assert (last.state, last.output_level) == (DriverStatus.STOPPED, 0.0)
    assert 0.0 < last.sequence_time < 600.0
    code, errors = rig.ended(process)
    assert code == 1 and "RuntimeError: a defect" in errors


def test_parameters_set_during_a_run_are_refused_or_change_nothing_of_it(rig, scenario_path):
    """Every declared parameter, with another value of its kind."""
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True)
    plan = [(1, 1.5), (4, 1.7), (2, 1.8)]
    rig.send(encode(swarm, plan))
    rig.state(DriverStatus.RUNNING)
    declarations = list(PARAMETERS)

    def another(declaration):
        value = declaration.default
        if isinstance(value, bool):
            return not value
        if isinstance(value, float):
            return min(2.0 * value + 0.01, declaration.high)
        return {int: 1, str: "other", tuple: [1]}[type(value)]

    changes = [Parameter(declaration.name, value=another(declaration)) for declaration in declarations]
    results = dict(zip([declaration.name for declaration in declarations], rig.set_parameters(changes), strict=True))
    assert rig.statuses[-1].state == DriverStatus.RUNNING
    assert {name for name, result in results.items() if result.successful} == {"pose_rate", "status_rate", "auto_start"}
    assert all(result.reason for result in results.values() if not result.successful)
    done = rig.state(DriverStatus.DONE)
    last = rig.wait(lambda: rig.poses[-1].sequence_time == done.sequence_time and rig.poses[-1], "the final poses")
    assert max(deviation(swarm, last, plan)) < 1e-6


def test_limits_of_the_driver_are_refusals(rig, scenario_path):
    swarm = bench(6)
    rig.start_driver(scenario_path(6), auto_start=True, max_duration=2.0, max_duty=0.5, max_slew_rate=1e5)
    long = encode(swarm, [(1, 3.0)], plan_id="max 2 s")
    driven = encode(swarm, [(1, 1.0)], plan_id="max_duty")
    steep = sequence(swarm, [60.0, 0.0], [0.01, 0.0005], plan_id="slew rate")
    for bad in (long, driven, steep):
        rig.send(bad)
        status = rig.status(lambda s, name=bad.plan_id: s.refused_plan_id == name, f"the refusal of {bad.plan_id}")
        assert (status.state, status.error_code) == (DriverStatus.IDLE, ErrorCode.LIMIT_EXCEEDED)
        assert bad.plan_id.split()[-1] in status.error_msg or "most is 2 s" in status.error_msg
    rig.send(encode(swarm, [(1, 0.04)]))
    rig.state(DriverStatus.DONE)


def test_no_start_without_a_sequencer_and_a_latched_end_without_poses(rig, scenario_path, monkeypatch, tmp_path):
    make_blind_backend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    swarm = bench(6)
    tracker = rig.node.create_publisher(SwarmPoses, "swarm_poses", POSES)
    seen = {"swarm_id": swarm.swarm_id, "ids": [1]}

    def track():
        tracker.publish(SwarmPoses(**seen))

    timer = rig.node.create_timer(0.02, track)
    rig.start_driver(scenario_path(6), backend="blind", pose_timeout=1.0)
    rig.status(lambda s: not s.missing, "the poses")
    rig.send(encode(swarm, [(4, 600.0)]))
    rig.state(DriverStatus.LOADED)
    assert rig.call("start").success
    rig.state(DriverStatus.RUNNING)
    for change in ({"ids": []}, {"swarm_id": "another"}):  # nobody seen; somebody else's robots
        seen.update(change)
        fault = rig.state(DriverStatus.FAULT)
        assert fault.error_code == ErrorCode.POSES_LOST and list(fault.missing) == ["swarm_poses"]
        assert "tracker" in fault.error_msg
        assert rig.call("reset").success
        rig.send(encode(swarm, [(4, 600.0)]))
        rig.state(DriverStatus.LOADED)
        refused = rig.call("start")
        assert not refused.success and "swarm_poses" in refused.message
        seen.update(swarm_id=swarm.swarm_id, ids=[1])
        rig.status(lambda s: not s.missing, "the poses again")
        assert rig.call("start").success
        rig.state(DriverStatus.RUNNING)
    rig.node.destroy_timer(timer)
    assert rig.state(DriverStatus.FAULT).error_code == ErrorCode.POSES_LOST
    rig.node.destroy_publisher(rig.life)
    rig.status(lambda s: set(s.missing) == {"swarm_poses", "sequencer_status"}, "the loss of the sequencer")


def test_idle_driver_ends_without_a_word(rig, scenario_path):
    process = rig.start_driver(scenario_path(6))
    assert rig.end(process)[0] == 0


@pytest.mark.parametrize(
    ("parameters", "field"),
    [
        ({}, "scenario"),
        ({"scenario": "/nowhere.yaml"}, "scenario"),
        ({"scenario": 5}, "scenario"),
        ({"scenario": "VALID", "backend": "laser"}, "backend"),
        ({"scenario": "VALID", "pose_rate": 0}, "pose_rate"),
        ({"scenario": "VALID", "pose_rate": ".nan"}, "pose_rate"),
        ({"scenario": "VALID", "real_time_factor": -1.0}, "real_time_factor"),
        ({"scenario": "VALID", "auto_start": "often"}, "auto_start"),
        ({"scenario": "VALID", "pose_raet": 1.0}, "pose_raet"),
        ({"scenario": "VALID", "peer_timeout": 0.01}, "peer_timeout"),
        ({"scenario": "VALID", "max_duty": 1.1}, "max_duty"),
        ({"scenario": "VALID", "real_time_factor": 5e-324}, "real_time_factor"),
        ({"scenario": "VALID", "gate_timeout": 0.0}, "gate_timeout"),
        ({"scenario": "BROKEN"}, "swarm.speed"),
        ({"scenario": "VALID", "waveform_generator.channel": 1}, "waveform_generator.channel"),  # of a backend not chosen
        ({"scenario": "VALID", "backend": "waveform_generator"}, "waveform_generator.visa_resource"),
        ({"scenario": "VALID", **GENERATOR, "waveform_generator.channel": 3}, "waveform_generator.channel"),
        ({"scenario": "VALID", **GENERATOR}, "instrument"),
    ],
)
def test_bad_starts_are_one_line_and_exit_code_2(rig, scenario_path, parameters, field):
    if parameters.get("scenario") in ("VALID", "BROKEN"):
        broken = {"swarm.speed": float("nan")} if parameters["scenario"] == "BROKEN" else {}
        parameters = {**parameters, "scenario": scenario_path(2, **broken)}
    code, errors = rig.ended(rig.start("driver", **parameters))
    assert code == 2
    assert errors.startswith(f"driver: {field}: ") and errors.count("\n") == 1, errors


@pytest.mark.parametrize("arguments", [["-p", "scenario"], ["--params-file", "/nowhere.yaml"], ["--bogus"]])
def test_a_command_line_that_ros_does_not_understand(rig, arguments):
    code, errors = rig.ended(rig.start("driver", *arguments))
    assert code == 2
    assert errors.splitlines()[-1].startswith("driver: --ros-args: "), errors  # rcl may have logged a line before
    assert "Traceback" not in errors


def test_parameters_are_guarded_and_take_effect(rig, scenario_path):
    rig.start_driver(scenario_path(6))
    results = rig.set_parameters(
        [
            Parameter("no_such_thing", value=1.0),
            Parameter("scenario", value="/other.yaml"),
            Parameter("backend", value="other"),
            Parameter("real_time_factor", value=-1.0),
            Parameter("real_time_factor", value=math.nan),
            Parameter("pose_rate", value="often"),
            Parameter("pose_rate", value=1e9),
            Parameter("auto_start", value=1),
        ]
    )
    assert [result.successful for result in results] == [False] * 8
    assert all(result.reason for result in results)
    good = [Parameter("real_time_factor", value=0), Parameter("auto_start", value=True), Parameter("pose_rate", value=200.0)]
    assert [result.successful for result in rig.set_parameters(good)] == [True] * 3
    rig.send(encode(bench(6), [(4, 500.0)]))
    rig.state(DriverStatus.DONE)
    assert rig.set_parameters([Parameter("real_time_factor", value=1.0)])[0].successful
    with rig.heard:
        rig.poses.clear()
    rig.send(encode(bench(6), [(4, 0.5)], plan_id="paced"))
    done = rig.status(lambda s: s.state == DriverStatus.DONE and s.plan_id == "paced", "the end of the paced one")
    rig.wait(lambda: rig.poses and rig.poses[-1].sequence_time == done.sequence_time, "the final poses")
    ticks = {round(200.0 * message.sequence_time, 6) for message in rig.poses}
    assert len([tick for tick in ticks if tick % 4]) > 20  # between those of the default 50 Hz


def test_imperfections_reach_the_substrate_and_only_there(rig, scenario_path):
    swarm = bench(6)
    settings = {"seed": 11, "speed_error": 0.03, "radius_error": [0.01, -0.02, 0.0, 0.03, 0.04, -0.05], "heading_bias": 0.09}
    settings |= {"heading_noise": 0.035, "always_turn": [6], "lost_probability": 0.0}
    rig.start_driver(scenario_path(6), real_time_factor=0, **{f"imperfections.{name}": value for name, value in settings.items()})
    assert rig.descriptions[-1].swarm_id == swarm.swarm_id  # the planner hears nothing of them
    expected = play(Substrate(swarm, Imperfections(**settings)), encode(swarm, PLAN)).poses()

    def run():
        rig.send(encode(swarm, PLAN))
        rig.state(DriverStatus.LOADED)
        assert rig.call("start").success
        done = rig.state(DriverStatus.DONE)
        last = rig.wait(lambda: rig.poses and rig.poses[-1].sequence_time == done.sequence_time and rig.poses[-1], "the last poses")
        return list(last.ids), np.array([last.x, last.y, last.heading])

    ids, poses = run()
    assert ids == [1, 2, 3, 4, 5, 6]
    assert np.array_equal(poses, [expected.x, expected.y, expected.heading])
    assert np.abs(poses[0] - closed_form(swarm, PLAN)[:, 0]).max() > 1e-6
    results = rig.set_parameters(
        [
            Parameter("imperfections.always_turn", value=[7]),
            Parameter("imperfections.speed_error", value=[0.1]),
            Parameter("imperfections.speed_error", value="much"),
            Parameter("imperfections.seed", value=-1),
            Parameter("imperfections.dropped_symbols", value=2.0),
        ]
    )
    assert [result.successful for result in results] == [False] * 5
    assert all(result.reason for result in results)
    numbers = ("speed_error", "radius_error", "heading_bias", "heading_noise")
    off = [Parameter(f"imperfections.{name}", value=0.0) for name in numbers]
    off += [Parameter("imperfections.always_turn", value=[]), Parameter("imperfections.lost_probability", value=1.0)]
    assert [result.reason for result in rig.set_parameters(off)] == [""] * 6
    rig.wait(lambda: not rig.poses[-1].ids, "poses of nobody")
    assert rig.set_parameters([Parameter("imperfections.lost_probability", value=0.0)])[0].successful
    assert rig.call("reset").success
    rig.state(DriverStatus.IDLE)
    rig.wait(lambda: list(rig.poses[-1].ids) == ids, "everybody")
    rig.send(encode(swarm, [(4, 600.0)]))
    assert rig.set_parameters([Parameter("real_time_factor", value=1.0)])[0].successful
    rig.state(DriverStatus.LOADED)
    assert rig.call("start").success
    (refused,) = rig.set_parameters([Parameter("imperfections.speed_error", value=0.1)])
    assert not refused.successful and "running" in refused.reason


def test_imperfections_are_refused_by_other_backends(rig, scenario_path, monkeypatch, tmp_path):
    make_blind_backend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    path = scenario_path(6)
    code, errors = rig.ended(rig.start("driver", scenario=path, backend="blind", **{"imperfections.speed_error": 0.03}))
    assert code == 2
    assert errors.startswith("driver: imperfections.speed_error: ") and "'simulated'" in errors
    rig.start_driver(path, backend="blind")
    (refused,) = rig.set_parameters([Parameter("imperfections.always_turn", value=[1])])
    assert not refused.successful and "imperfections.always_turn" in refused.reason


def test_a_sequencer_whose_first_sign_of_life_was_missed_is_seen(rig, scenario_path):
    process = rig.start("driver", code=DEAF_AT_FIRST, scenario=scenario_path(6))
    rig.wait(lambda: process.poll() is not None or (rig.statuses and not rig.statuses[-1].missing), "sight of this rig")
    assert process.poll() is None, process.stderr.read()
    rig.wait(rig.publisher.get_subscription_count, "the match of voltage_sequence")
    rig.send(encode(bench(6), PLAN))
    rig.state(DriverStatus.LOADED)
    assert rig.call("start").success
    rig.node.destroy_publisher(rig.life)
    assert rig.state(DriverStatus.FAULT).error_code == ErrorCode.PEER_LOST


DEAF_AT_FIRST = """
from stressbot_driver.ros import driver_node

callbacks, made = driver_node.SubscriptionEventCallbacks, []

def deaf_at_first(**events):
    made.append(events)
    return callbacks() if len(made) == 1 else callbacks(**events)

driver_node.SubscriptionEventCallbacks = deaf_at_first
driver_node.main()
"""


def make_blind_backend(folder):
    """Install a backend `blind` that is not the simulated one, though it does the same."""
    (folder / "blind.py").write_text(BLIND)
    information = folder / "blind-0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: blind\nVersion: 0\n")
    (information / "entry_points.txt").write_text("[stressbot_driver.backends]\nblind = blind:Blind\n")


BLIND = """
from stressbot_driver.backends.base import Backend, Progress
from stressbot_driver.sequence import Limits


class Blind(Backend):
    limits = Limits(0.0, 200.0)

    def upload(self, sequence): pass
    def start(self, pacing): pass
    def stop(self): pass
    def reset(self): pass
    def close(self): pass
    def progress(self): return Progress()
"""


def test_a_restarted_driver_is_not_handed_an_old_sequence(rig, scenario_path):
    path = scenario_path(6)
    first = rig.start_driver(path)
    rig.send(encode(bench(6), PLAN))
    rig.state(DriverStatus.LOADED)
    first.kill()
    rig.ended(first)
    with rig.heard:
        rig.statuses.clear()
        rig.descriptions.clear()
    rig.start_driver(path)
    assert rig.state(DriverStatus.IDLE).plan_id == ""
    assert not rig.call("start").success


@pytest.mark.timing
def test_a_thousand_poses_fifty_times_a_second_without_loss(rig, scenario_path):
    swarm = bench(1022)
    rig.start_driver(scenario_path(1022), auto_start=True)
    seconds = 3.0
    played = encode(swarm, [(4, seconds)])
    rig.send(played)
    done = rig.state(DriverStatus.DONE)
    rig.wait(lambda: rig.poses[-1].sequence_time == done.sequence_time, "the final poses")
    times = {round(message.sequence_time, 9) for message in rig.poses}
    missing = [k for k in range(1, int(played.duration * 50.0)) if round(k / 50.0, 9) not in times]
    assert not missing
    assert all(len(message.x) == 1022 for message in rig.poses)
    assert max(deviation(swarm, rig.poses[-1], [(4, seconds)])) < 1e-6


def test_five_thousand_robots_run(rig, scenario_path):
    swarm = bench(5000)
    rig.start_driver(scenario_path(5000), auto_start=True, real_time_factor=0, pose_rate=10.0)
    plan = [(1 + k % swarm.group_count, 1.0) for k in range(28)]
    rig.send(encode(swarm, plan))
    done = rig.state(DriverStatus.DONE)
    rig.wait(lambda: rig.poses[-1].sequence_time == done.sequence_time, "the final poses")
    assert max(deviation(swarm, rig.poses[-1], plan)) < 1e-6


def test_another_sign_of_life_does_not_hide_the_loss_of_a_sequencer(rig, scenario_path):
    rig.start_driver(scenario_path(6), auto_start=True)
    another = rig.node.create_publisher(SequencerStatus, "sequencer_status", living(0.03))
    rig.wait(another.get_subscription_count, "the driver")
    rig.send(encode(bench(6), [(4, 600.0)]))
    rig.state(DriverStatus.RUNNING)
    rig.node.destroy_publisher(rig.life)
    fault = rig.state(DriverStatus.FAULT)
    assert (fault.error_code, fault.output_level) == (ErrorCode.PEER_LOST, 0.0)


def test_beside_another_driver_nothing_is_loaded_or_started_and_the_stop_works(rig, scenario_path):
    swarm = bench(6)
    driver = rig.start_driver(scenario_path(6))
    other = rig.node.create_publisher(DriverStatus, "driver_status", LATCHED)
    rig.node.create_timer(0.05, lambda: other.publish(DriverStatus(state=DriverStatus.IDLE)))
    for number in range(1000):
        plan_id = f"try {number}"
        rig.send(encode(swarm, [(4, 600.0)], plan_id=plan_id))
        status = rig.status(lambda s, plan_id=plan_id: plan_id in (s.plan_id, s.refused_plan_id), "its word")
        if status.refused_plan_id == plan_id:
            break
    assert (status.error_code, status.output_level) == (ErrorCode.AMBIGUOUS_SWARM, 0.0)
    answer = rig.call("start")
    assert not answer.success and "more than one driver" in answer.message
    assert rig.call("stop").success
    assert rig.end(driver)[0] == 0


def test_the_log_tells_a_run_with_its_figures(rig, scenario_path):
    driver = rig.start_driver(scenario_path(6), real_time_factor=0)
    rig.send(encode(bench(6), PLAN, plan_id="told"))
    rig.state(DriverStatus.LOADED)
    assert rig.call("start").success
    rig.state(DriverStatus.DONE)
    assert not rig.call("start").success
    assert rig.call("reset").success
    rig.send(encode(bench(6), [(4, 600.0)], plan_id="broken off"))
    rig.state(DriverStatus.LOADED)
    assert rig.set_parameters([Parameter("real_time_factor", value=1.0)])[0].successful
    assert rig.call("start").success
    rig.status(lambda s: s.output_level == 140.0, "the drive")
    assert rig.call("stop").success
    log = rig.end(driver)[1]
    told = [
        r"INFO\] .*plan 'told' loaded: 6 epochs, \d+\.\d{3} s, up to 140 V",
        r"INFO\] .*plan 'told' started: 6 epochs, \d+\.\d{3} s, up to 140 V",
        r"INFO\] .*plan 'told' ended after \d+\.\d{3} s, 6 of 6 epochs",
        r"INFO\] .*reset: the robots are at their starts",
        r"INFO\] .*plan 'broken off' stopped after \d+\.\d{3} s, 0 of 1 epochs",
    ]
    assert re.search(".*".join(told), log, re.DOTALL), log
    assert re.search(r"WARN\] .*refused: start: no voltage sequence is loaded", log), log


@pytest.mark.parametrize("node", ["driver", "viewer", "instrument_emulator"])
def test_simulated_time_is_refused_at_the_start(rig, scenario_path, node):
    scenario = {} if node == "viewer" else {"scenario": scenario_path(2)}
    code, errors = rig.ended(rig.start(node, use_sim_time=True, **scenario))
    assert code == 2
    assert errors.startswith(f"{node}: use_sim_time: cannot be true") and errors.count("\n") == 1, errors


def test_simulated_time_is_refused_later_and_the_watches_hold(rig, scenario_path):
    rig.start_driver(scenario_path(6), auto_start=True)
    for state in (DriverStatus.IDLE, DriverStatus.RUNNING):
        (refused,) = rig.set_parameters([Parameter("use_sim_time", value=True)])
        assert not refused.successful and "sequence_time" in refused.reason
        (kept,) = rig.set_parameters([Parameter("use_sim_time", value=False)])
        assert kept.successful
        if state == DriverStatus.IDLE:
            rig.send(encode(bench(6), [(4, 600.0)]))
            rig.state(DriverStatus.RUNNING)
    rig.node.destroy_publisher(rig.life)
    assert rig.state(DriverStatus.FAULT).error_code == ErrorCode.PEER_LOST
