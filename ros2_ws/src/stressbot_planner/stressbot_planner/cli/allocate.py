"""`stressbot allocate`: codewords that suit a task, by the planner's own cost."""

import argparse
import math
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stressbot_planner.cli.arguments import count, positive, seed, usable_jobs
from stressbot_planner.cli.live_line import LiveLine
from stressbot_planner.cli.printing import CommandReport, Row, codeword_lines
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import files, streams
from stressbot_planner.system.interrupts import EndedByCtrlC

if TYPE_CHECKING:
    from stressbot_planner.codesign.allocating import Allocation
    from stressbot_planner.codesign.measuring import Candidate
    from stressbot_planner.codesign.objective import Objective
    from stressbot_planner.codesign.search import SearchProgress
    from stressbot_planner.codesign.words import Words
    from stressbot_planner.execution.worker import Worker
    from stressbot_planner.formats.scenario import Scenario
    from stressbot_planner.model.electrical import Electrical
    from stressbot_planner.problem.definition import Problem

TIME_LIMIT = 60.0
"""s; of a sweep for each number of groups."""

RANDOM, MOST_TASKS = re.compile(r"random:([0-9]{1,9})"), 1000

GIVEN, FOUND = "as given", "found"

HEADER = [
    "", "groups", "modules", "symbols", "states", "bound", "cost", "driving (s)", "selection (s)", "activations", "path (units)",
    "planning (s)",
]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")
    groups = parser.add_mutually_exclusive_group(required=True)
    groups.add_argument("--groups", type=count, metavar="M", help="number of groups, the one in which all turn included")
    groups.add_argument(
        "--sweep", action="store_true",
        help="all numbers of groups from the fewest that tell the robots apart to one a robot and one more",
    )
    parser.add_argument(
        "--modules", type=count, metavar="B", help="most PFSM modules of a robot, the groups that it is in (default: any number)"
    )
    parser.add_argument(
        "--objective", default="time", metavar="path|time|WEIGHT",
        help="what codewords are chosen by: the path, summed over robots, the time to drive and to select groups, or both: the "
        "weight of the time, 0 to 1 (default: %(default)s)",
    )
    parser.add_argument(
        "--tasks", nargs="+", metavar="random:N|FILE",
        help="suit, in the mean, so many tasks at random in the same place, or those of scenario files, not the scenario's own",
    )
    parser.add_argument(
        "--time-limit", type=positive, metavar="S",
        help="seconds to try for, by the clock, in a sweep for each number of groups (default: 60, with --max-tries none)",
    )
    parser.add_argument(
        "--max-tries", type=count, metavar="N",
        help="how often the planner may run: the same seed then gives the same codewords, however busy the machine is",
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of the random generator (default: %(default)s)")
    parser.add_argument(
        "--jobs", type=count, default=1, metavar="J",
        help="processes that plan, no more than there are processors; they change nothing but the time (default: %(default)s)",
    )
    parser.add_argument(
        "--output", type=Path, metavar="X", help="scenario file (YAML) to write; of a sweep its picture (.png, .pdf, .svg)"
    )


def run(options: argparse.Namespace) -> int:
    """Look for codewords, write the scenario with the best; the first Ctrl-C ends the search, and what was found counts."""
    output: Path | None = options.output
    drawn = [] if options.tasks is None else [int(found[1]) for found in map(RANDOM.fullmatch, options.tasks) if found]
    sources = [] if options.tasks is None or drawn else options.tasks
    if output is not None:
        files.check_output(output, options.scenario, *sources)
    elif not options.sweep:
        raise StressbotError(ErrorCode.MISSING_FIELD, "--output", "is missing: name the scenario file to write")
    from stressbot_planner import planners
    from stressbot_planner.codesign.measuring import workers
    from stressbot_planner.codesign.tasks import check_task
    from stressbot_planner.codesign.words import fewest_groups
    from stressbot_planner.formats import scenario
    from stressbot_planner.reporting import plotting

    planners.time_weight(options.objective)
    if options.sweep and output is not None and output.suffix[1:] not in plotting.FORMATS:
        formats = ", .".join(plotting.FORMATS)
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--output", f"ends in '{output.suffix}': of a sweep use .{formats}")
    loaded = scenario.load(options.scenario)
    if loaded.electrical.pull_downs:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            "electrical.pull_down",
            "lists a level for each robot: these select the groups, so that codewords cannot be chosen; give one level",
        )
    check_task(loaded.problem)
    n = loaded.swarm.n
    many = range(fewest_groups(n), n + 2) if options.sweep else (options.groups,)
    chances = [_Chance.of(options, loaded, groups) for groups in many]
    tasks = _tasks(options, loaded, drawn, sources)
    jobs = usable_jobs(options.jobs, "plan")
    clock = EndedByCtrlC()
    with clock, _AllocatingLine(options) as line, workers(jobs) as processes:
        found = _search(options, loaded, chances, tasks, clock, processes, line)
    if clock.stopped and all(one.allocation.found is None for one in found):
        raise KeyboardInterrupt
    report = _report(options, loaded, len(tasks), found, clock.stopped)
    if output is not None and any(one.allocation.found is not None for one in found):
        _write(options, loaded, found)
        report.pairs([("written", str(output))])
        report.data["written"] = str(output)
    report.print(options.json)
    failed = next((one for one in found if one.allocation.found is None), None)
    if failed is not None:
        streams.complain("stressbot", failed.why_not())
        return streams.NO_PLAN
    return streams.SOLVED


class _Chance(NamedTuple):
    """A number of groups, the words for it and the electrical interface that selects them."""

    words: "Words"
    electrical: "Electrical"

    @classmethod
    def of(cls, options: argparse.Namespace, loaded: "Scenario", groups: int) -> "_Chance":
        import numpy as np

        from stressbot_planner.codesign.words import Words
        from stressbot_planner.formats import scenario

        most = groups - 1 if options.modules is None else options.modules
        words = Words(loaded.swarm.n, groups - 1, min(most, groups - 1) if options.sweep else most)
        any_words = words.random(np.random.default_rng(0))
        return cls(words, scenario.parse(scenario.with_codewords(options.scenario, any_words)).electrical)


def _tasks(options: argparse.Namespace, loaded: "Scenario", drawn: list[int], sources: list[str]) -> "tuple[Problem, ...]":
    import numpy as np

    from stressbot_planner.codesign import tasks
    from stressbot_planner.formats import scenario

    if options.tasks is None:
        return (loaded.problem,)
    if drawn:
        if len(options.tasks) > 1 or not 1 <= drawn[0] <= MOST_TASKS:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, "--tasks", f"is '{' '.join(options.tasks)}': give random:1 to random:{MOST_TASKS}, or files"
            )
        rng = np.random.default_rng((options.seed, drawn[0]))
        return tuple(tasks.random_task(loaded.problem, rng) for _ in range(drawn[0]))
    return tuple(tasks.task_of(scenario.load(source).problem, loaded.problem, source) for source in sources)


def _search(
    options: argparse.Namespace, loaded: "Scenario", chances: "list[_Chance]", tasks: "tuple[Problem, ...]", clock: EndedByCtrlC,
    processes: "list[Worker]", line: "_AllocatingLine",
) -> "list[_Found]":
    from stressbot_planner.codesign.allocating import allocate
    from stressbot_planner.codesign.measuring import Candidate, Measuring
    from stressbot_planner.codesign.objective import Objective

    own = Objective(options.objective, tasks, loaded.electrical.selection_time)
    given = Candidate.of(loaded.swarm.codewords, own)
    pulse_length = loaded.electrical.pulse_length(loaded.swarm.speed)
    found: list[_Found] = []
    for words, electrical in chances:
        objective = own if words.bits + 1 == loaded.swarm.m else replace(own, selection_time=electrical.selection_time)
        limit = options.time_limit or (TIME_LIMIT if options.max_tries is None else math.inf)
        begin = time.monotonic()
        measuring = Measuring(pulse_length, options.seed, clock, clock() + limit, processes)
        line.begin(words.bits + 1, objective, limit)
        known = [one.allocation.found.codewords for one in found if one.allocation.found is not None]
        allocation = allocate(objective, words, given, measuring, options.seed, options.max_tries, known, line)
        found.append(_Found(words, electrical, allocation, time.monotonic() - begin))
        if clock.stopped:
            break
    return found


class _Found(NamedTuple):
    """What came of a search."""

    words: "Words"
    electrical: "Electrical"
    allocation: "Allocation"
    seconds: float

    def why_not(self) -> str:
        """Return why nothing was found."""
        progress = self.allocation.progress
        if not progress.tried:
            return f"no plan found for {self.words.bits + 1} groups: not one run of the planner ended in time, allow more"
        reasons = (report.reason for run in self.allocation.given.runs for report in run if report.reason)
        why = next(reasons, "as given there is one")
        return f"no plan found for {self.words.bits + 1} groups and any of {progress.tried} allocations; as given: {why}"


def _write(options: argparse.Namespace, loaded: "Scenario", found: list[_Found]) -> None:
    if options.sweep:
        from stressbot_planner.reporting import allocation_curve

        points = [_figures(one.allocation.found, one.electrical) for one in found if one.allocation.found is not None]
        given = _figures(found[0].allocation.given, loaded.electrical)
        figure = allocation_curve.draw(points, given, loaded.name, found[0].allocation.given.objective.unit)
        with files.replacing(options.output) as stream:
            figure.savefig(stream, format=options.output.suffix[1:])
        return
    from stressbot_planner.formats import scenario

    allocation = found[0].allocation
    assert allocation.found is not None
    codewords = loaded.swarm.codewords if allocation.found is allocation.given else allocation.found.codewords
    files.write_text(options.output, scenario.with_codewords(options.scenario, codewords))


def _report(
    options: argparse.Namespace, loaded: "Scenario", tasks: int, found: list[_Found], is_interrupted: bool
) -> CommandReport:
    given = found[0].allocation.given
    objective = given.objective
    report = CommandReport(
        scenario=loaded.name,
        robots=loaded.swarm.n,
        objective=options.objective,
        unit=objective.unit,
        tasks=tasks,
        seed=options.seed,
        interrupted=is_interrupted,
        given=_figures(given, loaded.electrical),
        found=[_data(one) for one in found] if options.sweep else _data(found[0]),
    )
    told = "its own goals" if options.tasks is None else f"the mean over {tasks}: {' '.join(options.tasks)}"
    report.pairs([("scenario", f"{loaded.name}: {loaded.swarm.n} robots, {loaded.swarm.m} groups"), ("tasks", told)])
    for one in found:
        report.pairs(_told(one, objective.unit))
    rows = [_cells(GIVEN, given, loaded.electrical)]
    rows += [_cells(FOUND, one.allocation.found, one.electrical) for one in found if one.allocation.found is not None]
    report.lines("")
    report.table(f"Allocations by their best plans; the cost is in {objective.unit}", HEADER, rows)
    for one in found:
        if (best := one.allocation.found) is not None:
            report.lines("", f"Codewords for {one.words.bits + 1} groups (first bit: G1)", *codeword_lines(best.codewords))
    report.lines("")
    if is_interrupted:
        report.pairs([("result", "ended by Ctrl-C")])
    return report


def _told(one: _Found, unit: str) -> list[Row]:
    """Return what was done for a number of groups, what is proved and what is found."""
    allocation, progress, groups = one.allocation, one.allocation.progress, one.words.bits + 1
    found, given = allocation.found, allocation.given
    work = (
        f"{groups} groups: {progress.tries} runs for {progress.tried} allocations of {one.words.count} words, {progress.screened} "
        f"left out by their bound, {one.seconds:.1f} s"
    )
    proved = f"no allocation to {groups} groups gets below {allocation.bound.proved:.4g} {unit}"
    if found is None:
        return [("search", work), ("proved", proved), ("found", "no plan for any allocation")]
    what = f"{found.value:.4g} {unit}"
    if found is given:
        what += ": no better allocation than the given one"
    elif not math.isfinite(given.value):
        what += "; as given there is no plan"
    elif allocation.saved >= 0:
        what += f", {100 * allocation.saved:.1f} % less than as given"
    else:
        what += f", {-100 * allocation.saved:.1f} % more than as given: allow more time or groups, or keep those"
    return [("search", work), ("proved", f"{proved}, this one not below {found.bound:.4g}"), ("found", what)]


def _cells(name: str, candidate: "Candidate", electrical: "Electrical") -> list[str]:
    data = _figures(candidate, electrical)
    modules = sorted({min(data["modules"]), max(data["modules"])})
    cells = [name, str(data["groups"]), "-".join(map(str, modules)), str(data["symbols"]), str(data["states"])]
    return cells + [f"{data['bound']:.2f}"] + [
        "none" if data[key] is None else f"{data[key]:.{digits}f}"
        for key, digits in (
            ("cost", 2), ("driving_time", 2), ("selection_time", 2), ("activations", 0), ("path_length", 1), ("planning_time", 1)
        )
    ]


def _data(one: _Found) -> dict[str, Any]:
    progress, found = one.allocation.progress, one.allocation.found
    return {
        "proved": one.allocation.bound.proved,
        "tries": progress.tries,
        "tried": progress.tried,
        "left_out": progress.screened,
        "seconds": one.seconds,
        "saved": one.allocation.saved,
        "is_given": found is one.allocation.given,
        "allocation": None if found is None else _figures(found, one.electrical),
    }


def _figures(candidate: "Candidate", electrical: "Electrical") -> dict[str, Any]:
    """Return what an allocation takes and what it costs, the mean over tasks, by the best plan for each."""
    figures = candidate.figures()
    costs: dict[str, Any] = dict.fromkeys(("cost", "driving_time", "selection_time", "activations", "path_length", "planning_time"))
    if figures is not None:
        costs |= figures._asdict() | {"cost": candidate.value}
    return {
        "groups": len(candidate.codewords[0]) + 1,
        "codewords": candidate.codewords,
        "modules": [word.count("1") for word in candidate.codewords],
        "symbols": electrical.symbols,
        "states": electrical.states,
        "epoch_selection_time": electrical.selection_time,
        "bound": candidate.bound,
        "runs": len(candidate.runs),
        **costs,
    }


class _AllocatingLine(LiveLine):
    """Shows the best cost so far, what was tried, seconds left."""

    def __init__(self, options: argparse.Namespace):
        super().__init__()
        self._most = options.max_tries

    def begin(self, groups: int, objective: "Objective", limit: float) -> None:
        """Show from now on what is done for a number of groups, for s."""
        self._groups, self._unit, self._end = groups, objective.unit, time.monotonic() + limit
        self.say(lambda: f"{groups} groups: lower bounds")

    def __call__(self, progress: "SearchProgress") -> None:
        self.say(lambda: self._told(progress))

    def _told(self, progress: "SearchProgress") -> str:
        best = "no plan yet" if math.isinf(progress.best) else f"best {progress.best:.4g} {self._unit}"
        parts = [f"{self._groups} groups", best, f"{progress.tried} allocations", f"{progress.tries} runs"]
        if self._most is not None:
            parts[-1] = f"{progress.tries} of {self._most} runs"
        if math.isfinite(self._end):
            parts.append(f"{max(0.0, self._end - time.monotonic()):.0f} s left")
        return ", ".join(parts) + "; Ctrl-C keeps the best allocation"
