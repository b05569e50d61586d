"""The state machine, every transition and every refusal, over a backend that obeys the test."""

import threading
from functools import partial
from pathlib import Path

import pytest
from driver_support import bench, encode, sequence

from stressbot_driver.backends.base import Backend, Pacing, Progress
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import Limits
from stressbot_driver.session import AHEAD, Session, State, Status


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
    def __init__(self, **caps):
        self.bench = bench(6)
        self.published = []
        self.session = Session(
            partial(PuppetBackend, self.bench),
            on_change=lambda: self.published.append(self.session.status()),
            on_poses=lambda *_: None,
            **caps,
        )
        self.backend = self.session.backend

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
            self.session.failed(StressbotError(ErrorCode.BACKEND_FAILURE, "backend", "it broke: call reset"))
        assert self.state == state


@pytest.fixture
def rig():
    return Rig()


def refused(request):
    with pytest.raises(StressbotError) as error:
        request()
    assert error.value.message
    return error.value.code


def documented():
    """Cells (state, event, outcome) of the table of states in docs/safety.md."""
    text = (Path(__file__).parents[4] / "docs/safety.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]
    head = next(row for row in rows if row[:2] == ["state", "sequence"])
    states = {row[0]: row[1:] for row in rows if len(row) == len(head) and row[0] in State.__members__}
    assert list(states) == [state.name for state in State]
    return [(State[name], event, cell) for name, row in states.items() for event, cell in zip(head[1:], row, strict=True)]


LOSS = StressbotError(ErrorCode.PEER_LOST, "sequencer_status", "silent: start it again, then call reset")


@pytest.mark.parametrize(("state", "event", "after"), documented(), ids=lambda value: getattr(value, "name", value))
def test_every_documented_transition_and_refusal(rig, state, event, after):
    events = {
        "sequence": rig.load,
        "start": rig.start,
        "stop": rig.session.stop,
        "reset": rig.session.reset,
        "end": rig.session.finished,
        "failure": lambda: rig.session.failed(StressbotError(ErrorCode.BACKEND_FAILURE, "backend", "it broke: call reset")),
        "loss": lambda: rig.session.lost(LOSS),
    }
    rig.bring_to(state)
    rig.backend.calls.clear()
    if after in State.__members__:
        events[event]()
        assert rig.state == State[after]
        if State[after] != state:
            assert rig.published[-1].state == State[after]
        if event in ("sequence", "start", "reset"):
            assert rig.session.status().error_code == ErrorCode.NONE
        if event == "stop" or (event, state) == ("loss", State.RUNNING):
            assert "stop" in rig.backend.calls
        return
    code = ErrorCode.BACKEND_FAILURE if after == "the fault's code" else ErrorCode[after]
    assert refused(events[event]) == code
    assert rig.state == state
    assert rig.session.status().error_code == code
    assert rig.published[-1].error_msg
    assert not rig.backend.calls


def test_a_loss_is_latched_named_and_keeps_later_starts_away(rig):
    rig.bring_to(State.RUNNING)
    assert rig.session.lost(LOSS)
    status = rig.published[-1]
    assert (status.state, status.error_code, status.missing) == (State.FAULT, ErrorCode.PEER_LOST, ("sequencer_status",))
    rig.session.found("sequencer_status")
    assert (rig.state, rig.published[-1].missing) == (State.FAULT, ())
    assert refused(rig.load) == refused(rig.start) == ErrorCode.PEER_LOST
    assert "silent" in rig.session.status().error_msg
    rig.session.reset()
    assert not rig.session.lost(LOSS)
    rig.load()
    assert refused(rig.start) == ErrorCode.PEER_LOST
    assert rig.state == State.LOADED
    rig.session.found("sequencer_status")
    rig.start()
    assert rig.state == State.RUNNING


def test_a_loss_during_a_start_still_ends_at_rest(rig):
    rig.load()
    losing = threading.Thread(target=rig.session.lost, args=(LOSS,))
    stopped, stop = threading.Event(), rig.backend.stop

    def noticed_stop():
        stop()
        stopped.set()

    def start(pacing):
        rig.backend.calls.append("start")
        losing.start()
        stopped.wait()  # the loss has seen RUNNING, and what is now started must not stay
        rig.backend.calls.append("volts")

    rig.backend.start, rig.backend.stop = start, noticed_stop
    rig.start()
    losing.join()
    assert rig.state == State.FAULT
    assert rig.backend.calls[-1] == "stop"


def test_what_was_planned_before_the_last_motion_is_refused(rig):
    """Doubled, late and reordered messages, and a plan that another planner has made meanwhile."""
    now = 10
    rig.session._now = lambda: now
    rig.session._moved = 5
    for stamp in (1, 4):
        assert refused(lambda stamp=stamp: rig.load("from before the driver", stamp=stamp)) == ErrorCode.OUTDATED
    rig.load("first", stamp=6)
    rig.load("second", stamp=6)  # nobody has moved in between
    rig.start()
    rig.session.finished()
    for plan_id in ("first", "second", "late"):
        assert refused(lambda plan_id=plan_id: rig.load(plan_id, stamp=9)) == ErrorCode.OUTDATED
        assert (rig.state, rig.session.status().refused_plan_id) == (State.DONE, plan_id)
    rig.load("third", stamp=10)
    now = 20
    rig.session.reset()
    assert refused(lambda: rig.load("third", stamp=19)) == ErrorCode.OUTDATED
    rig.load("unstamped")
    rig.load("fourth", stamp=20)


def test_a_clock_that_was_set_back_needs_a_reset_and_lets_nothing_old_through(rig):
    hour, rig.session._moved = 3600 * 10**9, 0
    now = 10 * hour
    rig.session._now = lambda: now
    rig.load("first", stamp=now)
    rig.start()
    rig.session.finished()
    now -= hour
    assert refused(lambda: rig.load("new", stamp=now)) == ErrorCode.OUTDATED
    rig.session.reset()
    assert refused(lambda: rig.load("from before the jump", stamp=now + hour)) == ErrorCode.OUTDATED
    rig.load("from a clock that is a little ahead", stamp=now + AHEAD)
    assert AHEAD == 10**9 and refused(lambda: rig.load("from one that is more", stamp=now + AHEAD + 1)) == ErrorCode.OUTDATED
    rig.load("new", stamp=now)


def test_refusals_of_old_and_future_poses_say_by_how_much(rig):
    rig.session._now, rig.session._moved = (lambda: 20 * 10**9), 5 * 10**9
    for stamp, text in ((2 * 10**9, "poses of 3.000 s before"), (27 * 10**9, "poses of 7.000 s in the future")):
        assert refused(lambda stamp=stamp: rig.load(stamp=stamp)) == ErrorCode.OUTDATED
        assert text in rig.session.status().error_msg


def test_a_loss_at_rest_is_told_once(rig):
    for _ in range(3):
        assert not rig.session.lost(LOSS)
    assert [status.missing for status in rig.published] == [("sequencer_status",)]


def test_a_status_begins_with_nothing_and_has_nothing_after_a_reset(rig):
    assert Status() == Status(State.IDLE, "", 0, 0, 0.0, 0.0, 0.0, ErrorCode.NONE, "", "", ())
    rig.bring_to(State.DONE)
    rig.session.reset()
    assert rig.session.status() == Status()


def test_in_fault_a_refusal_is_told_and_the_fault_itself_only_once(rig):
    rig.bring_to(State.FAULT)
    rig.published.clear()
    assert refused(lambda: rig.load("late")) == ErrorCode.BACKEND_FAILURE
    assert (rig.published[-1].refused_plan_id, len(rig.published)) == ("late", 1)
    fresh = Rig()
    fresh.load()
    fresh.backend.broken = "start"
    fresh.published.clear()
    refused(fresh.start)
    assert [status.state for status in fresh.published] == [State.RUNNING, State.FAULT]


@pytest.mark.parametrize("request_", ["stop", "loss", "close"])
def test_an_output_that_does_not_come_to_rest_is_a_fault(rig, request_):
    rig.bring_to(State.RUNNING)
    rig.backend.broken = "stop"
    if request_ == "loss":
        rig.session.lost(LOSS)
    else:
        assert refused(getattr(rig.session, request_)) == ErrorCode.BACKEND_FAILURE
    assert rig.state == State.FAULT
    assert "cable unplugged" in rig.session.status().error_msg
    assert request_ != "close" or rig.backend.calls[-1] == "close"


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


def test_the_tighter_of_backend_and_caps_holds():
    rig = Rig(max_duration=0.15, max_slew_rate=float("inf"), max_level=300.0)
    assert (rig.session.limits.max_duration, rig.session.limits.max_level) == (0.15, 200.0)
    assert refused(rig.load) == ErrorCode.LIMIT_EXCEEDED
    assert "duration" in rig.session.status().error_msg
    rig = Rig(max_duty=0.4)
    electrical = rig.bench.electrical
    assert refused(lambda: rig.session.load(encode(rig.bench, [(1, 1.0)]))) == ErrorCode.LIMIT_EXCEEDED
    rig.session.load(sequence(rig.bench, [electrical.reset_level, 0.0], [1.0, 1.0]))  # which moves nobody


def test_a_sequence_that_the_output_cannot_play_is_refused_and_the_loaded_one_stays(rig):
    rig.load("first")

    def refuse(_sequence):
        raise StressbotError(ErrorCode.LIMIT_EXCEEDED, "levels[0]", "the generator cannot hold it: send shorter epochs")

    rig.backend.upload = refuse
    assert refused(lambda: rig.load("second")) == ErrorCode.LIMIT_EXCEEDED
    status = rig.session.status()
    assert (status.state, status.plan_id, status.refused_plan_id) == (State.LOADED, "first", "second")
    rig.start()


@pytest.mark.parametrize("running", [False, True])
def test_no_status_repeats_a_name_of_any_length(rig, running):
    if running:
        rig.bring_to(State.RUNNING)
    assert refused(lambda: rig.load("p" * 10_000_000)) == (ErrorCode.BUSY if running else ErrorCode.LIMIT_EXCEEDED)
    status = rig.session.status()
    assert len(status.refused_plan_id) <= 200 and len(status.error_msg) <= 2000
    assert running or refused(lambda: rig.load("plan", swarm_id="s" * 10_000_000)) == ErrorCode.WRONG_SWARM
    assert len(rig.session.status().error_msg) <= 2000


def test_no_drive_at_all_where_max_duty_is_zero():
    rig = Rig(max_duty=0.0)
    assert refused(lambda: rig.session.load(encode(rig.bench, [(1, 1e-3)]))) == ErrorCode.LIMIT_EXCEEDED
    rig.load()  # which moves nobody


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


@pytest.mark.parametrize("request_", ["start", "reset"])
def test_an_output_that_refuses_what_only_an_upload_may_be_refused_is_a_fault(rig, request_):
    def refuse(*_arguments):
        raise StressbotError(ErrorCode.UNSUPPORTED, "real_time_factor", "is 2: a generator plays in real time, set it to 1")

    rig.load()
    setattr(rig.backend, request_, refuse)
    assert refused(rig.start if request_ == "start" else rig.session.reset) == ErrorCode.UNSUPPORTED
    assert rig.state == State.FAULT and rig.backend.calls[-1] == "stop"


def test_poses_are_not_read_while_a_sequence_runs(rig):
    rig.backend.poses = lambda: "poses"
    assert rig.session.poses() == (0.0, "poses")
    rig.bring_to(State.RUNNING)
    assert rig.session.poses() is None
    rig.session.finished()
    assert rig.session.poses() == (0.0, "poses")
    rig.backend.poses = lambda: None
    assert rig.session.poses() is None


def test_a_backend_that_fails_while_it_is_made_is_a_fault():
    def make(listener):
        listener.failed(StressbotError(ErrorCode.BACKEND_FAILURE, "instrument", "it was on: call reset"))
        return PuppetBackend(bench(6), listener)

    session = Session(make, on_change=lambda: None, on_poses=lambda *_: None)
    assert session.status().state == State.FAULT
    with pytest.raises(StressbotError, match="it was on"):
        session.start(Pacing())


def test_close_stops_first(rig):
    rig.bring_to(State.RUNNING)
    rig.session.close()
    assert rig.backend.calls[-1] == "close" and "stop" in rig.backend.calls
    assert rig.state == State.STOPPED


def test_start_with_nothing_loaded_names_the_cause(rig):
    def cause():
        with pytest.raises(StressbotError) as refusal:
            rig.start()
        assert refusal.value.code == ErrorCode.NOTHING_LOADED
        return refusal.value.message

    assert "plan from the present poses" in cause()
    rig.session._why_none = lambda: "no sequencer is there: start one"
    assert cause() == "no voltage sequence is loaded: no sequencer is there: start one"
    with pytest.raises(StressbotError):
        rig.load(plan_id="hot", swarm_id="other")
    assert "that of plan hot was refused (swarm_id: " in cause()
    assert "that of plan hot was refused (swarm_id: " in cause()  # not only once
    rig.load(plan_id="good")
    rig.session.stop()
    assert "that of plan good was stopped, and each serves once" in cause()
    rig.session.reset()
    assert "no sequencer is there" in cause()
    rig.bring_to(State.DONE)
    assert "that of plan plan has run to its end, and each serves once" in cause()
