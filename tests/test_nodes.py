"""The three nodes as processes over DDS: every refusal on the wire, and how the nodes live and die."""

import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
import uuid
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from stressbot_msgs.action import PlanMotion as PlanMotionAction
from stressbot_msgs.msg import DriverStatus, MotionPlan, SequencerStatus, SwarmDescription, SwarmPoses
from stressbot_msgs.msg import Primitive as PrimitiveMsg
from stressbot_msgs.srv import PlanMotion
from system_rig import DEADLINE, NEAR, SCENARIOS, asking_again

from stressbot_planner.errors import ErrorCode
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners import LONGEST_REQUEST
from stressbot_planner.ros import conversion, planner_node
from stressbot_planner.ros.client import SwarmClient
from stressbot_planner.ros.qos import LATCHED, LIVING, ORDERS

pytestmark = pytest.mark.xdist_group("nodes")

UNIT = 1e-4
HOPELESS = {"planner": "rrt", "tolerance": 0.031 * UNIT}
"""A tree that must come within a tenth of a body of its goals grows for as long as it may."""


@pytest.fixture(scope="module")
def system(new_system):
    return new_system(scenario=SCENARIOS / "paper-six-two-discs.yaml", real_time_factor=0.0)


# What plan_motion refuses


@pytest.mark.parametrize(
    ("request_", "code", "text"),
    [
        ({"robots": [7], "goal_x": [0.0], "goal_y": [0.0]}, ErrorCode.UNKNOWN_ROBOT, "robots 1 to 6"),
        ({"robots": [0], "goal_x": [0.0], "goal_y": [0.0]}, ErrorCode.UNKNOWN_ROBOT, "robots 1 to 6"),
        ({"robots": [2, 2], "goal_x": [1e-3, 1e-3], "goal_y": [1e-3, 1e-4]}, ErrorCode.DUPLICATE_GOAL, r"robots\[1\]"),
        ({"robots": [1], "goal_x": [math.nan], "goal_y": [0.0]}, ErrorCode.NOT_FINITE, r"goal_x\[0\]"),
        ({"robots": [1], "goal_x": [0.0], "goal_y": [-math.inf]}, ErrorCode.NOT_FINITE, r"goal_y\[0\]"),
        ({"robots": [1], "goal_x": [3e-3], "goal_y": [1e-3]}, ErrorCode.OUTSIDE_WORKSPACE, "goal of robot 1"),
        ({"robots": [3], "goal_x": [8e-4], "goal_y": [6.5e-4]}, ErrorCode.INSIDE_OBSTACLE, "goal of robot 3"),
        ({"robots": [1, 2], "goal_x": [1e-3, 1e-3], "goal_y": [1e-3, 1.01e-3]}, ErrorCode.GOALS_TOO_CLOSE, "goal of robot 2"),
        ({"robots": [1], "goal_x": [2e-4], "goal_y": [5.3e-4]}, ErrorCode.GOALS_TOO_CLOSE, "goal of robot"),
        ({"robots": [1], "goal_x": [], "goal_y": [0.0]}, ErrorCode.WRONG_COUNT, "goal_x"),
        ({"robots": [1, 2], "goal_x": [1e-3, 1e-3], "goal_y": [0.0]}, ErrorCode.WRONG_COUNT, "goal_y"),
        (
            {"robots": [1, 2], "goal_x": [1e-3, 1e-3], "goal_y": [1e-3, 1.01e-3], "assign": True},
            ErrorCode.GOALS_TOO_CLOSE,
            "goal of robot 2",
        ),
        ({"goal_x": [1e-3], "goal_y": [1e-3]}, ErrorCode.WRONG_COUNT, "goal_x"),
        ({"robots": [1], "goal_x": [1e-3], "goal_y": [1e-3], "goal_heading": [0.0, 1.0]}, ErrorCode.WRONG_COUNT, "goal_heading"),
        (
            {"robots": [1], "goal_x": [1e-3], "goal_y": [1e-3], "goal_heading": [math.inf]},
            ErrorCode.NOT_FINITE,
            r"goal_heading\[0\]",
        ),
        (
            {
                "robots": [1, 2, 3, 4, 5], "goal_x": [1.4e-3] * 5, "goal_y": [k * 2e-4 for k in range(1, 6)],
                "goal_heading": [0.0] * 5,
            },
            ErrorCode.INFEASIBLE,
            r"goal_heading\[4\]: the goal of robot 5 has a heading that follows from the ones of robots",
        ),
        ({"tolerance": 0.0}, ErrorCode.OUT_OF_RANGE, "tolerance"),
        ({"tolerance": -1e-6}, ErrorCode.OUT_OF_RANGE, "tolerance"),
        ({"tolerance": math.nan}, ErrorCode.NOT_FINITE, "tolerance"),
        ({"time_limit": 0.0}, ErrorCode.OUT_OF_RANGE, "time_limit"),
        ({"time_limit": -1.0}, ErrorCode.OUT_OF_RANGE, "time_limit"),
        ({"time_limit": math.inf}, ErrorCode.NOT_FINITE, "time_limit"),
        ({"planner": "magic"}, ErrorCode.UNKNOWN_PLANNER, "optimize.*pure_control"),
        ({"objective": "beauty"}, ErrorCode.UNKNOWN_OBJECTIVE, "path, time"),
        ({"planner": "rrt", "tolerance": 1e-10}, ErrorCode.UNSUPPORTED, "tolerance"),
        ({**HOPELESS, "time_limit": 0.2}, ErrorCode.NO_PLAN_FOUND, r"rrt: .* leaves a robot 0\.0\d+ m from its goal"),
        ({**HOPELESS, "time_limit": LONGEST_REQUEST, "max_tries": 20}, ErrorCode.NO_PLAN_FOUND, "rrt: .*within 20 tries"),
        # in metres, by the request's fields
        ({"planner": "sequential"}, ErrorCode.UNSUPPORTED, "tolerance: is 1e-10 m: .* give 3e-06 m or more"),
        ({"tolerance": 0.03}, ErrorCode.OUT_OF_RANGE, "tolerance: is 0.03 m, larger than .*0.00283 m"),
        ({"tolerance": math.inf}, ErrorCode.NOT_FINITE, "tolerance"),
        ({"min_clearance": 0.03}, ErrorCode.OUT_OF_RANGE, "min_clearance: is 0.03 m, larger than .*0.00283 m"),
        ({"min_clearance": 5e-4}, ErrorCode.OUT_OF_RANGE, "min_clearance: is 0.0005 m, but a start leaves only 0.00017 m "),
        ({"min_clearance": -1.0}, ErrorCode.OUT_OF_RANGE, "min_clearance: is -1.0"),
        ({"min_clearance": math.nan}, ErrorCode.OUT_OF_RANGE, "min_clearance: is nan"),
        ({"time_limit": 3601.0}, ErrorCode.OUT_OF_RANGE, "time_limit: is 3601 s: give at most 3600 s"),
        ({"time_limit": 1e300}, ErrorCode.OUT_OF_RANGE, "time_limit: is 1e.300 s: give at most 3600 s"),
        ({"planner": "parallel", "tolerance": 1e-4, "order": 99}, ErrorCode.OUT_OF_RANGE, "order: is 99: .* 1 to 3"),
        ({"planner": "x" * 1_000_000}, ErrorCode.LIMIT_EXCEEDED, "planner: has 1000000 characters"),
        ({"planner": "x" * 200}, ErrorCode.UNKNOWN_PLANNER, "planner: is 'x+…x+': use one of"),
        ({"objective": "9" * 1_000_000}, ErrorCode.LIMIT_EXCEEDED, "objective: has 1000000 characters"),
        ({"objective": "9" * 200}, ErrorCode.UNKNOWN_OBJECTIVE, "objective: is '9+…9+': use"),
        ({"objective": ""}, ErrorCode.UNKNOWN_OBJECTIVE, "objective: is ''"),
        (
            {"robots": [1], "goal_x": [1e-3, 2e-3], "goal_y": [1e-3]},
            ErrorCode.WRONG_COUNT,
            "goal_y: has 1 entries for 1 robots and 2 stages",
        ),
        (
            {"robots": [1], "goal_x": [1e-3, 1e-3], "goal_y": [8.0, 1e-3]},
            ErrorCode.OUTSIDE_WORKSPACE,
            r"goal_x\[0\], goal_y\[0\]: the waypoint of robot 1 at x 0.001 m",
        ),
        (
            {"robots": [1], "goal_x": [1e-3], "goal_y": [1e-3], "parked": [1]},
            ErrorCode.DUPLICATE_GOAL,
            r"robots\[0\]: is 1, which is parked",
        ),
        ({"parked": [9]}, ErrorCode.UNKNOWN_ROBOT, r"parked\[0\]: is 9"),
        (
            {"parked": [2, 3]},
            ErrorCode.INFEASIBLE,
            r"parked\[0\]: robot 2 is parked, and robot 1 is in no group that leaves out robots 2, 3",
        ),
        ({"robots": [1], "goal_x": [1e-3] * 102, "goal_y": [1e-3] * 102}, ErrorCode.LIMIT_EXCEEDED, "goal_x: has 102 stages"),
        (
            {"robots": [5, 1], "goal_x": [1e-3, 8.0], "goal_y": [1e-3, 2.0]},
            ErrorCode.OUTSIDE_WORKSPACE,
            r"goal_x\[1\], goal_y\[1\]: the goal of robot 1 at x 8 m, y 2 m puts a body of radius 3e-05 m by",
        ),
        (
            {"robots": [1, 2], "goal_x": [1e-3, 1e-3], "goal_y": [1e-3, 1.01e-3]},
            ErrorCode.GOALS_TOO_CLOSE,
            r"goal_x\[1\], goal_y\[1\]: the goal of robot 2 is 1e-05 m from the goal of robot 1: the two bodies need 6e-05 m",
        ),
    ],
)
def test_a_bad_request_gets_its_own_code_and_says_what_to_change(system, request_, code, text):
    answer = system.plan(**request_)
    assert not answer.success
    assert ErrorCode(answer.error_code) == code, answer.error_msg
    assert not answer.plan.primitives
    assert re.search(text, answer.error_msg), answer.error_msg
    assert "unit" not in answer.error_msg and len(answer.error_msg) < 400


def test_headings_of_a_request_are_met(system):
    asked = {"robots": [2, 5], "goal_x": [1.4e-3, 1.4e-3], "goal_y": [1.8e-3, 1e-3], "goal_heading": [1.0, math.nan]}
    answer = system.plan(**asked, first=True)
    assert answer.success, answer.error_msg
    turned = np.reshape(answer.plan.predicted, (6, 3))[1, 2] - 1.0
    assert abs(math.remainder(turned, 2 * math.pi)) < 1e-3
    np.testing.assert_array_equal(answer.plan.goal_heading, [math.nan, 1.0, *[math.nan] * 4])


def test_goals_in_stages_of_a_request_are_met_in_one_plan(system):
    asked = {"robots": [2, 5], "goal_x": [5e-4, 5e-4, 1.4e-3, 1.4e-3], "goal_y": [1e-3, 5e-4, 1.8e-3, 1e-3]}
    answer = system.plan(**asked, first=True)
    assert answer.success, answer.error_msg
    np.testing.assert_allclose(np.reshape(answer.plan.goal, (6, 2))[[1, 4]], [[1.4e-3, 1.8e-3], [1.4e-3, 1e-3]])
    groups, lengths = [p.group for p in answer.plan.primitives], [p.distance * 1e4 for p in answer.plan.primitives]
    swarm = scenario.load(SCENARIOS / "paper-six-two-discs.yaml").swarm
    poses = replay(swarm, np.reshape(answer.plan.start, (6, 3)) * [1e4, 1e4, 1.0], np.array(groups), np.array(lengths))
    away = np.hypot(*np.moveaxis(poses[:, [1, 4], :2] - [[5.0, 10.0], [5.0, 5.0]], 2, 0)).max(axis=1)
    assert away.min() < 1e-3


def test_a_second_plan_while_one_is_made_is_refused_and_planning_goes_on_when_its_process_dies(system):
    service = system.client._services["plan_motion"]
    answer = service.call_async(PlanMotion.Request(**HOPELESS, time_limit=LONGEST_REQUEST))
    node = system.processes._running["planner"].pid
    children = Path(f"/proc/{node}/task/{node}/children")
    # Killed only once it is planning: a refused second request proves that the first has arrived.
    system.wait_for(lambda: system.plan().error_code == ErrorCode.BUSY, "the plan to be in the making")
    assert not answer.done()
    whose = r"for a call of plan_motion \(the scenario's goals, time_limit 3600 s\) since \d+\.\d s"
    assert re.search(whose, system.plan().error_msg)
    os.kill(int(children.read_text().split()[0]), signal.SIGKILL)
    system.wait_for(answer.done, "answer")
    assert ErrorCode(answer.result().error_code) == ErrorCode.INTERNAL
    assert system.plan().success


# What the sequencer refuses


def make_plan(system, *primitives, **fields):
    values = {"plan_id": uuid.uuid4().hex, "swarm_id": system.client.description.swarm_id, "planner": "test"}
    return MotionPlan(**{**values, "primitives": list(primitives), **fields})


def activation(**fields):
    return PrimitiveMsg(**{"kind": PrimitiveMsg.ACTIVATE, "group": 1, "distance": UNIT, **fields})


@pytest.fixture(scope="module")
def send_plan(system):
    """Return a function that publishes a plan and returns what the sequencer says of it."""
    publisher = system.client.node.create_publisher(MotionPlan, "motion_plan", ORDERS)
    system.wait_for(lambda: publisher.get_subscription_count() == 1, "connection to the sequencer")

    def send(plan):
        publisher.publish(plan)
        system.wait_for(lambda: system.client.sequencer_status.plan_id == plan.plan_id, "status of the sequencer")
        return system.client.sequencer_status

    return send


@pytest.mark.parametrize(
    ("primitive", "fields", "code"),
    [
        ({}, {"swarm_id": "another"}, ErrorCode.WRONG_SWARM),
        ({"group": 5}, {}, ErrorCode.UNKNOWN_GROUP),
        ({"group": 0}, {}, ErrorCode.UNKNOWN_GROUP),
        ({"kind": PrimitiveMsg.TRANSLATE, "group": 4}, {}, ErrorCode.UNKNOWN_GROUP),
        ({"kind": 0}, {}, ErrorCode.INVALID_PLAN),
        ({"kind": 200}, {}, ErrorCode.INVALID_PLAN),
        ({"distance": math.nan}, {}, ErrorCode.NOT_FINITE),
        ({"distance": math.inf}, {}, ErrorCode.NOT_FINITE),
        ({"distance": -UNIT}, {}, ErrorCode.OUT_OF_RANGE),
        ({"kind": PrimitiveMsg.TURN, "angle": math.nan}, {}, ErrorCode.NOT_FINITE),
        ({"kind": PrimitiveMsg.TURN, "angle": 1.0, "excursion": 1e-300}, {}, ErrorCode.OUT_OF_RANGE),
        ({"kind": PrimitiveMsg.ORIENT, "robots": [9], "angles": [1.0]}, {}, ErrorCode.UNKNOWN_ROBOT),
        ({"kind": PrimitiveMsg.ORIENT, "robots": [1, 2], "angles": [1.0]}, {}, ErrorCode.WRONG_COUNT),
        ({"kind": PrimitiveMsg.ISOLATE}, {}, ErrorCode.WRONG_COUNT),
    ],
)
def test_a_bad_plan_is_refused_where_everybody_can_read_it(system, send_plan, primitive, fields, code):
    plan = make_plan(system, activation(**primitive), **fields)
    status = send_plan(plan)
    assert ErrorCode(status.error_code) == code, status.error_msg
    assert status.epoch_count == 0
    assert status.error_msg
    assert system.client.sequence is None or system.client.sequence.plan_id != plan.plan_id


def test_a_good_plan_becomes_a_sequence_that_the_driver_loads(system, send_plan):
    plan = make_plan(system, activation(), activation(group=4, distance=2 * UNIT))
    status = send_plan(plan)
    assert status.error_code == ErrorCode.NONE, status.error_msg
    assert status.epoch_count == 2
    system.wait_until_loaded(plan.plan_id)
    assert system.client.driver_status.duration == pytest.approx(status.duration)


def test_a_plan_of_nothing_is_no_sequence(system, send_plan):
    plan = make_plan(system)
    status = send_plan(plan)
    assert (status.error_code, status.epoch_count) == (ErrorCode.NONE, 0)
    assert system.client.sequence is None or system.client.sequence.plan_id != plan.plan_id


# A plan while the robots move; plans from where they are


def set_parameter(system, node, name, value):
    client = AsyncParameterClient(system.client.node, f"{system.namespace}/{node}")
    system.wait_for(client.services_are_ready, f"parameters of {node}")
    future = client.set_parameters([Parameter(name, value=value)])
    system.wait_for(future.done, "answer")
    return future.result().results[0]


def test_no_plan_is_made_while_a_sequence_runs_and_the_next_starts_where_the_robots_are(system):
    assert set_parameter(system, "driver", "real_time_factor", 1.0).successful
    first = system.plan()
    assert first.success, first.error_msg
    system.wait_until_loaded(first.plan.plan_id)
    assert system.client.trigger("start").success
    system.wait_for(lambda: system.client.driver_status.epoch >= 1, "first epoch")
    busy = system.plan()
    assert ErrorCode(busy.error_code) == ErrorCode.BUSY
    assert first.plan.plan_id in busy.error_msg
    assert system.client.trigger("stop").success
    system.wait_for(system.has_reached(DriverStatus.STOPPED, first.plan.plan_id), "stop")
    poses = system.poses_after(system.client.driver_status.header.stamp)
    second = system.plan(planner="pure_control")
    assert second.success, second.error_msg
    start, _ = conversion.poses_from_plan(second.plan, conversion.scene_from_description(system.client.description))
    np.testing.assert_allclose(start, poses, atol=1e-12)
    assert not np.allclose(
        start, conversion.poses_from_plan(first.plan, conversion.scene_from_description(system.client.description))[0], atol=1e-3
    )
    system.reset()
    assert set_parameter(system, "driver", "real_time_factor", 0.0).successful


def test_robots_that_are_not_named_keep_their_place(system):
    answer = system.plan(planner="pure_control", robots=[3], goal_x=[2e-4], goal_y=[1e-4 * 10.0])
    assert answer.success, answer.error_msg
    poses, scene = system.execute(answer.plan)
    np.testing.assert_allclose(poses[2, :2], [2.0, 10.0], atol=NEAR)
    others = [k for k in range(6) if k != 2]
    np.testing.assert_allclose(poses[others, :2], scene.starts[others, :2], atol=NEAR)
    system.reset()


def goals_in_force(answer):
    return np.asarray(answer.plan.goal).reshape(-1, 2)


def test_robots_that_may_take_each_others_goals_take_the_better_ones(system):
    scene = conversion.scene_from_description(system.client.description)
    # as asked for, robots 1 and 2 would cross to each other's side
    crossed = {"robots": [1, 2], "goal_x": [4e-4, 4e-4], "goal_y": [5.2e-4, 2.0e-4], "planner": "pure_control"}
    fixed, free = system.plan(**crossed), system.plan(**crossed, assign=True)
    assert fixed.success and free.success, (fixed.error_msg, free.error_msg)
    np.testing.assert_allclose(goals_in_force(fixed)[:2], [[4e-4, 5.2e-4], [4e-4, 2.0e-4]])
    np.testing.assert_allclose(goals_in_force(free)[:2], [[4e-4, 2.0e-4], [4e-4, 5.2e-4]])
    np.testing.assert_allclose(goals_in_force(free)[2:], scene.starts[2:, :2] * scene.unit)
    poses, _ = system.execute(free.plan)
    np.testing.assert_allclose(poses[:2, :2], [[4, 2], [4, 5.2]], atol=NEAR)
    system.reset()


def test_all_goals_of_the_scenario_may_be_exchanged(system):
    scene = conversion.scene_from_description(system.client.description)
    fixed, free = (system.plan(planner="pure_control", assign=assign) for assign in (False, True))
    assert fixed.success and free.success, (fixed.error_msg, free.error_msg)
    np.testing.assert_allclose(goals_in_force(fixed), scene.goals * scene.unit)
    assert not np.allclose(goals_in_force(free), goals_in_force(fixed))
    np.testing.assert_allclose(sorted(goals_in_force(free).tolist()), sorted((scene.goals * scene.unit).tolist()))
    np.testing.assert_allclose(np.asarray(free.plan.predicted).reshape(-1, 3)[:, :2], goals_in_force(free), atol=NEAR * scene.unit)
    system.reset()


def test_goals_that_are_reached_already_need_no_motion(system):
    system.reset()
    answer = system.plan(robots=[1], goal_x=[2e-4], goal_y=[2e-4])
    assert answer.success, answer.error_msg
    assert not answer.plan.primitives
    assert answer.warning.startswith("nothing to do: every robot is within the tolerance")


def test_a_plan_of_many_hours_is_answered_with_a_warning(system):
    """Robots cannot be told apart well by the last group that they differ in, so that some plans are long."""
    answer = system.plan()
    assert answer.success and not answer.warning
    long = MotionPlan(primitives=[PrimitiveMsg()], execution_time=60_000.0, selection_time=7000.0)
    assert "takes 18.6 h on the substrate" in planner_node._warning(long)


# The action

ENDLESS = {**HOPELESS, "time_limit": 1000.0}


@pytest.fixture(scope="module")
def actions(system):
    """An action client that the planner has met."""
    client = ActionClient(system.client.node, PlanMotionAction, "plan_motion_action")
    system.wait_for(client.server_is_ready, "plan_motion_action")
    begun = []

    def answered():
        if not begun or time.monotonic() > begun[-1][0] + 5.0:
            goal = PlanMotionAction.Goal(tolerance=0.0)
            begun.append((time.monotonic(), system.asked(lambda: client.send_goal_async(goal))))
        return any(future.done() for _, future in begun)

    system.wait_for(answered, "first answer")
    return client


def sent(system, actions, heard=None, **goal):
    tell = None if heard is None else lambda message: heard.append(message.feedback)
    future = system.asked(lambda: actions.send_goal_async(PlanMotionAction.Goal(**goal), feedback_callback=tell))
    system.wait_for(future.done, "acceptance")
    return future.result()


def result_of(system, handle):
    future = system.asked(handle.get_result_async)
    system.wait_for(future.done, "result")
    system.expected(future.result().result)
    return future.result()


def test_the_action_answers_as_the_service_does(system, actions):
    by_action = result_of(system, sent(system, actions, planner="pure_control", seed=3)).result
    by_service = system.plan(planner="pure_control", seed=3)
    assert by_action.success and by_service.success, by_action.error_msg
    assert by_action.plan.primitives == by_service.plan.primitives
    refused = result_of(system, sent(system, actions, planner="magic"))
    assert (refused.status, refused.result.error_code) == (GoalStatus.STATUS_ABORTED, ErrorCode.UNKNOWN_PLANNER)
    system.reset()


def test_feedback_tells_of_the_best_plan_so_far(system, actions):
    heard = []
    result = result_of(system, sent(system, actions, heard, time_limit=4.0)).result
    assert result.success, result.error_msg
    assert heard
    assert [entry.elapsed for entry in heard] == sorted(entry.elapsed for entry in heard)
    assert [entry.tries for entry in heard] == sorted(entry.tries for entry in heard)
    found = [entry.path_length for entry in heard if entry.found]
    assert found and found == sorted(found, reverse=True) and found[-1] >= 0.99 * result.plan.path_length
    system.reset()


def test_a_goal_can_be_cancelled_and_the_planner_is_free_at_once(system, actions):
    heard = []
    handle = sent(system, actions, heard, **HOPELESS, time_limit=1000.0)
    system.wait_for(lambda: heard and heard[-1].tries, "feedback")
    assert "for a goal of plan_motion_action" in system.plan().error_msg
    cancelled = system.asked(handle.cancel_goal_async)
    system.wait_for(cancelled.done, "cancel")
    result = result_of(system, handle)  # long before its time is over
    assert (result.status, result.result.error_code) == (GoalStatus.STATUS_CANCELED, ErrorCode.CANCELLED)
    assert not result.result.plan.primitives
    assert system.plan().success
    system.reset()


@pytest.mark.parametrize("kind", ["action", "service"])
def test_a_client_that_is_gone_frees_the_planner(new_system, kind):
    lonely = new_system(scenario=SCENARIOS / "paper-six-two-discs.yaml")
    other = SwarmClient("other", lonely.namespace)
    try:
        other.wait_for(other.is_system_ready, DEADLINE, "all nodes")
        if kind == "action":
            client = ActionClient(other.node, PlanMotionAction, "plan_motion_action")
            other.wait_for(client.server_is_ready, DEADLINE, "the action")
        else:
            lonely.asked(lambda: lonely.client.node.destroy_client(lonely.client._services.pop("plan_motion")))

        def ask():
            if kind == "action":
                other.node.executor.create_task(lambda: client.send_goal_async(PlanMotionAction.Goal(**ENDLESS)))
            else:
                other._services["plan_motion"].call_async(PlanMotion.Request(**ENDLESS))

        def is_planning():
            return "1000 s" in other.call("plan_motion", PlanMotion.Request(tolerance=0.0), DEADLINE).error_msg

        lonely.wait_for(asking_again(ask, is_planning), "the plan to be in the making")
    finally:
        other.close()
        if kind == "action":
            client.destroy()  # nobody waits for its events any more
    lonely.wait_for(lambda: "nobody waits for" in lonely.log("planner"), "the planner to notice")
    lonely.client._services["plan_motion"] = lonely.client.node.create_client(PlanMotion, "plan_motion")
    lonely.wait_for(lambda: lonely.plan(first=True).success, "a plan")
    lonely.processes.close()  # only so many nodes on one machine find each other


# Whether a plan is heard


def test_a_plan_that_no_sequencer_hears_is_no_success_but_is_there(new_system):
    deaf = new_system(nodes=("driver", "planner"), scenario=SCENARIOS / "paper-six.yaml")
    deaf.wait_for(lambda: deaf.client.is_ready("plan_motion") and deaf.client.has_met("planner"), "planner")
    answer = deaf.plan(planner="pure_control")
    assert (answer.success, answer.error_code) == (False, ErrorCode.NOT_HEARD)
    assert answer.error_msg.startswith("motion_plan: was heard by no sequencer: start one")
    assert answer.plan.primitives
    deaf.processes.close()


def test_so_many_tries_give_one_plan(system):
    first, again = (system.plan(max_tries=5, time_limit=LONGEST_REQUEST, seed=3) for _ in range(2))
    assert first.success, first.error_msg
    assert first.plan.primitives == again.plan.primitives


@pytest.mark.timing
def test_plan_motion_adds_little_to_the_planning(system):
    added = []
    # The best of many, because other tests keep the machine busy.
    while len(added) < 100 and min(added, default=1.0) > 0.050:  # the sequencer's word included
        begin = time.monotonic()
        answer = system.plan(first=True)
        added.append(time.monotonic() - begin - answer.planning_time)
        assert answer.success
    assert min(added) <= 0.050, added


# Parameters


def test_parameters_are_checked_when_they_change(system):
    refused = set_parameter(system, "planner", "planner", "magic")
    assert not refused.successful
    assert "optimize" in refused.reason
    assert set_parameter(system, "planner", "planner", "pure_control").successful
    assert system.plan().plan.planner == "pure_control"
    assert set_parameter(system, "planner", "planner", "optimize").successful


@pytest.mark.parametrize("node", ["planner", "sequencer"])
def test_simulated_time_is_refused_while_a_node_is_up(system, node):
    refused = set_parameter(system, node, "use_sim_time", True)
    assert not refused.successful and "sequence_time" in refused.reason
    assert set_parameter(system, node, "use_sim_time", False).successful


@pytest.mark.parametrize(
    ("node", "arguments", "text"),
    [
        ("planner", ["-p", "planner:=magic"], "planner: planner: is 'magic': use one of"),
        ("planner", ["-p", "planner:=3"], "planner: planner: is 3: give text"),
        ("planner", ["-p", "use_sim_time:=true"], "planner: use_sim_time: cannot be true"),
        ("sequencer", ["-p", "use_sim_time:=true"], "sequencer: use_sim_time: cannot be true"),
        ("mover", ["-p", "use_sim_time:=true"], "mover: use_sim_time: cannot be true"),
        ("planner", ["-p", "nonsense:=3"], "planner: nonsense: is no parameter of this node: it has planner"),
        ("mover", ["-p", "assumed.heading_noise:=0"], "mover: assumed.heading_noise: is 0: give 0.0001 to 1.5708"),
        ("mover", ["-p", "planning_time:=soon"], "mover: planning_time: is 'soon': give a number"),
        ("sequencer", ["-p", "nonsense:=3"], "sequencer: nonsense: is no parameter of this node: it has none at all"),
        ("sequencer", ["-r"], "sequencer: --ros-args: failed"),
    ],
)
def test_a_node_that_is_started_wrongly_says_so_in_one_line(new_system, node, arguments, text):
    lonely = new_system(nodes=())
    process = lonely.start(node, *arguments)
    assert process.wait(DEADLINE) == 2
    *rest, last = lonely.log(node).splitlines()
    assert last.startswith(text), last
    assert all("[rcl]" in line for line in rest)  # rcl itself speaks of a malformed command line


# Life and death


def test_the_sequencer_shows_life_in_real_time_where_it_may_and_works_as_others_do(system):
    pid = system.processes._running["sequencer"].pid
    asked = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(4))"
    wanted = os.SCHED_FIFO if subprocess.run([sys.executable, "-c", asked], capture_output=True).returncode == 0 else os.SCHED_OTHER
    tasks = {int(task.name): (task / "comm").read_text().strip() for task in Path(f"/proc/{pid}/task").iterdir()}
    life = {os.sched_getscheduler(task) for task, name in tasks.items() if name.startswith("dds.")}
    assert life == {wanted} and os.sched_getscheduler(pid) == os.SCHED_OTHER


def test_a_killed_sequencer_starts_again_without_replaying_an_old_plan(system):
    old = system.plan()
    system.wait_until_loaded(old.plan.plan_id)
    system.reset()
    assert system.processes.stop("sequencer", signal.SIGKILL) == -signal.SIGKILL
    system.client.sequencer_status = None
    system.start("sequencer")
    system.wait_for(system.client.is_system_ready, "new sequencer")
    assert system.client.sequencer_status.plan_id == ""
    new = system.plan(seed=1)
    assert new.success
    system.wait_until_loaded(new.plan.plan_id)
    poses, scene = system.execute(new.plan)
    np.testing.assert_allclose(poses[:, :2], scene.goals, atol=NEAR)
    system.reset()


def test_a_plan_without_a_driver_is_refused_by_the_sequencer(new_system, system):
    lonely = new_system(nodes=("sequencer",))
    publisher = lonely.client.node.create_publisher(MotionPlan, "motion_plan", ORDERS)
    lonely.wait_for(lambda: publisher.get_subscription_count() == 1, "connection")
    publisher.publish(MotionPlan(plan_id="first", swarm_id=system.client.description.swarm_id, primitives=[activation()]))
    lonely.wait_for(lambda: lonely.client.sequencer_status, "status")
    assert lonely.client.sequencer_status.error_code == ErrorCode.NO_SWARM
    assert "start the driver" in lonely.client.sequencer_status.error_msg


@pytest.mark.parametrize(("chosen", "shared"), [({}, False), ({"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, True)])
def test_nodes_share_no_memory_with_others_unless_the_user_wants_it(new_system, monkeypatch, chosen, shared):
    """A process that is killed while it holds a lock there makes others deaf."""
    for name, value in chosen.items():
        monkeypatch.setenv(name, value)
    nodes = new_system(scenario=SCENARIOS / "paper-six.yaml").processes._running
    assert len(nodes) == 3
    for process in nodes.values():
        assert ("/dev/shm/fastrtps" in Path(f"/proc/{process.pid}/maps").read_text()) is shared


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_nodes_end_cleanly_at_a_signal(new_system, number):
    lonely = new_system(nodes=("planner", "sequencer"))
    lonely.wait_for(lambda: lonely.client.is_ready("plan_motion"), "planner")
    lonely.wait_for(lambda: lonely.client.node.count_publishers("sequencer_status") == 1, "sequencer")
    for name in ("planner", "sequencer"):
        assert lonely.processes.stop(name, number) == 0
        assert "Traceback" not in lonely.log(name)


def test_a_planner_that_plans_ends_at_once(new_system):
    busy = new_system(scenario=SCENARIOS / "paper-six-two-discs.yaml")
    request = PlanMotion.Request(**HOPELESS, time_limit=LONGEST_REQUEST)
    is_planning = asking_again(
        lambda: busy.client._services["plan_motion"].call_async(request),
        lambda: busy.plan(tolerance=0.0).error_code == ErrorCode.BUSY,
    )
    busy.wait_for(is_planning, "the plan to be in the making")
    assert busy.processes.stop("planner") == 0  # it would be killed if it took the time that it was given
    assert "Traceback" not in busy.log("planner")


# Measured poses, from a driver that this test plays


@pytest.fixture(scope="module")
def played(new_system, system):
    """A planner alone, and a function that plays its driver."""
    lonely = new_system(nodes=("planner",))
    lonely.wait_for(lambda: lonely.client.is_ready("plan_motion") and lonely.client.has_met("planner"), "planner")
    node = lonely.client.node
    descriptions = node.create_publisher(SwarmDescription, "swarm_description", LATCHED)
    poses = node.create_publisher(SwarmPoses, "swarm_poses", 10)
    original = system.client.description

    # The planner's word is good only if a sequencer hears it.
    statuses = node.create_publisher(SequencerStatus, "sequencer_status", LIVING)
    lonely.refusal = ErrorCode.NONE, ""

    def sequence(plan):
        code, text = lonely.refusal
        statuses.publish(SequencerStatus(plan_id=plan.plan_id, error_code=int(code), error_msg=text))

    node.create_subscription(MotionPlan, "motion_plan", sequence, ORDERS)

    def play(seen, stamped=False, **changes):
        fields = {name: getattr(original, name) for name in original.get_fields_and_field_types()}
        description = SwarmDescription(**{**fields, "swarm_id": uuid.uuid4().hex, **changes})
        descriptions.publish(description)
        assert descriptions.wait_for_all_acked(Duration(seconds=DEADLINE))
        start = np.asarray(description.start).reshape(-1, 3)
        rows = [k for k, robot in enumerate(description.ids) if robot in seen]
        message = SwarmPoses(
            swarm_id=description.swarm_id,
            ids=[description.ids[k] for k in rows],
            x=start[rows, 0].tolist(),
            y=start[rows, 1].tolist(),
            heading=start[rows, 2].tolist(),
        )
        ended = threading.Event()

        def repeat():
            while not ended.wait(0.02):
                if stamped:
                    message.header.stamp = node.get_clock().now().to_msg()
                poses.publish(message)

        thread = threading.Thread(target=repeat)
        thread.start()
        return lambda: (ended.set(), thread.join())

    return lonely, play


def test_without_a_driver_there_is_nothing_to_plan_for(played):
    answer = played[0].plan()
    assert ErrorCode(answer.error_code) == ErrorCode.NO_SWARM
    assert "start the driver" in answer.error_msg


def test_robots_that_the_tracker_does_not_see_are_named(played):
    lonely, play = played
    stop = play({1, 2, 4, 6})
    answer = lonely.plan()
    stop()
    assert ErrorCode(answer.error_code) == ErrorCode.NO_SWARM
    assert "robots 3, 5" in answer.error_msg


def test_a_plan_that_the_sequencer_refuses_is_no_success(played):
    lonely, play = played
    stop = play(set(range(1, 7)))
    lonely.refusal = ErrorCode.INVALID_PLAN, "plan: is not to my taste"
    answer = lonely.plan(planner="pure_control")
    lonely.refusal = ErrorCode.NONE, ""
    stop()
    assert (answer.success, answer.error_code) == (False, ErrorCode.INVALID_PLAN)
    assert answer.error_msg == "sequencer: plan: is not to my taste"


def test_poses_that_overlap_are_refused(played):
    lonely, play = played
    start = [value for k in range(6) for value in (3e-4 + 1e-5 * k, 3e-4, 0.0)]
    stop = play(set(range(1, 7)), start=start)
    answer = lonely.plan()
    stop()
    assert ErrorCode(answer.error_code) == ErrorCode.STARTS_OVERLAP
    assert "measured pose of robot" in answer.error_msg


def test_a_description_that_contradicts_itself_is_refused(played):
    lonely, play = played
    stop = play(set(range(1, 7)), codewords=["001"] * 6)
    answer = lonely.plan()
    stop()
    assert ErrorCode(answer.error_code) == ErrorCode.NO_SWARM
    assert "cannot be told apart" in answer.error_msg


def test_a_scenario_whose_robots_take_any_goal(played, system):
    lonely, play = played
    stop = play(set(range(1, 7)), assign=[1, 3, 4])
    answer = lonely.plan(planner="pure_control")
    stop()
    assert answer.success, answer.error_msg
    listed = np.asarray(system.client.description.goal).reshape(-1, 2)
    np.testing.assert_allclose(goals_in_force(answer)[[1, 4, 5]], listed[[1, 4, 5]])
    assert not np.allclose(goals_in_force(answer), listed)
    np.testing.assert_allclose(sorted(goals_in_force(answer).tolist()), sorted(listed.tolist()))


def test_a_plan_asked_for_before_the_planner_hears_that_a_motion_has_ended_waits_for_the_news(played):
    lonely, play = played
    stop = play(set(range(1, 7)), stamped=True)
    statuses = lonely.client.node.create_publisher(DriverStatus, "driver_status", LATCHED)
    statuses.publish(DriverStatus(state=DriverStatus.RUNNING, plan_id="last"))
    answer = lonely.client._services["plan_motion"].call_async(PlanMotion.Request(planner="pure_control"))
    lonely.wait_for(lambda: "another plan" in lonely.plan().error_msg, "the request to arrive")
    end = DriverStatus(state=DriverStatus.STOPPED, plan_id="last")
    end.header.stamp = lonely.client.node.get_clock().now().to_msg()
    statuses.publish(end)
    lonely.wait_for(answer.done, "the plan")
    stop()
    assert answer.result().success, answer.result().error_msg
