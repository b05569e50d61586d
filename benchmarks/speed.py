"""Speed of the parts: ratios side by side in one run."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import yaml
from driver_support import play
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from volts import sequence_of

from stressbot_driver.bench import parse_bench
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import advance, replay
from stressbot_planner.reproduce.tables import Table
from stressbot_planner.sequencing import decode, encode

SCENARIOS = Path(__file__).parents[1] / "scenarios"
SAMPLES = 100
SIZES = (6, 126, 1022)


def seconds(function: Callable[[], object], at_least: float = 0.3) -> float:
    """Return the time of one call, the least of several rounds."""
    function()
    best, spent = np.inf, 0.0
    while spent < at_least or best == np.inf:
        begin = time.perf_counter()
        function()
        took = time.perf_counter() - begin
        best, spent = min(best, took), spent + took
    return best


def many(n: int, drive: str = "constant") -> str:
    """Return a scenario of n robots far apart."""
    robots = [{"start": [5.0 * (k % 40), 5.0 * (k // 40), 0.0], "goal": [5.0 * (k % 40), 5.0 * (k // 40)]} for k in range(n)]
    swarm = {"speed": 1.0, "turning_radius": 1.0, "body_radius": 0.3}
    return yaml.safe_dump({"name": "many", "swarm": swarm, "robots": robots, "electrical": {"drive": drive}})


def tables(folder: Path) -> list[Table]:
    """Return all tables; draw the substrate's speed into a folder."""
    checks, substrate = checker(), simulated_substrate(folder)
    return [checks, substrate, encoding()]


def checker() -> Table:
    """Compare the exact collision check with the replay that it follows, and with dense sampling."""
    loaded = scenario.load(SCENARIOS / "paper-six-two-discs.yaml")
    swarm, problem = loaded.swarm, loaded.problem
    rng = np.random.default_rng(0)
    groups, lengths = rng.integers(1, swarm.m + 1, 60), rng.uniform(0, 0.4, 60)
    poses = replay(swarm, problem.starts, groups, lengths)
    shapes = Shapes.of(problem.environment)
    discs = shapes.circles
    body = swarm.body_radius

    def sampled():
        smallest = np.inf
        for k, (group, length) in enumerate(zip(groups, lengths, strict=True)):
            for part in np.linspace(0, length, SAMPLES):
                xy = advance(swarm, poses[k], group, part)[:, :2]
                apart = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) - body[:, None] - body
                to_discs = np.hypot(*(xy[:, None] - discs[None, :, :2]).transpose(2, 0, 1)) - discs[:, 2] - body[:, None]
                smallest = min(smallest, apart[~np.eye(swarm.n, dtype=bool)].min(), to_discs.min())
        return smallest

    exact = seconds(lambda: clearance_of(swarm, shapes, poses, groups, lengths))
    alone = seconds(lambda: replay(swarm, problem.starts, groups, lengths))
    dense = seconds(sampled, at_least=0.0)
    rows = [
        ("replay", f"{1e6 * alone:.0f}", f"{alone / exact:.2f}"),
        ("exact, continuous check", f"{1e6 * exact:.0f}", "1"),
        (f"{SAMPLES} samples an activation", f"{1e6 * dense:.0f}", f"{dense / exact:.0f}"),
    ]
    header = ("60 activations, 6 robots, 2 discs", "time (µs)", "÷ exact check")
    return Table("Collision checker", header, tuple(rows), "- Samples are taken in numpy, without walls, and can miss a collision.")


def simulated_substrate(folder: Path) -> Table:
    """Measure how much faster than real time the simulated substrate is."""
    rows, factors = [], {}
    for drive in ("constant", "pulses"):
        for n in SIZES:
            text = many(n, drive)
            loaded, bench = scenario.parse(text), parse_bench(text)
            rng = np.random.default_rng(1)
            groups, lengths = rng.integers(1, loaded.swarm.m + 1, 300), rng.uniform(0.05, 2, 300)
            step = loaded.electrical.pulse_length(loaded.swarm.speed)
            whole = lengths if step is None else step * np.rint(lengths / step)
            sequence = sequence_of(encode(loaded.swarm, loaded.electrical, groups, whole), bench)
            took = seconds(partial(play, Substrate(bench), sequence))
            factors[drive, n] = factor = sequence.duration / took
            slower = factors["constant", n] / factor
            rows.append((drive, str(n), f"{1e6 * took / len(sequence.levels):.1f}", f"{factor:.0f}", f"{slower:.1f}"))
    _draw(folder / "substrate.png", [factors["pulses", n] for n in SIZES])
    header = ("drive", "robots", "a segment (µs)", "× real time", "slower than constant by")
    note = "- Pulses of 12 nm at 8333 Hz."
    return Table("Simulated substrate", header, tuple(rows), note)


def _draw(path: Path, factors: list[float]) -> None:
    figure = Figure(figsize=(6.0, 4.0), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.loglog(SIZES, factors, "o-", color="#1f4e8c")
    axes.set_xticks(SIZES, [str(n) for n in SIZES])
    axes.minorticks_off()
    axes.axhline(1.0, color="#d62728", linewidth=1.2)
    axes.text(SIZES[0], 1.15, "real time", color="#d62728")
    axes.set_ylim(bottom=0.5)
    axes.set_xlabel("robots")
    axes.set_ylabel("simulated seconds a second")
    axes.grid(color="#e6e6e6")
    figure.savefig(path)


def encoding() -> Table:
    """Compare encoding and decoding of a long plan."""
    loaded = scenario.parse(many(126))
    rng = np.random.default_rng(2)
    groups, lengths = rng.integers(1, loaded.swarm.m + 1, 100_000), rng.uniform(0.05, 2, 100_000)
    program = encode(loaded.swarm, loaded.electrical, groups, lengths)
    forth = seconds(lambda: encode(loaded.swarm, loaded.electrical, groups, lengths))
    back = seconds(lambda: decode(loaded.swarm, loaded.electrical, program))
    rows = [("encode", f"{1e3 * forth:.0f}", "1"), ("decode", f"{1e3 * back:.0f}", f"{back / forth:.1f}")]
    return Table("Volts of 100 000 activations", ("126 robots", "time (ms)", "÷ encode"), tuple(rows))
