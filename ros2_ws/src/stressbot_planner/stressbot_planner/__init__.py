"""Motion planning and sequencing for swarms of MicroStressBots under group control.

    from stressbot_planner import Settings, load, plot, solve

    scenario = load("scenario.yaml")
    result = solve(scenario.problem, "optimize", Settings(max_tries=20))
    plot(result.plan).savefig("plan.png")

The names of `__all__` are the public ones; each is imported when it is first asked for.
"""

from importlib import import_module

_HOMES = {
    "Outcome": "planners",
    "Plan": "problem.plan",
    "Problem": "problem.definition",
    "Result": "problem.plan",
    "Scenario": "formats.scenario",
    "Settings": "planners",
    "StressbotError": "errors",
    "Swarm": "model.swarm",
    "load": "formats.scenario",
    "parse": "formats.scenario",
    "plot": "reporting.plotting",
    "solve": "planners",
}

__all__ = list(_HOMES)


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
