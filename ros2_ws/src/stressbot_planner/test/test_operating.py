"""What an operator is told where not everybody is there."""

from types import SimpleNamespace

import pytest
from stressbot_msgs.msg import DriverStatus, SequencerStatus, SwarmDescription, SwarmPoses

from stressbot_planner.ros import operating


class Heard:
    """A client that has heard what it will ever hear."""

    def __init__(self, **heard):
        self.driver_status = self.description = self.sequencer_status = None
        self.poses = []
        vars(self).update(heard)
        self.driver, self.swarm = self.driver_status, self.description
        self.node = SimpleNamespace(count_publishers=lambda topic: 0)

    def wait_for(self, condition, timeout, what):
        if not condition():
            raise TimeoutError(f"no {what} within {timeout:g} s")


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(operating, "SEEN_WITHIN", -1.0)


DRIVER = {
    "driver_status": DriverStatus(state=DriverStatus.RUNNING, backend="waveform_generator", sequence_time=2.0, duration=5.0),
    "description": SwarmDescription(name="bench", ids=[1, 2]),
}


def test_robots_that_nobody_sees_are_none():
    told = operating.status(Heard(**DRIVER), 1.0)
    assert (told["state"], told["time_left"], told["robot_count"]) == ("RUNNING", 3.0, 2)
    assert told["robots"] == [] and told["sequencer"] is None


def test_what_the_sequencer_refused_is_told():
    refused = SequencerStatus(error_code=1, error_msg="robots: no")
    poses = SwarmPoses(ids=[2], x=[1.0], y=[2.0], heading=[0.5])
    told = operating.status(Heard(**DRIVER, sequencer_status=refused, poses=[poses]), 1.0)
    assert told["sequencer"] == "robots: no" and told["robots"] == [{"id": 2, "x": 1.0, "y": 2.0, "heading": 0.5}]


def test_without_a_driver_there_is_nothing_to_tell():
    with pytest.raises(TimeoutError, match="word of a driver"):
        operating.status(Heard(), 0.1)
