"""`stressbot reproduce`: the paper's tables and figures, with our numbers beside the paper's.

`production.produce` runs on whatever backend `joblib.parallel_config` has set up around it; `run` sets up the cores of
this machine.
"""

import argparse
import json
import sys
from contextlib import redirect_stdout
from pathlib import Path

from stressbot_planner.system import files

DEFAULT_OUTPUT = Path("results/reproduce")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument("--full", action="store_true", help="more seeds and larger limits: half an hour")
    parser.add_argument(
        "--output", type=Path, default=DEFAULT_OUTPUT, metavar="FOLDER", help="for the results (default: %(default)s)"
    )
    parser.add_argument("--jobs", type=_jobs, default=2, metavar="N", help="runs side by side (default: %(default)s)")


def _jobs(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text[:9]) <= 1024:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 1 to 1024")
    return int(text)


def run(options: argparse.Namespace) -> int:
    """Reproduce on this machine, one thread of linear algebra a run; return 0.

    Raises:
        StressbotError: the output folder cannot be written.
    """
    from joblib import parallel_config

    from stressbot_planner.reproduce.production import produce

    files.make_folder(options.output)
    said = redirect_stdout(sys.stderr if options.json else sys.stdout)
    with parallel_config("loky", n_jobs=options.jobs, inner_max_num_threads=1), said:
        produce(options.output, options.full)
    if options.json:
        sys.stdout.write(json.dumps({"success": True, "written": str(options.output)}) + "\n")
    return 0
