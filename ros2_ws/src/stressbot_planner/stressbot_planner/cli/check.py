"""`stressbot check`: what a plan would do, without driving it."""

import argparse
from typing import TYPE_CHECKING

from stressbot_planner.cli.arguments import count, not_negative, positive, seed
from stressbot_planner.cli.plan import figures
from stressbot_planner.cli.printing import CommandReport
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import streams

if TYPE_CHECKING:
    import numpy as np

    from stressbot_planner.execution.blind_drive import Noise
    from stressbot_planner.model.electrical import Electrical
    from stressbot_planner.problem.plan import Plan
    from stressbot_planner.sequencing import VoltageProgram

LARGEST_ERROR = 0.3
"""Of speeds and radii: three times this still leaves a robot that goes forward."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")
    parser.add_argument("plan", metavar="PLAN.json", help="plan for it")
    parser.add_argument(
        "--speed-error", type=not_negative, default=0.03, metavar="E",
        help="standard deviation of robots' speeds, as a share, for the risk (default: %(default)s)",
    )
    parser.add_argument(
        "--radius-error", type=not_negative, default=0.0, metavar="E", help="the same of their turning radii (default: %(default)s)"
    )
    parser.add_argument(
        "--heading-bias", type=not_negative, default=0.0, metavar="B",
        help="standard deviation of the angle between heading and slide, rad (default: %(default)s)",
    )
    parser.add_argument(
        "--heading-noise", type=not_negative, default=0.0, metavar="B",
        help="standard deviation of the jump of a heading as each activation begins, rad (default: %(default)s)",
    )
    parser.add_argument(
        "--tolerance", type=positive, metavar="T", help="goal radius for the risk, in scenario units (default: that of the plan)"
    )
    parser.add_argument(
        "--max-risk", type=not_negative, metavar="P",
        help="largest probability, to first order, of a collision, and of a robot that ends outside its goal",
    )
    parser.add_argument("--samples", type=count, default=200, metavar="N", help="swarms drawn for it (default: %(default)s)")
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of their random generator (default: %(default)s)")


def run(options: argparse.Namespace) -> int:
    """Check the plan; return 3 if it is not valid, or more of a risk than allowed."""
    for name in ("speed_error", "radius_error"):
        if (value := getattr(options, name)) > LARGEST_ERROR:
            option = "--" + name.replace("_", "-")
            raise StressbotError(ErrorCode.OUT_OF_RANGE, option, f"is {value}: give at most {LARGEST_ERROR}")
    if options.max_risk is not None and options.max_risk > 1:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--max-risk", f"is {options.max_risk}: give a probability, 0 to 1")
    import numpy as np

    from stressbot_planner.execution import blind_drive
    from stressbot_planner.execution.first_order_risk import first_order_risk
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
            ("result", _verdict(plan)),
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
    noise = blind_drive.Noise(options.speed_error, options.radius_error, options.heading_bias, options.heading_noise)
    tolerance = options.tolerance or plan.problem.tolerance
    expected = first_order_risk(plan, noise, tolerance)
    risk = blind_drive.risk(plan, noise, options.samples, options.seed)
    usual, most = np.quantile(risk.goal_errors, [0.5, 0.95])
    report.pairs(
        [
            (
                "risk",
                f"driven blindly, {_words(noise)}: {risk.collisions} of {options.samples} swarms "
                f"collide; the worst robot ends {usual:.3g} units from its goal, in one of twenty {most:.3g} or more",
            ),
            (
                "to first order",
                f"a collision with probability {expected.collides:.3g}, a robot further than {tolerance:g} units from its goal "
                f"with {expected.misses:.3g}",
            ),
        ]
    )
    report.data["risk"] = {
        "speed_error": options.speed_error, "samples": options.samples, "seed": options.seed, "collisions": risk.collisions,
        "min_clearances": risk.gaps, "goal_errors": risk.goal_errors, "radius_error": noise.radius_error,
        "heading_bias": noise.heading_bias, "heading_noise": noise.heading_noise, "tolerance": tolerance,
        "collides": expected.collides, "misses": expected.misses, "outside": expected.outside,
        "covariances": expected.covariances,
    }
    report.print(options.json)
    if not plan.valid:
        streams.complain("stressbot", f"{options.plan} is not valid: {plan.account}")
        return streams.NO_PLAN
    if options.max_risk is not None and max(expected.collides, expected.misses) > options.max_risk:
        streams.complain(
            "stressbot",
            f"{options.plan} is more of a risk than {options.max_risk:g}: a collision has probability {expected.collides:.3g}, "
            f"a robot outside its goal {expected.misses:.3g}",
        )
        return streams.NO_PLAN
    return streams.SOLVED


def _verdict(plan: "Plan") -> str:
    if not plan.valid:
        return "NOT valid"
    depth = plan.problem.contact_depth if plan.problem.contacts else 0.0
    others = f" but contacts by up to {depth:.4g} units" if depth else ""
    return f"valid: no bodies overlap at any time{others}, all robots reach their goals"


def _words(noise: "Noise") -> str:
    parts = [f"speeds wrong by {100 * noise.speed_error:g} %"]
    if noise.radius_error:
        parts.append(f"turning radii by {100 * noise.radius_error:g} %")
    if noise.heading_bias:
        parts.append(f"directions by {noise.heading_bias:g} rad")
    if noise.heading_noise:
        parts.append(f"headings by {noise.heading_noise:g} rad in each activation")
    return ", ".join(parts)


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
