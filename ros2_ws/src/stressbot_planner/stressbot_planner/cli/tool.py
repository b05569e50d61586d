"""The offline tool `stressbot`: plan, plot and show scenarios without ROS, and start the demo.

Exit codes: 0 done, 1 failed, 2 bad input, 3 no plan found, 130 interrupted; but for 0 one line on standard error says why. What is
heavy to import is imported by the command that needs it, so that help and refusals come at once.
"""

import argparse
import math
import signal
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from stressbot_msgs.wording import sentence

from stressbot_planner import reproduce
from stressbot_planner.cli import view
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import files, streams, threads

if TYPE_CHECKING:
    from stressbot_planner.formats.scenario import Scenario
    from stressbot_planner.problem.definition import Problem
    from stressbot_planner.problem.plan import Result

STANDARD_OUTPUT = "-"
PAGE = ".html"
WIDEST_TABLE = 20
"""Up to as many robots get a column each in the table of groups."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool and return its exit code."""
    threads.limit()
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # until here, see setup.py
        signal.signal(signal.SIGINT, signal.default_int_handler)
    arguments = sys.argv[1:] if arguments is None else list(arguments)

    def command() -> int:
        options = _parser(with_demo=arguments[:1] == ["demo"]).parse_args(arguments)
        return options.run(options)

    return streams.run("stressbot", command)


# --- arguments ----------------------------------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    """Refuses in one line; argparse would print the usage as well."""

    def error(self, message: str) -> NoReturn:
        self.exit(streams.BAD_INPUT, f"{self.prog}: {sentence(message)}\n")


def _parser(with_demo: bool) -> argparse.ArgumentParser:
    parser = _Parser(
        prog="stressbot",
        description="Plan for swarms of MicroStressBots under group control.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input, 3 no plan found within the limit, 130 interrupted. "
        "The formats of scenario and plan files are described in docs/scenario-file.md and docs/plan-file.md.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")

    init = commands.add_parser(
        "init", help="write a scenario file to begin with",
        description="Write a scenario file to begin with: the paper's six robots, or others at random.",
    )
    init.add_argument("scenario", type=Path, metavar="SCENARIO", help="scenario file (YAML) that is not there yet")
    init.add_argument("--robots", type=_count, metavar="N", help="so many robots at random places (default: the paper's six)")
    init.add_argument(
        "--obstacles", type=_whole, metavar="M", help="so many discs among them, and walls (default: the open plane)"
    )
    init.add_argument("--seed", type=_seed, default=0, metavar="S", help="of the places (default: %(default)s)")
    init.set_defaults(run=_init)

    plan = commands.add_parser("plan", help="find a plan for a scenario", description="Find a plan for a scenario.")
    plan.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")
    plan.add_argument("--planner", default="optimize", metavar="NAME", help="name of the planner (default: %(default)s)")
    plan.add_argument(
        "--objective", default="path", metavar="path|time|WEIGHT",
        help="make the path, summed over robots, or the time to drive and to select groups short, or both: the weight of the "
        "time, 0 to 1 (default: %(default)s)",
    )
    plan.add_argument(
        "--tolerance", type=_positive, metavar="T", help="goal radius in scenario units (default: 1e-6, which is exact)"
    )
    plan.add_argument(
        "--order", type=_order, metavar="R",
        help="of the Lie brackets whose subgroups are moved, 1 to the number of groups - 1, for planners that use subgroups",
    )
    plan.add_argument("--seed", type=_seed, default=0, metavar="S", help="of the random generator (default: %(default)s)")
    plan.add_argument(
        "--time-limit", type=_positive, metavar="S",
        help="seconds to try for, by the clock (default: 10, with --max-tries none)",
    )
    plan.add_argument(
        "--max-tries", type=_count, metavar="N",
        help="how often to try: the same seed then gives the same plan, however busy the machine is",
    )
    plan.add_argument("--first", action="store_true", help="stop at the first plan")
    plan.add_argument(
        "--min-clearance", type=_not_negative, default=0.0, metavar="C", help="gap that all bodies keep, in scenario units"
    )
    plan.add_argument("--max-epochs", type=_count, metavar="N", help="most activations that the plan may have")
    plan.add_argument(
        "--jobs", type=_count, default=1, metavar="J",
        help="processes that search side by side, no more than there are processors (default: %(default)s)",
    )
    plan.add_argument("--output", type=Path, metavar="PLAN.json", help="write the plan to this file; -: to standard output")
    plan.set_defaults(run=_plan)

    plot = commands.add_parser("plot", help="draw a scenario or a plan", description="Draw a scenario or a plan.")
    plot.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML), or a recording (.mcap) for a page")
    plot.add_argument("plan", nargs="?", metavar="PLAN.json", help="plan file; without one, starts and goals are drawn")
    plot.add_argument(
        "--output", type=Path, metavar="X.png",
        help="picture to write, or with the ending .html a page that moves and needs nothing else; the ending says the format "
        "(default: named after the plan or the scenario, ending in .png)",
    )
    plot.set_defaults(run=_plot)

    show = commands.add_parser(
        "show", help="describe a scenario: groups, codewords, PFSM codes, bounds",
        description="Describe a scenario: groups, codewords, PFSM codes, bounds.",
    )
    show.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")
    show.set_defaults(run=_show)

    demo = commands.add_parser(
        "demo", help="plan, then drive the simulated swarm through ROS 2",
        description="Plan, then drive the simulated swarm through ROS 2.",
    )
    if with_demo:
        try:
            from stressbot_planner.cli import demo as module
        except ModuleNotFoundError as error:
            raise ImportError(f"the demo needs ROS 2 Jazzy and a workspace built from the whole repository ({error})") from error
        module.add_arguments(demo)
        demo.set_defaults(run=module.run)

    record = commands.add_parser(
        "record", help="record topics to a file, which ros2 bag and Foxglove read as well",
        description="Record topics to a file until Ctrl-C, in MCAP, which ros2 bag and Foxglove read as well.",
    )
    record.add_argument("topics", nargs="*", metavar="TOPIC", help="topic to record (default: all)")
    record.add_argument(
        "--output", type=Path, metavar="X.mcap",
        help="file that is not there yet (default: recording-DATE-TIME.mcap)",
    )
    record.set_defaults(run=_record)

    replay = commands.add_parser(
        "replay", help="publish again what was recorded",
        description="Publish again what was recorded, with the same times between.",
    )
    replay.add_argument("recording", type=Path, metavar="X.mcap", help="recording")
    replay.add_argument(
        "topics", nargs="*", metavar="TOPIC", help="topic to replay (default: all but hidden ones and those of ROS)"
    )
    replay.add_argument(
        "--rate", type=_not_negative, default=1.0, metavar="F",
        help="recorded seconds per second; 0: as fast as possible (default: %(default)g)",
    )
    replay.set_defaults(run=_replay)

    page = commands.add_parser(
        "view", help="show a swarm in a browser: live, a plan or a recording, and drive it from there",
        description="Show a swarm in a browser until Ctrl-C: the nodes that run, a simulated system, a plan or a recording.",
    )
    view.add_arguments(page)
    page.set_defaults(run=view.run)

    again = commands.add_parser(
        "reproduce", help="measure all planners as in the paper's tables and figures",
        description="Measure all planners as in the paper's tables and figures, and beyond them.",
    )
    reproduce.add_arguments(again)
    again.set_defaults(run=reproduce.run)
    return parser


def _number(text: str, wanted: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"is '{text}': give {wanted}") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"is {value}: give a finite number")
    return value


def _positive(text: str) -> float:
    value = _number(text, wanted := "a number greater than 0")
    if value <= 0:
        raise argparse.ArgumentTypeError(f"is {value}: give {wanted}")
    return value


def _not_negative(text: str) -> float:
    value = _number(text, wanted := "a number of 0 or more")
    if value < 0:
        raise argparse.ArgumentTypeError(f"is {value}: give {wanted}")
    return value


def _seed(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 0 to 10^18 - 1")
    return int(text)


def _order(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text[:9]) <= 99:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 1")
    return int(text)


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > 9 or int(text) < 1:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 1")
    return int(text)


def _whole(text: str) -> int:
    return 0 if text == "0" else _count(text)


# --- commands -----------------------------------------------------------------------------------------------------


def _init(options: argparse.Namespace) -> int:
    from stressbot_planner.cli import init

    return init.run(options)


def _plan(options: argparse.Namespace) -> int:
    output: Path | None = options.output
    file = None if output is None or str(output) == STANDARD_OUTPUT else output
    if file is not None:
        files.check_output(file, options.scenario)
    from stressbot_planner import planners
    from stressbot_planner.formats import scenario
    from stressbot_planner.formats.plan_file import plan_file, plan_text
    from stressbot_planner.planners import assignment
    from stressbot_planner.problem.definition import EXACT

    planners.get(options.planner)
    planners.time_weight(options.objective)
    loaded = scenario.load(options.scenario, options.tolerance or EXACT)
    settings = planners.Settings(
        objective=options.objective,
        time_limit=options.time_limit,
        max_tries=options.max_tries,
        first=options.first,
        min_clearance=options.min_clearance,
        max_epochs=options.max_epochs,
        selection_time=loaded.electrical.selection_time,
        pulse_length=loaded.electrical.pulse_length(loaded.swarm.speed),
        order=options.order,
        seed=options.seed,
        jobs=options.jobs,
    )
    jobs = planners.usable_jobs(options.jobs)
    if jobs < options.jobs:
        streams.complain("stressbot", f"--jobs: is {options.jobs}, more than there are processors: {jobs} search")
    result = assignment.solve(loaded.problem, options.planner, settings)
    if output is not None:
        text = plan_text(plan_file(result, loaded.name, loaded.electrical.selection_time))
        if file is not None:
            files.write_text(file, text)
        else:
            sys.stdout.write(text)
    with redirect_stdout(sys.stdout if file is not None or output is None else sys.stderr):
        _print_pairs(_summary(loaded, result) + ([("written", str(file))] if file is not None else []))
    if not result.success:
        streams.complain("stressbot", f"no plan found: {result.reason}")
        return streams.NO_PLAN
    return streams.SOLVED


def _plot(options: argparse.Namespace) -> int:
    ending = PAGE if Path(options.scenario).suffix == view.RECORDING else ".png"
    output = options.output or Path(f"{Path(options.plan or options.scenario).stem}{ending}")
    files.check_output(output, options.scenario, options.plan)
    if output.suffix == PAGE or ending == PAGE:
        return _plot_page(options, output)
    from stressbot_planner.formats import scenario
    from stressbot_planner.formats.plan_file import read_plan_file
    from stressbot_planner.reporting import plotting

    loaded = scenario.load(options.scenario)
    stored = read_plan_file(options.plan, loaded.problem, loaded.name) if options.plan else None
    if output.suffix[1:] not in plotting.FORMATS:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "--output", f"ends in '{output.suffix}': use .{', .'.join(plotting.FORMATS)} or {PAGE}"
        )
    if stored is None:
        figure = plotting.plot_plan(loaded.problem, loaded.problem.starts[None], loaded.length_unit, loaded.name)
    else:
        title = plotting.plan_title(loaded.name, stored)
        figure = plotting.plot_plan(stored.plan.problem, stored.plan.poses, loaded.length_unit, title)
    with files.replacing(output) as stream:
        figure.savefig(stream, format=output.suffix[1:])
    print(output)
    return streams.SOLVED


def _plot_page(options: argparse.Namespace, output: Path) -> int:
    from stressbot_planner.view import page

    if output.suffix != PAGE:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--output", f"ends in '{output.suffix}': use {PAGE} for a recording")
    data = view.data_of(options.scenario, options.plan)
    files.write_text(output, page.alone(data))
    print(output)
    return streams.SOLVED


def _show(options: argparse.Namespace) -> int:
    from stressbot_planner.formats import scenario
    from stressbot_planner.planners.assignment import assigned

    loaded = scenario.load(options.scenario)
    swarm, electrical = loaded.swarm, loaded.electrical
    path_bound = assigned(loaded.problem, "path").lower_bounds.path_length
    time_bound = assigned(loaded.problem, "time").lower_bounds.execution_time
    environment = loaded.problem.environment
    radii = sorted(set(swarm.turning_radius.tolist()))
    turning = f"{radii[0]:g} for every robot: the primitives h_i, g_i and Rot exist"
    if not swarm.alike:
        turning = f"{radii[0]:g} to {radii[-1]:g}: only the primitives f_i exist, because h_i, g_i and Rot need equal robots"
    slowest = float(swarm.pace.min() * swarm.speed)
    bodies = " to ".join(f"{radius:g}" for radius in sorted({swarm.body_radius.min(), swarm.body_radius.max()}))
    walls = environment.workspace
    _print_pairs(
        [
            ("scenario", f"{loaded.name}: {swarm.n} robots, {swarm.m} groups, 1 unit is {loaded.length_unit:g} m"),
            ("speed", f"{swarm.speed:g} units/s" if swarm.equal_speeds else f"{slowest:g} to {swarm.speed:g} units/s"),
            ("turning radius", turning),
            ("body radius", bodies if swarm.body_radius.all() else f"{bodies} (0: points, which pass each other)"),
            ("workspace", f"x {walls.x_min:g} to {walls.x_max:g}, y {walls.y_min:g} to {walls.y_max:g}" if walls else "open plane"),
            ("obstacles", str(len(environment.obstacles))),
            *_assigned_goals(loaded.problem),
            ("lower bounds", f"path {path_bound:.2f} units, driving time {time_bound:.2f} s"),
            ("selection time", f"{electrical.selection_time:g} s for each activation ({len(electrical.codes[0])} symbols)"),
            ("drive", _drive(loaded)),
        ]
    )
    robots = range(1, swarm.n + 1)
    wide = swarm.n <= WIDEST_TABLE
    header = ["Group", *([f"R{k}" for k in robots] if wide else ["members"]), "size", "code", "volts"]
    rows = []
    for i, (row, code) in enumerate(zip(swarm.membership, electrical.codes, strict=True), start=1):
        members = [str(int(bit)) for bit in row] if wide else [_ranges([k for k in robots if row[k - 1]])]
        volts = " ".join(f"{electrical.symbol_levels[symbol]:g}" for symbol in code)
        rows.append([f"G{i}", *members, str(int(row.sum())), " ".join(map(str, code)), volts])
    print()
    _print_table("Groups (the last one: all rotate)", header, rows)
    print()
    words = [f"R{k} {word}" for k, word in zip(robots, swarm.codewords, strict=True)]
    per_line = max(1, 100 // (max(map(len, words)) + 2))
    print("Codewords (first bit: G1)")
    for first in range(0, len(words), per_line):
        print("  " + "  ".join(words[first : first + per_line]))
    return streams.SOLVED


def _record(options: argparse.Namespace) -> int:
    from stressbot_planner.cli import recordings

    return recordings.record(options)


def _replay(options: argparse.Namespace) -> int:
    from stressbot_planner.cli import recordings

    return recordings.replay(options)


# --- output -------------------------------------------------------------------------------------------------------


def _summary(loaded: "Scenario", result: "Result") -> list[tuple[str, str]]:
    swarm = loaded.swarm
    rows = [
        ("scenario", f"{loaded.name}: {swarm.n} robots, {swarm.m} groups"),
        ("planner", f"{result.planner}, seed {result.seed}, {result.planning_time:.3f} s"),
        ("result", "solved" if result.success else "no plan found" + (", this is the closest attempt" if result.plan else "")),
    ]
    plan = result.plan
    if plan is None:
        return rows
    bounds = plan.problem.lower_bounds
    selection = len(plan.groups) * loaded.electrical.selection_time
    return [
        *rows,
        *_assigned_goals(plan.problem),
        ("activations", f"{len(plan.groups)} from {len(plan.primitives)} primitives"),
        ("path length", f"{plan.path_length:.2f} units, {_ratio(plan.path_length, bounds.path_length)}"),
        (
            "execution",
            f"{plan.execution_time:.2f} s driving, {_ratio(plan.execution_time, bounds.execution_time)}; "
            f"{selection:.2f} s to select groups",
        ),
        *_pulses(loaded, plan.lengths),
        ("min clearance", str(plan.clearance)),
        ("goal error", f"{plan.goal_error:.3g} units (tolerance {plan.problem.tolerance:g})"),
    ]


def _pulses(loaded: "Scenario", lengths) -> list[tuple[str, str]]:
    step = loaded.electrical.pulse_length(loaded.swarm.speed)
    return [] if step is None else [("pulses", f"{lengths.sum() / step:.0f}, {step:.4g} units each")]


def _drive(loaded: "Scenario") -> str:
    electrical, swarm = loaded.electrical, loaded.swarm
    drive = electrical.drive
    if drive is None:
        return f"constant {electrical.drive_level:g} V, an idealisation: real robots make one step a pulse"
    steps = 1e9 * loaded.length_unit * swarm.speed * swarm.pace / drive.frequency
    nm = f"{steps.max():.4g} nm" if swarm.equal_speeds else f"{steps.min():.4g} to {steps.max():.4g} nm"
    microseconds = 1e6 / drive.frequency
    return (
        f"pulses of {electrical.drive_level:g} V for {drive.duty * microseconds:.4g} us and {drive.low_level:g} V for "
        f"{(1 - drive.duty) * microseconds:.4g} us, {'alternating' if drive.alternating else 'unipolar'}: {drive.frequency:.6g} Hz "
        f"with a step of {nm}"
    )


def _assigned_goals(problem: "Problem") -> list[tuple[str, str]]:
    free = [row + 1 for row in problem.exchangeable]
    return [("goals", f"{len(free)} assigned among robots {_ranges(free)}")] if free else []


def _ratio(value: float, bound: float) -> str:
    return f"{value / bound:.3f} × the lower bound {bound:.2f}" if bound > 0 else "lower bound 0"


def _ranges(numbers: list[int]) -> str:
    """Return ascending numbers as text: 1-3, 5."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in parts) or "none"


def _print_pairs(rows: list[tuple[str, str]]) -> None:
    if not sys.stdout.isatty():
        for name, value in rows:
            print(f"{name + ':':<16}{value}")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in rows:
        table.add_row(Text(name, style="bold"), Text(value))
    Console().print(table)


def _print_table(title: str, header: list[str], rows: list[list[str]]) -> None:
    if not sys.stdout.isatty():
        widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
        print(title)
        for row in (header, *rows):
            print("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left")
    for name in header:
        table.add_column(name, no_wrap=name != "members", style="bold" if name == "Group" else None)
    for row in rows:
        table.add_row(*(Text(cell, style="dim" if cell == "0" else "") for cell in row))
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
