"""`stressbot show`: describe a scenario: groups, codewords, PFSM codes, bounds."""

import argparse
from typing import TYPE_CHECKING

from stressbot_planner.cli.plan import assigned_goals
from stressbot_planner.cli.printing import CommandReport, codeword_lines, ranges
from stressbot_planner.system import streams

if TYPE_CHECKING:
    from stressbot_planner.formats.scenario import Scenario
    from stressbot_planner.model.electrical import Electrical

WIDEST_TABLE = 20
"""Up to as many robots get a column each in the table of groups."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file (YAML)")


def run(options: argparse.Namespace) -> int:
    """Describe the scenario."""
    from stressbot_planner.formats import scenario
    from stressbot_planner.planners.assignment import assigned

    loaded = scenario.load(options.scenario)
    swarm, electrical = loaded.swarm, loaded.electrical
    path_bound = assigned(loaded.problem, "path").lower_bounds.path_length
    timed = assigned(loaded.problem, "time")
    time_bound, with_turns = timed.lower_bounds.execution_time, timed.turning_time
    environment = loaded.problem.environment
    radii = sorted(set(swarm.turning_radius.tolist()))
    turning = f"{radii[0]:g} for every robot: the primitives h_i, g_i and Rot exist"
    if not swarm.alike:
        turning = f"{radii[0]:g} to {radii[-1]:g}: f_i for all; h_i, g_i and Rot for those of one radius ÷ speed at a time"
    slowest = float(swarm.pace.min() * swarm.speed)
    bodies = " to ".join(f"{radius:g}" for radius in sorted({swarm.body_radius.min(), swarm.body_radius.max()}))
    walls = environment.workspace
    members = [[k for k in range(1, swarm.n + 1) if row[k - 1]] for row in swarm.membership]
    volts = [[electrical.symbol_levels[symbol] for symbol in code] for code in electrical.codes]
    report = CommandReport(
        scenario=loaded.name,
        robots=swarm.n,
        length_unit=loaded.length_unit,
        speed=swarm.speed * swarm.pace,
        turning_radius=swarm.turning_radius,
        body_radius=swarm.body_radius,
        workspace=None if walls is None else [walls.x_min, walls.x_max, walls.y_min, walls.y_max],
        obstacles=len(environment.obstacles),
        path_length_bound=path_bound,
        driving_time_bound=time_bound,
        driving_time_bound_with_turns=with_turns,
        selection_time=electrical.selection_time,
        groups=[
            {"members": who, "code": code, "volts": levels}
            for who, code, levels in zip(members, electrical.codes, volts, strict=True)
        ],
        codewords=swarm.codewords,
    )
    report.pairs(
        [
            ("scenario", f"{loaded.name}: {swarm.n} robots, {swarm.m} groups, 1 unit is {loaded.length_unit:g} m"),
            ("speed", f"{swarm.speed:g} units/s" if swarm.equal_speeds else f"{slowest:g} to {swarm.speed:g} units/s"),
            ("turning radius", turning),
            ("body radius", bodies if swarm.body_radius.all() else f"{bodies} (0: points, which pass each other)"),
            ("workspace", f"x {walls.x_min:g} to {walls.x_max:g}, y {walls.y_min:g} to {walls.y_max:g}" if walls else "open plane"),
            ("obstacles", str(len(environment.obstacles))),
            *assigned_goals(loaded.problem),
            ("lower bounds", f"path {path_bound:.2f} units, driving time {time_bound:.2f} s ({with_turns:.2f} s with turns)"),
            ("selection time", f"{electrical.selection_time:g} s for each activation ({_selection(electrical)})"),
            ("drive", _drive(loaded)),
        ]
    )
    wide = swarm.n <= WIDEST_TABLE
    header = ["Group", *([f"R{k}" for k in range(1, swarm.n + 1)] if wide else ["members"]), "size", "code", "volts"]
    rows = []
    for i, (row, code) in enumerate(zip(swarm.membership, electrical.codes, strict=True)):
        cells = [str(int(bit)) for bit in row] if wide else [ranges(members[i])]
        rows.append([f"G{i + 1}", *cells, str(len(members[i])), " ".join(map(str, code)), " ".join(f"{v:g}" for v in volts[i])])
    report.lines("")
    report.table("Groups (the last one: all rotate)", header, rows)
    report.lines("", "Codewords (first bit: G1)", *codeword_lines(swarm.codewords))
    report.print(options.json)
    return streams.SOLVED


def _selection(electrical: "Electrical") -> str:
    if electrical.pull_downs:
        low, high = min(electrical.pull_downs), max(electrical.pull_downs)
        return f"one level: arms come down at {low:g} to {high:g} V"
    return f"{len(electrical.codes[0])} symbols"


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
