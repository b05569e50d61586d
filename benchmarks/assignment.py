"""Interchangeable robots: what it is worth to know the coupling when goals are assigned, and what it costs."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from stressbot_planner import planners
from stressbot_planner.formats import scenario
from stressbot_planner.planners.assignment import assigned
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table

BOUND_SIZES, PLAN_SIZES, TIME_SIZES = (6, 14, 30, 62), (6, 14), (6, 62, 254, 1022)
TIME_LIMIT = 5.0


def fixed(problem: Problem, objective: str) -> Problem:
    """Return the problem as it is."""
    return problem


def nearest(problem: Problem, objective: str) -> Problem:
    """Return the problem with the assignment of least sum of straight distances."""
    distance = np.hypot(*(problem.starts[:, None, :2] - problem.goals).T).T
    return replace(problem, goals=problem.goals[linear_sum_assignment(distance)[1]])


WAYS: dict[str, Callable[[Problem, str], Problem]] = {"fixed": fixed, "least sum of distances": nearest, "coupled": assigned}


def tables(seeds: int) -> list[Table]:
    """Return all tables; seeds: random swarms a row."""
    return [bounds(seeds), plans(seeds), times()]


def bounds(seeds: int) -> Table:
    """Compare the bounds on driving time."""
    rows = []
    for n in BOUND_SIZES:
        for discs in (False, True):
            problems = [_swarm(n, discs, seed) for seed in range(seeds)]
            found = [[way(p, "time").lower_bounds.execution_time for way in WAYS.values()] for p in problems]
            rows.append((str(n), "discs" if discs else "open", *(f"{mean:.1f}" for mean in np.mean(found, axis=0))))
    return Table(f"Bound on driving time (s), mean of {seeds} random swarms", ("n", "plane", *WAYS), tuple(rows))


def plans(seeds: int) -> Table:
    """Compare what `optimize` makes of the assignments."""
    rows = []
    for n in PLAN_SIZES:
        for objective in planners.OBJECTIVES:
            problems = [_swarm(n, False, seed) for seed in range(seeds)]
            found = [[_planned(way(p, objective), objective) for way in WAYS.values()] for p in problems]
            means, solved = np.nanmean(found, axis=0), np.isfinite(found).sum(axis=0)
            cells = (f"{mean:.1f} ({k}/{seeds})" for mean, k in zip(means, solved, strict=True))
            rows.append((str(n), objective, *cells))
    title = f"Plans by `optimize`, open plane, {TIME_LIMIT:g} s of processor: path (units) or driving time (s), mean (solved)"
    return Table(title, ("n", "objective", *WAYS), tuple(rows))


def times() -> Table:
    """Measure how long it takes to assign."""
    rows = []
    for n in TIME_SIZES:
        problem = _swarm(n, False, 0)
        begin = time.process_time()
        coupled = assigned(problem, "time").lower_bounds.execution_time
        took = time.process_time() - begin
        ratio = coupled / nearest(problem, "time").lower_bounds.execution_time
        rows.append((str(n), f"{took:.3g}", f"{ratio:.2f}"))
    return Table("Time to assign", ("n", "processor time (s)", "bound, ÷ least sum of distances"), tuple(rows))


def _swarm(n: int, discs: bool, seed: int) -> Problem:
    return replace(scenario.parse(instances.random(n, discs, seed)).problem, exchangeable=tuple(range(n)))


def _planned(problem: Problem, objective: str) -> float:
    settings = planners.Settings(objective=objective, time_limit=TIME_LIMIT, clock=time.process_time)
    result = planners.solve(problem, "optimize", settings)
    if not result.success:
        return np.nan
    return result.plan.path_length if objective == "path" else result.plan.execution_time
