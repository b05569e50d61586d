"""Volts are all that the two halves share: what the sequencer encodes, the simulated robots read, for any alphabet."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from stressbot_driver.bench import parse_bench
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner import planners
from stressbot_planner.kinematics import replay
from stressbot_planner.scenario import parse
from stressbot_planner.sequencing import encode


def make_scenario(n: int, level_count: int, scheme: str, seed: int) -> str:
    rng = np.random.default_rng(seed)
    symbols = np.cumsum(rng.uniform(8.0, 20.0, level_count)) + 4.0
    reset, drive = float(symbols[-1]) + 15.0, float(symbols[-1]) + 50.0
    return yaml.safe_dump(
        {
            "name": "volts",
            "length_unit": 3.7e-5,
            "swarm": {
                "speed": 2.3,
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


SCENARIOS = Path(__file__).parents[1] / "scenarios"


def driven(text: str, program) -> np.ndarray:
    """Return the poses (n, 3), SI, that a simulated swarm of its own ends with."""
    substrate = Substrate(parse_bench(text))
    for level, dwell in zip(program.levels, program.dwells, strict=True):
        substrate.apply(level)
        substrate.advance(dwell)
    poses = substrate.poses()
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
    result = planners.solve(scenario.problem, planner, planners.Settings(time_limit=20.0))
    assert result.success, result.reason
    plan = result.plan
    poses = driven(text, encode(scenario.swarm, scenario.electrical, plan.groups, plan.lengths))
    np.testing.assert_allclose(poses[:, :2] / scenario.length_unit, plan.poses[-1, :, :2], atol=1e-6)
    assert scenario.problem.goal_error(poses[:, :2] / scenario.length_unit) <= tolerance + 1e-6
