"""Over which transports a node's process talks."""

from pathlib import Path

import pytest
from stressbot_msgs.transports import avoid_shared_memory

APART = "<intraprocess_delivery>OFF</intraprocess_delivery>"


@pytest.mark.parametrize(
    "discovery",
    [
        {},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "192.168.7.2"},
    ],
)
def test_other_machines_are_found_as_before_and_talked_to_by_udp(discovery):
    environment = dict(discovery)
    avoid_shared_memory(environment)
    profile = Path(environment.pop("FASTRTPS_DEFAULT_PROFILES_FILE")).read_text(encoding="utf-8")
    assert environment == discovery | {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    assert APART in profile and "participant" not in profile.partition("<dds")[2]


def test_discovery_on_this_machine_is_limited_by_a_profile_instead():
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    avoid_shared_memory(environment)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    profile = Path(environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text(encoding="utf-8")
    assert "127.0.0.1" in profile and "<type>UDPv4</type>" in profile and "SHM" not in profile and APART in profile


@pytest.mark.parametrize("name", ["FASTDDS_BUILTIN_TRANSPORTS", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"])
def test_what_the_user_has_chosen_stays(name):
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", name: "chosen"}
    avoid_shared_memory(environment)
    assert environment == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", name: "chosen"}
