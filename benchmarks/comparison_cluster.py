"""One search spread over processes: joblib's own (loky), and Dask's workers, here two on this machine (`make bench-extra`)."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
from joblib import parallel_config
from optimizer import CASES

from stressbot_planner.planners import Settings, solve
from stressbot_planner.reproduce.tables import Table

CASE = next(case for case in CASES if case.name == "14 at random, 4 discs")
WORKERS = 2


@contextmanager
def _loky() -> Iterator[None]:
    with parallel_config("loky"):
        yield


@contextmanager
def _dask() -> Iterator[None]:
    from dask.distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster),
        parallel_config("dask"),
    ):
        yield


WAYS = {"1 process": (1, ExitStack), "2 processes, loky": (WORKERS, _loky), "2 processes, Dask workers": (WORKERS, _dask)}


def tables(seeds: int) -> list[Table]:
    """Return what two processes are worth on one random swarm, with so many seeds."""
    problem, rows = CASE.problem(0), []
    for name, (jobs, backend) in WAYS.items():
        if backend is _dask and not find_spec("distributed"):
            rows.append((name, "not installed: make bench-extra", *[""] * 4))
            continue
        with backend():
            settings = Settings(time_limit=CASE.seconds, jobs=jobs, clock=time.process_time)
            begin = time.monotonic()
            solve(problem, "optimize", Settings(time_limit=0.1, jobs=jobs, clock=time.process_time))
            start_up = time.monotonic() - begin
            found = [_run(problem, settings, seed) for seed in range(seeds)]
        wall, tries, first, ratio = np.median(found, axis=0)
        rows.append((name, f"{start_up:.1f}", f"{wall:.1f}", f"{tries:.0f}", f"{first:.3f}", f"{ratio:.3f}"))
    header = ("way", "first call of all (s)", "a call (s)", "orders tried", "first plan (s)", "path ÷ bound")
    note = (
        f"- Medians of {seeds} seeds, {CASE.name}; each process searches for {CASE.seconds:g} s of its own processor time. "
        "The first two columns are on the wall."
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
