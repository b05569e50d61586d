"""Pulses, from a plan to places: what the planner says in whole numbers is what robots do that see volts only."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from driver_support import play
from hypothesis import given, settings
from hypothesis import strategies as st
from volts import sequence_of

from stressbot_driver.bench import parse_bench
from stressbot_driver.drive import check_drive
from stressbot_driver.sequence import Limits, VoltageSequence, check_sequence
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.formats.scenario import parse
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.whole_pulses import LEEWAY
from stressbot_planner.planners import Settings, solve
from stressbot_planner.sequencing import decode, encode

SCENARIOS = Path(__file__).parents[1] / "scenarios"
ALTERNATING = {"polarity": "alternating", "duty": 0.4}


def make_text(n: int, drive: str | dict, seed: int = 0, pull_down: float | list[float] = 120.0, **swarm) -> str:
    rng = np.random.default_rng(seed)
    return yaml.safe_dump(
        {
            "name": "pulses",
            "swarm": {"speed": 2.0, "turning_radius": 1.0, "body_radius": 0.3, "groups": "binary", **swarm},
            "robots": [
                {"start": [0.0, 3.2 * k, 0.0], "goal": [12.0, 3.2 * int(row)]} for k, row in enumerate(rng.permutation(n))
            ],
            "electrical": {"drive": drive, "pull_down": pull_down, "min_level": -400.0, "max_level": 400.0},
        }
    )


def driven(bench, program) -> Substrate:
    """Return a simulated swarm that has seen the volts of a program, which driver and robots take."""
    sequence = sequence_of(program, bench)
    check_sequence(sequence, bench.swarm_id, Limits(bench.electrical.min_level, bench.electrical.max_level))
    check_drive(sequence, bench.electrical)
    return play(Substrate(bench), sequence)


def places(substrate: Substrate, unit: float) -> np.ndarray:
    poses = substrate.poses()
    return np.column_stack([poses.x / unit, poses.y / unit, poses.heading])


def assert_predicted(substrate: Substrate, scenario, groups, lengths) -> np.ndarray:
    predicted = replay(scenario.swarm, scenario.problem.starts, groups, lengths)[-1]
    found = places(substrate, scenario.length_unit)
    np.testing.assert_allclose(found[:, :2], predicted[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * found[:, 2]), np.exp(1j * predicted[:, 2]), atol=1e-9)
    return predicted


@pytest.mark.parametrize("drive", ["pulses", ALTERNATING, {"frequency": 777.7, "duty": 0.9, "low_level": 100.0}], ids=str)
@pytest.mark.parametrize(("n", "swarm"), [(1, {}), (6, {}), (14, {"groups": "balanced"}), (3, {"speed": [1.0, 2.0, 0.3]})])
def test_robots_count_what_the_sequencer_counts(n, swarm, drive):
    text = make_text(n, drive, **swarm)
    scenario, bench = parse(text), parse_bench(text)
    step = scenario.electrical.pulse_length(scenario.swarm.speed)
    rng = np.random.default_rng(n)
    groups, counts = rng.integers(1, scenario.swarm.m + 1, 40), rng.integers(0, 40_000, 40)
    counts[:3] = 0, 1, 2
    substrate = driven(bench, encode(scenario.swarm, scenario.electrical, groups, step * counts))
    assert (substrate.pulses_answered == counts.sum()).all()
    assert_predicted(substrate, scenario, groups, step * counts)


@pytest.mark.parametrize("drive", ["pulses", ALTERNATING], ids=str)
@pytest.mark.parametrize("n", [1, 2, 6, 14])
@pytest.mark.parametrize("seed", range(3))
def test_levels_select_the_robots_above_them(n, drive, seed):
    rng = np.random.default_rng(seed)
    text = make_text(n, drive, groups="by_level", pull_down=(145.0 + rng.permutation(60)[:n] * 0.9).tolist())
    scenario, bench = parse(text), parse_bench(text)
    assert scenario.swarm.m == n + 1 and scenario.swarm.codewords == bench.codewords
    step = scenario.electrical.pulse_length(scenario.swarm.speed)
    groups, counts = rng.integers(1, n + 2, 40), rng.integers(0, 40_000, 40)
    groups[:2], counts[:2] = (1, n + 1), (1, 2)
    program = encode(scenario.swarm, scenario.electrical, groups, step * counts)
    substrate = driven(bench, program)
    assert (substrate.pulses_answered == counts.sum()).all()
    assert_predicted(substrate, scenario, groups, step * counts)
    again = decode(scenario.swarm, scenario.electrical, program)
    np.testing.assert_array_equal(again[0], groups[counts > 0])
    np.testing.assert_allclose(again[1], step * counts[counts > 0], rtol=1e-15)


def test_pulses_that_would_bring_down_more_arms_are_refused():
    text = make_text(3, "pulses", groups="by_level", pull_down=[150.0, 160.0, 170.0])
    scenario, bench = parse(text), parse_bench(text)
    program = encode(scenario.swarm, scenario.electrical, np.array([2, 3]), np.array([1.0, 1.0]))
    levels = np.where(program.pulses > 0, 165.0, program.levels)
    with pytest.raises(Exception, match="arms come down that another level has left up"):
        check_drive(sequence_of(replace(program, levels=levels), bench), bench.electrical)
    held = replace(program, pulses=np.zeros(len(levels)), low_levels=np.zeros(len(levels)))
    with pytest.raises(Exception, match="is held"):
        check_drive(sequence_of(held, bench), bench.electrical)


@settings(deadline=None)
@given(st.data())
def test_decode_undoes_encode(data):
    drive = data.draw(st.sampled_from(["pulses", ALTERNATING, {"step_length": 0.37, "response": 2e-3}]))
    scenario = parse(make_text(6, drive))
    swarm, electrical = scenario.swarm, scenario.electrical
    groups = np.array(data.draw(st.lists(st.integers(1, swarm.m), max_size=12)), dtype=int)
    counts = np.array([data.draw(st.integers(1, 2**40)) for _ in groups], dtype=float)
    step = electrical.pulse_length(swarm.speed)
    program = encode(swarm, electrical, groups, step * counts)
    assert program.epoch_count == len(groups)
    assert not program.pulses.any() or program.pulses[program.pulses > 0].tolist() == counts.tolist()
    again_groups, again_lengths = decode(swarm, electrical, program)
    np.testing.assert_array_equal(again_groups, groups)
    np.testing.assert_allclose(again_lengths, step * counts, rtol=1e-15)
    np.testing.assert_array_equal(encode(swarm, electrical, again_groups, again_lengths).pulses, program.pulses)


def test_alternating_epochs_leave_little_charge():
    scenario = parse(make_text(6, ALTERNATING))
    rng = np.random.default_rng(0)
    groups, lengths = rng.integers(1, scenario.swarm.m + 1, 300), rng.uniform(0.1, 3.0, 300)
    program = encode(scenario.swarm, scenario.electrical, groups, lengths)
    bench = parse_bench(make_text(6, ALTERNATING))
    one_epoch = 3.0 * 90.0 * 0.01  # a reset and two symbols, at most
    check_sequence(sequence_of(program, bench), bench.swarm_id, Limits(-200.0, 200.0, max_charge=one_epoch))
    assert (program.levels.min(), program.levels.max()) == (-140.0, 140.0)


@pytest.mark.parametrize("n", [6, 14])
@pytest.mark.parametrize("seed", range(6))
def test_a_plan_of_whole_pulses_ends_within_steps_of_its_goals(n, seed):
    text = make_text(n, "pulses", seed)
    scenario, bench = parse(text), parse_bench(text)
    step = scenario.electrical.pulse_length(scenario.swarm.speed)
    found = solve(scenario.problem, "optimize", Settings(max_tries=50, first=True, seed=seed, pulse_length=step))
    assert found.success, found.reason
    plan = found.plan
    assert plan.problem.tolerance == pytest.approx(1e-6 + LEEWAY * step)
    np.testing.assert_allclose(plan.lengths / step, np.rint(plan.lengths / step), atol=1e-6)
    program = encode(scenario.swarm, scenario.electrical, plan.groups, plan.lengths)
    end = assert_predicted(driven(bench, program), scenario, plan.groups, plan.lengths)
    off = np.hypot(*(end[:, :2] - plan.problem.goals).T) / step
    assert off.max() <= 5.0 and np.median(off) <= 2.0


def test_the_drives_that_fail_are_refused_before():
    """Each moves nobody, or everybody the wrong way; the driver says so first."""
    text = make_text(6, "pulses")
    scenario, bench = parse(text), parse_bench(text)
    step = scenario.electrical.pulse_length(scenario.swarm.speed)
    program = encode(scenario.swarm, scenario.electrical, np.array([2]), np.array([step * 10_000]))
    drive = bench.electrical.drive
    train = int(np.flatnonzero(program.pulses)[0])
    right = driven(bench, program)

    def changed(**changes) -> VoltageSequence:
        values = vars(sequence_of(program, bench)) | {
            name: np.where(np.arange(len(program.levels)) == train, value, getattr(program, name))
            for name, value in changes.items()
        }
        values["duration"] = float(values["dwells"].sum())
        return VoltageSequence(**values)

    def played(sequence: VoltageSequence) -> Substrate:
        return play(Substrate(bench), sequence)

    constant = changed(pulses=0, low_levels=0.0)
    weak = changed(levels=0.9 * bench.electrical.pull_down, low_levels=100.0)
    low = changed(low_levels=25.0)
    fast = changed(dwells=10_000 / (10.0 * drive.frequency))
    for sequence, most in ((constant, 1), (weak, 0), (fast, 0)):
        check_sequence(sequence, bench.swarm_id, Limits(-200.0, 200.0))
        with pytest.raises(Exception, match="send"):
            check_drive(sequence, bench.electrical)
        assert (played(sequence).pulses_answered <= most).all()
    with pytest.raises(Exception, match="arms rise"):
        check_drive(low, bench.electrical)
    turned = played(low)
    np.testing.assert_allclose(turned.poses().heading, 0.0, atol=1e-12)  # whoever should have turned has slid
    assert np.abs(right.poses().heading).max() > 1.0
