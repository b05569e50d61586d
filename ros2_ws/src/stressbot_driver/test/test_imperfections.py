"""Each imperfection by itself: what it does, how large it is, that a seed fixes it, and that nothing else moves."""

import math

import numpy as np
import pytest
from driver_support import DEADLINE, FakeClock, Recorder, bench, closed_form, encode, play

from stressbot_driver.backends.base import Pacing
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.simulation.imperfections import IDEAL, Flaws, Imperfections
from stressbot_driver.simulation.substrate import Substrate
from stressbot_driver.simulation.tracker import Tracker

PLAN = [(1, 0.5), (4, 1.0), (2, 0.7), (3, 0.4), (4, 2.0), (1, 1.3)]
MANY = 1022

ONE_OF_EACH = {
    "speed_error": 0.03,
    "radius_error": 0.05,
    "heading_bias": 0.09,
    "heading_noise": 0.035,
    "threshold_error": 20.0,
    "threshold_drift": 2.0,
    "dropped_symbols": 0.1,
    "misread_symbols": 0.1,
    "selection_motion": 0.2,
    "always_slide": (2,),
    "always_turn": (5,),
}
LOOKING = {"position_noise": 1e-6, "orientation_noise": 0.02, "latency": 0.1, "lost_probability": 0.1, "lost_frames": 3}


def driven(swarm, plan=PLAN, **settings):
    return play(Substrate(swarm, Imperfections(**settings)), encode(swarm, plan))


def poses(substrate):
    measured = substrate.poses()
    return np.column_stack([measured.x, measured.y, substrate.heading_unwrapped])


def slid(swarm, substrate):
    """[units] (n,) from the starts."""
    return np.hypot(*(poses(substrate) - swarm.start)[:, :2].T) / swarm.length_unit


@pytest.mark.parametrize("settings", [{}, {"seed": 7}, LOOKING, {"dropped_symbols": 0.0, "lost_frames": 9}])
def test_off_is_exactly_the_model(settings):
    swarm = bench(30, **{"swarm.turning_radius": [0.5 + 0.1 * k for k in range(30)]})
    plan = [(1 + k % swarm.group_count, 0.1 + 0.07 * k) for k in range(50)]
    plain = play(Substrate(swarm), encode(swarm, plan))
    assert np.array_equal(poses(driven(swarm, plan, **settings)), poses(plain))


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_each_one_has_an_effect_and_a_seed_fixes_it(name):
    swarm = bench(6)
    plan = PLAN * 4

    def run(seed):
        return poses(driven(swarm, plan, seed=seed, **{name: ONE_OF_EACH[name]}))

    assert not np.allclose(run(0), poses(driven(swarm, plan)), rtol=0, atol=1e-9)
    assert np.array_equal(run(3), run(3))
    if name not in ("selection_motion", "always_slide", "always_turn"):
        assert not np.array_equal(run(3), run(4))


def test_a_reset_makes_the_same_run_again_and_off_makes_it_exact_again():
    swarm = bench(6)
    substrate = Substrate(swarm, Imperfections(**ONE_OF_EACH))
    first = poses(play(substrate, encode(swarm, PLAN)))
    substrate.reset()
    assert np.array_equal(poses(substrate), swarm.start)
    assert np.array_equal(poses(play(substrate, encode(swarm, PLAN))), first)
    substrate.impair(IDEAL)
    substrate.reset()
    assert np.allclose(poses(play(substrate, encode(swarm, PLAN))), closed_form(swarm, PLAN), rtol=0, atol=1e-12)


def test_taking_on_imperfections_moves_nobody():
    swarm = bench(6)
    substrate = play(Substrate(swarm), encode(swarm, PLAN))
    before = poses(substrate)
    substrate.impair(Imperfections(**ONE_OF_EACH))
    assert np.array_equal(poses(substrate), before)


def test_kinds_do_not_disturb_each_other():
    swarm = bench(6)
    alone = Flaws(Imperfections(seed=5, speed_error=0.03), swarm.ids, 2)
    together = Flaws(Imperfections(seed=5, **ONE_OF_EACH), swarm.ids, 2)
    assert np.array_equal(alone.speed_factor, together.speed_factor)
    assert np.array_equal(alone.radius_factor, np.ones(6)) and np.array_equal(alone.heading_bias, np.zeros(6))
    assert not np.allclose((together.speed_factor - 1) / 0.03, (together.radius_factor - 1) / 0.05)


@pytest.mark.parametrize("name", ["speed_error", "radius_error", "heading_bias", "threshold_error", "threshold_drift"])
def test_lasting_errors_have_their_sigma(name):
    flaws = Flaws(Imperfections(seed=1, **{name: 0.1}), np.arange(1, 20_001), 2)
    values = {
        "speed_error": flaws.speed_factor - 1, "radius_error": flaws.radius_factor - 1,
        "heading_bias": flaws.heading_bias, "threshold_error": flaws.threshold_error, "threshold_drift": flaws.threshold_drift,
    }
    assert values[name].std() == pytest.approx(0.1, rel=0.03) and values[name].mean() == pytest.approx(0.0, abs=0.003)
    assert np.abs(values[name]).max() <= 0.4
    assert not any(values[other].any() for other in values if other != name)


def test_given_errors_are_the_true_ones():
    swarm = bench(3, **{"swarm.groups": ["01", "10", "11"]})
    errors = {"speed_error": [0.1, -0.1, 0.0], "radius_error": [0.125, 0.0, 0.0], "heading_bias": [0, 0.3, -0.2]}
    substrate = driven(swarm, [(1, 2.0)], **errors)
    expected = poses(driven(swarm, []))
    # Robot 1 turns by u'/r' t; robots 2 and 3 slide beside their heading, which stays.
    expected[0, 2] += 2.0 * 1.1 / 1.125
    expected[1, :2] += 1.8e-4 * np.array([math.cos(0.3), math.sin(0.3)])
    expected[2, :2] += 2.0e-4 * np.array([math.cos(-0.2), math.sin(-0.2)])
    assert np.allclose(poses(substrate), expected, rtol=0, atol=1e-12)


def test_heading_noise_jumps_once_for_each_activation_and_stays():
    swarm = bench(MANY)
    plan = [(swarm.group_count, 0.3)] * 25
    exact, noisy = poses(driven(swarm, plan))[:, 2], poses(driven(swarm, plan, heading_noise=0.02))[:, 2]
    assert (noisy - exact).std() == pytest.approx(0.02 * 5.0, rel=0.1)
    assert (noisy - exact).mean() == pytest.approx(0.0, abs=0.02)
    # Within an activation nothing wanders: a slide is straight, along the heading.
    substrate = Substrate(swarm, Imperfections(heading_noise=0.5))
    play(substrate, encode(swarm, [(1, 3.0)]))
    members = swarm.membership[:, 0]
    x, y, heading = poses(substrate)[members].T
    assert np.allclose(x, 3e-4 * np.cos(heading), atol=1e-12)
    assert np.allclose(y - swarm.start[members, 1], 3e-4 * np.sin(heading), atol=1e-12)


def test_dropped_symbols_stop_an_arm_from_being_held():
    swarm = bench(MANY)  # codes of 4 symbols
    symbols = swarm.electrical.codes.shape[1]
    members = swarm.membership[:, 0]
    away = slid(swarm, driven(swarm, [(1, 1.0)], dropped_symbols=0.1))
    assert (away[members] > 0.5).mean() == pytest.approx(0.9**symbols, abs=0.06)
    assert not away[~members].any()  # who misses a symbol has taken too few for any code
    everything = slid(swarm, driven(swarm, [(1, 1.0)], dropped_symbols=1.0))
    assert not everything.any()


def test_misread_symbols_select_another_group():
    swarm = bench(MANY)
    symbols = swarm.electrical.codes.shape[1]
    assert len(swarm.electrical.symbol_levels) == 2  # so that a misread code is a flipped one
    members = swarm.membership[:, 0]
    away = slid(swarm, driven(swarm, [(1, 1.0)], misread_symbols=0.05))
    kept = 0.95**symbols
    assert (away[members] > 0.5).mean() >= kept - 0.06
    assert (away[~members] > 0.5).any()
    # All flipped: G_1, 00…0, is read as 11…1 by everybody.
    flipped = 1 - swarm.electrical.codes[0]
    read_as = [k for k, code in enumerate(swarm.electrical.codes) if code.tolist() == flipped.tolist()]
    expected = swarm.membership[:, read_as[0]] if read_as and read_as[0] < swarm.group_count - 1 else np.zeros(MANY, dtype=bool)
    away = slid(swarm, driven(swarm, [(1, 1.0)], misread_symbols=1.0))
    assert np.array_equal(away > 0.5, expected)


def test_thresholds_that_drift_far_enough_lose_the_code():
    swarm = bench(6)
    substrate = Substrate(swarm, Imperfections(threshold_drift=[0.0, 0.0, 0.0, 0.0, 5.0, -20.0]))
    # Before the activations robot 5 reads 0, 5.2, 10.5 and 15.7 V too little, robot 6 four times that too much. G_1 needs
    # the reset, 13 V above the edge of its band, and a rest 18 V below it.
    for expected in ([1.0, 1.0, 1.0], [2.0, 2.0, 1.0], [3.0, 3.0, 1.0], [4.0, 3.0, 1.0]):
        play(substrate, encode(swarm, [(1, 1.0)]))
        assert slid(swarm, substrate)[3:] == pytest.approx(expected)
    substrate.reset()
    play(substrate, encode(swarm, [(1, 1.0)]))
    assert slid(swarm, substrate)[3:] == pytest.approx([1.0, 1.0, 1.0])


def test_thresholds_that_are_off_bring_down_the_wrong_arm():
    electrical = {"electrical.drive": "pulses", "electrical.pull_down": [150, 160, 170]}
    swarm = bench(3, **{"swarm.groups": "by_level"}, **electrical)
    for error, expected in (([0, 0, 0], [0, 1, 1]), ([0, -9, 0], [0, 0, 1]), ([9, 0, 0], [1, 1, 1])):
        substrate = Substrate(swarm, Imperfections(threshold_error=error))
        for level in (swarm.electrical.rest_level, swarm.electrical.symbol_levels[1]):
            substrate.apply(level)
            substrate.advance(0.01)
        assert substrate.arm_up.tolist() == expected


def test_motion_during_selection_is_a_fraction_of_the_speed():
    swarm = bench(6)
    electrical = swarm.electrical
    still, creeping = driven(swarm, [(4, 1.0)]), driven(swarm, [(4, 1.0)], selection_motion=0.25)
    assert not slid(swarm, still).any()
    sending = electrical.reset_dwell + 2 * electrical.symbol_dwell
    assert slid(swarm, creeping) == pytest.approx([0.25 * sending] * 6, rel=1e-9)
    assert poses(creeping)[:, 2] == pytest.approx(poses(still)[:, 2], abs=1e-12)  # arms are up meanwhile


def test_stuck_arms_always_slide_or_always_turn():
    swarm = bench(6)
    substrate = driven(swarm, [(1, 1.0), (4, 2.0)], always_slide=[1], always_turn=[6])
    assert slid(swarm, substrate) == pytest.approx([3.0, 0.0, 0.0, 1.0, 1.0, 0.0], abs=1e-9)
    assert poses(substrate)[:, 2] == pytest.approx([0.0, 3.0, 3.0, 2.0, 2.0, 3.0], abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "code", "field"),
    [
        ({"speed_error": 0.5}, ErrorCode.OUT_OF_RANGE, "imperfections.speed_error"),
        ({"speed_error": math.nan}, ErrorCode.OUT_OF_RANGE, "imperfections.speed_error"),
        ({"speed_error": [0.1, -0.3, 0.1]}, ErrorCode.OUT_OF_RANGE, "imperfections.speed_error"),
        ({"radius_error": [0.1, "x", 0.1]}, ErrorCode.WRONG_TYPE, "imperfections.radius_error"),
        ({"heading_noise": [0.1]}, ErrorCode.WRONG_TYPE, "imperfections.heading_noise"),
        ({"heading_bias": -0.1}, ErrorCode.OUT_OF_RANGE, "imperfections.heading_bias"),
        ({"heading_bias": [0.1]}, ErrorCode.WRONG_COUNT, "imperfections.heading_bias"),
        ({"dropped_symbols": 1.1}, ErrorCode.OUT_OF_RANGE, "imperfections.dropped_symbols"),
        ({"dropped_symbols": 0.6, "misread_symbols": 0.6}, ErrorCode.OUT_OF_RANGE, "imperfections.misread_symbols"),
        ({"always_turn": [4]}, ErrorCode.UNKNOWN_ROBOT, "imperfections.always_turn"),
        ({"always_turn": [1.5]}, ErrorCode.WRONG_TYPE, "imperfections.always_turn"),
        ({"always_turn": 1}, ErrorCode.WRONG_TYPE, "imperfections.always_turn"),
        ({"always_turn": [2], "always_slide": [2]}, ErrorCode.OUT_OF_RANGE, "imperfections.always_turn"),
        ({"seed": -1}, ErrorCode.OUT_OF_RANGE, "imperfections.seed"),
        ({"seed": True}, ErrorCode.WRONG_TYPE, "imperfections.seed"),
        ({"lost_frames": 0}, ErrorCode.OUT_OF_RANGE, "imperfections.lost_frames"),
    ],
)
def test_refusals_name_the_parameter(settings, code, field):
    with pytest.raises(StressbotError) as refused:
        Substrate(bench(3), Imperfections(**settings))
    assert (refused.value.code, refused.value.field) == (code, field)


# The tracker


def test_measured_poses_scatter_around_the_true_ones():
    swarm = bench(MANY)
    true = Substrate(swarm).poses()
    seen = Tracker(Imperfections(seed=2, position_noise=3e-6, orientation_noise=0.5)).measure(true)
    for values, sigma in ((seen.x - true.x, 3e-6), (seen.y - true.y, 3e-6), (np.angle(np.exp(1j * seen.heading)), 0.5)):
        assert values.std() == pytest.approx(sigma, rel=0.1) and abs(values.mean()) < sigma / 8
    assert (np.abs(seen.heading) <= math.pi).all()
    assert np.array_equal(seen.ids, true.ids)


def test_lost_robots_are_missing_for_so_many_frames():
    true = Substrate(bench(MANY)).poses()
    tracker = Tracker(Imperfections(lost_probability=0.02, lost_frames=5))
    seen = np.array([np.isin(true.ids, tracker.measure(true).ids) for _ in range(200)])
    missing = (~seen).mean()
    assert missing == pytest.approx(5 * 0.02 / (1 + 4 * 0.02), rel=0.1)
    starts = seen[:-6] & ~seen[1:-5]  # a frame seen, the next one not
    assert starts.any() and all((~seen[k : len(seen) - 6 + k])[starts].all() for k in range(1, 6))
    poses = tracker.measure(true)
    assert len(poses.ids) == len(poses.x) == len(poses.y) == len(poses.heading)
    assert np.array_equal(poses.x, true.x[np.isin(true.ids, poses.ids)])


def run_backend(plan, **settings):
    swarm, listener = bench(6), Recorder()
    backend = SimulatedBackend(swarm, FakeClock(), listener)
    backend.impair(Imperfections(**settings))
    backend.upload(encode(swarm, plan))
    backend.start(Pacing(pose_rate=20.0))
    assert listener.ended.wait(DEADLINE)
    return listener.samples, backend


def test_latency_holds_reports_back_and_loses_none():
    plain, _ = run_backend([(1, 1.0), (4, 0.5)])
    late, backend = run_backend([(1, 1.0), (4, 0.5)], latency=0.2)
    assert [time for time, _ in late] == [time for time, _ in plain]
    for (_, one), (_, other) in zip(plain, late, strict=True):
        assert np.array_equal(one.x, other.x) and np.array_equal(one.heading, other.heading)
    assert backend.poses().heading.tolist() == late[-1][1].heading.tolist()
    tracker, true = Tracker(Imperfections(latency=0.2)), Substrate(bench(6)).poses()
    reports = [[time for time, _ in tracker.report(t, true)] for t in (0.0, 0.1, 0.2, 0.35, 0.4)]
    assert reports == [[], [], [0.0], [0.1], [0.2]]
    assert [time for time, _ in tracker.rest()] == [0.35, 0.4]


def test_looking_changes_no_motion():
    samples, backend = run_backend(PLAN, seed=1, **ONE_OF_EACH, **LOOKING)
    for _ in range(10):
        backend.poses()
    assert np.array_equal(poses(backend._substrate), poses(driven(bench(6), seed=1, **ONE_OF_EACH)))
    assert any(len(sample.ids) < 6 for _, sample in samples)


def test_imperfections_wait_for_the_end_of_a_sequence():
    swarm, clock, listener = bench(6), FakeClock(), Recorder()
    backend = SimulatedBackend(swarm, clock, listener)
    refusals = []

    def interfere():
        with pytest.raises(StressbotError) as refused:
            backend.impair(Imperfections(speed_error=0.1))
        refusals.append(refused.value.code)

    clock.at(0.3, interfere)
    backend.upload(encode(swarm, PLAN))
    backend.start(Pacing())
    assert listener.ended.wait(DEADLINE)
    assert refusals == [ErrorCode.BUSY]
    assert np.allclose(poses(backend._substrate), closed_form(swarm, PLAN), rtol=0, atol=1e-12)
