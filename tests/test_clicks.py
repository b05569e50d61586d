"""Clicks as RViz sends them: they select a robot and make a plan for it, and nothing that they do moves a robot."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped, PoseStamped
from rclpy.action import ActionClient
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus, MotionPlan
from system_rig import asking_again
from three_robots import SCENARIO
from visualization_msgs.msg import MarkerArray

from stressbot_planner.ros.conversion import scene_from_description
from stressbot_planner.ros.qos import LATCHED
from stressbot_planner.ros.unfolding import activations_of_plan

SCALE = 500.0
STARTS = np.array([[2e-4, 2e-4], [2e-4, 6e-4], [2e-4, 10e-4]])
FREE = (9e-4, 9e-4)


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(SCENARIO)
    system = new_system(nodes=("driver", "sequencer", "planner", "mover"), scenario=path)
    system.start("clicks", view_scale=SCALE)
    node = system.client.node
    system.points = node.create_publisher(PointStamped, "clicked_point", 5)
    system.goals = node.create_publisher(PoseStamped, "goal_pose", 5)
    system.plans, system.marks = [], []
    node.create_subscription(MotionPlan, "accepted_plan", system.plans.append, LATCHED)
    node.create_subscription(MarkerArray, "goal_markers", system.marks.append, LATCHED)
    system.wait_for(lambda: system.points.get_subscription_count() and system.goals.get_subscription_count(), "clicks")
    return system


@pytest.fixture
def at_rest(system):
    """Robots at their starts, nothing selected before robot 3, and no goals."""
    system.reset()
    system.plans.clear()
    select(system, 2, 2.1e-4, 9e-4)
    yield system
    assert system.client.trigger("stop").success
    system.wait_for(lambda: system.client.driver_status.state != DriverStatus.RUNNING, "rest")


def select(system, row, x, y, frame="substrate"):
    message = PointStamped(point=Point(x=x, y=y))
    message.header.frame_id = frame
    told = f"robot {row + 1} is selected"
    before = system.log("clicks").count(told)
    selected = asking_again(lambda: system.points.publish(message), lambda: system.log("clicks").count(told) > before)
    system.wait_for(selected, told)


def goal(x, y, frame="substrate"):
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = x, y
    return message


def planned(system, message):
    """Send a goal and return the plan that the sequencer has accepted."""
    before = len(system.plans)
    system.wait_for(asking_again(lambda: system.goals.publish(message), lambda: len(system.plans) > before), "a plan")
    plan = system.plans[-1]
    system.wait_until_loaded(plan.plan_id)
    system.wait_for(lambda: system.log("clicks").rstrip().endswith("call start to drive it"), "the word of clicks")
    return plan


def refused(system, message, reason):
    before = system.log("clicks").count(reason)
    system.wait_for(
        asking_again(lambda: system.goals.publish(message), lambda: system.log("clicks").count(reason) > before), reason
    )


def goals_of(plan):
    return np.reshape(plan.goal, (3, 2))


def test_a_click_in_the_magnified_picture_plans_for_the_robot_next_to_the_one_before_and_moves_nothing(at_rest):
    system = at_rest
    select(system, 1, SCALE * 2.2e-4, SCALE * 5.5e-4, "substrate_view")
    plan = planned(system, goal(SCALE * FREE[0], SCALE * FREE[1], "substrate_view"))
    assert np.allclose(goals_of(plan), [STARTS[0], FREE, STARTS[2]], rtol=0, atol=1e-12)
    status = system.client.driver_status
    assert (status.state, status.output_level, status.sequence_time) == (DriverStatus.LOADED, 0.0, 0.0)
    assert np.allclose(1e-4 * system.poses_after(status.header.stamp)[:, :2], STARTS, rtol=0, atol=1e-12)

    def marked():
        marks = {(marker.ns, marker.id): marker for marker in system.marks[-1].markers} if system.marks else {}
        return {("goals", 2), ("selected", 0)} <= set(marks) and marks

    marks = system.wait_for(marked, "marks")
    for place, points in ((FREE, marks["goals", 2].points), (STARTS[1], marks["selected", 0].points[:-1])):
        middle = np.mean([(point.x, point.y) for point in points], axis=0)
        assert np.allclose(middle, SCALE * np.array(place), rtol=0, atol=1e-9)


def test_goals_add_up_until_robots_move(at_rest):
    system = at_rest
    planned(system, goal(9e-4, 10e-4))
    select(system, 0, 0.0, 0.0)
    plan = planned(system, goal(9e-4, 3e-4))
    assert np.allclose(goals_of(plan), [[9e-4, 3e-4], STARTS[1], [9e-4, 10e-4]], rtol=0, atol=1e-12)
    assert system.client.trigger("start").success
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.RUNNING, "motion")
    refused(system, goal(*FREE), "goal_pose: driver: is running or in FAULT")
    assert system.client.trigger("stop").success
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.STOPPED, "rest")
    plan = planned(system, goal(9e-4, 4e-4))
    where = np.reshape(plan.start, (3, 3))[:, :2]
    assert np.allclose(goals_of(plan)[1:], where[1:], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (goal(*FREE, "map"), "goal_pose: header.frame_id: is 'map'"),
        (goal(math.nan, 0.0), "goal_pose: position: is nan"),
        (goal(5e-4, 6e-4), "no plan for robot 3: goal_x[0], goal_y[0]: the goal of robot 3"),
        (goal(5.0, 5.0), "no plan for robot 3: goal_x[0], goal_y[0]: the goal of robot 3"),
    ],
    ids=["frame", "number", "obstacle", "outside"],
)
def test_a_click_that_cannot_be_meant_is_refused_with_a_reason_and_forgotten(at_rest, message, reason):
    refused(at_rest, message, reason)
    assert not at_rest.plans
    plan = planned(at_rest, goal(*FREE))
    assert np.allclose(goals_of(plan), [*STARTS[:2], FREE], rtol=0, atol=1e-12)


def test_a_click_is_refused_while_a_closed_loop_moves_the_swarm(at_rest):
    system = at_rest
    actions = ActionClient(system.client.node, MoveSwarm, "move_swarm")
    system.wait_for(actions.server_is_ready, "the mover")
    system.wait_for(system.is_known_to_mover(actions), "mover's sight of this client")
    heard = []
    accepted = system.asked(lambda: actions.send_goal_async(MoveSwarm.Goal(), feedback_callback=heard.append))
    system.wait_for(lambda: accepted.done() and heard, "motion")
    refused(system, goal(*FREE), "goal_pose: move_swarm: moves the swarm in closed loop")
    cancelled = system.asked(accepted.result().cancel_goal_async)
    system.wait_for(cancelled.done, "cancelling")
    result = system.asked(accepted.result().get_result_async)
    system.wait_for(result.done, "end of the closed loop")


def test_a_click_before_a_robot_is_selected_is_refused(new_system, tmp_path):
    path = tmp_path / "three.yaml"
    path.write_text(SCENARIO)
    system = new_system(nodes=("driver",), scenario=path)
    system.start("clicks")
    system.goals = system.client.node.create_publisher(PoseStamped, "goal_pose", 5)
    refused(system, goal(*FREE), "goal_pose: robot: is not selected: click on one first")
    system.points = system.client.node.create_publisher(PointStamped, "clicked_point", 5)
    select(system, 1, *STARTS[1].tolist())
    refused(system, goal(*FREE), "goal_pose: plan_motion_action: is served by nobody")


def test_who_is_parked_in_the_scenario_has_no_goal_and_is_not_moved_for_the_goals_of_others(new_system, tmp_path):
    path = tmp_path / "parked.yaml"
    words = "groups: ['100', '010', '001']"
    path.write_text(SCENARIO.replace("groups: binary", words).replace("goal: [8, 2]", "goal: parked"))
    system = new_system(nodes=("driver", "sequencer", "planner"), scenario=path)
    system.start("clicks")
    system.goals = system.client.node.create_publisher(PoseStamped, "goal_pose", 5)
    system.points = system.client.node.create_publisher(PointStamped, "clicked_point", 5)
    system.plans = []
    system.client.node.create_subscription(MotionPlan, "accepted_plan", system.plans.append, LATCHED)
    select(system, 1, *STARTS[1].tolist())
    refused(system, goal(*FREE), "goal_pose: robot: is 2, which is parked")
    select(system, 0, *STARTS[0].tolist())
    plan = planned(system, goal(*FREE))
    scene = scene_from_description(system.client.description)
    assert 2 not in activations_of_plan(plan, scene)[0]
    assert np.allclose(goals_of(plan), [FREE, *STARTS[1:]], rtol=0, atol=1e-12)
