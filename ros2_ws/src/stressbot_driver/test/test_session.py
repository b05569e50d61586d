"""The state machine, every transition and every refusal, over a backend that obeys the test."""

import pytest
from driver_support import bench, encode, sequence

from stressbot_driver.backends.base import Backend, Pacing, Progress
from stressbot_driver.errors import BenchError, ErrorCode
from stressbot_driver.sequence import Limits
from stressbot_driver.session import Session, State


class PuppetBackend(Backend):
    """Runs until the test says that it ended; fails where the test says so."""

    def __init__(self, bench, listener):
        super().__init__(bench, None, listener)
        self.calls = []
        self.broken = None

    @property
    def limits(self):
        return Limits(min_level=0.0, max_level=200.0)

    def _call(self, name):
        self.calls.append(name)
        if self.broken == name:
            raise OSError("cable unplugged")

    def upload(self, sequence):
        self._call("upload")

    def start(self, pacing):
        self._call("start")

    def stop(self):
        self._call("stop")

    def reset(self):
        self._call("reset")

    def close(self):
        self._call("close")

    def progress(self):
        return Progress()


class Rig:
    def __init__(self):
        self.bench = bench(6)
        self.published = []
        self.session = Session(on_change=lambda: self.published.append(self.session.status()), on_poses=lambda *_: None)
        self.backend = PuppetBackend(self.bench, self.session)
        self.session.attach(self.backend)

    def load(self, plan_id="plan", **changes):
        self.session.load(sequence(self.bench, [90.0, 0.0], [0.1, 0.1], plan_id=plan_id, **changes))

    def start(self):
        self.session.start(Pacing())

    @property
    def state(self):
        return self.session.status().state

    def bring_to(self, state):
        """From IDLE to `state` by the shortest way."""
        if state == State.IDLE:
            return
        self.load()
        if state == State.STOPPED:
            self.session.stop()
        if state in (State.RUNNING, State.DONE, State.FAULT):
            self.start()
        if state == State.DONE:
            self.session.finished()
        if state == State.FAULT:
            self.session.failed(BenchError(ErrorCode.BACKEND_FAILURE, "backend", "it broke: call reset"))
        assert self.state == state


@pytest.fixture
def rig():
    return Rig()


def refused(request):
    with pytest.raises(BenchError) as error:
        request()
    assert error.value.message
    return error.value.code


TABLE = {
    # state: (load, start, stop, reset): the state after, or the refusal
    State.IDLE: (State.LOADED, ErrorCode.NOTHING_LOADED, State.IDLE, State.IDLE),
    State.LOADED: (State.LOADED, State.RUNNING, State.STOPPED, State.IDLE),
    State.RUNNING: (ErrorCode.BUSY, ErrorCode.BUSY, State.STOPPED, ErrorCode.BUSY),
    State.DONE: (State.LOADED, ErrorCode.NOTHING_LOADED, State.DONE, State.IDLE),
    State.STOPPED: (State.LOADED, ErrorCode.NOTHING_LOADED, State.STOPPED, State.IDLE),
    State.FAULT: (ErrorCode.BACKEND_FAILURE, ErrorCode.BACKEND_FAILURE, State.FAULT, State.IDLE),
}


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("number", range(4), ids=["load", "start", "stop", "reset"])
def test_every_request_in_every_state(rig, state, number):
    rig.bring_to(state)
    request = [rig.load, rig.start, rig.session.stop, rig.session.reset][number]
    after = TABLE[state][number]
    before = len(rig.published)
    if isinstance(after, ErrorCode):
        assert refused(request) == after
        assert rig.state == state
        assert rig.session.status().error_code == after
        assert rig.published[-1].error_msg
    else:
        request()
        assert rig.state == after
        if after != state:
            assert rig.published[-1].state == after
        if number != 2:
            assert rig.session.status().error_code == ErrorCode.NONE
    assert len(rig.published) >= before


def test_states_equal_the_message():
    from stressbot_msgs.msg import DriverStatus

    assert {state.name: int(state) for state in State} == {
        name: getattr(DriverStatus, name) for name in dir(type(DriverStatus)) if name[0].isalpha() and name.isupper()
    }


def test_stop_reaches_the_output_in_every_state(rig):
    for state in State:
        fresh = Rig()
        fresh.bring_to(state)
        fresh.backend.calls.clear()
        fresh.session.stop()
        assert "stop" in fresh.backend.calls


def test_a_refused_sequence_leaves_the_loaded_one(rig):
    rig.load("first")
    assert refused(lambda: rig.load("second", swarm_id="other")) == ErrorCode.WRONG_SWARM
    status = rig.session.status()
    assert (status.state, status.plan_id, status.refused_plan_id) == (State.LOADED, "first", "second")
    assert status.error_code == ErrorCode.WRONG_SWARM and "swarm_id" in status.error_msg
    rig.start()
    assert rig.session.status().error_code == ErrorCode.NONE


def test_a_refused_sequence_leaves_the_running_one(rig):
    rig.load("first")
    rig.start()
    rig.backend.calls.clear()
    assert refused(lambda: rig.load("second")) == ErrorCode.BUSY
    status = rig.session.status()
    assert (status.state, status.plan_id, status.refused_plan_id) == (State.RUNNING, "first", "second")
    assert rig.backend.calls == []


def test_nothing_reaches_the_backend_before_the_check(rig):
    assert refused(lambda: rig.session.load(sequence(rig.bench, [0.0, 300.0], [1.0, 1.0]))) == ErrorCode.LIMIT_EXCEEDED
    assert rig.backend.calls == []


def test_a_new_sequence_replaces_the_loaded_one(rig):
    rig.load("first")
    rig.session.load(encode(rig.bench, [(1, 1.0), (2, 2.0)], plan_id="second"))
    status = rig.session.status()
    assert (status.plan_id, status.epoch_count) == ("second", 2)
    assert status.duration == pytest.approx(3.0 + 2 * (0.01 + 0.005 + 2 * 0.015 + 0.005))


@pytest.mark.parametrize("broken", ["upload", "start", "reset"])
def test_a_failing_backend_ends_in_fault_at_rest(rig, broken):
    rig.backend.broken = broken
    requests = {"upload": [rig.load], "start": [rig.load, rig.start], "reset": [rig.session.reset]}[broken]
    for request in requests[:-1]:
        request()
    assert refused(requests[-1]) == ErrorCode.BACKEND_FAILURE
    status = rig.session.status()
    assert status.state == State.FAULT and "cable unplugged" in status.error_msg
    assert rig.backend.calls[-1] == "stop"
    rig.backend.broken = None
    rig.session.reset()
    assert rig.state == State.IDLE and rig.session.status().error_msg == ""


def test_poses_are_not_read_while_a_sequence_runs(rig):
    rig.backend.poses = lambda: "poses"
    assert rig.session.poses() == (0.0, "poses")
    rig.bring_to(State.RUNNING)
    assert rig.session.poses() is None
    rig.session.finished()
    assert rig.session.poses() == (0.0, "poses")
    rig.backend.poses = lambda: None
    assert rig.session.poses() is None


def test_close_stops_first(rig):
    rig.bring_to(State.RUNNING)
    rig.session.close()
    assert rig.backend.calls[-1] == "close" and "stop" in rig.backend.calls
    assert rig.state == State.STOPPED
