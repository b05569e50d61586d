"""What stands on topics for those who look on: qualities of service as documented, the copy of a plan, the health of nodes."""

import json
import math
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path as PathMessage
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from stressbot_msgs.msg import DriverStatus, MotionPlan
from system_rig import asking_again
from three_robots import SCENARIO
from visualization_msgs.msg import MarkerArray

from stressbot_driver.ros import viewer_node
from stressbot_planner.ros.bringup import share
from stressbot_planner.ros.qos import LATCHED
from stressbot_planner.ros.standard_messages import VIEW_FRAME, VIEW_SCALE

PAGE = Path(__file__).parents[1] / "docs/topics.md"
ROWS = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in PAGE.read_text().splitlines() if line.startswith("| `")]
TOLD, HEARD = ([row for row in ROWS if len(row) == cells] for cells in (7, 4))
TOLD_HEALTH = {"driver", "sequencer", "planner", "mover"}
NODES = (*sorted(TOLD_HEALTH), "viewer", "paths", "clicks")


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "three.yaml"
    path.write_text(SCENARIO)
    system = new_system(nodes=NODES, scenario=path, real_time_factor=0.0)
    system.health = {}

    def hear(message):
        for status in message.status:
            if status.name.startswith(f"{system.namespace}/"):
                system.health[status.name.rpartition("/")[2]] = status

    system.client.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    return system


@pytest.mark.parametrize("row", TOLD, ids=lambda row: row[0])
def test_qualities_of_service_are_as_documented(system, row):
    topic, kind, nodes, reliability, durability, _depth, _why = row
    name = topic if topic.startswith("/") else f"{system.namespace}/{topic.replace('_N/', '_1/')}"

    def ours():
        ends = system.client.node.get_publishers_info_by_topic(name)
        return {end.node_name.removesuffix("_client"): end for end in ends if end.node_namespace == system.namespace}

    expected = {node for node in NODES if node in nodes.split(", ")}
    if topic == "motion_plan":
        expected.discard("mover")  # which has a client of its own as long as it moves
    system.wait_for(lambda: set(ours()) == expected, f"publishers of {topic}")
    for end in ours().values():
        assert end.topic_type == kind
        assert end.qos_profile.reliability == ReliabilityPolicy[reliability.upper()]
        assert end.qos_profile.durability == DurabilityPolicy[durability.upper().replace(" ", "_")]


@pytest.mark.parametrize(("topic", "kind"), [row[:2] for row in HEARD])
def test_clicks_are_heard_as_documented(system, topic, kind):
    def ours():
        ends = system.client.node.get_subscriptions_info_by_topic(f"{system.namespace}/{topic}")
        return [(end.node_name, end.topic_type) for end in ends]

    system.wait_for(lambda: ours() == [("clicks", kind)], f"subscription of {topic}")


def topics_in(value):
    """Every absolute name in a layout of Foxglove: keys and values, without the field of a message behind it."""
    if isinstance(value, dict):
        return {name for pair in value.items() for part in pair for name in topics_in(part)}
    if isinstance(value, list):
        return {name for part in value for name in topics_in(part)}
    return {value.split(".")[0]} if isinstance(value, str) and value.startswith("/") else set()


def panels_in(layout):
    return {layout} if isinstance(layout, str) else panels_in(layout["first"]) | panels_in(layout["second"])


def test_the_layout_of_foxglove_names_topics_services_and_frames_that_exist():
    layout = json.loads(share("foxglove", "stressbot.json").read_text())
    documented = {"/" + row[0].removeprefix("/") for row in ROWS}
    named = topics_in(layout)
    assert named - {"/start", "/stop", "/rosout"} <= documented
    assert named >= {"/swarm_markers", "/path_markers", "/goal_markers", "/goal_pose", "/clicked_point", "/diagnostics", "/stop"}
    assert panels_in(layout["layout"]) == set(layout["configById"])
    scene = layout["configById"]["3D!swarm"]
    assert scene["followTf"] == scene["layers"]["grid"]["frameId"] == VIEW_FRAME
    field = layout["configById"]["Plot!volts"]["paths"][0]["value"].partition(".")[2]
    assert field in DriverStatus.get_fields_and_field_types()


def test_the_configuration_of_rviz_names_topics_that_exist_and_asks_for_what_they_offer():
    config = yaml.safe_load(share("rviz", "stressbot.rviz").read_text())["Visualization Manager"]
    told = {row[0]: row for row in TOLD}
    displays = [entry for entry in config["Displays"] if "Topic" in entry]
    assert {entry["Topic"]["Value"] for entry in displays} == {
        "swarm_markers", "path_markers", "goal_markers", "image_raw",
    }
    for entry in displays:
        _, kind, _, reliability, durability, *_ = told[entry["Topic"]["Value"]]
        assert kind.rpartition("/")[2] == entry["Class"].rpartition("/")[2]
        assert entry["Topic"]["Durability Policy"].lower() == durability
        assert entry["Topic"]["Reliability Policy"].lower() == reliability
    assert {entry["Topic"]["Value"] for entry in config["Tools"] if "Topic" in entry} == {row[0] for row in HEARD}
    assert config["Global Options"]["Fixed Frame"] == VIEW_FRAME


def test_nodes_that_share_a_magnification_have_the_same():
    nodes = yaml.safe_load(share("config", "stressbot.yaml").read_text())
    scales = {nodes[f"/**/{node}"]["ros__parameters"]["view_scale"] for node in ("viewer", "paths", "clicks")}
    assert scales == {VIEW_SCALE.default} == {entry.default for entry in viewer_node.PARAMETERS if entry.name == "view_scale"}


def test_who_comes_later_sees_the_plan_that_was_accepted(system):
    plan = system.plan(first=True).plan
    system.wait_until_loaded(plan.plan_id)
    heard = []
    late = system.client.node.create_subscription(MotionPlan, "accepted_plan", heard.append, LATCHED)
    system.wait_for(lambda: heard, "the copy")
    assert heard == [plan]
    other = MotionPlan(plan_id="refused", swarm_id="another")
    orders = system.client.node.create_publisher(MotionPlan, "motion_plan", 1)
    refused = asking_again(lambda: orders.publish(other), lambda: system.client.sequencer_status.plan_id == "refused")
    system.wait_for(refused, "refusal")
    system.wait_for(lambda: "another" in getattr(system.health.get("sequencer"), "message", ""), "health of the sequencer")
    assert system.health["sequencer"].level == DiagnosticStatus.WARN
    assert heard == [plan]
    system.client.node.destroy_subscription(late)


def places_of(message):
    return np.array([(stamped.pose.position.x, stamped.pose.position.y) for stamped in message.poses]).reshape(-1, 2)


def heading_of(stamped):
    return 2 * math.atan2(stamped.pose.orientation.z, stamped.pose.orientation.w)


class Looking:
    """One who looks on: the newest message of each topic, from now until the end of a `with`."""

    def __init__(self, system, **topics):
        self._node, self.newest = system.client.node, {}
        self._ends = [
            self._node.create_subscription(kind, topic.replace("__", "/"), self._keeper(topic), LATCHED)
            for topic, kind in topics.items()
        ]

    def _keeper(self, topic):
        return lambda message: self.newest.__setitem__(topic, message)

    def __enter__(self):
        return self.newest

    def __exit__(self, *_):
        for end in self._ends:
            self._node.destroy_subscription(end)


PATHS = {f"robot_{k}__{what}_path": PathMessage for k in (1, 2, 3) for what in ("planned", "driven")}


def test_paths_lead_from_where_robots_are_to_where_they_end_and_say_where_they_have_been(system):
    system.reset()
    plan = system.plan(first=True).plan
    with Looking(system, path_markers=MarkerArray, **PATHS) as seen:
        start, end = np.reshape(plan.start, (3, 3)), np.reshape(plan.predicted, (3, 3))
        for row in range(3):
            topic = f"robot_{row + 1}__planned_path"
            path = system.wait_for(
                lambda topic=topic: len(seen[topic].poses) > 1 and seen[topic] if topic in seen else None, topic
            )
            assert path.header.frame_id == path.poses[0].header.frame_id == "substrate"
            assert path.header.stamp == plan.header.stamp
            assert np.allclose(places_of(path)[[0, -1]], [start[row, :2], end[row, :2]], rtol=0, atol=1e-12)
            for stamped, heading in ((path.poses[0], start[row, 2]), (path.poses[-1], end[row, 2])):
                assert math.cos(heading_of(stamped) - heading) == pytest.approx(1.0)
        system.execute(plan)
        slid = sum(np.hypot(*np.diff(places_of(seen[f"robot_{k}__planned_path"]), axis=0).T).sum() for k in (1, 2, 3))
        assert slid == pytest.approx(plan.path_length)

        def came_along():
            return all(len(path := places_of(seen[f"robot_{k}__driven_path"])) > 1 and
                       np.hypot(*(path[-1] - end[k - 1, :2])) < 5e-6 for k in (1, 2, 3))

        system.wait_for(lambda: len(seen) == 7 and came_along(), "trails")

        def marked(what):
            return [marker for marker in seen["path_markers"].markers if marker.ns == what]

        for what in ("planned", "driven"):
            system.wait_for(lambda what=what: {marker.id for marker in marked(what)} == {1, 2, 3}, f"{what} lines")
        planned = marked("planned")
        assert {marker.header.frame_id for marker in planned} == {"substrate_view"}
        ends = {marker.id: (marker.points[-1].x, marker.points[-1].y) for marker in planned}
        assert np.allclose([ends[k] for k in (1, 2, 3)], 1000.0 * end[:, :2], rtol=0, atol=1e-9)
        system.reset()
        system.wait_for(lambda: all(len(seen[f"robot_{k}__driven_path"].poses) < 2 for k in (1, 2, 3)), "empty trails")


def test_who_looks_later_sees_the_paths_of_now(system):
    system.reset()
    plan = system.plan(first=True).plan
    with Looking(system, robot_2__planned_path=PathMessage) as seen:
        system.wait_for(lambda: any(len(path.poses) for path in seen.values()), "a path")
        end = np.reshape(plan.predicted, (3, 3))[1, :2]
        system.wait_for(lambda: np.allclose(places_of(seen["robot_2__planned_path"])[-1], end, rtol=0, atol=1e-12), "this path")
        other = system.plan(robots=[2], goal_x=[4e-4], goal_y=[9e-4], first=True).plan
        assert other.primitives
        system.wait_for(lambda: seen["robot_2__planned_path"].header.stamp == other.header.stamp, "the next path")
        assert np.allclose(places_of(seen["robot_2__planned_path"])[-1], [4e-4, 9e-4], rtol=0, atol=1e-9)


def test_a_plan_that_cannot_be_unfolded_ends_nobody_who_looks_on(system):
    publisher = system.client.node.create_publisher(MotionPlan, "accepted_plan", LATCHED)
    with Looking(system, path_markers=MarkerArray):
        for start in ([0.0] * 4, [math.nan] * 9):
            publisher.publish(MotionPlan(plan_id=f"odd{len(start)}", swarm_id=system.client.description.swarm_id, start=start))
            reason = "is not one of 3 robots" if len(start) == 4 else "are no numbers"
            system.wait_for(lambda reason=reason: reason in system.log("paths"), "refusal")
    system.client.node.destroy_publisher(publisher)


def test_health_is_told_and_what_is_wrong(system):
    system.reset()
    system.plan(first=True)
    system.wait_for(lambda: set(system.health) == TOLD_HEALTH, "health of all")
    system.wait_for(lambda: all(one.level == DiagnosticStatus.OK for one in system.health.values()), "good health")
    figures = {value.key: value.value for value in system.health["driver"].values}
    assert figures["swarm_id"] == system.client.description.swarm_id and figures["backend"] == "simulated"
    system.processes.stop("sequencer", signal.SIGKILL)
    system.wait_for(lambda: system.health["driver"].level == DiagnosticStatus.WARN, "warning")
    assert "sequencer_status" in system.health["driver"].message
    system.start("sequencer")
    system.wait_for(lambda: system.health["driver"].level == DiagnosticStatus.OK, "good health again")
