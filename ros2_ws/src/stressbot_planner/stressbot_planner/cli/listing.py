"""`stressbot planners`: which planners there are."""

import argparse
import inspect

from stressbot_planner.cli.printing import CommandReport
from stressbot_planner.system import streams


def run(options: argparse.Namespace) -> int:
    """List all that are installed, with the first line of what they say of themselves."""
    from stressbot_planner import planners

    words = {name: _first_line(planners.get(name)) for name in planners.names()}
    report = CommandReport(planners=words)
    report.pairs(list(words.items()))
    report.print(options.json)
    return streams.SOLVED


def _first_line(planner: object) -> str:
    module = inspect.getmodule(planner)
    text = inspect.getdoc(module) or inspect.getdoc(planner) or ""
    return text.partition("\n")[0].partition("`: ")[2]
