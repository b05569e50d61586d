"""`stressbot view`: the page, of live nodes, of a simulated system that it starts, of a plan or of a recording."""

import argparse
import json
import os
import signal
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import streams
from stressbot_planner.system.interrupts import handled

RECORDING = ".mcap"
STARTED = ("driver", "sequencer", "planner", "mover")
PATIENCE = 2.0
"""s; a simulated swarm on whatever busy machine is no reason to fault for a late sign of life."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        "source", nargs="?", metavar="SOURCE",
        help="SCENARIO.yaml: start a simulated system and show it; with PLAN.json behind it: show that plan; X.mcap: show that "
        "recording (default: the nodes that run)",
    )
    parser.add_argument("plan", nargs="?", metavar="PLAN.json", help="plan of the scenario")
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="port on 127.0.0.1 (default: any that is free)")
    parser.add_argument("--read-only", action="store_true", help="give nobody the right to plan, start and reset; all may stop")
    parser.add_argument("--no-open", action="store_true", help="print the address, and open no browser")
    parser.add_argument("--namespace", default="", metavar="NS", help="of the nodes (default: none)")
    parser.add_argument(
        "--real-time-factor", type=_factor, default=1.0, metavar="F",
        help="substrate seconds per second of the system that is started; 0: as fast as possible (default: %(default)g)",
    )


def _port(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text[:9]) > 65535:
        raise argparse.ArgumentTypeError(f"is '{text}': give a whole number from 0 to 65535")
    return int(text)


def _factor(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"is '{text}': give a number from 0 to 1e6")
    return value


def run(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; return the exit code."""
    if options.plan is not None or (options.source is not None and Path(options.source).suffix == RECORDING):
        return _serve_file(options, data_of(options.source, options.plan))
    return _serve_live(options)


def data_of(source: str, plan: str | None) -> dict[str, Any]:
    """Return what the page shows of a recording, of a scenario's plan, or of a scenario alone; raises StressbotError."""
    path = Path(source)
    if path.suffix == RECORDING:
        if plan is not None:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, "PLAN.json", f"is {plan}, but {path} is a recording: give that alone")
        from stressbot_planner.ros.view_recording import recorded

        return recorded(path)
    from stressbot_planner.formats import scenario
    from stressbot_planner.formats.plan_file import StoredPlan, read_plan_file
    from stressbot_planner.problem.plan import Plan
    from stressbot_planner.view import scene

    loaded = scenario.load(path)
    at_rest = StoredPlan("", 0, True, Plan(loaded.problem, ()))
    stored = at_rest if plan is None else read_plan_file(plan, loaded.problem, loaded.name)
    shown, motion = scene.of_plan(loaded, stored)
    return {"file": "PLAN", "scene": shown, "motion": motion}


def _serve_file(options: argparse.Namespace, data: dict[str, Any]) -> int:
    from stressbot_planner.view.board import Board
    from stressbot_planner.view.server import PageServer, ReadOnlyDesk

    board = Board()
    board.put("file", data)
    ended = threading.Event()
    with (
        handled((signal.SIGTERM, signal.SIGINT, signal.SIGHUP), lambda *_: ended.set()),
        PageServer(board, ReadOnlyDesk(), options.port, read_only=True) as server,
    ):
        _tell(server.address, options)
        ended.wait()
    return streams.SOLVED


def _serve_live(options: argparse.Namespace) -> int:
    from stressbot_planner.ros import view_node
    from stressbot_planner.ros.bringup import NODES, RANGE, command
    from stressbot_planner.ros.child_processes import ChildProcesses

    with ExitStack() as stack:
        if options.source is not None:
            from stressbot_planner.formats import scenario

            path = Path(options.source)
            scenario.load(path)
            os.environ.setdefault(RANGE, "LOCALHOST")
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="stressbot-view-")))
            os.environ.setdefault("ROS_LOG_DIR", str(folder))
            processes = stack.enter_context(ChildProcesses(folder))
            driver = {
                "scenario": path.resolve(), "real_time_factor": options.real_time_factor, "peer_timeout": PATIENCE,
                "gate_timeout": PATIENCE,
            }
            for entry in NODES:
                if entry.executable in STARTED:
                    parameters = driver if entry.executable == "driver" else {}
                    processes.start(entry.executable, command(entry, parameters, namespace=options.namespace))
        return view_node.serve(options.namespace, options.port, options.read_only, lambda address: _tell(address, options))


def _tell(address: str, options: argparse.Namespace) -> None:
    """Say where the page is, and open it where there is a screen."""
    line = json.dumps({"address": address}) if options.json else address
    sys.stdout.write(f"{line}\n")  # in one piece, whatever else is said
    sys.stdout.flush()
    if not options.no_open and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        import webbrowser

        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
