"""Pulses: counted by robots that see volts, in closed form and edge by edge; checked before; played by both backends."""

from dataclasses import replace

import numpy as np
import pytest
from driver_support import DEADLINE, FakeClock, Recorder, bench, play, pulsed, sequence
from hypothesis import given, settings
from hypothesis import strategies as st
from instrument_support import EmulatedBench

from stressbot_driver.backends.base import Pacing
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.drive import check_drive
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.gate import memory
from stressbot_driver.sequence import Limits, check_sequence
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Substrate

PULSES = {"electrical.drive": "pulses", "swarm.speed": 2.0}
ALTERNATING = {"electrical.drive": {"polarity": "alternating"}, "electrical.min_level": -200.0, "swarm.speed": 2.0}
SWARM = bench(6, **PULSES)
LIMITS = Limits(min_level=-200.0, max_level=200.0)


def play_edge_by_edge(substrate, played):
    for k, (level, dwell) in enumerate(zip(played.levels.tolist(), played.dwells.tolist(), strict=True)):
        train = played.train(k)
        if train is None:
            substrate.apply(level)
            substrate.advance(dwell)
            continue
        sign = 1.0
        for _ in range(train.count):
            for volts, seconds in ((train.high, train.high_dwell), (train.low, train.low_dwell)):
                substrate.apply(sign * volts)
                substrate.advance(seconds)
            sign = -sign if train.alternating else sign
    return substrate


def by_steps(bench, activations):
    """Poses (n, 3) [m, m, rad] by the number of steps alone, headings unwrapped."""
    step = bench.speed / bench.electrical.drive.frequency
    poses = bench.start.copy()
    for group, count in activations:
        for j, word in enumerate(bench.codewords):
            if group < bench.group_count and word[group - 1] == "1":
                poses[j, :2] += count * step[j] * np.array([np.cos(poses[j, 2]), np.sin(poses[j, 2])])
            else:
                poses[j, 2] += count * step[j] / bench.turning_radius[j]
    return poses


def poses(substrate):
    found = substrate.poses()
    return np.column_stack([found.x, found.y, substrate.heading_unwrapped])


def assert_near(found, expected, bench=SWARM, tolerance=1e-9):
    assert np.abs(found - expected)[:, :2].max() / bench.length_unit < tolerance
    assert np.abs(found - expected)[:, 2].max() < tolerance


plans = st.lists(st.tuples(st.integers(1, SWARM.group_count), st.integers(1, 200)), min_size=1, max_size=4)


@settings(deadline=None, max_examples=30)
@given(plans, st.sampled_from([PULSES, ALTERNATING]), st.booleans())
def test_counting_is_as_good_as_every_edge(plan, changes, flawed):
    """With imperfections too, but for those that are sums over many steps."""
    swarm = bench(6, **changes)
    settings = {"heading_bias": 0.1, "speed_error": 0.1, "threshold_drift": 3.0, "charging": 0.5, "charge_leak": 2.0}
    make = Imperfections(**settings) if flawed else Imperfections()
    counted = play(Substrate(swarm, make), pulsed(swarm, plan))
    every = play_edge_by_edge(Substrate(swarm, make), pulsed(swarm, plan))
    np.testing.assert_array_equal(counted.pulses_answered, every.pulses_answered)
    assert_near(poses(counted), poses(every))
    if not flawed:
        assert (counted.pulses_answered == sum(count for _, count in plan)).all()
        assert_near(poses(counted), by_steps(swarm, plan))


def test_millions_of_pulses_take_no_longer_and_stay_exact():
    class Counted(Substrate):
        applied = 0

        def _apply(self, level):
            self.applied += 1
            super()._apply(level)

    plan = [(1, 10**6), (4, 10**7), (2, 3), (3, 10**12)]
    substrate = play(Counted(SWARM), pulsed(SWARM, plan))
    assert substrate.applied < 100
    assert (substrate.pulses_answered == sum(count for _, count in plan)).all()


def test_thresholds_that_drift_lose_robots_at_the_same_pulse():
    """One robot's thresholds rise until the high level no longer reaches them, another's fall until the low level does."""
    drift = [0.0, 0.0, 100.0, 0.0, 0.0, -80.0]
    plan = [(4, 3000)]
    counted = play(Substrate(SWARM, Imperfections(threshold_drift=drift)), pulsed(SWARM, plan))
    every = play_edge_by_edge(Substrate(SWARM, Imperfections(threshold_drift=drift)), pulsed(SWARM, plan))
    np.testing.assert_array_equal(counted.pulses_answered, every.pulses_answered)
    answered = counted.pulses_answered
    assert 0 < answered[2] < answered[5] < 3000 == answered[0]
    assert_near(poses(counted), poses(every))


def test_an_alternating_drive_keeps_thresholds_where_they_are():
    plan = [(1, 50_000), (4, 50_000)] * 3
    for changes, kept in ((PULSES, False), (ALTERNATING, True)):
        swarm = bench(6, **changes)
        substrate = play(Substrate(swarm, Imperfections(charging=[1.0] * 6)), pulsed(swarm, plan))
        assert (substrate.pulses_answered == 300_000).all() == kept


def test_looking_changes_nothing():
    flaws = Imperfections(missed_steps=0.02, step_spread=0.1, heading_noise=0.1, threshold_drift=0.01)
    plain, watched = Substrate(SWARM, flaws), Substrate(SWARM, flaws)
    pattern, count = [(140.0, 3e-5), (110.0, 3e-5)], 20_000
    for _ in range(3):
        for share in (0.1, 0.5, 0.50001, 0.9):
            watched.poses_during(pattern, count, share * count * 6e-5)
        for substrate in (plain, watched):
            substrate.repeat(pattern, count)
            substrate.apply(0.0)
            substrate.advance(0.01)
    np.testing.assert_array_equal(poses(plain), poses(watched))


def test_poses_on_the_way_are_a_count():
    substrate = Substrate(SWARM)
    pattern, step = [(140.0, 3e-5), (110.0, 3e-5)], SWARM.speed[0] / SWARM.electrical.drive.frequency
    for after, steps in ((0.0, 0), (2.9e-5, 0), (3.1e-5, 1), (6.1e-5, 1), (0.3 + 2e-5, 5000), (0.3 + 4e-5, 5001)):
        turned = substrate.poses_during(pattern, 10**6, after).heading
        np.testing.assert_allclose(turned, steps * step / SWARM.turning_radius, rtol=1e-12, atol=1e-15)


def test_missed_and_uneven_steps_are_what_was_asked_for():
    flaws = Imperfections(missed_steps=0.01, step_spread=0.5)
    made = []
    for seed in range(30):
        substrate = play(Substrate(SWARM, replace(flaws, seed=seed)), pulsed(SWARM, [(4, 10_000)]))
        made += (poses(substrate)[:, 2] / (SWARM.speed[0] / 16666.666666666668 / SWARM.turning_radius)).tolist()
    assert np.mean(made) == pytest.approx(9900, abs=5 * 52 / np.sqrt(len(made)))
    assert np.std(made) == pytest.approx(np.hypot(0.5 * np.sqrt(9900), np.sqrt(99)), rel=0.2)


def test_steps_depend_on_frequency_and_level():
    flaws = Imperfections(frequency_slope=[-0.2] * 6, level_slope=[1.5] * 6)
    turned = {}
    for name, high, part in (("as described", 140.0, 3e-5), ("half as fast", 140.0, 6e-5), ("higher", 154.0, 3e-5)):
        substrate = Substrate(SWARM, flaws)
        substrate.repeat([(high, part), (110.0, part)], 100_000)
        turned[name] = substrate.heading_unwrapped[0]
    assert turned["half as fast"] / turned["as described"] == pytest.approx(1.1, rel=1e-3)
    assert turned["higher"] / turned["as described"] == pytest.approx(1.15, rel=1e-3)


def test_a_steady_drive_has_no_steps_to_miss():
    with pytest.raises(StressbotError, match="electrical.drive") as refused:
        Substrate(bench(2), Imperfections(missed_steps=0.1))
    assert (refused.value.code, refused.value.field) == (ErrorCode.UNSUPPORTED, "imperfections.missed_steps")


# The check


GOOD = pulsed(SWARM, [(1, 1000), (4, 1)])
TRAIN = 6


def at_train(name, value):
    values = getattr(GOOD, name).copy()
    values[TRAIN] = value
    return {name: values}


@pytest.mark.parametrize(
    ("changes", "code", "field"),
    [
        ({"pulses": GOOD.pulses[:-1]}, ErrorCode.WRONG_COUNT, "pulses"),
        ({"low_levels": GOOD.low_levels[:-1]}, ErrorCode.WRONG_COUNT, "low_levels"),
        ({"pulses": GOOD.pulses[:0]}, ErrorCode.WRONG_COUNT, "low_levels"),
        (at_train("pulses", 0), ErrorCode.INVALID_SEQUENCE, "low_levels[6]"),
        (at_train("pulses", 2**53 + 2), ErrorCode.LIMIT_EXCEEDED, "pulses[6]"),
        (at_train("low_levels", np.nan), ErrorCode.NOT_FINITE, "low_levels[6]"),
        (at_train("low_levels", 140.0), ErrorCode.OUT_OF_RANGE, "low_levels[6]"),
        (at_train("low_levels", -10.0), ErrorCode.OUT_OF_RANGE, "low_levels[6]"),
        (at_train("levels", 200.1), ErrorCode.LIMIT_EXCEEDED, "levels[6]"),
        ({"duty": 0.0}, ErrorCode.OUT_OF_RANGE, "duty"),
        ({"duty": 1.0}, ErrorCode.OUT_OF_RANGE, "duty"),
        ({"duty": np.nan}, ErrorCode.OUT_OF_RANGE, "duty"),
    ],
)
def test_trains_that_are_none_are_refused(changes, code, field):
    with pytest.raises(StressbotError) as refused:
        check_sequence(replace(GOOD, **changes), SWARM.swarm_id, LIMITS)
    assert (refused.value.code, refused.value.field) == (code, field)


@pytest.mark.parametrize(
    ("limits", "field"),
    [
        ({"max_frequency": 16_000.0}, "pulses[6]"),
        ({"min_dwell": 3.1e-5}, "dwells[6]"),
        ({"max_slew_rate": 0.9e6}, "dwells[6]"),  # 30 V within 30 us
        ({"max_duty": 0.1, "drive_above": 125.0}, "levels"),
        ({"max_charge": 5.0}, "levels[6]"),
        ({"capacitance": 1e-9, "max_power": 0.014}, "pulses[6]"),
    ],
)
def test_trains_beyond_a_limit_are_refused_and_others_not(limits, field):
    check_sequence(GOOD, SWARM.swarm_id, LIMITS)
    with pytest.raises(StressbotError) as refused:
        check_sequence(GOOD, SWARM.swarm_id, replace(LIMITS, **limits))
    assert (refused.value.code, refused.value.field) == (ErrorCode.LIMIT_EXCEEDED, field)
    roomier = {name: value / 1.4 if name == "min_dwell" else 2e4 * value for name, value in limits.items() if name != "capacitance"}
    if "max_duty" in roomier:
        roomier = {"max_duty": 0.9}
    check_sequence(GOOD, SWARM.swarm_id, replace(LIMITS, **roomier))


def test_alternating_trains_leave_one_pulse_at_most_and_need_room_below():
    swarm = bench(6, **ALTERNATING)
    good = pulsed(swarm, [(1, 100_001)])
    check_sequence(good, swarm.swarm_id, replace(LIMITS, max_charge=2.0))
    check_drive(good, swarm.electrical)
    with pytest.raises(StressbotError, match="beyond the limits") as refused:
        check_sequence(good, swarm.swarm_id, replace(LIMITS, min_level=-139.0))
    assert (refused.value.code, refused.value.field) == (ErrorCode.LIMIT_EXCEEDED, "levels[6]")
    with pytest.raises(StressbotError) as refused:
        check_drive(replace(good, swarm_id=SWARM.swarm_id), SWARM.electrical)
    assert (refused.value.code, refused.value.field) == (ErrorCode.INVALID_SEQUENCE, "alternating")


def test_a_steady_bench_takes_no_trains():
    with pytest.raises(StressbotError) as refused:
        check_drive(GOOD, bench(6).electrical)
    assert (refused.value.code, refused.value.field) == (ErrorCode.INVALID_SEQUENCE, "pulses[6]")


@settings(deadline=None)
@given(st.data())
def test_no_volt_leaves_the_limits(data):
    """Whatever numbers a sequence has: refused, or each level that it puts on the electrodes lies within the limits."""
    volts = st.one_of(st.sampled_from([0.0, 110.0, 140.0, -140.0, 200.0]), st.floats(-300, 300))
    count = data.draw(st.integers(1, 6))
    draw = lambda numbers: np.array(data.draw(st.lists(numbers, min_size=count, max_size=count)), dtype=float)  # noqa: E731
    drawn = sequence(
        SWARM,
        draw(volts),
        draw(st.floats(1e-4, 10.0)),
        pulses=draw(st.one_of(st.just(0), st.integers(0, 1000), st.integers(0, 2**54))).astype(np.uint64),
        low_levels=draw(volts),
        duty=data.draw(st.floats(0.01, 0.99)),
        alternating=data.draw(st.booleans()),
    )
    low, high = data.draw(st.sampled_from([(0.0, 200.0), (-200.0, 200.0), (-120.0, 150.0)]))
    try:
        check_sequence(drawn, SWARM.swarm_id, Limits(low, high))
    except StressbotError:
        return
    for k, level in enumerate(drawn.levels.tolist()):
        train = drawn.train(k)
        seen = [level] if train is None else [volts for volts, _ in (train.pattern if train.count > 1 else train.pattern[:2])]
        assert low <= min(seen) and max(seen) <= high
        assert train is None or train.high_dwell > 0.0 < train.low_dwell


def test_the_gate_reads_what_the_driver_writes():
    copy = memory.read_sequence(memory.sealed_sequence(GOOD))
    for name, value in vars(GOOD).items():
        np.testing.assert_array_equal(getattr(copy, name), value)


# Backends


def test_the_simulated_backend_plays_and_stops_trains():
    clock, listener = FakeClock(), Recorder()
    backend = SimulatedBackend(SWARM, clock, listener, {})
    plan = [(1, 10_000), (4, 20_000), (2, 1)]
    backend.upload(pulsed(SWARM, plan))
    backend.start(Pacing(1.0, 50.0))
    assert listener.ended.wait(DEADLINE) and listener.error is None
    expected = by_steps(SWARM, plan)
    found = backend.poses()
    np.testing.assert_allclose(np.column_stack([found.x, found.y]), expected[:, :2], atol=1e-9 * SWARM.length_unit)
    headings = np.array([sample.heading[3] for _, sample in listener.samples])
    assert len(np.unique(headings)) > 20  # seen on the way
    backend.reset()
    backend.upload(pulsed(SWARM, [(4, 100_000)]))
    listener.ended.clear()
    clock.at(clock.now() - 100.0 + 1.0, backend._halt.set)
    backend.start(Pacing(1.0, 50.0))
    backend._join()
    turned = backend.poses().heading * SWARM.turning_radius / (SWARM.speed / SWARM.electrical.drive.frequency)
    assert np.ptp(turned) < 1e-6 and turned[0] == pytest.approx((1.0 - 0.045) * SWARM.electrical.drive.frequency, abs=1.0)
    backend.close()


@pytest.mark.parametrize("changes", [PULSES, ALTERNATING], ids=["unipolar", "alternating"])
@pytest.mark.parametrize("max_block", [10.0, 0.5])
def test_an_instrument_plays_every_pulse(tmp_path, changes, max_block):
    rig = EmulatedBench(tmp_path, changes=changes, max_block=max_block)
    plan = [(1, 10_001), (4, 33_333), (2, 1), (3, 2)]
    backend = rig.open()
    played = pulsed(rig.bench, plan)
    check_sequence(played, rig.bench.swarm_id, backend.limits)
    backend.upload(played)
    backend.start(Pacing())
    assert rig.listener.ended.wait(60.0) and rig.listener.error is None
    rig.emulator.advance()
    assert (rig.substrate.pulses_answered == sum(count for _, count in plan)).all()
    assert max(rig.deviation(by_steps(rig.bench, plan))) < 1e-9
    assert rig.trains and all(count * len(pattern) <= 2 * 33_334 for pattern, count in rig.trains)
    rig.close()
