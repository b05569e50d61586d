"""What this project has promised for the paper's two problems, and whether a run of `stressbot reproduce` keeps it."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stressbot_planner.reproduce import published
from stressbot_planner.reproduce.tables import Table

LARGEST_MEMORY = 2e9


@dataclass(frozen=True)
class Target:
    """For a row of Table 3 or 4: least share of solved runs, largest median planning time, s."""

    section: str
    label: str
    solved: float
    time: float


TARGETS = (
    Target("table-3", "RRT with rot.", 1.0, 0.5),
    Target("table-3", "Original RRT", 0.9, 60.0),
    Target("table-4", "RRT with rotation", 1.0, 3.0),
    Target("table-4", "Subgroup sequential", 1.0, 2.0),
    Target("table-4", "Subgroup parallel", 1.0, 10.0),
    Target("table-4", "Pure control", 1.0, 2.0),
)


def tables(report: Path) -> list[Table]:
    """Return each target with what was measured, and how planning times compare."""
    runs = json.loads(report.read_text(encoding="utf-8"))["runs"]
    return [_targets(runs), _relative_times(runs)]


def _targets(runs: list[dict]) -> Table:
    rows = []
    for target in TARGETS:
        mine = [run for run in runs if (run["section"], run["row"]) == (target.section, target.label)]
        solved = [run for run in mine if run["solved"]]
        times = [run["planning_time"] for run in solved] or [np.inf]
        share = len(solved) / max(len(mine), 1)
        rows.append(_row(
            f"{target.section}, {target.label}: solved, median time",
            f"≥ {target.solved:.0%}, ≤ {target.time:g} s",
            f"{len(solved)}/{len(mine)}, {np.median(times):.2f} s (max {max(times):.2f} s)",
            share >= target.solved and np.median(times) <= target.time,
        ))
    for section, published_rows in (("table-3", published.TABLE_3), ("table-4", published.TABLE_4)):
        for row in published_rows:
            if row.path is None:
                continue
            paths = [run["path_length"] for run in runs if (run["section"], run["row"]) == (section, row.label) and run["solved"]]
            mean = float(np.mean(paths)) if paths else np.inf
            rows.append(_row(f"{section}, {row.label}: mean path", f"≤ {row.path:.2f}", f"{mean:.2f}", mean <= row.path))
    memory = max(run["peak_memory"] or 0 for run in runs)
    rows.append(_row("peak memory", f"≤ {LARGEST_MEMORY / 1e6:.0f} MB", f"{memory / 1e6:.0f} MB", memory <= LARGEST_MEMORY))
    return Table("Targets", ("target", "wanted", "measured", "kept"), tuple(rows))


def _row(name: str, wanted: str, measured: str, kept: bool) -> tuple[str, str, str, str]:
    return name, wanted, measured, "yes" if kept else "NO"


def _relative_times(runs: list[dict]) -> Table:
    rows = []
    for section in ("table-3", "table-4"):
        medians = {}
        for run in runs:
            if run["section"] == section and run["objective"] == "path":
                medians.setdefault(run["planner"], []).append(run["planning_time"])
        medians = {planner: float(np.median(times)) for planner, times in medians.items()}
        least = min(medians.values(), default=1.0)
        rows += [
            (section, planner, f"{1e3 * time:.1f}", f"{time / least:.1f}")
            for planner, time in sorted(medians.items(), key=lambda item: item[1])
        ]
    header = ("problem", "planner", "median planning time (ms)", "÷ the least")
    return Table("Planning times side by side", header, tuple(rows))
