"""What stands on topics for those who look on: qualities of service as documented, the copy of a plan, the health of nodes."""

import signal
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from stressbot_msgs.msg import MotionPlan
from system_rig import asking_again
from three_robots import SCENARIO

from stressbot_planner.ros.qos import LATCHED

PAGE = Path(__file__).parents[1] / "docs/topics.md"
ROWS = [[cell.strip(" `") for cell in line.split("|")[1:-1]] for line in PAGE.read_text().splitlines() if line.startswith("| `")]
TOLD_HEALTH = {"driver", "sequencer", "planner", "mover"}
NODES = (*sorted(TOLD_HEALTH), "viewer")


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


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_qualities_of_service_are_as_documented(system, row):
    topic, kind, nodes, reliability, durability, _depth, _why = row
    name = topic if topic.startswith("/") else f"{system.namespace}/{topic}"

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
