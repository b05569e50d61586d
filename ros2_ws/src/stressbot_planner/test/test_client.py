"""What a client has not heard it does not take for something else; what of a command line holds for a second client."""

import pytest
from stressbot_msgs.msg import DriverStatus

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.client import SwarmClient, without_parameters


class Silent(SwarmClient):
    """One that has heard nothing."""

    description = driver_status = sequencer_status = sequence = None
    poses = ()

    def __init__(self):
        pass


@pytest.mark.parametrize(
    ("name", "topic"),
    [("swarm", "swarm_description"), ("driver", "driver_status"), ("sequencer", "sequencer_status"), ("volts", "voltage_sequence")],
)
def test_what_is_gone_is_refused_by_its_topic(name, topic):
    with pytest.raises(StressbotError) as refusal:
        getattr(Silent(), name)
    assert (refusal.value.code, refusal.value.field) == (ErrorCode.NO_SWARM, topic)
    assert not Silent().is_bench_ready()


def test_what_was_heard_is_given():
    client = Silent()
    client.driver_status = DriverStatus(plan_id="p")
    assert client.driver.plan_id == "p"


def test_parameters_are_for_the_first_context_alone():
    line = ["mover", "--ros-args", "--params-file", "gone.yaml", "-r", "a:=b", "-p", "x:=1", "--param", "y:=2", "-r", "__ns:=/c"]
    assert without_parameters(line) == ["mover", "--ros-args", "-r", "a:=b", "-r", "__ns:=/c"]
    assert without_parameters(["mover", "-p"]) == ["mover"]
