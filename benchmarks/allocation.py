"""Codewords chosen for a task: what they save, by plans that the search has not seen."""

import time
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from stressbot_planner import planners
from stressbot_planner.codesign.allocating import allocate
from stressbot_planner.codesign.measuring import Candidate, Measuring, workers
from stressbot_planner.codesign.objective import Objective, with_codewords
from stressbot_planner.codesign.words import Words, fewest_groups
from stressbot_planner.formats import scenario
from stressbot_planner.model.electrical import default_codes
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table

PAPER_GROUPS, PAPER_LIMIT, PAPER_SEEDS = (4, 5, 6, 7), 60.0, range(100, 105)
"""s of processor; seeds of searches."""

FIELDS = {6: (40.0, 12), 14: (80.0, 6), 30: (160.0, 3)}
"""Robots: s of processor for a search, fields each with and without discs."""

FIRST_FIELD = 1000
"""Seed of the first field; those below served development."""

PLANNING = {6: 4.0, 14: 8.0, 30: 16.0}
"""s of processor for each plan that is compared."""

PLAN_SEEDS = range(9000, 9003)
"""Of these plans: the search has other ones."""


@dataclass(frozen=True)
class Found:
    """Codewords of a search, and what the median plan for them and for the given ones costs."""

    text: str
    groups: int
    codewords: tuple[str, ...]
    proved: float
    bound: float
    search_saved: float
    tried: int
    given: tuple[float, float, float]
    found: tuple[float, float, float]

    @property
    def ratio(self) -> float:
        """Time to drive and to select of the found codewords ÷ that of the given ones."""
        return sum(self.found[:2]) / sum(self.given[:2])


def tables(full: bool) -> list[Table]:
    """Return all tables."""
    return [papers(full), fields(full)]


def papers(full: bool) -> Table:
    """The paper's six robots past two discs."""
    seeds = PAPER_SEEDS if full else PAPER_SEEDS[:2]
    runs = [(instances.paper(True), groups, PAPER_LIMIT, seed) for groups in PAPER_GROUPS for seed in seeds]
    found = _searched(runs)
    given = found[0]
    rows = [("binary", "4", "-", f"{_bound(given.text):.1f}", *(f"{value:.1f}" for value in given.given))]
    for groups in PAPER_GROUPS:
        mine = [one for one in found if one.groups == groups]
        rows.append((
            "chosen", str(groups), f"{mine[0].proved:.1f}", _spread([one.bound for one in mine]),
            *(_spread([one.found[k] for one in mine]) for k in range(3)),
        ))
    return Table(
        f"The paper's six robots past two discs; {len(seeds)} searches of {PAPER_LIMIT:g} s of processor each",
        ("codewords", "groups", "proved (s)", "bound (s)", "driving (s)", "selection (s)", "path (units)"),
        tuple(rows),
        f"Median (least to most) over searches, each the median of {len(PLAN_SEEDS)} plans by `optimize` for the time in "
        f"{PLANNING[6]:g} s of processor, with other seeds than the search has.",
    )


def fields(full: bool) -> Table:
    """Random fields, with as few groups as tell the robots apart."""
    rows = []
    for n, (limit, most) in FIELDS.items():
        count = most if full else max(1, most // 3)
        for discs in (False, True):
            texts = [instances.random(n, discs, FIRST_FIELD + k) for k in range(count)]
            found = _searched([(text, fewest_groups(n), limit, FIRST_FIELD + k) for k, text in enumerate(texts)])
            ratios = np.array([one.ratio for one in found])
            given, chosen = (np.median([sum(getattr(one, name)[:2]) for one in found]) for name in ("given", "found"))
            rows.append((
                str(n), str(fewest_groups(n)), "discs" if discs else "open", str(count), f"{limit:g}",
                f"{given:.1f}", f"{chosen:.1f}",
                f"{100 * (1 - np.median(ratios)):.0f} %", f"{100 * (1 - ratios.max()):.0f} %", f"{int((ratios > 1).sum())}",
                f"{100 * np.median([one.search_saved for one in found]):.0f} %",
            ))
    return Table(
        "Random fields: time to drive and to select, chosen codewords beside binary ones",
        (
            "n", "groups", "plane", "fields", "search (s)", "binary (s)", "chosen (s)", "saved, median", "least", "worse",
            "by its own measure",
        ),
        tuple(rows),
        f"Medians of {len(PLAN_SEEDS)} plans a field by `optimize`, with seeds that the search has not, in "
        f"{', '.join(f'{PLANNING[n]:g} s ({n} robots)' for n in FIELDS)} of processor. A swarm without a plan counts as worse.",
    )


def _searched(runs: list[tuple[str, int, float, int]]) -> list[Found]:
    return Parallel()(delayed(search)(*run) for run in runs)


def search(text: str, groups: int, limit: float, seed: int) -> Found:
    """Search by processor time, here, then plan for what was found and for what was given."""
    loaded = scenario.parse(text)
    problem, electrical = loaded.problem, loaded.electrical
    selection = {m: _selection_time(electrical, m) for m in (groups, loaded.swarm.m)}
    own = Objective("time", (problem,), selection[loaded.swarm.m])
    objective = own if groups == loaded.swarm.m else Objective("time", (problem,), selection[groups])
    with workers(1):
        measuring = Measuring(None, seed, time.process_time, time.process_time() + limit)
        words = Words(loaded.swarm.n, groups - 1, groups - 1)
        allocation = allocate(objective, words, Candidate.of(loaded.swarm.codewords, own), measuring, seed)
    best = allocation.found or allocation.given
    return Found(
        text, groups, best.codewords, allocation.bound.proved, best.bound, allocation.saved, allocation.progress.tried,
        planned(problem, loaded.swarm.codewords, own.selection_time),
        planned(problem, best.codewords, best.objective.selection_time),
    )


def planned(problem, codewords: tuple[str, ...], selection_time: float) -> tuple[float, float, float]:
    """Return the driving time, the selection time and the path of the median plan, infinite where there is none."""
    figures = []
    for seed in PLAN_SEEDS:
        settings = planners.Settings(
            objective="time", time_limit=PLANNING[len(codewords)], selection_time=selection_time, seed=seed, clock=time.process_time
        )
        result = planners.solve(with_codewords(problem, codewords), "optimize", settings)
        if result.success:
            plan = result.plan
            figures.append((plan.execution_time, selection_time * len(plan.groups), plan.path_length))
        else:
            figures.append((np.inf,) * 3)
    return sorted(figures, key=lambda one: one[0] + one[1])[len(figures) // 2]


def _selection_time(electrical, groups: int) -> float:
    return replace(electrical, codes=default_codes(groups, len(electrical.symbol_levels))).selection_time


def _bound(text: str) -> float:
    return scenario.parse(text).problem.turning_time


def _spread(values: list[float]) -> str:
    return f"{np.median(values):.1f} ({min(values):.1f} to {max(values):.1f})"
