"""The default planner on growing problems: how soon there is a plan, and how near the lower bound it comes."""

import time
from dataclasses import dataclass, replace

import numpy as np

from stressbot_planner import scenario
from stressbot_planner.planners import Settings, solve
from stressbot_planner.problem import Problem
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table


@dataclass(frozen=True)
class Case:
    """Problems of one kind: n robots, with or without discs; seconds after which the plan is looked at.

    A swarm, a number, makes all of them that random one; otherwise each seed has its own.
    """

    name: str
    n: int
    discs: bool
    seconds: float
    paper: bool = False
    tolerance: float = 1e-6
    swarm: int | None = None

    def problem(self, seed: int) -> Problem:
        text = instances.paper(self.discs) if self.paper else instances.random(self.n, self.discs, seed if self.swarm is None else self.swarm)
        return replace(scenario.parse(text).problem, tolerance=self.tolerance)


CASES = (
    Case("paper's six, open plane", 6, False, 1.0, paper=True),
    Case("paper's six, two discs", 6, True, 0.5, paper=True),
    Case("paper's six, two discs, goal radius 1.5", 6, True, 0.5, paper=True, tolerance=1.5),
    Case("6 at random, 2 discs", 6, True, 0.5),
    Case("14 at random, open plane", 14, False, 5.0),
    Case("14 at random, 4 discs", 14, True, 5.0),
    Case("30 at random, open plane", 30, False, 10.0),
    Case("30 at random, 10 discs", 30, True, 10.0),
    Case("62 at random, open plane", 62, False, 30.0),
    Case("62 at random, 20 discs", 62, True, 30.0),
)


def tables(seeds: int) -> list[Table]:
    """Return how `optimize` does on all cases, with so many seeds for up to 14 robots and a third of them beyond."""
    rows = []
    for case in CASES:
        for objective in ("path", "time"):
            some = range(seeds if case.n <= 14 else max(seeds // 3, 1))
            rows.append(_row(case, objective, [_run(case, objective, seed) for seed in some]))
    head = ("problem", "objective", "solved", "first plan (s), median", "largest", "after (s)", "÷ bound, median", "largest")
    return [Table("`optimize`, one thread, processor time", head, tuple(rows))]


def _run(case: Case, objective: str, seed: int) -> tuple[float, float]:
    """Return when the first plan was found, and the ratio to the exact problem's bound at the end; NaN for none."""
    problem = case.problem(seed)
    result = solve(problem, "optimize", Settings(objective, case.seconds, seed=seed, clock=time.process_time))
    if not result.success:
        return np.nan, np.nan
    bounds = replace(problem, tolerance=1e-6).lower_bounds
    if objective == "path":
        return result.history[0][0], result.plan.path_length / bounds.path_length
    return result.history[0][0], result.plan.execution_time / bounds.execution_time


def _row(case: Case, objective: str, found: list[tuple[float, float]]) -> tuple[str, ...]:
    first, ratio = np.array([run for run in found if np.isfinite(run[0])]).reshape(-1, 2).T
    figures = [""] * 4
    if len(first):
        figures = [f"{np.median(first):.3f}", f"{first.max():.3f}", f"{np.median(ratio):.3f}", f"{ratio.max():.3f}"]
    return (case.name, objective, f"{len(first)}/{len(found)}", *figures[:2], f"{case.seconds:g}", *figures[2:])
