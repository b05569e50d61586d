"""How well the identification finds true speeds, turning radii and heading biases, how long it takes, and whether robots touch."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import yaml
from joblib import Parallel, delayed
from simulated_bench import SimulatedBench

from stressbot_driver.simulation.imperfections import Flaws
from stressbot_planner.estimation.identification import identify
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table

SEEDS = 20
PRECISION = 0.005
IMPERFECTIONS = {
    "speed_error": 0.03,
    "radius_error": 0.05,
    "heading_bias": np.radians(5.0),
    "heading_noise": np.radians(2.0),
    "position_noise": 2e-6,
    "orientation_noise": np.radians(1.0),
    "lost_probability": 0.002,
    "lost_frames": 10,
}
"""Lengths in m; scenarios have 1e-4 m a unit."""


class Run(NamedTuple):
    """Errors (largest over robots) of speed and radius, relative, and of heading bias, rad; shares of intervals that hold."""

    speed: float
    radius: float
    bias: float
    held: float
    seconds: float
    gap: float


def run(text: str, seed: int) -> Run:
    """Identify the robots of one scenario with one seed."""
    bench = SimulatedBench(text, seed=seed, **IMPERFECTIONS)
    swarm = bench.scenario.swarm
    estimates, _ = identify(swarm, bench.scenario.problem.environment, bench.measure, bench.drive, PRECISION)
    flaws = Flaws(bench.settings, bench.bench.ids, len(bench.bench.electrical.symbol_levels))
    true = (swarm.speed * swarm.pace * flaws.speed_factor, swarm.turning_radius * flaws.radius_factor, flaws.heading_bias)
    found = [[getattr(entry, name) for entry in estimates] for name in ("speed", "turning_radius", "heading_bias")]
    errors = [np.array([entry.value for entry in mine]) - values for mine, values in zip(found, true, strict=True)]
    widths = [np.array([entry.half_width for entry in mine]) for mine in found]
    held = np.mean([np.abs(error) <= width for error, width in zip(errors, widths, strict=True)])
    return Run(
        *(float(np.abs(error / scale).max()) for error, scale in zip(errors, (true[0], true[1], 1.0), strict=True)),
        float(held), bench.time, bench.gap,
    )


def corridor() -> str:
    """Return 14 small robots in a 15 x 15 workspace, a row of seven discs across it, starts on one side of them."""
    starts = [(1.0 + 1.7 * column, 1.5 + 2.0 * row) for column in range(2) for row in range(7)]
    goals = [(12.5 + 1.2 * column, 1.5 + 2.0 * row) for column in range(2) for row in range(7)]
    return yaml.safe_dump({
        "name": "corridor",
        "workspace": {"x": [0, 15], "y": [0, 15]},
        "obstacles": [{"circle": {"center": [7.5, 1.5 + 2.0 * k], "radius": 0.7}} for k in range(7)],
        "swarm": {"speed": 1.0, "turning_radius": 0.5, "body_radius": 0.2},
        "robots": [{"start": [*start, 0.0], "goal": list(goal)} for start, goal in zip(starts, goals, strict=True)],
    })


CASES: dict[str, Callable[[], str]] = {
    "paper's six, two discs": lambda: instances.paper(True),
    "14 at random, discs": lambda: instances.random(14, True, 0),
    "14 in a corridor": corridor,
}


def tables() -> list[Table]:
    """Return one table, a row for each case."""
    rows = []
    for name, make in CASES.items():
        text = make()
        runs = Parallel()(delayed(run)(text, seed) for seed in range(SEEDS))
        largest = [max(getattr(entry, field) for entry in runs) for field in ("speed", "radius", "bias")]
        rows.append((
            name, f"{100 * largest[0]:.2f} %", f"{100 * largest[1]:.2f} %", f"{np.degrees(largest[2]):.2f}",
            f"{100 * np.mean([entry.held for entry in runs]):.1f} %",
            f"{np.median([entry.seconds for entry in runs]):.0f} ({max(entry.seconds for entry in runs):.0f})",
            f"{min(entry.gap for entry in runs):.2f}",
        ))
    header = (
        "robots", "largest error of a speed", "of a radius", "of a bias (deg)", "95 % intervals that hold",
        "on the substrate (s), median (max)", "smallest gap (units)",
    )
    note = (
        f"- {SEEDS} seeds each. Speed error σ = 3 %, radius error 5 %, heading bias 5°, white heading noise 2° per activation, "
        "measured poses 0.02 units and 1°, 50 a second, each robot lost for 0.2 s about every 10 s."
    )
    return [Table("Calibration", header, tuple(rows), note)]
