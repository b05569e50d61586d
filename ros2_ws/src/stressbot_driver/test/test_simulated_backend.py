import math
import threading
import time

import numpy as np
import pytest
from driver_support import DEADLINE, FakeClock, Recorder, bench, closed_form, encode, sequence

from stressbot_driver.backends import playback
from stressbot_driver.backends.base import Backend, Pacing, make_backend
from stressbot_driver.backends.simulated import SLIP, SimulatedBackend
from stressbot_driver.clock import WallClock
from stressbot_driver.declaration import Declaration
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.simulation.substrate import Substrate

PLAN = [(1, 0.5), (4, 1.0), (2, 0.7)]


class LoggedSubstrate(Substrate):
    """Remembers when each level was applied."""

    def __init__(self, bench, clock):
        self.log = []
        self.clock = clock
        super().__init__(bench)

    def apply(self, level):
        self.log.append((self.clock.now(), level))
        super().apply(level)


class Rig:
    def __init__(self, count=6, clock=None):
        self.bench = bench(count)
        self.clock = clock or FakeClock()
        self.listener = Recorder()
        self.substrate = LoggedSubstrate(self.bench, self.clock)
        self.backend = SimulatedBackend(self.bench, self.clock, self.listener, substrate=self.substrate)

    def run(self, plan=PLAN, pacing=None):
        played = encode(self.bench, plan)
        self.backend.upload(played)
        self.substrate.log.clear()
        self.backend.start(pacing or Pacing())
        assert self.listener.ended.wait(DEADLINE)
        return played

    def end_poses(self):
        return self.listener.samples[-1]


def test_levels_are_applied_at_their_times():
    rig = Rig()
    played = rig.run()
    expected = 100.0 + np.concatenate([[0.0], np.cumsum(played.dwells)])
    times, levels = zip(*rig.substrate.log, strict=True)
    assert list(levels) == [*played.levels, 0.0]
    assert np.allclose(times, expected, rtol=0, atol=1e-9)
    assert rig.listener.done and rig.listener.error is None


@pytest.mark.parametrize("factor", [0.0, 0.1, 1.0, 7.0, 1e6])
def test_the_end_is_exact_at_any_pace(factor):
    rig = Rig()
    played = rig.run(pacing=Pacing(real_time_factor=factor))
    time, poses = rig.end_poses()
    assert time == pytest.approx(played.duration, abs=1e-12)
    expected = closed_form(rig.bench, PLAN)
    assert np.allclose(poses.x, expected[:, 0], rtol=0, atol=1e-15)
    progress = rig.backend.progress()
    assert (progress.epoch, progress.level) == (3, 0.0)
    assert progress.time == time
    assert rig.clock.now() - 100.0 == pytest.approx(played.duration / factor if factor else 0.0, rel=1e-6)


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0])
def test_poses_come_at_the_pose_rate_of_wall_time(factor):
    rig = Rig()
    played = rig.run(pacing=Pacing(real_time_factor=factor, pose_rate=20.0))
    times = [time for time, _ in rig.listener.samples]
    assert times == sorted(times)
    wanted = np.arange(1, int(played.duration / factor * 20.0) + 1) * factor / 20.0
    assert all(np.abs(np.array(times) - time).min() < 1e-9 for time in wanted)
    # Ends of epochs come on top, but never so many that readers are flooded.
    assert len(times) <= len(wanted) + 3 + 1


def test_as_fast_as_possible_reports_epoch_ends_without_flooding():
    rig = Rig()
    rig.run([(1, 0.1)] * 500, Pacing(real_time_factor=0.0, pose_rate=50.0))
    assert 2 <= len(rig.listener.samples) <= 3  # no wall time passes on the fake clock
    assert rig.listener.samples[-1][0] == pytest.approx(encode(rig.bench, [(1, 0.1)] * 500).duration)


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_stop_within_a_segment_ends_at_rest_where_the_robots_are(factor):
    rig = Rig()
    played = encode(rig.bench, [(4, 10.0)])
    moment = float(played.dwells[:-2].sum()) + 3.0  # three seconds into the drive
    rig.clock.at(moment / factor, rig.backend.stop)
    ended = threading.Event()
    rig.listener.poses_measured = lambda time, poses: (rig.listener.samples.append((time, poses)), ended.set())
    rig.backend.upload(played)
    rig.backend.start(Pacing(real_time_factor=factor, pose_rate=0.1))
    rig.backend._thread.join(DEADLINE)
    assert ended.is_set()
    time, poses = rig.end_poses()
    assert time == pytest.approx(moment, abs=1e-9)
    assert poses.heading == pytest.approx([3.0] * 6, abs=1e-6)
    assert rig.substrate.log[-1][1] == 0.0 and rig.substrate.log[-1][0] == pytest.approx(100.0 + moment / factor)
    assert not rig.listener.done and rig.listener.error is None
    assert rig.backend.progress().level == 0.0


def test_stop_works_at_any_time_and_twice():
    rig = Rig()
    rig.backend.stop()
    rig.backend.upload(encode(rig.bench, PLAN))
    rig.backend.stop()
    rig.backend.start(Pacing(real_time_factor=0.0))
    assert rig.listener.ended.wait(DEADLINE)
    rig.backend.stop()
    rig.backend.close()
    rig.backend.close()


def test_a_failure_ends_at_rest_and_is_reported_after():
    rig = Rig()
    levels_at_report = []
    rig.listener.failed = lambda error: (levels_at_report.append((rig.substrate.level, error.code)), rig.listener.ended.set())

    def broken(dt):
        raise RuntimeError("the grid is on fire")

    rig.substrate.advance = broken
    rig.run()
    assert levels_at_report == [(0.0, ErrorCode.BACKEND_FAILURE)]


def test_a_failing_listener_ends_at_rest_too():
    rig = Rig()

    def broken(time, poses):
        raise RuntimeError("no more listeners")

    rig.listener.poses_measured = broken
    rig.run()
    assert rig.listener.error.code == ErrorCode.BACKEND_FAILURE
    assert "no more listeners" in rig.listener.error.message
    assert rig.substrate.level == 0.0


def test_after_a_freeze_playback_goes_on_instead_of_rushing():
    rig = Rig()
    played = encode(rig.bench, PLAN)
    rig.clock.at(0.5, lambda: setattr(rig.clock, "time", rig.clock.time + 60.0))
    rig.run()
    times = np.array([time for time, _ in rig.substrate.log]) - 100.0
    gaps = np.diff(times)
    assert gaps.max() > 59.0
    assert times[-1] == pytest.approx(played.duration + 60.0, abs=1.0)
    # Nothing after the freeze was shorter than meant, but for what the slip forgives.
    late = np.argmax(gaps)
    assert (gaps[late + 2 :] > played.dwells[late + 2 :] - SLIP - 1e-9).all()
    assert rig.end_poses()[0] == pytest.approx(played.duration)


def test_one_sequence_at_a_time():
    rig = Rig()
    with pytest.raises(StressbotError) as refused:
        rig.backend.start(Pacing())
    assert refused.value.code == ErrorCode.NOTHING_LOADED
    errors = []

    def interfere():
        for request in (
            lambda: rig.backend.upload(encode(rig.bench, PLAN)),
            lambda: rig.backend.start(Pacing()),
            rig.backend.reset,
        ):
            try:
                request()
            except StressbotError as error:
                errors.append(error.code)

    rig.clock.at(0.3, interfere)
    rig.run()
    assert errors == [ErrorCode.BUSY] * 3
    assert rig.listener.done


def test_reset_brings_the_robots_home():
    rig = Rig()
    rig.run()
    rig.backend.reset()
    assert rig.backend.poses().x.tolist() == rig.bench.start[:, 0].tolist()
    assert rig.backend.progress().time == 0.0


def test_limits_are_those_of_the_scenario():
    limits = Rig().backend.limits
    assert (limits.min_level, limits.max_level) == (0.0, 200.0)


def test_backends_are_found_by_name():
    backend = make_backend("simulated", bench(), FakeClock(), Recorder())
    assert isinstance(backend, SimulatedBackend) and isinstance(backend, Backend)
    with pytest.raises(StressbotError) as refused:
        make_backend("laser", bench(), FakeClock(), Recorder())
    assert refused.value.code == ErrorCode.UNKNOWN_BACKEND
    assert "simulated" in refused.value.message


def test_options_that_are_not_given_have_their_defaults():
    class Tunable(SimulatedBackend):
        OPTIONS = (Declaration("gain", 2.0, "[V/V]", low=0.0, high=9.0), Declaration("seed", 0, "Any.", low=0, high=9))

    backend = Tunable(bench(), FakeClock(), Recorder(), {"seed": 3})
    assert backend.options == {"gain": 2.0, "seed": 3}
    gain, seed = Tunable.OPTIONS
    assert [gain.problem(value) for value in (0, 1.5)] == [None, None]
    assert all(gain.problem(value) for value in (True, "1", math.nan, 9.1))
    assert seed.problem(9) is None
    assert all(seed.problem(value) for value in (True, 1.0, "1", 10, -1))


def test_abstract_backends_cannot_be_made():
    with pytest.raises(TypeError):
        Backend(bench(), FakeClock(), Recorder())


def test_wall_clock_wakes_at_once_and_on_time():
    clock, wake = WallClock(), threading.Event()
    began = clock.now()
    assert not clock.wait_until(began + 0.02, wake)
    assert clock.now() - began >= 0.02
    assert not clock.wait_until(began, wake)
    threading.Timer(0.05, wake.set).start()
    assert clock.wait_until(began + 60.0, wake)
    assert clock.now() - began < 10.0


@pytest.mark.timing
def test_epoch_timing_on_the_wall_clock():
    """The p99 of the lateness of level changes; the median too, which a busy machine hardly touches."""
    rig = Rig(clock=WallClock())
    began = time.monotonic()
    played = rig.run([(1 + k % 4, 0.03) for k in range(25)])
    meant = np.concatenate([[0.0], np.cumsum(played.dwells)])
    applied = np.array([moment for moment, _ in rig.substrate.log])
    late = applied - applied[0] - meant
    assert applied[0] - began < 1.0
    assert late.min() > -1e-3
    assert np.percentile(late, 50) < 0.002
    assert np.percentile(late, 99) < 0.05


def test_long_sequences_of_tiny_segments():
    rig = Rig()
    count = 20_000
    rig.backend.upload(sequence(rig.bench, [140.0] * count, [1e-6] * count, [count]))
    rig.backend.start(Pacing(real_time_factor=0.0))
    assert rig.listener.ended.wait(DEADLINE)
    assert rig.end_poses()[1].heading == pytest.approx([0.02] * 6, abs=1e-9)


def test_a_stop_while_playback_begins_ends_it(monkeypatch):
    rig = Rig()
    rig.backend.upload(encode(rig.bench, PLAN))
    raised = []

    def stop():
        try:
            rig.backend.stop()
        except Exception as error:
            raised.append(error)

    class Begun(threading.Thread):
        def start(self):
            stopping.start()
            stopping.join(0.05)  # as far as it comes: it may have to wait for us
            super().start()

    stopping = threading.Thread(target=stop)
    monkeypatch.setattr(playback.threading, "Thread", Begun)
    rig.backend.start(Pacing())
    stopping.join()
    assert not raised and not rig.backend._thread.is_alive()
    assert rig.substrate.log[-1][1] == 0.0


def test_a_playback_that_finds_no_thread_can_be_tried_again(monkeypatch):
    rig = Rig()
    rig.backend.upload(encode(rig.bench, PLAN))
    with monkeypatch.context() as patched:
        patched.setattr(playback.threading.Thread, "start", _raise_no_thread)
        with pytest.raises(RuntimeError):
            rig.backend.start(Pacing())
    rig.backend.stop()
    rig.run()
    assert rig.listener.done


def _raise_no_thread(_thread):
    raise RuntimeError("can't start new thread")
