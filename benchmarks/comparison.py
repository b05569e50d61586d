"""`optimize` beside the other planners, and beside IPOPT and OMPL as a user would set them up (`make bench-extra` installs them).

Whatever makes a plan, `Plan.valid` decides about it. Processor time, after kernels and libraries are loaded.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from optimizer import CASES, Case

from stressbot_planner import planners
from stressbot_planner.errors import StressbotError
from stressbot_planner.planners import Settings
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reporting.palette import COLOURS
from stressbot_planner.reproduce.figures import MARKERS
from stressbot_planner.reproduce.tables import Table

MISSING = "not installed: make bench-extra"
GOAL_RADIUS = 1.5
"""For trees: the paper's in Table 4."""

LIMIT = 10.0
"""s after which a planner has failed."""

WEIGHTS = np.linspace(0, 1, 11).round(1)
FRONT_SEEDS = 2

BASE = "optimize"


@dataclass(frozen=True)
class Contestant:
    """A planner of ours (no module), or a module of this folder with a function `plan` like theirs, and a library that it needs.

    It takes goals exactly, or needs balls around them; among discs, or in the open plane only.
    """

    name: str
    exact: bool = True
    discs: bool = True
    module: str = ""
    library: str = ""
    objectives: tuple[str, ...] = ("path",)

    @property
    def installed(self) -> bool:
        return not self.library or find_spec(self.library) is not None


CONTESTANTS = (
    Contestant(BASE, objectives=("path", "time")),
    Contestant("IPOPT, CasADi", module="comparison_ipopt", library="casadi", objectives=("path", "time")),
    Contestant("optimize_paper", discs=False),
    Contestant("pure_control"),
    Contestant("sequential", exact=False),
    Contestant("parallel", exact=False),
    Contestant("rrt_rotation", exact=False),
    Contestant("rrt", exact=False),
    Contestant("RRT, OMPL", exact=False, module="comparison_ompl", library="ompl"),
)

COMPARED = ("paper's six, open plane", "paper's six, two discs", "6 at random, 2 discs", "14 at random, 4 discs")
FRONTS = {"paper's six, open plane": 0, "paper's six, two discs": 0, "14 at random, 4 discs": 0}
"""Of which cases and random swarms the Pareto front is shown."""


@dataclass(frozen=True)
class Run:
    """What came of one attempt: s until the first plan, path and driving time of the last in relation to the exact bounds."""

    solved: bool = False
    first: float = np.nan
    path: float = np.nan
    time: float = np.nan
    refused: str = ""


def tables(seeds: int, folder: Path) -> list[Table]:
    """Return all tables for a number of random seeds a row, and draw the fronts."""
    cases = [case for case in CASES if case.name in COMPARED]
    return [*(_compared(cases, objective, seeds) for objective in planners.OBJECTIVES), fronts(folder)]


def _compared(cases: Sequence[Case], objective: str, seeds: int) -> Table:
    rows = []
    for case in cases:
        them = [one for one in CONTESTANTS if objective in one.objectives and (one.discs or not case.discs)]
        runs = _all([(one, case, objective, seed) for one in them if one.installed for seed in range(seeds)])
        base = runs[:seeds]
        for one in them:
            if not one.installed:
                rows.append((_name(case), one.name, MISSING, *[""] * 7))
                continue
            mine, runs = runs[:seeds], runs[seeds:]
            rows.append((_name(case), one.name, *_figures(one, mine, base, objective)))
    header = (
        "problem", "planner", "goals", "solved", "first plan (s), median", "largest", "÷ optimize",
        f"{objective} ÷ bound, median", "largest", "÷ optimize",
    )
    note = (
        f"- {seeds} seeds. Solved within {LIMIT:g} s. Quality: of the best plan after as long as the first "
        "column says, or of the first one if that came later. Bounds are those of the exact problem, also where goals have radius "
        f"{GOAL_RADIUS}."
    )
    return Table(f"Side by side, objective {objective}", header, tuple(rows), note)


def _name(case: Case) -> str:
    return f"{case.name}; {case.seconds:g} s"


def _figures(one: Contestant, mine: list[Run], base: list[Run], objective: str) -> tuple[str, ...]:
    solved, reference = ([run for run in runs if run.solved] for runs in (mine, base))
    count = f"{len(solved)}/{len(mine)}"
    goals = "exact" if one.exact else f"within {GOAL_RADIUS}"
    if mine[0].refused:
        return (goals, "refused", *[""] * 6)
    if not solved:
        return (goals, count, *[""] * 6)
    first, quality = ([getattr(run, name) for run in solved] for name in ("first", objective))
    against = [np.median([getattr(run, name) for run in reference] or [np.nan]) for name in ("first", objective)]
    return (
        goals, count,
        f"{np.median(first):.3f}", f"{max(first):.3f}", f"{np.median(first) / against[0]:.1f}",
        f"{np.median(quality):.3f}", f"{max(quality):.3f}", f"{np.median(quality) / against[1]:.2f}",
    )


def _all(arguments: Sequence[tuple]) -> list[Run]:
    """Return what comes of `attempt` for all these arguments."""
    return Parallel()(delayed(attempt)(*each) for each in arguments)


def attempt(one: Contestant, case: Case, objective: str, seed: int) -> Run:
    """Plan until the case's time is over; if there is no plan by then, anew until there is one."""
    problem = case.problem(seed)
    bounds = problem.lower_bounds
    if not one.exact:
        problem = replace(problem, tolerance=GOAL_RADIUS)
    settings = Settings(objective, case.seconds, seed=seed, clock=time.process_time)
    try:
        found = _planned(one, problem, settings)
        if found is None:
            found = _planned(one, problem, replace(settings, time_limit=LIMIT, first=True))
    except StressbotError as error:
        return Run(refused=str(error))
    if found is None:
        return Run()
    first, plan = found
    return Run(True, first, plan.path_length / bounds.path_length, plan.execution_time / bounds.execution_time)


def _planned(one: Contestant, problem: Problem, settings: Settings) -> tuple[float, Plan] | None:
    """Return s until the first plan and the last plan, or None."""
    if not one.module:
        result = planners.solve(problem, one.name, settings)
        plan, took, history = result.plan if result.success else None, result.planning_time, result.history
    else:
        function = _loaded(one.module)
        begin = settings.clock()
        outcome = function(problem, settings, np.random.default_rng(settings.seed))
        plan = outcome.primitives and Plan(problem, outcome.primitives)
        plan = plan if plan and plan.valid else None
        took, history = settings.clock() - begin, outcome.history
    return plan and (history[0][0] if history else took, plan)


@cache
def _loaded(module: str) -> Callable:
    """Return a module's function `plan` after a short try, so that nobody's time is that of loading."""
    function = import_module(module).plan
    problem = replace(CASES[0].problem(0), tolerance=GOAL_RADIUS)
    function(problem, Settings(time_limit=0.5, first=True, clock=time.process_time), np.random.default_rng(0))
    return function


# --- path against time ------------------------------------------------------------------------------------------------


def fronts(folder: Path) -> Table:
    """Return what `optimize` reaches for each weight of the time; draw it, and all others, as `front.png`."""
    named = {case.name: case for case in CASES}
    points, columns = {}, []
    for name, swarm in FRONTS.items():
        case = replace(named[name], swarm=swarm)
        them = [one for one in CONTESTANTS if one.installed and (one.discs or not case.discs)]
        arguments = [(one, case, str(w), seed) for one in them for w in _weights(one) for seed in range(FRONT_SEEDS)]
        runs = _all(arguments)
        points[name] = {
            one.name: [
                (run.path, run.time) for (who, *_), run in zip(arguments, runs, strict=True) if who is one and run.solved
            ]
            for one in CONTESTANTS
        }
        mine = np.array([(run.path, run.time) for run in runs[: len(WEIGHTS) * FRONT_SEEDS]]).reshape(len(WEIGHTS), FRONT_SEEDS, 2)
        columns.append(np.nanmedian(mine, axis=1))
    folder.mkdir(parents=True, exist_ok=True)
    _drawn(points).savefig(folder / "front.png")
    rows = [(f"{w:g}", *(f"{path:.3f}, {seconds:.3f}" for path, seconds in (column[k] for column in columns)))
            for k, w in enumerate(WEIGHTS)]
    note = f"- Medians of {FRONT_SEEDS} seeds, after the time that the tables above name. The picture is {folder.name}/front.png."
    return Table("`optimize`: path ÷ bound, time ÷ bound, by the weight of the time", ("weight", *FRONTS), tuple(rows), note)


def _weights(one: Contestant) -> tuple[float, ...]:
    """Return the weights of the time to plan for."""
    if one.name == BASE:
        return tuple(WEIGHTS.tolist())
    return (0.0, 0.5, 1.0) if "time" in one.objectives else (0.0,)


def _drawn(points: dict[str, dict[str, list[tuple[float, float]]]]) -> Figure:
    """Return the fronts: above with everybody, below the corner of the best."""
    figure = Figure(figsize=(4.4 * len(points), 8.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for column, (name, found) in enumerate(points.items()):
        for row in range(2):
            axes = figure.add_subplot(2, len(points), row * len(points) + column + 1)
            for k, (who, those) in enumerate(found.items()):
                style = {"color": (*COLOURS, "black")[k], "label": who}
                if who == BASE:
                    axes.plot(*zip(*_front(those), strict=True), drawstyle="steps-post", linewidth=1.2, color=style["color"])
                xs, ys = zip(*those, strict=True) if those else ((), ())
                axes.plot(xs, ys, linestyle="none", marker=(*MARKERS, "h")[k], markersize=4 if who == BASE else 6, **style)
            axes.set_xlabel("path ÷ lower bound")
            axes.set_ylabel("driving time ÷ lower bound")
            axes.grid(color="#e6e6e6", which="both")
            if row == 0:
                axes.set_title(name, fontsize=10)
                axes.set_xscale("log")
                axes.set_yscale("log")
                for axis in (axes.xaxis, axes.yaxis):
                    axis.set_major_formatter(lambda value, _: f"{value:g}")
                    axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "235" else "")
            else:
                corner = np.array(found[BASE])
                axes.set_xlim(0.99, 1.15 * corner[:, 0].max())
                axes.set_ylim(0.99, 1.15 * corner[:, 1].max())
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncol=5, frameon=False)
    return figure


def _front(those: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points that no other one beats in both, by increasing path."""
    front: list[tuple[float, float]] = []
    for point in sorted(those):
        if not front or point[1] < front[-1][1]:
            front.append(point)
    return front
