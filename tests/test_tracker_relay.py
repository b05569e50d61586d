"""The tracker relay: a PoseArray becomes swarm_poses with ids, unseen robots are left out, wrong arrays are refused."""

import math

import pytest
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion
from three_robots import SCENARIO

from stressbot_planner.ros.bringup import NodeEntry, command

FAR = 77.0
"""m; the simulated driver, which publishes poses too, has no robot there."""


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(SCENARIO)
    system = new_system(nodes=("driver",), scenario=path)
    system.processes.start(
        "tracker_relay", command(NodeEntry("stressbot_planner", "tracker_relay"), {}, namespace=system.namespace)
    )
    system.tracker = system.client.node.create_publisher(PoseArray, "tracked_poses", 1)
    system.wait_for(system.tracker.get_subscription_count, "relay")
    system.wait_for(lambda: system.client.description, "description")
    return system


def pose(x, heading):
    return Pose(position=Point(x=x, y=2.0, z=0.0), orientation=Quaternion(z=math.sin(heading / 2), w=math.cos(heading / 2)))


def array(*poses, frame="substrate"):
    message = PoseArray(poses=list(poses))
    message.header.frame_id = frame
    return message


def test_a_pose_array_gets_ids_and_an_unseen_robot_is_left_out(system):
    message = array(pose(FAR, 0.5), pose(math.nan, 0.0), pose(FAR + 1, -2.0))

    def relayed():
        system.tracker.publish(message)
        return next((found for found in system.client.poses if list(found.x) == [FAR, FAR + 1]), None)

    found = system.wait_for(relayed, "relayed poses")
    assert list(found.ids) == [1, 3] and list(found.y) == [2.0, 2.0]
    assert list(found.heading) == pytest.approx([0.5, -2.0])
    assert found.swarm_id == system.client.description.swarm_id and found.header.frame_id == "substrate"


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (array(pose(FAR, 0.0)), "has 1 poses for 3 robots"),
        (array(*[pose(FAR + 5, 0.0)] * 3, frame="map"), "frame_id is 'map'"),
    ],
)
def test_wrong_arrays_are_refused_with_a_reason(system, message, reason):
    def refused():
        system.tracker.publish(message)
        return reason in system.log("tracker_relay")

    system.wait_for(refused, "refusal")
    assert not any(FAR + 5 in found.x for found in system.client.poses)
