"""`stressbot check`: what a plan would do, without driving it."""

import argparse
from typing import TYPE_CHECKING

from stressbot_planner.cli.arguments import count, not_negative, seed
from stressbot_planner.cli.plan import figures
from stressbot_planner.cli.printing import CommandReport
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import streams

if TYPE_CHECKING:
    import numpy as np

    from stressbot_planner.model.electrical import Electrical
    from stressbot_planner.sequencing import VoltageProgram

LARGEST_ERROR = 0.3
"""Of speeds: three times this still leaves a robot that goes forward."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")
    parser.add_argument("plan", metavar="PLAN.json", help="plan for it")
    parser.add_argument(
        "--speed-error", type=not_negative, default=0.03, metavar="E",
        help="standard deviation of robots' speeds, as a share, for the risk (default: %(default)s)",
    )
    parser.add_argument("--samples", type=count, default=200, metavar="N", help="swarms drawn for it (default: %(default)s)")
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of their random generator (default: %(default)s)")


def run(options: argparse.Namespace) -> int:
    """Check the plan; return 3 if it is not valid."""
    if options.speed_error > LARGEST_ERROR:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--speed-error", f"is {options.speed_error}: give at most {LARGEST_ERROR}")
    import numpy as np

    from stressbot_planner.execution import blind_drive
    from stressbot_planner.formats import scenario
    from stressbot_planner.formats.plan_file import read_plan_file
    from stressbot_planner.sequencing import volts_of

    loaded = scenario.load(options.scenario)
    stored = read_plan_file(options.plan, loaded.problem, loaded.name)
    plan = stored.plan
    report = CommandReport(scenario=loaded.name, planner=stored.planner, seed=stored.seed, valid=plan.valid)
    report.pairs(
        [
            ("scenario", f"{loaded.name}: {loaded.swarm.n} robots, {loaded.swarm.m} groups"),
            ("planner", f"{stored.planner}, seed {stored.seed}"),
            ("result", "valid: no bodies overlap at any time, all robots reach their goals" if plan.valid else "NOT valid"),
        ]
    )
    rows, data = figures(loaded, plan)
    report.pairs(rows)
    report.data |= data
    program = volts_of(plan.problem.swarm, loaded.electrical, plan.problem.starts, plan.groups, plan.lengths)
    lowest, highest = _levels(program)
    driven = _driven(program, loaded.electrical)
    allowed = f"{loaded.electrical.min_level:g} to {loaded.electrical.max_level:g} V"
    report.pairs(
        [
            ("duration", f"{program.duration:.3f} s in {program.epoch_count} epochs"),
            ("volts", f"{lowest:g} to {highest:g} V; allowed are {allowed}"),
            ("driven", f"{100 * driven:.1f} % of the time"),
        ]
    )
    report.data |= {
        "duration": program.duration, "epochs": program.epoch_count, "lowest_level": lowest, "highest_level": highest,
        "driven_share": driven,
    }
    risk = blind_drive.risk(plan, options.speed_error, options.samples, options.seed)
    usual, most = np.quantile(risk.goal_errors, [0.5, 0.95])
    report.pairs(
        [
            (
                "risk",
                f"driven blindly, speeds wrong by {100 * options.speed_error:g} %: {risk.collisions} of {options.samples} swarms "
                f"collide; the worst robot ends {usual:.3g} units from its goal, in one of twenty {most:.3g} or more",
            )
        ]
    )
    report.data["risk"] = {
        "speed_error": options.speed_error, "samples": options.samples, "seed": options.seed, "collisions": risk.collisions,
        "min_clearances": risk.gaps, "goal_errors": risk.goal_errors,
    }
    report.print(options.json)
    if not plan.valid:
        why = f"clearance {plan.clearance}, goal error {plan.goal_error:.3g} units, heading error {plan.heading_error:.3g} rad"
        streams.complain("stressbot", f"{options.plan} is not valid: {why}")
        return streams.NO_PLAN
    return streams.SOLVED


def _levels(program: "VoltageProgram") -> tuple[float, float]:
    levels: np.ndarray = program.levels
    highest = float(levels.max(initial=0.0))
    lowest = float(levels.min(initial=0.0))
    return (min(lowest, -highest), highest) if program.alternating else (lowest, highest)


def _driven(program: "VoltageProgram", electrical: "Electrical") -> float:
    """Return the share of the time in which robots are driven, 0..1."""
    if not program.epoch_count:
        return 0.0
    return 1.0 - program.epoch_count * electrical.selection_time / program.duration
