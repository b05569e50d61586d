"""Motion planning and sequencing for swarms of MicroStressBots under group control.

    from stressbot_planner import Settings, Solved, load, plot, solve

    scenario = load("scenario.yaml")
    result = solve(scenario.problem, "optimize", Settings(max_tries=20))
    if isinstance(result, Solved):
        plot(result.plan).savefig("plan.png")
    else:
        print(result.reason)

The names of `__all__` are the public ones; each is imported when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stressbot_planner.errors import StressbotError
    from stressbot_planner.formats.scenario import Scenario, load, parse
    from stressbot_planner.model.swarm import Swarm
    from stressbot_planner.planners import Outcome, Settings, solve
    from stressbot_planner.problem.definition import Problem
    from stressbot_planner.problem.plan import Failed, Plan, Result, Solved
    from stressbot_planner.reporting.plotting import plot

_HOMES = {
    "Failed": "problem.plan",
    "Outcome": "planners",
    "Plan": "problem.plan",
    "Problem": "problem.definition",
    "Result": "problem.plan",
    "Scenario": "formats.scenario",
    "Settings": "planners",
    "Solved": "problem.plan",
    "StressbotError": "errors",
    "Swarm": "model.swarm",
    "load": "formats.scenario",
    "parse": "formats.scenario",
    "plot": "reporting.plotting",
    "solve": "planners",
}

__all__ = [
    "Failed", "Outcome", "Plan", "Problem", "Result", "Scenario", "Settings", "Solved", "StressbotError", "Swarm",
    "load", "parse", "plot", "solve",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
