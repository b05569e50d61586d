"""The DDS security policy: it says what the nodes really do, and a keystore can be made of it."""

import os
import stat
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))

import security_policy  # noqa: E402

from stressbot_planner.ros.bringup import NODES, share  # noqa: E402

pytestmark = pytest.mark.xdist_group("security")


def profiles(text):
    """What may be done, by node: sets of (what, how, name)."""
    found = {}
    for profile in ElementTree.fromstring(text).iter("profile"):
        rules = found.setdefault(profile.attrib["node"], set())
        for group in profile:
            (how, allowed), = group.attrib.items()
            assert allowed == "ALLOW"
            rules |= {(group.tag, how, entry.text) for entry in group}
    return found


def test_the_policy_allows_what_the_nodes_do_and_nothing_else():
    committed = security_policy.POLICY.read_text()
    with security_policy.survey() as running:
        with suppress(TimeoutError):  # what differs is told below
            running.client.wait_for(lambda: security_policy.document(running.look()) == committed, 300.0, "committed policy")
        seen = security_policy.document(running.seen)
        enclaves = {name: enclave for name, _, enclave in running.node.get_node_names_and_namespaces_with_enclaves()}
    assert profiles(seen) == profiles(committed), "run tools/security_policy.py, look at what has changed, and commit it"
    assert seen == committed
    for enclave, names in security_policy.NODES.items():
        for name in set(names) - {"stressbot_demo"}:  # this process
            assert enclaves[name] == f"/stressbot/{enclave}"


def test_only_the_sequencer_sends_volts_and_only_people_who_may_start_them():
    allowed = profiles(security_policy.POLICY.read_text())
    sends = {node for node, rules in allowed.items() if ("topics", "publish", "voltage_sequence") in rules}
    starts = {node for node, rules in allowed.items() if ("services", "request", "start") in rules}
    sets = {node for node, rules in allowed.items() if ("services", "request", "driver/set_parameters") in rules}
    assert sends == {"sequencer"}
    assert starts == {"operator", "maintainer", "mover_client", "calibrate", "recognise", "stressbot_demo"}
    assert sets == {"maintainer"}
    assert all(("services", "request", "stop") in allowed[person] for person in ("observer", "operator", "maintainer"))


def test_every_node_of_the_launch_file_has_an_enclave():
    paths = {enclave.attrib["path"] for enclave in ElementTree.fromstring(security_policy.POLICY.read_text()).iter("enclave")}
    assert paths >= {f"/stressbot/{entry.executable}" for entry in NODES}


def test_the_script_makes_a_key_and_permissions_for_each_enclave_once(tmp_path):
    called, store = tmp_path / "called", tmp_path / "keystore"
    ros2 = tmp_path / "bin/ros2"
    ros2.parent.mkdir()
    ros2.write_text(
        f'#!/bin/sh\necho "$@" >> {called}\n'
        '[ "$2" != create_keystore ] || mkdir -p "$3/public"\n'
        '[ "$2" != create_enclave ] || { mkdir -p "$3/enclaves$4"; touch "$3/enclaves$4/cert.pem"; }\n'
    )
    ros2.chmod(ros2.stat().st_mode | stat.S_IXUSR)
    environment = {**os.environ, "PATH": f"{ros2.parent}:{os.environ['PATH']}"}
    script, policy = share("security", "make_keystore.sh"), share("security", "stressbot.policy.xml")
    paths = [enclave.attrib["path"] for enclave in ElementTree.parse(policy).getroot().iter("enclave")]
    permissions = [f"security create_permission {store} {path} {policy}" for path in paths]

    subprocess.run(["bash", script, store], env=environment, check=True)
    lines = called.read_text().splitlines()
    assert lines[0] == f"security create_keystore {store}"
    assert lines[1::2] == [f"security create_enclave {store} {path}" for path in paths]
    assert lines[2::2] == permissions
    assert not any(stat.S_IMODE(path.stat().st_mode) & 0o077 for path in store.rglob("*"))  # nobody else reads a key

    called.unlink()
    subprocess.run(["bash", script, store], env=environment, check=True)  # after a change of the policy
    assert called.read_text().splitlines() == permissions
