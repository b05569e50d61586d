"""`stressbot plot`: draw a scenario or a plan, as a picture, a film or a page that moves."""

import argparse
from pathlib import Path

from stressbot_planner.cli import view
from stressbot_planner.cli.printing import CommandReport
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import files, streams

PAGE = ".html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML), or a recording (.mcap) for a page")
    parser.add_argument("plan", nargs="?", metavar="PLAN.json", help="plan file; without one, starts and goals are drawn")
    parser.add_argument(
        "--output", type=Path, metavar="X.png",
        help="picture to write; with the ending .gif or .mp4 (by ffmpeg) a film, with .html a page that moves and needs nothing "
        "else (default: named after the plan or the scenario, ending in .png)",
    )


def run(options: argparse.Namespace) -> int:
    """Write the picture, or the page."""
    ending = PAGE if Path(options.scenario).suffix == view.RECORDING else ".png"
    output = options.output or Path(f"{Path(options.plan or options.scenario).stem}{ending}")
    files.check_output(output, options.scenario, options.plan)
    if output.suffix == PAGE or ending == PAGE:
        return _plot_page(options, output)
    from stressbot_planner.formats import scenario
    from stressbot_planner.formats.plan_file import read_plan_file
    from stressbot_planner.reporting import film, plotting

    loaded = scenario.load(options.scenario)
    stored = read_plan_file(options.plan, loaded.problem, loaded.name) if options.plan else None
    formats = (*plotting.FORMATS, *film.WRITERS)
    if output.suffix[1:] not in formats:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--output", f"ends in '{output.suffix}': use .{', .'.join(formats)} or {PAGE}")
    if output.suffix[1:] in film.WRITERS:
        if stored is None:
            raise StressbotError(ErrorCode.MISSING_FIELD, "PLAN.json", f"is missing: {output} shows how robots move, name a plan")
        film.write(output, stored.plan, loaded.length_unit, plotting.plan_title(loaded.name, stored))
        return _written(output, options)
    if stored is None:
        figure = plotting.plot_plan(loaded.problem, loaded.problem.starts[None], loaded.length_unit, loaded.name)
    else:
        title = plotting.plan_title(loaded.name, stored)
        figure = plotting.plot_plan(stored.plan.problem, stored.plan.poses, loaded.length_unit, title)
    with files.replacing(output) as stream:
        figure.savefig(stream, format=output.suffix[1:])
    return _written(output, options)


def _plot_page(options: argparse.Namespace, output: Path) -> int:
    from stressbot_planner.view import page

    if output.suffix != PAGE:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--output", f"ends in '{output.suffix}': use {PAGE} for a recording")
    data = view.data_of(options.scenario, options.plan)
    files.write_text(output, page.alone(data))
    return _written(output, options)


def _written(output: Path, options: argparse.Namespace) -> int:
    report = CommandReport(written=str(output))
    report.lines(str(output))
    report.print(options.json)
    return streams.SOLVED
