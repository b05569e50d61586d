import importlib.util
import math

import numpy as np
import pytest
from driver_support import bench, encode, scenario_text
from geometry_msgs.msg import PoseArray
from node_rig import NodeRig
from stressbot_msgs.msg import DriverStatus
from visualization_msgs.msg import Marker, MarkerArray

from stressbot_driver.ros.conversions import description_message, poses_message
from stressbot_driver.ros.markers import fixed_markers, robot_markers
from stressbot_driver.ros.standard_messages import MOST_FRAMES, pose_array, transforms
from stressbot_driver.simulation.substrate import Substrate

pytestmark = pytest.mark.xdist_group("driver_processes")
CHANGES = {
    "workspace": {"x": [-1, 20], "y": [-1, 20]},
    "obstacles": [{"circle": {"center": [8, 8], "radius": 1}}, {"polygon": [[9, 9], [11, 9], [10, 11]]}],
    "swarm.body_radius": [0.3, 0.3, 0.4, 0.3, 0.3, 0.3],
}


def by_namespace(array, namespace):
    return [marker for marker in array.markers if marker.ns == namespace]


def test_fixed_markers_are_magnified():
    array = fixed_markers(description_message(bench(6, **CHANGES)), 1000.0)
    assert array.markers[0].action == Marker.DELETEALL
    assert {marker.header.frame_id for marker in array.markers} == {"substrate_view"}
    (walls,) = by_namespace(array, "walls")
    corners = [(-0.1, -0.1), (2, -0.1), (2, 2), (-0.1, 2), (-0.1, -0.1)]
    assert np.allclose([(p.x, p.y) for p in walls.points], corners)
    circle, polygon = by_namespace(array, "obstacles")
    assert (circle.pose.position.x, circle.scale.x) == pytest.approx((0.8, 0.2))
    assert len(polygon.points) == 4
    (goals,) = by_namespace(array, "goals")
    assert len(goals.points) == 6 * 4
    (starts,) = by_namespace(array, "starts")
    assert np.hypot(starts.points[0].x, starts.points[0].y) == pytest.approx(0.03)


def test_open_plane_has_no_walls():
    assert not by_namespace(fixed_markers(description_message(bench(2)), 1000.0), "walls")


def test_robot_markers_show_who_was_seen():
    swarm = bench(6, **CHANGES)
    message = poses_message(swarm.swarm_id, 0.0, Substrate(swarm).poses())
    array = robot_markers(description_message(swarm), message, 1000.0)
    bodies = by_namespace(array, "bodies")
    assert sorted(len(marker.points) for marker in bodies) == [1, 5]
    assert sorted(marker.scale.x for marker in bodies) == pytest.approx([0.06, 0.08])
    (headings,) = by_namespace(array, "headings")
    assert len(headings.points) == 6 * 6
    message.ids, message.x, message.y, message.heading = [3, 99], [1e-3, 0.0], [0.0, 0.0], [0.0, 0.0]
    array = robot_markers(description_message(swarm), message, 1000.0)
    assert [(p.x, p.y) for marker in by_namespace(array, "bodies") for p in marker.points] == [(1.0, 0.0)]
    message.ids, message.x, message.y, message.heading = [], [], [], []
    assert not any(marker.points for marker in robot_markers(description_message(swarm), message, 1000.0).markers)


def seen_of(swarm, **changes):
    message = poses_message(swarm.swarm_id, 0.0, Substrate(swarm).poses())
    message.header.stamp.sec = 7
    for name, values in changes.items():
        setattr(message, name, values)
    return message


def test_a_pose_array_has_who_was_seen_in_metres():
    swarm = bench(2)
    poses = seen_of(swarm, ids=[2, 99, 1], x=[1e-3, 5.0, math.nan], y=[2e-3, 5.0, 0.0], heading=[-2.5, 0.0, 0.0])
    array = pose_array(description_message(swarm), poses)
    assert (array.header.frame_id, array.header.stamp.sec) == ("substrate", 7)
    (pose,) = array.poses
    assert (pose.position.x, pose.position.y, pose.position.z) == (1e-3, 2e-3, 0.0)
    assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(-2.5)


def test_a_transform_leads_from_the_substrate_to_each_robot_that_was_seen():
    swarm = bench(2)
    poses = seen_of(swarm, ids=[2, 99, 1], x=[1e-3, 5.0, math.nan], y=[2e-3, 5.0, 0.0], heading=[-2.5, 0.0, 0.0])
    (one,) = transforms(description_message(swarm), poses)
    assert (one.header.frame_id, one.header.stamp.sec, one.child_frame_id) == ("substrate", 7, "robot_2")
    assert (one.transform.translation.x, one.transform.translation.y) == (1e-3, 2e-3)
    assert 2 * math.atan2(one.transform.rotation.z, one.transform.rotation.w) == pytest.approx(-2.5)


HAS_TF = importlib.util.find_spec("tf2_msgs") is not None


@pytest.mark.skipif(HAS_TF, reason="tf2_msgs is installed")
def test_tf_is_refused_where_its_messages_are_not_installed():
    rig = NodeRig()
    try:
        code, errors = rig.ended(rig.start("viewer", tf=True))
        assert (code, errors.count("\n")) == (2, 1) and "tf: cannot be true, tf2_msgs is not installed" in errors
    finally:
        rig.close()


@pytest.mark.skipif(not HAS_TF, reason="tf2_msgs is not installed: the wheels do not have it")
@pytest.mark.parametrize("count", [6, MOST_FRAMES + 1])
def test_transforms_are_published_for_few_robots_if_asked_for(tmp_path, count):
    kind = importlib.import_module("tf2_msgs.msg").TFMessage
    rig = NodeRig()
    try:
        path = tmp_path / "scenario.yaml"
        path.write_text(scenario_text(count))
        heard, arrays = [], []
        rig.node.create_subscription(kind, "/tf", rig._keep(heard), 10)
        rig.node.create_subscription(PoseArray, "pose_array", rig._keep(arrays), 10)
        rig.start("viewer", tf=True)
        rig.start_driver(path)
        rig.wait(lambda: len(arrays) > 5, "pose arrays")
        if count <= MOST_FRAMES:
            message = rig.wait(lambda: next(iter(heard), None), "transforms")
            assert [one.child_frame_id for one in message.transforms] == [f"robot_{k}" for k in range(1, count + 1)]
        else:
            assert not heard
    finally:
        rig.close()


def test_viewer_turns_poses_into_markers_and_a_pose_array(tmp_path):
    rig = NodeRig()
    try:
        path = tmp_path / "scenario.yaml"
        path.write_text(scenario_text(6, **CHANGES))
        arrays, poses = [], []
        rig.node.create_subscription(MarkerArray, "swarm_markers", rig._keep(arrays), 10)
        rig.node.create_subscription(PoseArray, "pose_array", rig._keep(poses), 10)
        viewer = rig.start("viewer", view_scale=10000.0)
        rig.start_driver(path, auto_start=True)
        rig.send(encode(bench(6, **CHANGES), [(4, 0.2)]))
        rig.state(DriverStatus.DONE)
        rig.wait(lambda: any(by_namespace(array, "walls") for array in arrays), "the walls")
        array = rig.wait(lambda: next((a for a in arrays if by_namespace(a, "bodies")), None), "the bodies")
        assert max(p.y for m in by_namespace(array, "bodies") for p in m.points) == pytest.approx(10.0)
        array = rig.wait(lambda: next(iter(poses), None), "a pose array")
        assert len(array.poses) == 6 and max(pose.position.y for pose in array.poses) == pytest.approx(1e-3)
        assert rig.end(viewer)[0] == 0
        code, errors = rig.ended(rig.start("viewer", view_scale=-1))
        assert (code, errors.count("\n")) == (2, 1) and "view_scale" in errors
    finally:
        rig.close()
