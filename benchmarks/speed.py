"""Speed of the parts: ratios side by side in one run."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from stressbot_driver.bench import parse_bench
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner import scenario
from stressbot_planner.collision import Shapes, clearance_of
from stressbot_planner.kinematics import advance, replay
from stressbot_planner.sequencing import decode, encode

SCENARIOS = Path(__file__).parents[1] / "scenarios"
SAMPLES = 100


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


def many(n: int) -> str:
    """Return a scenario of n robots far apart."""
    robots = [{"start": [5.0 * (k % 40), 5.0 * (k // 40), 0.0], "goal": [5.0 * (k % 40), 5.0 * (k // 40)]} for k in range(n)]
    swarm = {"speed": 1.0, "turning_radius": 1.0, "body_radius": 0.3}
    return yaml.safe_dump({"name": "many", "swarm": swarm, "robots": robots})


def table() -> str:
    """Return the tables as Markdown."""
    return "\n\n".join([_checker(), _substrate(), _encoding()])


def _checker() -> str:
    loaded = scenario.load(SCENARIOS / "paper-six-two-discs.yaml")
    swarm, problem = loaded.swarm, loaded.problem
    rng = np.random.default_rng(0)
    groups, lengths = rng.integers(1, swarm.m + 1, 60), rng.uniform(0, 0.4, 60)
    poses = replay(swarm, problem.starts, groups, lengths)
    shapes = Shapes.of(problem.environment)
    discs = shapes.circles

    def sampled():
        smallest = np.inf
        for k, (group, length) in enumerate(zip(groups, lengths, strict=True)):
            for part in np.linspace(0, length, SAMPLES):
                xy = advance(swarm, poses[k], group, part)[:, :2]
                between = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) + np.diag(np.full(swarm.n, np.inf))
                to_discs = np.hypot(*(xy[:, None] - discs[None, :, :2]).transpose(2, 0, 1)) - discs[:, 2]
                smallest = min(smallest, between.min() - 0.6, to_discs.min() - 0.3)
        return smallest

    exact = seconds(lambda: clearance_of(swarm, shapes, poses, groups, lengths))
    dense = seconds(sampled, at_least=0.0)
    return (
        "| collision check of 60 activations, 6 robots, 2 discs | time | ratio |\n|---|---|---|\n"
        f"| exact and continuous | {1e6 * exact:.0f} µs | 1 |\n"
        f"| {SAMPLES} samples an activation, numpy | {1e3 * dense:.0f} ms | {dense / exact:.0f} |"
    )


def _substrate() -> str:
    lines = ["| simulated substrate | time a level change | × real time | × 6 robots' time |", "|---|---|---|---|"]
    first = None
    for n in (6, 126, 1022):
        text = many(n)
        loaded = scenario.parse(text)
        rng = np.random.default_rng(1)
        program = encode(loaded.swarm, loaded.electrical, rng.integers(1, loaded.swarm.m + 1, 300), rng.uniform(0.05, 2, 300))
        substrate = Substrate(parse_bench(text))

        def play(substrate=substrate, program=program):
            for level, dwell in zip(program.levels, program.dwells, strict=True):
                substrate.apply(level)
                substrate.advance(dwell)

        took = seconds(play)
        each = took / len(program.levels)
        first = first or each
        lines.append(f"| {n} robots | {1e6 * each:.1f} µs | {program.dwells.sum() / took:.0f} | {each / first:.1f} |")
    return "\n".join(lines)


def _encoding() -> str:
    loaded = scenario.parse(many(126))
    rng = np.random.default_rng(2)
    groups, lengths = rng.integers(1, loaded.swarm.m + 1, 100_000), rng.uniform(0.05, 2, 100_000)
    program = encode(loaded.swarm, loaded.electrical, groups, lengths)
    forth = seconds(lambda: encode(loaded.swarm, loaded.electrical, groups, lengths))
    back = seconds(lambda: decode(loaded.swarm, loaded.electrical, program))
    return (
        "| 100 000 epochs | time | ratio |\n|---|---|---|\n"
        f"| encode | {1e3 * forth:.0f} ms | 1 |\n| decode | {1e3 * back:.0f} ms | {back / forth:.1f} |"
    )
