"""`stressbot demo` and `run`: the whole system as real processes, asked from outside, watched to the end and judged."""

import argparse
import os
import signal
import sys
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from stressbot_msgs.domains import reserved

from stressbot_planner import planners
from stressbot_planner.cli.printing import print_json
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.model.swarm import check_positive
from stressbot_planner.problem.definition import EXACT
from stressbot_planner.reporting import demo_report
from stressbot_planner.reporting.demo_report import Executed, Verdict
from stressbot_planner.ros.bringup import NODES, command, share
from stressbot_planner.ros.child_processes import ChildProcesses
from stressbot_planner.ros.client import ALL_POSES, command_client
from stressbot_planner.ros.performance import Failure, Job, NoPlan, ProgressDisplay, perform
from stressbot_planner.system import files
from stressbot_planner.system.interrupts import handled

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

DEFAULT_SCENARIO = "paper-six.yaml"
PATIENCE = 2.0
"""s"""

FAILED, NO_PLAN, INTERRUPTED = 1, 3, 130


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the arguments of `demo`, or of `run`, which is the same for a scenario that has to be named."""
    if command == "demo":
        parser.add_argument(
            "scenario", metavar="SCENARIO", nargs="?", type=Path, help=f"scenario file (default: {DEFAULT_SCENARIO})"
        )
    else:
        parser.add_argument("scenario", metavar="SCENARIO", type=Path, help="scenario file (YAML)")
    parser.add_argument("--planner", default="optimize", metavar="NAME", help="name of the planner (default: %(default)s)")
    parser.add_argument(
        "--objective", default="path", metavar="path|time|WEIGHT",
        help="make the path, summed over robots, or the driving time short (default: %(default)s)",
    )
    parser.add_argument(
        "--tolerance", type=float, default=EXACT, metavar="T", help="goal radius in scenario units (default: %(default)g)"
    )
    parser.add_argument(
        "--order", type=int, metavar="R", help="of the Lie brackets whose subgroups a planner moves (default: the planner's)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the random generator (default: %(default)s)")
    parser.add_argument(
        "--time-limit", type=float, metavar="S", help="seconds to plan for, by the clock (default: 10, with --max-tries none)"
    )
    parser.add_argument("--max-tries", type=int, metavar="N", help="how often to try, as the planner counts (default: any number)")
    parser.add_argument(
        "--real-time-factor", type=float, default=0.0, metavar="F",
        help="substrate seconds per second; 1: as on a real substrate, 0: as fast as possible (default: %(default)g)",
    )
    parser.add_argument(
        "--output", type=Path, default=Path(f"results/{command}"), metavar="FOLDER", help="for the results (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Run it; return 0 if every robot is at its goal, as predicted, and every node ended well.

    Raises:
        StressbotError: an argument or the scenario file is refused.
    """
    with redirect_stdout(sys.stderr if args.json else sys.stdout):
        code, data = _run(args)
    if args.json:
        print_json(data)
    return code


def _run(args: argparse.Namespace) -> tuple[int, dict[str, Any]]:
    path = args.scenario or share("scenarios", DEFAULT_SCENARIO)
    _check(args)
    loaded = scenario.load(path, args.tolerance)
    order = Job(args.planner, args.objective, args.tolerance, args.seed, args.order, args.time_limit, args.max_tries)
    logs = _make_folders(args.output)
    for name in demo_report.RESULTS:
        files.check_output(args.output / name, path)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_LOG_DIR", str(logs / "ros"))
    processes = ChildProcesses(logs)
    show = DemoDisplay()
    try:
        # SIGTERM and a closed terminal end the demo as Ctrl-C does, with everything cleaned up
        with handled((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), _interrupt), ExitStack() as stack:
            stack.enter_context(reserved(os.environ))
            stack.enter_context(show)
            stack.enter_context(processes)
            show.step(f"{loaded.name}: {loaded.swarm.n} robots; starting the nodes")
            for entry in NODES:
                if not entry.options:
                    processes.start(entry.executable, command(entry, _parameters(entry.executable, path, args)))
            client = stack.enter_context(command_client("stressbot_demo", poses_depth=ALL_POSES))
            executed = perform(client, processes, loaded, order, show)
        verdict = demo_report.judge(executed, processes.exit_codes)
        demo_report.write(args.output, executed, verdict)
    except KeyboardInterrupt:
        print(f"{args.command}: interrupted", file=sys.stderr)
        return INTERRUPTED, {"success": False, "reason": "interrupted"}
    except NoPlan as error:
        print(f"{args.command}: no plan: {error}")
        return NO_PLAN, {"success": False, "reason": f"no plan: {error}"}
    except (Failure, TimeoutError) as error:
        _show_logs(processes)
        print(f"{args.command}: failed: {error}")
        return FAILED, {"success": False, "reason": str(error)}
    if not verdict.success:
        _show_logs(processes)
    print(f"results are in {args.output}")
    print(f"{args.command}: {_last_line(executed, verdict)}")
    data = demo_report.summary(executed, verdict) | {"results": str(args.output)}
    return 0 if verdict.success else FAILED, data


def _check(args: argparse.Namespace) -> None:
    planners.get(args.planner)
    planners.time_weight(args.objective)
    if args.max_tries is not None and not 1 <= args.max_tries < 2**32:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "--max-tries", f"is {args.max_tries}: give a whole number from 1 to 4294967295"
        )
    if args.time_limit is None:
        args.time_limit = min(planners.Settings(max_tries=args.max_tries).time_limit, planners.LONGEST_REQUEST)
    for name in ("tolerance", "time_limit"):
        check_positive(f"--{name.replace('_', '-')}", getattr(args, name))
    if not 0 <= args.seed < 2**64:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--seed", f"is {args.seed}: give a whole number from 0 to 2^64 - 1")
    if args.order is not None and not 1 <= args.order < 2**16:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "--order", f"is {args.order}: give a whole number from 1 to 65535")
    if not 0 <= args.real_time_factor <= 1e6:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "--real-time-factor", f"is {args.real_time_factor}: give a number from 0 to 1e6"
        )


def _parameters(executable: str, path: Path, args: argparse.Namespace) -> dict:
    if executable != "driver":
        return {}
    # As fast as possible, a thousand frames a second still show a path.
    rate = 50.0 if args.real_time_factor else 1000.0
    # The demo shows a motion, on however busy a machine: no real substrate waits for a late sign of life.
    return {
        "scenario": path.resolve(), "real_time_factor": args.real_time_factor, "pose_rate": rate, "peer_timeout": PATIENCE,
        "gate_timeout": PATIENCE,
    }


def _make_folders(output: Path) -> Path:
    logs = output / "logs"
    for folder in (output, logs):
        files.make_folder(folder)
    for entry in NODES:
        (logs / f"{entry.executable}.log").unlink(missing_ok=True)
    return logs


def _show_logs(processes: ChildProcesses) -> None:
    for entry in NODES:
        if (log := processes.log(entry.executable)).is_file():
            print(f"--- {log}", *log.read_text(errors="replace").splitlines()[-15:], sep="\n", file=sys.stderr)


def _last_line(executed: Executed, verdict: Verdict) -> str:
    gap = executed.result.plan.clearance.gap
    return (
        f"{int(verdict.at_goal.sum())}/{len(verdict.at_goal)} robots at their goals, "
        f"worst error {verdict.goal_errors.max():.2g} units, plan {executed.result.planning_time:.2f} s, "
        f"execution {executed.sequence_time:.2f} s, "
        f"min clearance {f'{gap:.3g} units' if np.isfinite(gap) else 'unlimited'}"
        + "".join(f", {problem}" for problem in verdict.problems)
    )


def _interrupt(*_):
    raise KeyboardInterrupt


class DemoDisplay(ProgressDisplay):
    """Steps and a bar on a terminal, plain lines elsewhere."""

    def __init__(self):
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._told = 0

    def __enter__(self) -> "DemoDisplay":
        if sys.stdout.isatty():
            from rich import progress

            self._bar = progress.Progress(
                progress.SpinnerColumn(), progress.TextColumn("{task.description}"), progress.BarColumn(),
                progress.TimeElapsedColumn(), transient=True,
            )
            self._bar.start()
        return self

    def __exit__(self, *_):
        if self._bar:
            self._bar.stop()

    def step(self, text: str) -> None:
        if not self._bar:
            print(text, flush=True)
            return
        if self._task is not None:
            self._bar.update(self._task, total=1, completed=1)
        self._task = self._bar.add_task(text, total=None)

    def progress(self, done: int, total: int) -> None:
        if self._bar and self._task is not None:
            self._bar.update(self._task, total=total, completed=done)
        elif total and done * 10 // total > self._told:
            self._told = done * 10 // total
            print(f"  {done} of {total} epochs", flush=True)
