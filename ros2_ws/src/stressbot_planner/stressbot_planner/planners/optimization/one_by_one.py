"""The plan of `pure_control`, which moves one robot after the other: long, but there where nobody gets past anybody."""

from dataclasses import replace

from stressbot_planner.planners import pure_control
from stressbot_planner.planners.optimization.search import Search
from stressbot_planner.problem.plan import Plan

SHORTEST_LIMIT = 1e-3
"""s."""


def ask_pure_control(search: Search, most: float) -> None:
    """Ask for a plan within so many s, and offer it."""
    limit = max(min(most, search.latest - search.elapsed()), SHORTEST_LIMIT)
    settings = replace(search.settings, time_limit=limit, on_progress=None)
    primitives = pure_control.plan(search.problem, settings, search.rng.spawn(1)[0]).primitives
    if primitives is not None:
        found = Plan(search.problem, primitives)
        if found.valid and found.keeps(search.settings.min_clearance):
            search.offer(primitives, found.groups, found.lengths)
