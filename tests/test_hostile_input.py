"""Hostile input: the campaign of `make fuzz` in a short form, and what it has found, once each."""

import json
import threading
from array import array
from functools import partial

import pytest
from fuzzing import files, generated, guided, instruments, loops, nodes, orders, pictures, settings, volts
from fuzzing.interface import ACCEPTED, DEADLINE, Final, Interface, Violation, outcome
from hypothesis import strategies as st
from stressbot_msgs.msg import MotionPlan, Obstacle, Primitive, SwarmDescription, SwarmPoses, VoltageSequence
from stressbot_msgs.srv import PlanMotion

from stressbot_driver.clock import WallClock
from stressbot_planner.errors import ErrorCode, StressbotError

MODULES = files, orders, volts, instruments, settings, pictures, loops
INTERFACES = tuple(interface for module in MODULES for interface in module.INTERFACES)
FEW = 60
CONSTANT = volts.BENCHES["constant drive"]
OVER_DDS = (
    "swarm_description", "malformed messages, bytes", "motion_plan", "voltage_sequence", "plan_motion_action", "set_parameters"
)


@pytest.mark.parametrize("interface", INTERFACES, ids=lambda interface: interface.name)
def test_a_little_of_the_campaign(interface):
    tally = generated.campaign(interface, FEW if interface.weight >= 0.5 else FEW // 4, 0)
    assert not tally.violations, tally.violations[0]
    assert tally.inputs
    assert len(tally.outcomes) > 1  # otherwise the inputs are all alike


@pytest.mark.xdist_group("hostile nodes")
def test_a_little_of_the_campaign_over_dds(tmp_path):
    running = nodes.Nodes(tmp_path)
    try:
        chosen = [interface for interface in nodes.interfaces(running) if interface.name in OVER_DDS]
        assert len(chosen) == len(OVER_DDS)
        for interface in chosen:
            tally = generated.campaign(interface, FEW // 2, 0, "DDS")
            assert not tally.violations, tally.violations[0]
        running.run_a_good_one()
    finally:
        running.system.close()


@pytest.mark.xdist_group("hostile nodes")
def test_a_few_closed_loops_over_dds():
    for tally in loops.campaign(8, 0, sizes=(1, 6), time_limit=2.0):
        assert tally.inputs == 4 and not tally.violations, tally.violations[0]


# The campaign would notice


def test_the_campaign_tells_crashes_hangs_empty_refusals_and_unsafe_volts():
    crash = generated.campaign(Interface("crash", st.integers(0, 9), lambda number: str(1 // (number - 7))), 100, 0)
    assert "ZeroDivisionError" in crash.violations[0] and "value=7" in crash.violations[0]

    def deaf():
        for _ in range(2):
            try:
                while True:
                    pass
            except Exception:
                pass

    quick = pytest.MonkeyPatch()
    with quick.context() as patch:
        patch.setattr("fuzzing.interface.DEADLINE", 0.1)
        with pytest.raises(Final, match="hangs"):
            Interface("hang", None, lambda _: deaf())(None)
    nameless = StressbotError(ErrorCode.OUT_OF_RANGE, "", "is wrong")
    with pytest.raises(Violation, match="no field"):
        outcome(lambda: (_ for _ in ()).throw(nameless))
    with pytest.raises(BaseException, match="on the substrate"):
        volts.Witness(CONSTANT).hold(200.1, 1.0)
    assert DEADLINE >= 1.0


def test_a_sequence_beyond_the_limits_that_no_check_stops_is_noticed_on_the_substrate(monkeypatch):
    monkeypatch.setattr("stressbot_driver.session.check_sequence", lambda *_: None)
    message = volts.good_message(CONSTANT)
    message.levels[3] = 250.0
    with pytest.raises(Violation, match="250"):
        volts.on_substrate(CONSTANT, message)


@pytest.mark.parametrize("bench", volts.BENCHES.values(), ids=volts.BENCHES)
def test_the_good_sequence_runs_on_both_backends(bench):
    for attempt in (volts.on_substrate, volts.on_generator):
        assert attempt(bench, volts.good_message(bench)) == ACCEPTED


def test_a_pulse_beyond_the_limits_is_noticed(monkeypatch):
    bench = volts.BENCHES["alternating pulses"]
    for check in ("check_sequence", "check_drive"):
        monkeypatch.setattr(f"stressbot_driver.session.{check}", lambda *_: None)
    message = volts.good_message(bench)
    train = message.pulses.index(next(count for count in message.pulses if count))
    message.levels[train] = 155.0
    with pytest.raises(Violation, match="155"):
        volts.on_substrate(bench, message)


def test_targets_of_the_guided_fuzzer_are_ready():
    for target in guided.TARGETS.values():
        attempt, seeds, tokens = target.load()
        assert {attempt(seed) for seed in seeds} and tokens
    assert sum(target.share for target in guided.TARGETS.values()) == pytest.approx(1.0)


# Found


@pytest.mark.parametrize(
    "text", ["!!bool x: 1", "- !!int ''", "!!timestamp x", "!!float ''", "!!omap [a]"]
)
def test_yaml_that_its_library_stumbles_over(text):
    assert files.read_by_planner(text) == files.read_by_driver(text) == "MALFORMED_FILE"


def test_a_key_without_a_name():
    text = files.as_yaml({**files.FULL, "": None})
    assert files.read_by_planner(text) == files.read_by_driver(text) == "UNKNOWN_FIELD"


def test_a_plan_file_of_few_bytes_that_unfolds_without_end():
    turn = {"kind": "Turn", "group": 1, "angle": 3.0, "excursion": 1e-5}
    assert files.read_plan(json.dumps({**files.PLAN, "primitives": [turn] * 1000})) == "INVALID_PLAN"


def test_descriptions_of_nobody_and_of_half_an_obstacle():
    electrical = orders.DESCRIPTION.electrical
    nobody = SwarmDescription(length_unit=1e-4, electrical=electrical)
    assert orders.described(nobody) == "NO_ROBOTS"
    assert orders.viewed(nobody) == "WRONG_COUNT"
    fields = {name: getattr(orders.DESCRIPTION, name) for name in SwarmDescription.get_fields_and_field_types()}
    half = SwarmDescription(**{**fields, "obstacles": [Obstacle(kind=Obstacle.CIRCLE, y=[1.0], radius=1.0)]})
    assert orders.described(half) == orders.viewed(half) == "WRONG_COUNT"


def test_poses_that_lack_a_heading():
    poses = SwarmPoses(ids=[1], x=[0.0], y=[0.0])
    assert orders.looked_at(poses) == "WRONG_COUNT"


def test_one_robot_fifteen_times_among_thirty_groups():
    twice = Primitive(kind=Primitive.ORIENT, robots=[1] * 15, angles=[0.1] * 15)
    plan = MotionPlan(plan_id="plan", swarm_id=orders.MANY.swarm_id, primitives=[twice])
    within_deadline = Interface("motion_plan", None, partial(orders.sequenced, orders.MANY))
    assert within_deadline(plan) == "INVALID_PLAN"  # it took days


def test_a_time_limit_that_nobody_can_wait_for():
    assert orders.asked(PlanMotion.Request(time_limit=3601.0)) == "OUT_OF_RANGE"
    assert orders.asked(PlanMotion.Request(time_limit=3600.0)) == ACCEPTED


def test_a_limit_of_tries_is_that_of_the_planner():
    asked = orders.task_of_request(PlanMotion.Request(max_tries=7), orders.SCENE, orders.POSES, "optimize")
    assert asked.settings.max_tries == 7
    asked = orders.task_of_request(PlanMotion.Request(), orders.SCENE, orders.POSES, "optimize")
    assert asked.settings.max_tries is None


def test_a_level_for_thirty_years():
    years = VoltageSequence(
        plan_id="plan", swarm_id=CONSTANT.swarm_id, levels=array("d", [140.0, 0.0]), dwells=array("d", [1e9, 1.0]),
        epoch_ends=array("I", [2]), duration=1e9 + 1.0,
    )
    assert volts.on_generator(CONSTANT, years) == "LIMIT_EXCEEDED"
    assert volts.on_substrate(CONSTANT, years) == ACCEPTED


def test_a_clock_waits_for_moments_that_threads_cannot_wait_for():
    clock, wake = WallClock(), threading.Event()
    threading.Timer(0.05, wake.set).start()
    assert clock.wait_until(clock.now() + 1e300, wake)


def test_interfaces_have_names_of_their_own():
    assert len({interface.name for interface in INTERFACES}) == len(INTERFACES)
