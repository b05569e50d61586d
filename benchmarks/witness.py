"""Plans replayed by the driver's simulated substrate, through volts: the witness that knows nothing of the planner."""

import json
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from driver_support import play
from joblib import Parallel, delayed
from volts import sequence_of

from stressbot_driver.bench import parse_bench
from stressbot_driver.drive import check_drive
from stressbot_driver.sequence import Limits, check_sequence
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import read_plan_file
from stressbot_planner.model.kinematics import replay
from stressbot_planner.reproduce.tables import Table
from stressbot_planner.sequencing import VoltageProgram, encode

LARGEST_ERROR = 1e-6
"""Between plan and simulated robots, units."""


def tables(folder: Path) -> list[Table]:
    """Replay every plan of a report of `stressbot reproduce`, failed attempts too, and a long random one."""
    runs = json.loads((folder / "report.json").read_text(encoding="utf-8"))["runs"]
    files = [(folder / run["plan_file"], folder / run["scenario_file"]) for run in runs if "plan_file" in run]
    found = Parallel()(delayed(replay_file)(*pair) for pair in files)
    by_planner: dict[str, list[Replayed]] = defaultdict(list)
    for replayed in found:
        by_planner[replayed.planner].append(replayed)
    rows = []
    for planner, mine in sorted(by_planner.items()):
        error = max(replayed.error for replayed in mine)
        most = [str(max(getattr(replayed, name) for replayed in mine)) for name in ("n", "epochs")]
        rows.append((planner, str(len(mine)), *most, f"{error:.1e}", _verdict(error)))
    header = ("planner", "plans", "largest n", "most epochs", "largest error (units)", "verdict")
    note = f"- Error: between planned and simulated positions at the end of the plan, at most {LARGEST_ERROR:g} units."
    return [Table("Plans replayed by the simulated substrate, through volts", header, tuple(rows), note), accuracy()]


def _verdict(error: float) -> str:
    return "same" if error <= LARGEST_ERROR else "DIFFERS"


class Replayed(NamedTuple):
    """Largest error, units, of a robot at the end of a plan for n robots."""

    planner: str
    n: int
    epochs: int
    error: float


def replay_file(plan_file: Path, scenario_file: Path) -> Replayed:
    """Compare the end of a stored plan with that of the simulated robots."""
    text = scenario_file.read_text(encoding="utf-8")
    loaded = scenario.parse(text)
    stored = read_plan_file(plan_file, loaded.problem, loaded.name)
    plan = stored.plan
    program = encode(loaded.swarm, loaded.electrical, plan.groups, plan.lengths)
    positions = driven(text, program) / loaded.length_unit
    error = float(np.abs(positions - plan.poses[-1, :, :2]).max())
    return Replayed(stored.planner, loaded.swarm.n, program.epoch_count, error)


def driven(text: str, program: VoltageProgram) -> np.ndarray:
    """Return positions (n, 2), m, of simulated robots after a voltage sequence from their starts. The driver would take it."""
    bench = parse_bench(text)
    sequence = sequence_of(program, bench)
    check_sequence(sequence, bench.swarm_id, Limits(bench.electrical.min_level, bench.electrical.max_level))
    check_drive(sequence, bench.electrical)
    poses = play(Substrate(bench), sequence).poses()
    return np.column_stack([poses.x, poses.y])


def accuracy(activations: int = 10_000) -> Table:
    """Drive long random plans, robots of unlike radii: how rounding errors add up in plan and simulation."""
    radii = "[1.0, 0.9, 1.1, 0.37, 2.3, 0.5]"
    robots = "\n".join(f"  - {{start: [0, {2 * k}, 0], goal: [12, {2 * k}]}}" for k in range(6))
    text = f"name: long\nlength_unit: 1.0e-4\nswarm: {{speed: 1.0, turning_radius: {radii}, body_radius: 0.3}}\nrobots:\n{robots}\n"
    loaded = scenario.parse(text)
    rng = np.random.default_rng(0)
    groups, lengths = rng.integers(1, loaded.swarm.m + 1, activations), rng.uniform(0.01, 12.0, activations)
    program = encode(loaded.swarm, loaded.electrical, groups, lengths)
    simulated = driven(text, program) / loaded.length_unit
    planned = replay(loaded.swarm, loaded.problem.starts, groups, lengths)[-1, :, :2]
    error = float(np.abs(simulated - planned).max())
    row = (str(activations), f"{lengths.sum():.0f}", f"{error:.1e}", _verdict(error))
    header = ("activations", "driving (s)", "largest error (units)", "verdict")
    return Table("A long random plan, unlike turning radii", header, (row,))
