"""`stressbot plan`: find a plan for a scenario."""

import argparse
import sys
import time
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stressbot_planner.cli.arguments import count, not_negative, order, positive, seed, usable_jobs
from stressbot_planner.cli.printing import CommandReport, Row, ranges, ratio
from stressbot_planner.system import files, streams

if TYPE_CHECKING:
    from stressbot_planner.formats.scenario import Scenario
    from stressbot_planner.problem.definition import Problem
    from stressbot_planner.problem.plan import Plan, Result

STANDARD_OUTPUT = "-"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")
    parser.add_argument("--planner", default="optimize", metavar="NAME", help="name of the planner (default: %(default)s)")
    parser.add_argument(
        "--objective", default="path", metavar="path|time|WEIGHT",
        help="make the path, summed over robots, or the time to drive and to select groups short, or both: the weight of the "
        "time, 0 to 1 (default: %(default)s)",
    )
    parser.add_argument(
        "--tolerance", type=positive, metavar="T", help="goal radius in scenario units (default: 1e-6, which is exact)"
    )
    parser.add_argument(
        "--order", type=order, metavar="R",
        help="of the Lie brackets whose subgroups are moved, 1 to the number of groups - 1, for planners that use subgroups",
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of the random generator (default: %(default)s)")
    parser.add_argument(
        "--time-limit", type=positive, metavar="S",
        help="seconds to try for, by the clock (default: 10, with --max-tries none)",
    )
    parser.add_argument(
        "--max-tries", type=count, metavar="N",
        help="how often to try: the same seed then gives the same plan, however busy the machine is",
    )
    parser.add_argument("--first", action="store_true", help="stop at the first plan")
    parser.add_argument(
        "--min-clearance", type=not_negative, default=0.0, metavar="C",
        help="gap that all bodies keep, in scenario units; optimize plans for it, what others find is refused if it has less",
    )
    parser.add_argument("--max-epochs", type=count, metavar="N", help="most activations that the plan may have; as --min-clearance")
    parser.add_argument(
        "--jobs", type=count, default=1, metavar="J",
        help="processes that search side by side, no more than there are processors (default: %(default)s)",
    )
    parser.add_argument("--output", type=Path, metavar="PLAN.json", help="write the plan to this file; -: to standard output")


def run(options: argparse.Namespace) -> int:
    """Plan, write the plan, say what it costs; the first Ctrl-C ends the search, and what was found counts."""
    output: Path | None = options.output
    file = None if output is None or str(output) == STANDARD_OUTPUT else output
    if file is not None:
        files.check_output(file, options.scenario)
    import numpy as np

    from stressbot_planner import planners
    from stressbot_planner.cli.live_line import PlanningLine
    from stressbot_planner.formats import scenario
    from stressbot_planner.formats.plan_file import plan_file, plan_text
    from stressbot_planner.planners import assignment
    from stressbot_planner.problem.definition import EXACT
    from stressbot_planner.system.interrupts import EndedByCtrlC

    planners.get(options.planner)
    planners.time_weight(options.objective)
    loaded = scenario.load(options.scenario, options.tolerance or EXACT)
    problems = [loaded.problem]  # the last one is that whose goals are assigned
    moving = np.delete(np.arange(loaded.swarm.n), list(loaded.problem.parked))

    def tell(progress: planners.Progress) -> None:
        line(progress)

    def assign(problem: "Problem") -> "Problem":
        assigned, goals = assignment.assigned(problem, options.objective), loaded.problem.goals.copy()
        goals[moving] = assigned.goals
        problems.append(replace(loaded.problem, goals=goals))
        return assigned

    clock = EndedByCtrlC()
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
        clock=clock,
        on_progress=tell,
    )
    usable_jobs(options.jobs, "search")
    line = PlanningLine(settings, lambda: problems[-1].lower_bounds)
    begin = time.monotonic()
    with clock, line:
        result = planners.solve(loaded.problem, options.planner, settings, assign)
    if clock.stopped:  # its own time is far ahead
        result = replace(result, planning_time=time.monotonic() - begin)
    if not result.success and clock.stopped:
        raise KeyboardInterrupt
    if output is not None:
        text = plan_text(plan_file(result, loaded.name, loaded.electrical.selection_time))
        if file is not None:
            files.write_text(file, text)
        else:
            sys.stdout.write(text)
    report = _report(loaded, result, clock.stopped)
    if file is not None:
        report.pairs([("written", str(file))])
        report.data["written"] = str(file)
    with redirect_stdout(sys.stdout if file is not None or output is None else sys.stderr):
        report.print(options.json)
    if not result.success:
        streams.complain("stressbot", f"no plan found: {result.reason}")
        return streams.NO_PLAN
    return streams.SOLVED


def _report(loaded: "Scenario", result: "Result", is_interrupted: bool) -> CommandReport:
    swarm, plan = loaded.swarm, result.plan
    report = CommandReport(
        scenario=loaded.name,
        robots=swarm.n,
        groups=swarm.m,
        planner=result.planner,
        seed=result.seed,
        planning_time=result.planning_time,
        success=result.success,
        interrupted=is_interrupted,
        error=None if result.success else result.code.name,
        reason=result.reason,
    )
    outcome = "solved" if result.success else "no plan found" + (", this is the closest attempt" if plan else "")
    if is_interrupted:
        outcome += ", ended by Ctrl-C"
    report.pairs(
        [
            ("scenario", f"{loaded.name}: {swarm.n} robots, {swarm.m} groups"),
            ("planner", f"{result.planner}, seed {result.seed}, {result.planning_time:.3f} s"),
            ("result", outcome),
        ]
    )
    if plan is not None:
        rows, data = figures(loaded, plan)
        report.pairs(rows)
        report.data |= data
    return report


def figures(loaded: "Scenario", plan: "Plan") -> tuple[list[Row], dict[str, Any]]:
    """Return what a plan costs, for people and for programs."""
    bounds = plan.problem.lower_bounds
    with_turns = plan.problem.turning_time
    selection = len(plan.groups) * loaded.electrical.selection_time
    step = loaded.electrical.pulse_length(loaded.swarm.speed)
    pulses = None if step is None else round(float(plan.lengths.sum()) / step)
    rows = [
        *assigned_goals(plan.problem),
        ("activations", f"{len(plan.groups)} from {len(plan.primitives)} primitives"),
        ("path length", f"{plan.path_length:.2f} units, {ratio(plan.path_length, bounds.path_length)}"),
        (
            "execution",
            f"{plan.execution_time:.2f} s driving, {ratio(plan.execution_time, bounds.execution_time)} "
            f"({with_turns:.2f} with turns); "
            f"{selection:.2f} s to select groups",
        ),
        *([] if step is None else [("pulses", f"{pulses}, {step:.4g} units each")]),
        ("min clearance", str(plan.clearance)),
        *([("other gaps", str(plan.clearance_of_others))] if plan.problem.contacts else []),
        ("goal error", f"{plan.goal_error:.3g} units (tolerance {plan.problem.tolerance:g})"),
        *_heading_row(plan),
        *_waypoint_rows(plan),
    ]
    data = {
        "activations": len(plan.groups),
        "primitives": len(plan.primitives),
        "path_length": plan.path_length,
        "path_length_bound": bounds.path_length,
        "driving_time": plan.execution_time,
        "driving_time_bound": bounds.execution_time,
        "driving_time_bound_with_turns": with_turns,
        "selection_time": selection,
        "pulses": pulses,
        "min_clearance": plan.clearance.gap,
        "min_clearance_at": str(plan.clearance),
        "goal_error": plan.goal_error,
        "tolerance": plan.problem.tolerance,
    }
    if plan.problem.contacts:
        data["min_clearance_of_others"] = plan.clearance_of_others.gap
    if len(plan.problem.headed):
        data |= {"heading_error": plan.heading_error, "heading_tolerance": plan.problem.heading_tolerance}
    if arrivals := plan.arrivals:
        data["waypoints"] = [arrival._asdict() for arrival in arrivals]
    return rows, data


def _waypoint_rows(plan: "Plan") -> list[Row]:
    return [
        (
            f"waypoint {stage}",
            f"after {one.activations} activations, {one.time:.2f} s driving: "
            + (f"{one.error:.3g} units away" if one.is_there else f"MISSED by {one.error:.3g} units"),
        )
        for stage, one in enumerate(plan.arrivals, 1)
    ]


def _heading_row(plan: "Plan") -> list[Row]:
    headed = (plan.problem.headed + 1).tolist()
    named = f"{plan.heading_error:.3g} rad, robots {ranges(headed)} (tolerance {plan.problem.heading_tolerance:.3g})"
    return [("heading error", named)] if headed else []


def assigned_goals(problem: "Problem") -> list[Row]:
    """Return the row that says which robots may take each other's goals, if any."""
    free = [row + 1 for row in problem.exchangeable]
    return [("goals", f"{len(free)} assigned among robots {ranges(free)}")] if free else []
