"""What a client of sequencer and driver takes for a measurement at rest."""

from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from stressbot_msgs.msg import DriverStatus, SwarmPoses

from stressbot_planner.ros import conversion
from stressbot_planner.ros.remote_bench import RemoteBench

UNIT = 1e-4
SCENE = SimpleNamespace(swarm=SimpleNamespace(n=2), ids=[1, 2], unit=UNIT, row=lambda robot, _: robot - 1)


class Client:
    """Messages that come one by one while somebody waits."""

    def __init__(self, status, messages):
        self.driver, self._coming, self.poses = status, list(messages), []
        self.node, self.swarm, self.drivers = self, None, 1

    def create_publisher(self, *_):
        return None

    def forget_poses(self):
        self.poses = []

    def is_bench_ready(self, seen=True):
        return True

    def wait_for(self, condition, timeout, what, meanwhile=None):
        while not (value := condition()):
            if not self._coming:
                raise TimeoutError(what)
            self.poses.append(self._coming.pop(0))
        return value


def stamped(message, seconds):
    message.header.stamp = Time(sec=int(seconds), nanosec=round(1e9 * (seconds % 1)))
    return message


def seen(x, sequence_time, stamp):
    return stamped(SwarmPoses(ids=[1, 2], x=[UNIT * x] * 2, y=[0.0, 0.0], heading=[0.0, 0.0], sequence_time=sequence_time), stamp)


@pytest.fixture
def measure(monkeypatch):
    monkeypatch.setattr(conversion, "scene_from_description", lambda _: SCENE)

    def measure(status, messages):
        return RemoteBench(Client(status, messages), "test", rest_frames=2).measure()[:, 0].tolist()

    return measure


DONE = stamped(DriverStatus(state=DriverStatus.DONE, sequence_time=2.3), 100.0)


def test_poses_from_before_a_motion_that_still_queue_up_are_no_measurement_after_it(measure):
    before = [seen(1.0, 3.7, 98.0 + 0.02 * k) for k in range(5)]  # the sequence before took longer
    during = [seen(1.5, 0.1 * k, 99.0 + 0.02 * k) for k in range(5)]
    after = [seen(2.0, 2.3, 100.0 + 0.02 * k) for k in range(5)]
    assert measure(DONE, before + during + after) == [2.0, 2.0]


def test_poses_of_a_motion_that_are_reported_late_are_no_measurement_at_rest(measure):
    late = [seen(1.5, 2.2, 100.1 + 0.02 * k) for k in range(5)]
    assert measure(DONE, late + [seen(2.0, 2.3, 100.3 + 0.02 * k) for k in range(2)]) == [2.0, 2.0]


def test_old_poses_alone_are_none(measure):
    with pytest.raises(TimeoutError):
        measure(DONE, [seen(1.0, 3.7, 98.0)] * 5)
