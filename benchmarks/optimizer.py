"""The default planner on growing problems: how soon there is a plan, how near the lower bound it comes, how soon it is mended."""

import time
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from stressbot_planner import scenario
from stressbot_planner.errors import StressbotError
from stressbot_planner.kinematics import replay
from stressbot_planner.plan import Plan
from stressbot_planner.planners import Settings, solve
from stressbot_planner.primitives import as_primitives
from stressbot_planner.problem import Problem
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table
from stressbot_planner.retiming import retime


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
        seed = seed if self.swarm is None else self.swarm
        text = instances.paper(self.discs) if self.paper else instances.random(self.n, self.discs, seed)
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

REPLANNED = ("paper's six, two discs", "14 at random, 4 discs")
PLANS, RESTS, LATER = 10, 100, 5.0
"""Plans, each made in its case's time; rests of them; s within which one must be mended."""

OFF_POSITION, OFF_HEADING = 0.05, np.radians(3.0)
"""Standard deviations of what robots are off, units and rad."""


def tables(full: bool) -> list[Table]:
    """Return how `optimize` does on all cases, and how soon plans are mended."""
    return [_planned(full), replanned()]


def _seeds(n: int, full: bool) -> int:
    return 20 if n <= 6 or full and n <= 14 else 6 if full or n <= 14 else 1


def _planned(full: bool) -> Table:
    rows = []
    for case in CASES:
        for objective in ("path", "time"):
            found = Parallel()(delayed(_run)(case, objective, seed) for seed in range(_seeds(case.n, full)))
            rows.append(_row(case, objective, found))
    head = ("problem", "objective", "solved", "first plan (s), median", "largest", "after (s)", "÷ bound, median", "largest")
    return Table("`optimize`, one thread, processor time", head, tuple(rows))


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


# --- replanning -------------------------------------------------------------------------------------------------------


def replanned() -> Table:
    """Return how soon plans that robots have strayed from are mended."""
    rows = []
    for case in (case for case in CASES if case.name in REPLANNED):
        plans = Parallel()(delayed(_rest)(case, seed) for seed in range(PLANS))
        found = Parallel()(delayed(_replan)(case, k % PLANS, *plans[k % PLANS], k) for k in range(RESTS))
        took, longer = np.array([run[1:] for run in found if run[0] == "solved" or run[0] == "retimed"]).T
        retimed = sum(run[0] == "retimed" for run in found)
        rows.append((
            case.name, f"{len(took)}/{RESTS}", f"{retimed}/{RESTS}", f"{1e3 * np.median(took):.1f}",
            f"{1e3 * np.percentile(took, 90):.1f}", f"{1e3 * took.max():.1f}", f"{np.median(longer):.2f}", f"{longer.max():.2f}",
        ))
    header = (
        "plan of", "mended", "by new durations alone", "time (ms), median", "90 %", "largest",
        "path ÷ rest of the plan, median", "largest",
    )
    note = (
        f"- {RESTS} rests of {PLANS} plans. Robots are off their plan after 20 to 80 % of its path, positions by sigma = "
        f"{OFF_POSITION} units, headings by 3 deg; they touch nothing. `optimize` from there, warm-started with the rest, first "
        f"plan, {LATER:g} s at most. New durations alone: `retime`."
    )
    return Table("Replanning", header, tuple(rows), note)


def _rest(case: Case, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return groups and lengths of a plan."""
    plan = solve(case.problem(seed), "optimize", Settings(time_limit=case.seconds, seed=seed, clock=time.process_time)).plan
    return np.array(plan.groups), np.array(plan.lengths)


def _replan(case: Case, swarm: int, groups: np.ndarray, lengths: np.ndarray, seed: int) -> tuple[str, float, float]:
    """Return "solved", "retimed" (what is solved by new durations alone) or "failed", s, and path in relation to the rest."""
    plan = Plan(case.problem(swarm), as_primitives(groups, lengths))
    rng = np.random.default_rng(seed)
    problem, groups, lengths = _strayed(plan, rng)
    slides = problem.swarm.slides
    retimed, _ = retime(slides[groups - 1], problem.swarm.turning_length, problem.starts, problem.goals, lengths)
    alone = Plan(problem, as_primitives(groups, retimed)).valid
    settings = Settings(time_limit=LATER, first=True, warm_start=(groups, lengths), seed=seed, clock=time.process_time)
    result = solve(problem, "optimize", settings)
    if not result.success:
        return "failed", np.nan, np.nan
    rest = float(slides.sum(axis=1)[groups - 1] @ lengths)
    return "retimed" if alone else "solved", result.planning_time, result.plan.path_length / rest


def _strayed(plan: Plan, rng: np.random.Generator) -> tuple[Problem, np.ndarray, np.ndarray]:
    """Return the problem from poses off the plan, somewhere in the middle of it, and groups and lengths of the rest."""
    slides = plan.problem.swarm.slides.sum(axis=1)[plan.groups - 1]
    path = np.cumsum(slides * plan.lengths)
    while True:
        at = rng.uniform(0.2, 0.8) * path[-1]
        now = int(np.searchsorted(path, at))
        lengths = np.append((path[now] - at) / slides[now], plan.lengths[now + 1 :])
        part = np.append(plan.lengths[:now], plan.lengths[now] - lengths[0])
        poses = replay(plan.problem.swarm, plan.problem.starts, plan.groups[: now + 1], part)[-1]
        poses += rng.normal(size=poses.shape) * (OFF_POSITION, OFF_POSITION, OFF_HEADING)
        try:
            return replace(plan.problem, starts=poses), plan.groups[now:].copy(), lengths
        except StressbotError:  # bodies overlap
            continue
