"""One search by one process and by two side by side."""

import time
from dataclasses import replace

import numpy as np
from optimizer import CASES

from stressbot_planner.planners import Settings, solve
from stressbot_planner.reproduce.tables import Table

CASE = next(case for case in CASES if case.name == "14 at random, 4 discs")
JOBS = (1, 2)


def tables(seeds: int) -> list[Table]:
    """Return what two processes are worth on one random swarm, with a number of seeds."""
    problem, rows = CASE.problem(0), []
    for jobs in JOBS:
        settings = Settings(time_limit=CASE.seconds, jobs=jobs, clock=time.process_time)
        found = [_run(problem, settings, seed) for seed in range(seeds)]
        wall, tries, first, ratio = np.median(found, axis=0)
        rows.append((str(jobs), f"{wall:.1f}", f"{tries:.0f}", f"{first:.3f}", f"{ratio:.3f}"))
    header = ("processes", "a call (s)", "orders tried", "first plan (s)", "path ÷ bound")
    note = (
        f"- Medians of {seeds} seeds, {CASE.name}; each process searches for {CASE.seconds:g} s of its own processor time. "
        "A call is on the wall, with the start of processes."
    )
    return [Table("One search on several processes", header, tuple(rows), note)]


def _run(problem, settings: Settings, seed: int) -> tuple[float, float, float, float]:
    """Return s on the wall, orders tried, s until the first plan, and path in relation to the bound."""
    begin = time.monotonic()
    result = solve(problem, "optimize", replace(settings, seed=seed))
    wall = time.monotonic() - begin
    if not result.success:
        return wall, result.details["tries"], np.nan, np.nan
    return wall, result.details["tries"], result.history[0][0], result.plan.path_length / problem.lower_bounds.path_length
