"""How late pictures are stamped, by what was driven and how robots moved. Plain kinematics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_driver.vision.latency import LEAST_EDGES, Latency, LatencyMeter, driven_for, remark

SPEED, RATE = 1e-4, 2.0
"""m/s, rad/s."""


class Drives:
    """Robots that are driven now and then, each a little faster or slower than described, turned by a jerk as a drive begins."""

    def __init__(self, random, count, robots, error, jerk):
        lengths, rests = random.uniform(0.1, 1.2, count), random.uniform(0.1, 0.8, count)
        self.begins = 1e9 + np.cumsum(rests) + np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
        self.ends = self.begins + lengths
        slides = random.random((count, robots)) < 0.5
        speed, rate = (value * (1.0 + random.normal(0.0, error, robots)) for value in (SPEED, RATE))
        jerks = random.normal(0.0, jerk, (count, robots))
        turns = np.where(slides, 0.0, rate * lengths[:, None])
        way = np.where(slides, speed * lengths[:, None], 0.0)
        heading = np.vstack([random.uniform(-3.0, 3.0, robots), jerks + turns]).cumsum(axis=0)
        self._times = np.column_stack([self.begins, self.begins + 1e-6, self.ends]).ravel()
        direction = heading[:-1] + jerks
        moves = np.stack([way * np.cos(direction), way * np.sin(direction)], axis=-1).cumsum(axis=0)
        before = np.concatenate([np.zeros((1, robots, 2)), moves[:-1]])
        self._poses = np.stack([
            np.concatenate([before, heading[:-1, :, None]], axis=-1),
            np.concatenate([before, direction[:, :, None]], axis=-1),
            np.concatenate([moves, heading[1:, :, None]], axis=-1),
        ], axis=1).reshape(-1, robots, 3)

    def at(self, times):
        """Poses (k, n, 3) at times (k,)."""
        flat = self._poses.reshape(len(self._times), -1)
        columns = [np.interp(times, self._times, column) for column in flat.T]
        return np.stack(columns, axis=-1).reshape(len(times), *self._poses.shape[1:])


def film(random, drives, latency, rate, noise=1e-6, lost=0.0, moves=True):
    """A meter that has seen all, of pictures that are taken `latency` before their stamps; robots may stand still."""
    stamps = np.arange(drives.begins[0] - 0.5 + random.uniform(0.0, 1.0 / rate), drives.ends[-1] + 1.0, 1.0 / rate)
    poses = drives.at(stamps - latency if moves else np.zeros(len(stamps)))
    poses += random.normal(0.0, 1.0, poses.shape) * (noise, noise, 1e4 * noise)
    poses[random.random(poses.shape[:2]) < lost] = np.nan
    return seen(drives, stamps, poses, random.random(len(stamps)) >= lost)


def seen(drives, stamps, poses, kept, speed=SPEED, rate=RATE):
    """A meter that has seen poses (k, n, 3), NaN where robots were not, in those pictures (k,) that are kept."""
    meter, last = LatencyMeter(), np.full_like(poses[0], np.nan)
    meter.drive(drives.begins, drives.ends)
    for stamp, now in zip(stamps[kept], poses[kept], strict=True):
        rows = np.isfinite(last[:, 0] + now[:, 0])
        meter.look(stamp, driven_for(last[rows], now[rows], speed, rate))
        last = now
    return meter


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    latency=st.floats(-0.05, 0.95),
    rate=st.floats(8.0, 60.0),
    robots=st.integers(1, 14),
    error=st.floats(0.0, 0.08),
    noise=st.floats(0.0, 1e-6),
    lost=st.sampled_from([0.0, 0.05]),
)
def test_it_is_found_whatever_speeds_and_pictures_are(seed, latency, rate, robots, error, noise, lost):
    random = np.random.default_rng(seed)
    drives = Drives(random, 20, robots, error, 0.035)
    found = film(random, drives, latency, rate, noise, lost).latency()
    assert found is not None and LEAST_EDGES <= found.edges <= 40
    assert abs(found.seconds - latency) < 0.003 + 0.025 / np.sqrt(robots)


def test_its_standard_error_is_that_of_many():
    off = []
    for seed in range(100):
        random = np.random.default_rng(seed)
        latency = random.uniform(0.0, 0.9)
        found = film(random, Drives(random, 15, 6, 0.05, 0.035), latency, 15.0).latency()
        off.append((found.seconds - latency) / found.error)
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.4
    assert abs(np.mean(off)) < 0.35


def test_substrate_time_may_be_faster_than_the_clock():
    drives = Drives(np.random.default_rng(0), 20, 6, 0.05, 0.035)
    stamps = np.arange(drives.begins[0] - 1.0, drives.ends[-1] + 1.0, 1.0 / 30.0)
    every = np.ones(len(stamps), dtype=bool)
    meter = seen(drives, stamps, drives.at(stamps - 0.2), every, 0.5 * SPEED, 0.5 * RATE)  # described: half as fast as by the clock
    assert abs(meter.latency().seconds - 0.2) < 0.01


@pytest.mark.parametrize("seed", range(20))
def test_of_robots_that_stand_still_nothing_is_told(seed):
    random = np.random.default_rng(seed)
    assert film(random, Drives(random, 20, 6, 0.05, 0.035), 0.1, 15.0, moves=False).latency() is None


def test_of_too_little_nothing_is_told():
    random = np.random.default_rng(0)
    nothing = LatencyMeter()
    assert nothing.latency() is None
    nothing.drive(np.array([1.0]), np.array([2.0]))
    nothing.look(1.5, np.nan)
    nothing.look(1.6, np.nan)
    assert nothing.latency() is None
    assert np.isnan(driven_for(np.empty((0, 3)), np.empty((0, 3)), SPEED, RATE))
    few = Drives(random, LEAST_EDGES // 2 - 1, 6, 0.05, 0.035)
    assert film(random, few, 0.1, 30.0).latency() is None
    rare = Drives(random, 20, 6, 0.05, 0.035)
    assert film(random, rare, 0.1, 1.5).latency() is None


@pytest.mark.parametrize(
    ("measured", "error", "given", "moves", "mends"),
    [
        (0.085, 0.002, 0.0, "85 ms later", "put `latency: 0.085` into the camera file"),
        (0.05, 0.002, 0.1, "50 ms earlier", "put `latency: 0.050` into the camera file"),
        (-0.01, 0.002, 0.1, "110 ms earlier", "put `latency: 0.000` into the camera file"),
        (-0.05, 0.002, 0.0, "50 ms earlier", "compare the clocks of camera and driver"),
    ],
)
def test_what_is_said_of_a_camera_file(measured, error, given, moves, mends):
    said = remark(Latency(measured, error, 20), given)
    assert said == f"robots move {moves} in the pictures than they are driven: {mends}"


@pytest.mark.parametrize(("measured", "error"), [(0.02, 0.001), (-0.02, 0.001), (0.08, 0.03)])
def test_what_may_be_right_is_not_mentioned(measured, error):
    assert remark(Latency(measured, error, 20), 0.0) == ""
