"""The default planner on growing problems: how soon there is a plan, how near the lower bound it comes, how soon it is mended."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from stressbot_planner.errors import StressbotError
from stressbot_planner.execution.retiming import retime
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners import OBJECTIVES, Settings, solve
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.definition import EXACT, Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table


@dataclass(frozen=True)
class Case:
    """Problems of one kind and how they are looked at.

    Attributes:
        name: for the tables.
        text: the scenario for a seed.
        seconds: after which the plan is looked at.
        runs: seeds, and seeds of a full run; 0: none.
        objectives: each is run.
        tolerance: of goals, units.
        swarm: the seed of the only scenario, if all runs have the same.
        body: radius in place of the scenario's, units.
    """

    name: str
    text: Callable[[int], str]
    seconds: float
    runs: tuple[int, int]
    objectives: tuple[str, ...] = OBJECTIVES
    tolerance: float = EXACT
    swarm: int | None = None
    body: float | None = None

    def problem(self, seed: int) -> Problem:
        """Return the problem of a seed."""
        problem = scenario.parse(self.text(seed if self.swarm is None else self.swarm)).problem
        body = problem.swarm.body_radius if self.body is None else np.full(problem.swarm.n, self.body)
        return replace(problem, tolerance=self.tolerance, swarm=replace(problem.swarm, body_radius=body))

    @property
    def discs(self) -> bool:
        """Whether there are any."""
        return not self.problem(0).environment.is_open_plane


def _paper(discs: bool) -> Callable[[int], str]:
    return lambda seed: instances.paper(discs)


def _random(n: int, discs: bool) -> Callable[[int], str]:
    return lambda seed: instances.random(n, discs, seed)


SLENDER = 0.001
"""Body radius, units, of swarms so large that they do not get past each other otherwise."""

CASES = (
    Case("paper's six, open plane", _paper(False), 1.0, (10, 100)),
    Case("paper's six, two discs", _paper(True), 0.5, (10, 100)),
    Case("paper's six, two discs, goal radius 1.5", _paper(True), 0.5, (10, 100), tolerance=1.5),
    Case("6 at random, 2 discs", _random(6, True), 0.5, (10, 100)),
    Case("14 at random, open plane", _random(14, False), 5.0, (4, 10)),
    Case("14 at random, 4 discs", _random(14, True), 5.0, (4, 100)),
    Case("14 across a band of 7 discs", instances.band, 10.0, (4, 100)),
    Case("30 at random, open plane", _random(30, False), 10.0, (1, 6)),
    Case("30 at random, 10 discs", _random(30, True), 10.0, (2, 50)),
    Case("62 at random, open plane", _random(62, False), 10.0, (1, 10), ("time",)),
    Case("62 at random, 20 discs", _random(62, True), 60.0, (1, 20)),
    Case("126 at random, open plane", _random(126, False), 60.0, (1, 10), ("time",)),
    Case("126 at random, 40 discs", _random(126, True), 300.0, (0, 10), ("time",)),
    Case("254 at random, open plane", _random(254, False), 180.0, (0, 5), ("time",)),
    Case("254 at random, open plane, bodies of 0.001", _random(254, False), 30.0, (1, 4), ("time",), body=SLENDER),
    Case("1022 at random, open plane, bodies of 0.001", _random(1022, False), 180.0, (1, 1), ("time",), body=SLENDER),
)

REPLANNED = ("paper's six, two discs", "14 at random, 4 discs")
PLANS, RESTS, LATER = 10, 100, 5.0
"""Plans, each made in its case's time; rests of them; s within which one must be mended."""

OFF_POSITION, OFF_HEADING = 0.05, np.radians(3.0)
"""Standard deviations of what robots are off, units and rad."""


def tables(full: bool) -> list[Table]:
    """Return how `optimize` does on all cases, and how soon plans are mended."""
    return [_planned(full), replanned()]


def _planned(full: bool) -> Table:
    rows = []
    for case in (case for case in CASES if case.runs[full]):
        for objective in case.objectives:
            found = Parallel()(delayed(_run)(case, objective, seed) for seed in range(case.runs[full]))
            rows.append(_row(case, objective, found))
    head = (
        "problem", "objective", "solved", "first plan (s), median", "largest", "after (s)", "÷ bound, median", "90 %", "largest",
    )
    return Table("`optimize`, one thread, processor time", head, tuple(rows))


def _run(case: Case, objective: str, seed: int) -> tuple[float, float]:
    """Return when the first plan was found, and the ratio to the exact problem's bound at the end; NaN for none."""
    problem = case.problem(seed)
    result = solve(problem, "optimize", Settings(objective, case.seconds, seed=seed, clock=time.process_time))
    if not result.success:
        return np.nan, np.nan
    bounds = replace(problem, tolerance=EXACT).lower_bounds
    if objective == "path":
        return result.history[0][0], result.plan.path_length / bounds.path_length
    return result.history[0][0], result.plan.execution_time / bounds.execution_time


def _row(case: Case, objective: str, found: list[tuple[float, float]]) -> tuple[str, ...]:
    first, ratio = np.array([run for run in found if np.isfinite(run[0])]).reshape(-1, 2).T
    figures = [""] * 5
    if len(first):
        quality = np.median(ratio), np.percentile(ratio, 90), ratio.max()
        figures = [f"{figure:.3f}" for figure in (np.median(first), first.max(), *quality)]
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
