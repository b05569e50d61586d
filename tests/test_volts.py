"""Volts are all that the two halves share: what the sequencer encodes, the simulated robots read, for any alphabet."""

import threading
from pathlib import Path

import numpy as np
import pytest
import yaml
from driver_support import play
from volts import sequence_of

from stressbot_driver.backends.base import Listener, Pacing, make_backend
from stressbot_driver.bench import load_bench, parse_bench
from stressbot_driver.clock import Clock
from stressbot_driver.instruments.emulator import Emulator
from stressbot_driver.instruments.emulator_server import EmulatorServer
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.formats.scenario import load, parse
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners import Settings, solve
from stressbot_planner.sequencing import encode

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def make_scenario(n: int, level_count: int, scheme: str, seed: int) -> str:
    rng = np.random.default_rng(seed)
    symbols = np.cumsum(rng.uniform(8.0, 20.0, level_count)) + 4.0
    reset, drive = float(symbols[-1]) + 15.0, float(symbols[-1]) + 50.0
    return yaml.safe_dump(
        {
            "name": "volts",
            "length_unit": 3.7e-5,
            "swarm": {
                "speed": [float(v) for v in rng.uniform(1.5, 2.3, n)],
                "turning_radius": [float(r) for r in rng.uniform(0.5, 2.0, n)],
                "body_radius": 0.1,
                "groups": scheme,
            },
            "robots": [{"start": [10.0 * k, 0.0, float(rng.uniform(-3, 3))], "goal": [10.0 * k, 5.0]} for k in range(n)],
            "electrical": {
                "symbol_levels": [float(v) for v in symbols], "reset_level": reset, "drive_level": drive,
                "pull_down": drive - 5.0, "release": 2.0, "max_level": 2000.0, "hysteresis": 2.0,
            },
        }
    )


def driven(text: str, program) -> np.ndarray:
    """Return the poses (n, 3), SI, that a simulated swarm of its own ends with."""
    bench = parse_bench(text)
    poses = play(Substrate(bench), sequence_of(program, bench)).poses()
    return np.column_stack([poses.x, poses.y, poses.heading])


@pytest.mark.parametrize("level_count", [2, 3, 5, 8])
@pytest.mark.parametrize(
    ("n", "scheme"), [(1, "binary"), (2, "balanced"), (6, "binary"), (6, "by_radius"), (31, "tight"), (126, "binary")]
)
def test_robots_end_where_the_closed_form_says(n, scheme, level_count):
    text = make_scenario(n, level_count, scheme, seed=level_count)
    scenario = parse(text)
    rng = np.random.default_rng(n)
    groups = rng.integers(1, scenario.swarm.m + 1, 60)
    lengths = rng.uniform(0.0, 6.0, 60)
    lengths[rng.random(60) < 0.2] = 0.0
    program = encode(scenario.swarm, scenario.electrical, groups, lengths)
    poses = driven(text, program)
    predicted = replay(scenario.swarm, scenario.problem.starts, groups, lengths)[-1]
    np.testing.assert_allclose(poses[:, :2] / scenario.length_unit, predicted[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * poses[:, 2]), np.exp(1j * predicted[:, 2]), atol=1e-9)


@pytest.mark.parametrize(("planner", "tolerance"), [("optimize", 1e-6), ("optimize_paper", 1e-6), ("rrt", 1.5)])
def test_robots_that_share_a_codeword_end_at_goals_of_their_own(planner, tolerance):
    text = (SCENARIOS / "different-radii.yaml").read_text()
    scenario = parse(text, tolerance)
    assert set(scenario.swarm.codewords) == {"1"}
    step = scenario.electrical.pulse_length(scenario.swarm.speed)
    result = solve(scenario.problem, planner, Settings(max_tries=2000, first=True, pulse_length=step))
    assert result.success, result.reason
    plan = result.plan
    poses = driven(text, encode(scenario.swarm, scenario.electrical, plan.groups, plan.lengths))
    np.testing.assert_allclose(poses[:, :2] / scenario.length_unit, plan.poses[-1, :, :2], atol=1e-6)
    assert scenario.problem.goal_error(poses[:, :2] / scenario.length_unit) <= plan.problem.tolerance + 1e-6


class Stepped(Clock):
    """Time passes at once while somebody waits."""

    def __init__(self):
        self._now = 0.0

    def now(self):
        return self._now

    def wait_until(self, deadline, wake):
        self._now = max(self._now, deadline)
        return wake.is_set()


class Ended(Listener):
    def __init__(self):
        self.event, self.error = threading.Event(), None

    def poses_measured(self, time, poses):
        raise AssertionError("a generator sees no robots")

    def finished(self):
        self.event.set()

    def failed(self, error):
        self.error = error
        self.event.set()


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_plan_survives_the_language_of_an_instrument(path, tmp_path):
    """Plan, volts, SCPI over TCP, volts again, poses: as predicted to 1e-6 units and rad over 50 epochs.

    Each edge is up to half a sample off, so that errors grow like the root of the number of epochs.
    """
    scenario = load(path)
    planner = "pure_control" if scenario.swarm.alike else "optimize"
    step = scenario.electrical.pulse_length(scenario.swarm.speed)
    result = solve(scenario.problem, planner, Settings(max_tries=100, first=True, pulse_length=step))
    assert result.success, result.reason
    swarm, groups, lengths = scenario.swarm, result.plan.groups, result.plan.lengths
    program = encode(swarm, scenario.electrical, groups, lengths)
    bench = load_bench(path)
    substrate, gain, clock, ended = Substrate(bench), 20.0, Stepped(), Ended()

    def play(volts, seconds):
        substrate.apply(volts * gain)
        substrate.advance(seconds)

    def repeat(pattern, count):
        substrate.repeat([(volts * gain, seconds) for volts, seconds in pattern], count)

    server = EmulatorServer(Emulator(clock, play, repeated=repeat))
    options = {
        "visa_resource": f"TCPIP0::127.0.0.1::{server.port}::SOCKET",
        "amplifier_gain": gain,
        "timeout": 20.0,
        "amplifier_max_voltage": 200.0,
        "record_folder": str(tmp_path),
    }
    backend = make_backend("waveform_generator", bench, clock, ended, options)
    backend.upload(sequence_of(program, bench))
    backend.start(Pacing())
    assert ended.event.wait(60.0) and ended.error is None
    backend.close()
    server.close()
    predicted = replay(swarm, scenario.problem.starts, groups, lengths)[-1]
    poses = substrate.poses()
    error = np.abs(np.column_stack([poses.x, poses.y]) / scenario.length_unit - predicted[:, :2]).max()
    print(f"{path.stem}: {program.epoch_count} epochs, {error:.2g} units")
    assert error < (1e-6 if step is None else 1e-9) * np.sqrt(max(program.epoch_count / 50, 1))
    np.testing.assert_allclose(np.exp(1j * poses.heading), np.exp(1j * predicted[:, 2]), atol=1e-6)
