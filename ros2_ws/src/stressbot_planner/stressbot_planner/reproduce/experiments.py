"""Which runs make up each section of the report, in quick and in full."""

from collections.abc import Callable
from dataclasses import dataclass

from stressbot_planner import planners
from stressbot_planner.formats import scenario
from stressbot_planner.primitives.subgroups import largest_order
from stressbot_planner.problem.definition import EXACT
from stressbot_planner.reproduce import instances, published
from stressbot_planner.reproduce.runs import Record, Run

ORDER_PLANNERS = ("sequential", "parallel", "rrt_rotation")
GROWTH_SIZES = tuple(2**bits - 2 for bits in range(3, 12))
"""6, 14, … 2046: the sizes that use every codeword of the paper's allocation."""

TOLERANCE = 1.5
"""Goal radius of order sweep and growth, units: that of the paper's Table 4."""

EXACT_PLANNERS = ("optimize", "optimize_paper")
"""These reach every goal exactly, in every section."""


@dataclass(frozen=True)
class Scale:
    """How much is run.

    Attributes:
        table_3, table_4, orders, growth: seeds of each section.
        table_limit, order_limit, growth_limit: time limits, s.
        order_discs: whether the order sweep takes both sizes with and without discs, or n = 6 with and n = 14 without.
    """

    table_3: int
    table_4: int
    orders: int
    growth: int
    table_limit: float
    order_limit: float
    growth_limit: float
    order_discs: bool


QUICK = Scale(20, 10, 2, 1, 60.0, 10.0, 15.0, False)
FULL = Scale(20, 10, 5, 2, 60.0, 60.0, 30.0, True)
"""Both have the paper's numbers of instances in its tables; sweep and growth take the time."""


def table_3(scale: Scale) -> list[Run]:
    """Return the runs of Table 3: the open plane."""
    return _paper_runs("table-3", instances.paper(discs=False), published.TABLE_3, scale.table_3, scale.table_limit)


def table_4(scale: Scale) -> list[Run]:
    """Return the runs of Table 4: two discs and walls."""
    return _paper_runs("table-4", instances.paper(discs=True), published.TABLE_4, scale.table_4, scale.table_limit)


def _paper_runs(section: str, text: str, rows, seeds: int, limit: float) -> list[Run]:
    return [
        Run(section, row.label, text, row.planner, limit, seed, row.objective, row.tolerance or EXACT)
        for row in rows
        for seed in range(seeds)
    ]


def orders(scale: Scale) -> list[Run]:
    """Return the runs of M(n, r) for every order r, n = 6 (the paper's instance) and n = 14 (a random one)."""
    both = scale.order_discs
    texts = [instances.paper(discs) for discs in ((False, True) if both else (True,))]
    texts += [instances.random(14, discs, 0) for discs in ((False, True) if both else (False,))]
    return [
        Run("orders", planner, text, planner, scale.order_limit, seed, tolerance=TOLERANCE, order=order)
        for text in texts
        for planner in ORDER_PLANNERS
        for order in range(1, largest_order(scenario.parse(text).swarm) + 1)
        for seed in range(scale.orders)
    ]


def growth(
    scale: Scale, perform_all: Callable[[list[Run]], list[Record]], sizes: tuple[int, ...] = GROWTH_SIZES
) -> list[Record]:
    """Perform the runs of growing swarms, each planner up to the first size at which it solves none; return all records."""
    records: list[Record] = []
    alive = [(planner, discs) for discs in (False, True) for planner in planners.names()]
    for n in sizes:
        runs = {case: [_growth_run(*case, n, seed, scale.growth_limit) for seed in range(scale.growth)] for case in alive}
        new = perform_all([run for case in alive for run in runs[case]])
        records += new
        alive = [
            case for k, case in enumerate(alive) if any(r["solved"] for r in new[k * scale.growth : (k + 1) * scale.growth])
        ]
        if not alive:
            break
    return records


def _growth_run(planner: str, discs: bool, n: int, seed: int, limit: float) -> Run:
    """Return a run in a process of its own; the instance changes with the seed."""
    tolerance = EXACT if planner in EXACT_PLANNERS else TOLERANCE
    section = "growth-discs" if discs else "growth"
    return Run(section, planner, instances.random(n, discs, seed), planner, limit, seed, tolerance=tolerance, fresh=True)
