"""Whole systems for tests: real processes that talk over real DDS, in a domain and a namespace of their own."""

import os
import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))
sys.path += [str(Path(__file__).parents[1] / "benchmarks"), str(Path(__file__).parents[1])]


@pytest.fixture(scope="session", autouse=True)
def ros_environment():
    """A domain that other test runs hardly use, and no talk beyond this machine."""
    os.environ["ROS_DOMAIN_ID"] = str(random.randint(1, 101))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


@pytest.fixture(scope="module")
def new_system(tmp_path_factory):
    """Return a function that makes a system (see system_rig.System); all are ended with the module."""
    from system_rig import System

    systems = []

    def make(**arguments):
        systems.append(System(tmp_path_factory.mktemp("system"), **arguments))
        return systems[-1]

    yield make
    for system in systems:
        system.close()
