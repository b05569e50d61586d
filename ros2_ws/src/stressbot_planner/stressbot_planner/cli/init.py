"""`stressbot init`: a scenario file to begin with, the paper's robots or others at random."""

import argparse
from pathlib import Path

from stressbot_planner.cli.arguments import count, seed, whole
from stressbot_planner.cli.printing import CommandReport
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import files, streams

MOST_ROBOTS, MOST_OBSTACLES = 2000, 300
"""That places are looked for; files may have more of both."""

PAPER = 6
"""Robots, where nobody says how many: those of the paper."""

HEADER = """\
# Made by `stressbot init`. Lengths are in units of length_unit, in metres. What can be changed and added: docs/scenario-file.md
# Robots make one step of 12 nm a pulse: docs/electrical.md
# `stressbot plot {name}` draws it, `stressbot plan {name} --output plan.json` plans for it.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help="scenario file (YAML) that is not there yet")
    parser.add_argument("--robots", type=count, metavar="N", help="so many robots at random places (default: the paper's six)")
    parser.add_argument(
        "--obstacles", type=whole, metavar="M", help="so many discs among them, and walls (default: the open plane)"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of the places (default: %(default)s)")


def run(options: argparse.Namespace) -> int:
    """Write the file and return the exit code.

    Raises:
        StressbotError: UNREADABLE_FILE or OUT_OF_RANGE, naming the argument.
    """
    path: Path = options.scenario
    try:
        files.check_output(path)
    except StressbotError as error:
        raise StressbotError(error.code, "SCENARIO", error.message) from error
    if path.exists():
        raise StressbotError(ErrorCode.UNREADABLE_FILE, "SCENARIO", f"{path} exists: give another name, or remove it")
    for name, most in (("robots", MOST_ROBOTS), ("obstacles", MOST_OBSTACLES)):
        if (getattr(options, name) or 0) > most:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, f"--{name}", f"is {getattr(options, name)}: give at most {most}")
    files.write_text(path, text(path.name, options.robots, options.obstacles, options.seed))
    report = CommandReport(written=str(path))
    report.lines(str(path))
    report.print(options.json)
    return streams.SOLVED


def text(name: str, robots: int | None, obstacles: int | None, seed: int) -> str:
    """Return the text of a scenario file.

    Args:
        name: of the file, for its comment.
        robots: how many, at random; None and no obstacles: the paper's six.
        obstacles: discs among them, in a workspace with walls; None: the open plane.
        seed: of the random places.
    """
    from stressbot_planner.reproduce import instances

    if robots is None and obstacles is None:
        body = instances.paper(discs=False)
    else:
        body = instances.field(robots or PAPER, obstacles, seed)
    return HEADER.format(name=name) + instances.pulsed(body)
