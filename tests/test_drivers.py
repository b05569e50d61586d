"""Who hears more than one driver refuses, and a driver's word lasts no longer than the driver."""

import os
import signal
import time
import uuid

import numpy as np
import pytest
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmDescription, SwarmPoses
from stressbot_msgs.msg import Primitive as PrimitiveMsg
from system_rig import ENTRIES, SCENARIOS, TIMEOUTS, System
from three_robots import SCENARIO as THREE

from stressbot_planner.errors import ErrorCode
from stressbot_planner.ros.bringup import NodeEntry, command
from stressbot_planner.ros.planner_node import FRESH
from stressbot_planner.ros.qos import LATCHED, ORDERS

pytestmark = [pytest.mark.xdist_group("drivers"), pytest.mark.timeout(300)]

UNIT = 1e-4
SIX = SCENARIOS / "paper-six-two-discs.yaml"


@pytest.fixture(scope="module")
def system(new_system):
    """Everybody who listens to a driver, and the driver."""
    system = new_system(nodes=("driver", "sequencer", "planner", "viewer"), scenario=SIX, real_time_factor=0.0)
    relay = command(NodeEntry("stressbot_planner", "tracker_relay"), {}, namespace=system.namespace)
    system.processes.start("tracker_relay", relay)
    system.plans = system.client.node.create_publisher(MotionPlan, "motion_plan", ORDERS)
    system.wait_for(system.plans.get_subscription_count, "sequencer")
    return system


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(THREE)
    return path


def start_second(system: System, scenario):
    """Another driver, under another name for the rig."""
    parameters = {"scenario": scenario} | TIMEOUTS
    system.processes.start("rival", command(ENTRIES["driver"], parameters, namespace=system.namespace))
    system.wait_for(lambda: system.client.drivers == 2, "the second driver")


def send(system, **fields):
    """Publish a plan, and return what the sequencer says of it."""
    step = PrimitiveMsg(kind=PrimitiveMsg.ACTIVATE, group=1, distance=UNIT)
    plan = MotionPlan(plan_id=uuid.uuid4().hex, planner="test", primitives=[step], **fields)
    system.plans.publish(plan)
    system.wait_for(lambda: system.client.sequencer_status.plan_id == plan.plan_id, "word of the sequencer")
    return system.client.sequencer_status


def everybody_agrees(system, swarm_id):
    """Wait until there is one driver again, and everybody knows its swarm: it loads what is planned."""
    client = system.client
    system.wait_for(lambda: client.description and client.description.swarm_id == swarm_id, "one description")
    system.wait_for(lambda: client.sequencer_status.swarm_id == swarm_id, "the sequencer's swarm")

    def loaded():
        answer = system.plan(planner="pure_control")
        assert answer.success, answer.error_msg
        assert answer.plan.swarm_id == swarm_id
        plan_id = answer.plan.plan_id
        system.wait_for(lambda: plan_id in (client.driver_status.plan_id, client.driver_status.refused_plan_id), "its word")
        return client.driver_status.plan_id == plan_id

    system.wait_for(loaded, "loading")  # the driver may hear a moment later than others that it is alone


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("other", ["another scenario", "the same scenario"])
def test_two_drivers_are_refused_by_all_and_the_survivor_is_heard_again(system, three, end, other):
    mine = system.client.description.swarm_id
    said = {name: len(system.log(name)) for name in ("planner", "sequencer", "viewer", "tracker_relay", "driver")}
    start_second(system, three if other == "another scenario" else SIX)
    answer = system.plan()
    assert (answer.success, answer.error_code) == (False, ErrorCode.AMBIGUOUS_SWARM), answer.error_msg
    assert "stop all but one" in answer.error_msg
    status = send(system, swarm_id=mine)
    assert (status.error_code, status.epoch_count) == (ErrorCode.AMBIGUOUS_SWARM, 0), status.error_msg
    for name, before in said.items():
        system.wait_for(lambda name=name, before=before: "more than one driver" in system.log(name)[before:], f"word of {name}")
    system.processes.stop("rival", end)
    everybody_agrees(system, mine)
    system.reset()


def test_the_first_of_two_drivers_may_be_the_one_that_ends(system, three):
    mine = system.client.description.swarm_id
    start_second(system, three)
    system.processes.stop("driver", signal.SIGKILL)
    system.wait_for(lambda: system.client.description and system.client.description.swarm_id != mine, "the other description")
    everybody_agrees(system, system.client.description.swarm_id)
    system.processes.stop("rival")
    system.start("driver", scenario=SIX, real_time_factor=0.0)
    system.wait_for(system.client.is_system_ready, "a driver again")
    everybody_agrees(system, mine)
    system.reset()


def test_a_description_dies_with_a_driver_that_is_killed(system):
    mine = system.client.description.swarm_id
    system.processes.stop("driver", signal.SIGKILL)
    system.wait_for(lambda: system.client.description is None, "its end")  # how soon: test_described.py
    answer = system.plan()
    assert (answer.success, answer.error_code) == (False, ErrorCode.NO_SWARM), answer.error_msg
    system.wait_for(lambda: system.client.sequencer_status.error_code == ErrorCode.NO_SWARM, "word of the sequencer")
    assert send(system, swarm_id=mine).error_code == ErrorCode.NO_SWARM
    system.start("driver", scenario=SIX, real_time_factor=0.0)
    system.wait_for(system.client.is_system_ready, "a driver again")
    everybody_agrees(system, mine)
    system.reset()


def test_a_driver_killed_while_it_runs_is_not_running_any_more(system):
    system.processes.stop("driver", signal.SIGKILL)
    system.wait_for(lambda: system.client.description is None, "its end")
    system.start("driver", scenario=SIX, real_time_factor=1.0)
    system.wait_for(system.client.is_system_ready, "a slow driver")
    plan = system.plan(planner="pure_control")
    system.wait_until_loaded(plan.plan.plan_id)
    assert system.client.trigger("start").success
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.RUNNING, "a run")
    assert system.plan().error_code == ErrorCode.BUSY
    system.processes.stop("driver", signal.SIGKILL)
    system.wait_for(lambda: system.client.description is None, "its end")
    assert system.plan().error_code == ErrorCode.NO_SWARM
    system.start("driver", scenario=SIX, real_time_factor=0.0)
    system.wait_for(system.client.is_system_ready, "a driver again")


def test_a_frozen_driver_is_gone_until_it_goes_on(system):
    mine = system.client.description.swarm_id
    pid = system.processes._running["driver"].pid
    os.kill(pid, signal.SIGSTOP)
    try:
        system.wait_for(lambda: system.client.description is None, "its end")
        assert system.plan().error_code == ErrorCode.NO_SWARM
    finally:
        os.kill(pid, signal.SIGCONT)
    everybody_agrees(system, mine)
    system.reset()


# Poses


@pytest.fixture(scope="module")
def played(new_system, system):
    """A planner alone, and a driver that this test plays: poses come when `say` is called."""
    lonely = new_system(nodes=("planner",))
    lonely.wait_for(lambda: lonely.client.is_ready("plan_motion") and lonely.client.has_met("planner"), "planner")
    descriptions = lonely.client.node.create_publisher(SwarmDescription, "swarm_description", LATCHED)
    poses = lonely.client.node.create_publisher(SwarmPoses, "swarm_poses", 10)
    description = system.client.description
    descriptions.publish(description)
    start = np.asarray(description.start).reshape(-1, 3)
    columns = {name: start[:, column].tolist() for column, name in enumerate(("x", "y", "heading"))}

    def say():
        poses.publish(SwarmPoses(swarm_id=description.swarm_id, ids=description.ids, **columns))

    lonely.wait_for(poses.get_subscription_count, "planner")
    lonely.wait_for(lambda: "swarm " + description.swarm_id in lonely.log("planner"), "the description")
    return lonely, say


def test_poses_that_come_no_more_are_refused(played):
    lonely, say = played

    def planned():
        say()
        return lonely.plan(planner="pure_control").error_code == ErrorCode.NOT_HEARD  # planned: there is no sequencer here

    lonely.wait_for(planned, "a plan from fresh poses")
    # Asked again until they are too old, also for an interval between two of ours that was long.
    answer = lonely.wait_for(
        lambda: (answer := lonely.plan(planner="pure_control")).error_code == ErrorCode.STALE_POSES and answer, "the refusal"
    )
    assert "does the tracker" in answer.error_msg
    lonely.wait_for(planned, "a plan from fresh poses again")


def test_poses_that_come_rarely_are_fresh_for_some_of_their_periods(played):
    lonely, say = played

    def planned():
        say()
        time.sleep(1.3 * FRESH)  # older than that when the planner is asked
        return lonely.plan(planner="pure_control").error_code == ErrorCode.NOT_HEARD

    lonely.wait_for(planned, "a plan, once the planner knows how rarely they come")
