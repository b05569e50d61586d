"""Writes the DDS security policy of all nodes from what they really declare, as the ROS graph shows it; see docs/security.md.

    source tools/env.sh; python tools/security_policy.py        # then commit what has changed

The nodes run in a namespace of their own, which the policy leaves out: its names are those at the root.
"""

import os
import random
import re
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from rclpy._rclpy_pybind11 import NodeNameNonExistentError  # rclpy does not export it
from rclpy.action import ActionClient
from rclpy.node import Node
from stressbot_msgs.action import MoveSwarm

from stressbot_planner.ros.bringup import NodeEntry, command
from stressbot_planner.ros.child_processes import ChildProcesses
from stressbot_planner.ros.client import SwarmClient

ROOT = Path(__file__).resolve().parents[1]
POLICY = ROOT / "ros2_ws/src/stressbot_planner/security/stressbot.policy.xml"
SCENARIO = ROOT / "scenarios/paper-six.yaml"

PROCESSES = (
    NodeEntry("stressbot_driver", "driver", {"scenario": str, "pose_timeout": float}),
    NodeEntry("stressbot_driver", "instrument_emulator", {"scenario": str, "port": int}),
    NodeEntry("stressbot_driver", "simulated_camera", {"camera": str}),
    NodeEntry("stressbot_driver", "camera_tracker", {"camera": str}),
    NodeEntry("stressbot_driver", "image_source", {"source": str}),
    NodeEntry("stressbot_driver", "viewer"),
    NodeEntry("stressbot_planner", "sequencer"),
    NodeEntry("stressbot_planner", "planner"),
    NodeEntry("stressbot_planner", "mover"),
    NodeEntry("stressbot_planner", "tracker_relay"),
    NodeEntry("stressbot_planner", "paths"),
    NodeEntry("stressbot_planner", "clicks"),
    NodeEntry("stressbot_planner", "calibrate"),
    NodeEntry("stressbot_planner", "recognise"),
)
VALUES = {"scenario": SCENARIO, "port": 0, "pose_timeout": 9.0, "camera": "bench", "source": ROOT / "docs/images"}

NODES = {
    **{entry.executable: (entry.executable,) for entry in PROCESSES},
    "mover": ("mover", "mover_client"),
    "demo": ("stressbot_demo",),
}
"""Nodes by enclave; an enclave is a process."""

ALONE, WAITING = ("mover", "calibrate", "recognise"), "_waiting"

Rules = dict[tuple[str, str], list[str]]
"""Names by what and how: ("topics", "publish"), ("services", "reply"), ("actions", "call"), …"""

_SEEN = (("topics", "subscribe"), ("topics", "publish"), ("services", "reply"), ("services", "request"))
_ACTION = "/_action/"

ROBOT = re.compile(r"^robot_\d+/")
"""Begins the names of topics that each robot has; another swarm has other robots."""


def graph_of(node: Node, name: str, namespace: str) -> Rules:
    """Return what a node does, relative to its namespace and itself; empty if it is not there."""
    views = (
        node.get_subscriber_names_and_types_by_node,
        node.get_publisher_names_and_types_by_node,
        node.get_service_names_and_types_by_node,
        node.get_client_names_and_types_by_node,
    )
    rules: dict[tuple[str, str], set[str]] = {}
    overheard: dict[tuple[str, str], set[str]] = {}
    for (what, how), view in zip(_SEEN, views, strict=True):
        try:
            names = [full for full, _ in view(name, namespace)]
        except NodeNameNonExistentError:
            return {}
        for full in names:
            action, is_action, _part = full.partition(_ACTION)
            if not is_action:
                rules.setdefault((what, how), set()).add(_relative(full, name, namespace))
            elif what == "services":
                how_action = "execute" if how == "reply" else "call"
                rules.setdefault(("actions", how_action), set()).add(_relative(action, name, namespace))
            else:
                overheard.setdefault((what, how), set()).add(_relative(full, name, namespace))
    of_action = {name for (what, _), names in rules.items() if what == "actions" for name in names}
    for (what, how), names in overheard.items():  # by nodes that neither serve nor call the action
        rules.setdefault((what, how), set()).update(name for name in names if name.partition(_ACTION)[0] not in of_action)
    return {key: sorted(rules[key]) for key in sorted(rules) if rules[key]}


def _relative(full: str, name: str, namespace: str) -> str:
    own = f"{namespace}/{name}/"
    relative = "~/" + full.removeprefix(own) if full.startswith(own) else full.removeprefix(namespace + "/")
    return ROBOT.sub("robot_*/", relative)


def people(nodes: dict[str, Rules]) -> dict[str, Rules]:
    """Return what people may do, each one more than the one before: look on, drive, set parameters."""
    published = {name for rules in nodes.values() for name in rules.get(("topics", "publish"), ())}
    topics = sorted(published - {"/parameter_events"})
    driven = ["plan_motion", "reset", "start", "stop"]
    asked = sorted(
        f"{name}{service[1:]}"
        for name, rules in nodes.items()
        for service in rules.get(("services", "reply"), ())
        if service.startswith("~/") and "parameter" in service
    )
    looking = [service for service in asked if "/set_" not in service]
    observer = {("topics", "subscribe"): topics, ("services", "request"): sorted(["stop", *looking])}
    actions = ["move_swarm", "plan_motion_action"]
    operator = observer | {
        ("topics", "publish"): ["clicked_point", "goal_pose"],
        ("services", "request"): sorted([*driven, *looking]),
        ("actions", "call"): actions,
    }
    return {
        "observer": observer,
        "operator": operator,
        "maintainer": operator | {("services", "request"): sorted([*driven, *asked])},
    }


class Survey:
    """All nodes, running; what was seen of each."""

    def __init__(self, client: SwarmClient, namespace: str) -> None:
        self.client, self.node, self._namespace = client, client.node, namespace
        self._mover = ActionClient(client.node, MoveSwarm, f"{namespace}{WAITING}/move_swarm")
        client.wait_for(self._mover.server_is_ready, 60.0, "mover")
        client.wait_for(self._planner_serves, 60.0, "planner")
        self._mover.send_goal_async(MoveSwarm.Goal())  # without a goal it is no client
        self.seen: dict[str, dict[str, Rules]] = {enclave: dict.fromkeys(names, {}) for enclave, names in NODES.items()}

    def _planner_serves(self) -> bool:
        """Tell whether the planner has come up: it serves only once its planning process has loaded all kernels."""
        return "plan_motion" in graph_of(self.node, "planner", self._namespace).get(("services", "reply"), ())

    def look(self) -> dict[str, dict[str, Rules]]:
        """Return what every node does, by enclave and name, as it was seen last."""
        for enclave, names in NODES.items():
            namespace = self._namespace + WAITING * (enclave in ALONE)
            for name in names:
                if rules := graph_of(self.node, name, namespace):
                    self.seen[enclave][name] = rules
        self.seen["demo"]["stressbot_demo"].pop(("actions", "call"), None)  # this tool's own
        return self.seen


@contextmanager
def survey() -> Iterator[Survey]:
    """Run all nodes, mover and calibrate where nobody else is: they wait there for a driver, and stay to be looked at."""
    namespace = f"/policy_{random.getrandbits(48):x}"
    with TemporaryDirectory() as folder, ChildProcesses(Path(folder), {**os.environ, "ROS_LOG_DIR": folder}) as processes:
        for entry in PROCESSES:
            values = {name: VALUES[name] for name in entry.arguments}
            where = namespace + WAITING * (entry.executable in ALONE)
            processes.start(entry.executable, command(entry, values, namespace=where))
        with SwarmClient("stressbot_demo", namespace) as client:
            yield Survey(client, namespace)


def document(nodes: dict[str, dict[str, Rules]]) -> str:
    """Return the policy file."""
    policy = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(policy, "enclaves")
    single = {name: rules for profiles in nodes.values() for name, rules in profiles.items()}
    for enclave, profiles in (nodes | {name: {name: rules} for name, rules in people(single).items()}).items():
        parent = ElementTree.SubElement(enclaves, "enclave", path=f"/stressbot/{enclave}")
        parent = ElementTree.SubElement(parent, "profiles")
        for name, rules in profiles.items():
            profile = ElementTree.SubElement(parent, "profile", ns="/", node=name)
            for (what, how), names in rules.items():
                group = ElementTree.SubElement(profile, what, {how: "ALLOW"})
                for text in names:
                    ElementTree.SubElement(group, what.removesuffix("s")).text = text
    ElementTree.indent(policy)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(policy, encoding="unicode")}\n'


def main() -> int:
    """Write the policy file once nothing new has come for some seconds."""
    with survey() as running:
        text, since = "", time.monotonic()
        while time.monotonic() < since + 5.0:
            nodes = running.look()
            if document(nodes) != text:
                text, since = document(nodes), time.monotonic()
            time.sleep(0.2)
    absent = [name for profiles in nodes.values() for name, rules in profiles.items() if not rules]
    if absent:
        sys.exit(f"not seen: {', '.join(absent)}")
    POLICY.parent.mkdir(exist_ok=True)
    POLICY.write_text(text)
    print(f"wrote {POLICY.relative_to(ROOT)}: {len(nodes)} enclaves of nodes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
