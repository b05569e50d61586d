"""`make fuzz`: the whole campaign. The last line counts; the exit code is 1 if there was a violation."""

import argparse
import json
import random
import sys
import warnings
from pathlib import Path

from hypothesis.errors import HypothesisWarning

from fuzzing import ROOT, files, generated, guided, instruments, loops, nodes, orders, pictures, settings, volts
from fuzzing.generated import Tally
from stressbot_planner.reproduce.tables import Table

MODULES = files, orders, volts, instruments, settings, pictures, loops
INTERFACES = tuple(interface for module in MODULES for interface in module.INTERFACES)


def table(tallies: list[Tally], number: int) -> Table:
    """Return what came of it."""
    rows = []
    for tally in tallies:
        shown = ", ".join(f"{name} {count}" for name, count in tally.outcomes.most_common(4))
        rows.append((tally.name, tally.how, str(tally.inputs), shown, str(len(tally.violations)), f"{tally.seconds:.0f}"))
    header = ("interface", "by", "inputs", "most frequent outcomes", "violations", "processor s")
    return Table(f"Hostile input, seed {number}", header, tuple(rows))


def main() -> int:
    """Run the campaign and return the exit code."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=60_000, help="generated in this process (%(default)s)")
    parser.add_argument("--guided", type=int, default=100_000, help="guided by coverage (%(default)s)")
    parser.add_argument("--messages", type=int, default=3000, help="over DDS at running nodes (%(default)s)")
    parser.add_argument("--loops", type=int, default=50, help="whole motions in closed loop over DDS (%(default)s)")
    parser.add_argument("--seed", type=int, default=None, help="of all that is generated (drawn)")
    parser.add_argument("--output", type=Path, default=ROOT / "results", help="folder of fuzz.md and fuzz.json (%(default)s)")
    parser.add_argument("only", nargs="?", default="", help="part of the name of the interfaces to try (all)")
    options = parser.parse_args()
    number = random.randrange(10**6) if options.seed is None else options.seed
    warnings.simplefilter("ignore", HypothesisWarning)
    tallies: list[Tally] = []

    def tell(tally: Tally) -> None:
        tallies.append(tally)
        print(f"{tally.name} ({tally.how}): {tally.inputs} inputs, {len(tally.violations)} violations", flush=True)
        for violation in tally.violations:
            print(f"  VIOLATION {violation}", flush=True)

    chosen = [interface for interface in INTERFACES if options.only in interface.name]
    whole = sum(interface.weight for interface in chosen)
    for interface in chosen:
        tell(generated.campaign(interface, round(options.inputs * interface.weight / whole), number))
    for tally in guided.campaign(options.guided, number, options.only):
        tell(tally)
    if options.messages:
        for tally in nodes.campaign(options.messages, number, options.only):
            tell(tally)
    for tally in loops.campaign(options.loops, number, options.only):
        tell(tally)

    options.output.mkdir(parents=True, exist_ok=True)
    report = table(tallies, number)
    (options.output / "fuzz.md").write_text(report.markdown() + "\n")
    (options.output / "fuzz.json").write_text(json.dumps([vars(tally) for tally in tallies], indent=1) + "\n")
    print(report.markdown())
    violations = sum(len(tally.violations) for tally in tallies)
    inputs, places = sum(tally.inputs for tally in tallies), len({tally.name for tally in tallies})
    print(f"fuzz: {inputs} inputs over {places} interfaces, {violations} violations (seed {number})")
    return int(violations > 0)


if __name__ == "__main__":
    sys.exit(main())
