"""`make bench`: the paper reproduced, its plans replayed by the simulated robots, pulses, speed of the parts, the running driver.

Prints every table and writes them to results/bench/ as Markdown, JSON and PNG. See docs/benchmarks.md.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stressbot_planner import reproduce
from stressbot_planner.system import threads

if TYPE_CHECKING:
    from stressbot_planner.reproduce.tables import Table

ROOT = Path(__file__).resolve().parents[1]
DEFAULT_OUTPUT = ROOT / "results/bench"
SUPPORT = ROOT / "ros2_ws/src/stressbot_driver/test/support"
"""How the driver's tests encode and play, and talk to a node: benchmarks do so in the same way."""



@dataclass(frozen=True)
class Part:
    """Something to measure: it gives tables, and pictures in its own folder or none. `joblib.Parallel` has its processes set up."""

    description: str
    tables: Callable[[argparse.Namespace], list["Table"]]


def reproduced(options: argparse.Namespace) -> list["Table"]:
    """Run `stressbot reproduce`, which shows its own tables; return which targets are met."""
    import targets

    arguments = ["--output", str(options.output / "reproduce"), "--jobs", str(options.jobs)] + ["--full"] * options.full
    parser = argparse.ArgumentParser()
    reproduce.add_arguments(parser)
    reproduce.run(parser.parse_args(arguments))
    return targets.tables(options.output / "reproduce/report.json")


def witnessed(options: argparse.Namespace) -> list["Table"]:
    """Replay all plans that `reproduced` has left."""
    import witness

    folder = options.output / "reproduce"
    if not (folder / "report.json").is_file():
        sys.exit(f"bench: {folder} holds no report: run the part 'reproduce' first")
    return witness.tables(folder)


def pulsed(options: argparse.Namespace) -> list["Table"]:
    """Drive plans of whole pulses."""
    import pulses

    return pulses.tables(options.full)


def timed(options: argparse.Namespace) -> list["Table"]:
    """Measure the speed of the parts."""
    import speed

    return speed.tables(options.output)


def driven(options: argparse.Namespace) -> list["Table"]:
    """Measure the running driver."""
    import driver_node

    return driver_node.tables()


def assigned(options: argparse.Namespace) -> list["Table"]:
    """Compare ways to assign goals among interchangeable robots."""
    import assignment

    return assignment.tables(10 if options.full else 2)


def allocated(options: argparse.Namespace) -> list["Table"]:
    """Choose codewords for tasks, and see what they save."""
    import allocation

    return allocation.tables(options.full)


def rivalled(options: argparse.Namespace) -> list["Table"]:
    """Put ways to tell robots apart beside each other."""
    import rivals

    return rivals.tables(options.full, options.output / "rivals")


def optimized(options: argparse.Namespace) -> list["Table"]:
    """Measure how soon the default planner has a plan, and how good it becomes."""
    import optimizer

    return optimizer.tables(options.full)


def compared(options: argparse.Namespace) -> list["Table"]:
    """Put the default planner beside the others, and beside IPOPT and OMPL where they are installed."""
    import comparison
    import comparison_cluster

    seeds = 10 if options.full else 3
    return comparison.tables(seeds, options.output / "comparison") + comparison_cluster.tables(seeds)


def calibrated(options: argparse.Namespace) -> list["Table"]:
    """Measure how well imperfect robots are identified."""
    import calibration

    return calibration.tables()


def seen(options: argparse.Namespace) -> list["Table"]:
    """Drive imperfect robots by what a camera shows."""
    import camera_loop

    return camera_loop.tables(options.full)


def moved(options: argparse.Namespace) -> list["Table"]:
    """Measure whether imperfect robots reach their goals."""
    import closed_loop

    return closed_loop.tables(options.full)


def succeeded(options: argparse.Namespace) -> list["Table"]:
    """Run the benchmark of the learned switcher that came after the paper."""
    import successor

    return successor.tables(options.full, options.output / "successor")


PARTS = {
    "reproduce": Part("the paper's tables and figures", reproduced),
    "witness": Part("its plans, through volts, on the simulated substrate", witnessed),
    "pulses": Part("plans of whole pulses, from volts", pulsed),
    "speed": Part("speed of the parts, side by side", timed),
    "assignment": Part("goals that any robot may take", assigned),
    "allocation": Part("codewords chosen for a task", allocated),
    "rivals": Part("ways to tell robots apart under one signal", rivalled),
    "optimizer": Part("the default planner, on growing problems", optimized),
    "comparison": Part("the default planner beside the others, IPOPT and OMPL; on two processes", compared),
    "calibration": Part("imperfect robots identified from their poses", calibrated),
    "closed_loop": Part("imperfect robots at their goals, in closed and in open loop", moved),
    "successor": Part("the benchmark of a learned switcher: our closed loop beside best-first searches", succeeded),
    "camera_loop": Part("the same in closed loop through pictures of a simulated microscope", seen),
    "driver": Part("the running driver node: timing and stop", driven),
}


def main() -> int:
    """Run all parts, or those asked for; return 1 if plans and simulated robots disagree."""
    sys.path.append(str(SUPPORT))
    threads.limit()  # before numpy is imported, which joblib does
    from joblib import parallel_config

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = "; ".join(f"{name}: {part.description}" for name, part in PARTS.items())
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"what to run (default: all). {parts}")
    parser.add_argument("--full", action="store_true", help="reproduce with more seeds and larger limits")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="runs side by side (default: %(default)s)")
    parser.add_argument(
        "--output", type=Path, default=DEFAULT_OUTPUT, metavar="FOLDER", help="for the results (default: results/bench)"
    )
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"no part {', '.join(unknown)}: use {', '.join(PARTS)}")
    options.output.mkdir(parents=True, exist_ok=True)
    wrong = []
    for name in options.parts or PARTS:
        print(f"\n## {PARTS[name].description}", flush=True)
        with parallel_config("loky", n_jobs=options.jobs, inner_max_num_threads=1):
            found = PARTS[name].tables(options)
        text = "\n".join(table.markdown() for table in found)
        print("\n" + text, flush=True)
        (options.output / f"{name}.md").write_text(text, encoding="utf-8")
        (options.output / f"{name}.json").write_text(json.dumps([vars(table) for table in found], indent=1), encoding="utf-8")
        wrong += [row for table in found for row in table.rows if "DIFFERS" in row]
    print(f"results are in {options.output}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
