"""Whole systems for tests: real processes that talk over real DDS, in a domain and a namespace of their own."""

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests hear Ctrl-C, also where tests run in the background
sys.path.insert(0, str(Path(__file__).parent / "support"))
sys.path += [str(Path(__file__).parents[1] / name) for name in ("benchmarks", "tools", "tools/ros2", "tools/site", "")]
sys.path.append(str(Path(__file__).parents[1] / "ros2_ws/src/stressbot_driver/test/support"))

settings.register_profile("stressbot", deadline=None, max_examples=60)
settings.load_profile("stressbot")


@pytest.fixture(scope="session", autouse=True)
def ros_environment():
    """A domain that nobody else uses, and no talk beyond this machine."""
    from stressbot_msgs.domains import reserve

    domain, hold = reserve()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    _keep_participants_apart()
    with hold:
        yield


def _keep_participants_apart():
    """Let this process, which has a client for each system, read a profile of Fast DDS once; node processes choose their own."""
    from rclpy import create_node, init
    from rclpy.context import Context
    from stressbot_msgs.transports import PROFILES, profile

    if PROFILES in os.environ:
        return
    os.environ[PROFILES], context = profile("apart.xml"), Context()
    init(context=context)
    create_node("first", context=context).destroy_node()
    context.try_shutdown()
    del os.environ[PROFILES]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Let one worker run all tests of a file: they share a system, and each further one costs half a minute of a processor."""
    for item in items:
        if item.path.parent == Path(__file__).parent and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


_of_this_test: list | None = None
"""Systems made while a test runs; None between tests."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call():
    """End what a test has made with it: three nodes that idle cost a quarter of a core."""
    global _of_this_test
    _of_this_test = systems = []
    try:
        return (yield)
    finally:
        _of_this_test = None
        for system in systems:
            system.close()


@pytest.fixture(scope="module")
def new_system(tmp_path_factory):
    """Return a function that makes a system (see system_rig.System); those of fixtures are ended with the module."""
    from system_rig import System

    systems = []

    def make(**arguments):
        system = System(tmp_path_factory.mktemp("system"), **arguments)
        (systems if _of_this_test is None else _of_this_test).append(system)
        return system

    yield make
    for system in systems:
        system.close()
