"""`stressbot status|start|stop|reset|move`: what an operator does with nodes that run."""

import argparse
import sys
from typing import TYPE_CHECKING, Any

from stressbot_planner.cli.arguments import number, positive
from stressbot_planner.cli.printing import CommandReport, print_refusal
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import streams

if TYPE_CHECKING:
    from stressbot_planner.ros.client import SwarmClient

MICRO = 1e6
"""µm in a metre."""

MOST_LISTED = 30
"""Robots whose poses are shown; `--json` has all."""

HELP = {
    "status": "say what driver and sequencer do, and where the robots are",
    "start": "put the loaded sequence on the substrate",
    "stop": "bring the output to rest",
    "reset": "leave a fault or an end; simulated robots go back to their starts",
    "move": "bring robots to goals in closed loop, until all are near them or Ctrl-C",
}


def add_arguments(parser: argparse.ArgumentParser, word: str) -> None:
    """Declare the arguments of one of the commands."""
    parser.add_argument("--namespace", default="", metavar="NS", help="of the nodes (default: none)")
    parser.add_argument(
        "--timeout", type=positive, default=10.0, metavar="S", help="seconds to wait for an answer (default: %(default)g)"
    )
    if word == "move":
        parser.add_argument(
            "--goal", action="append", nargs=3, type=_finite, default=[], metavar=("ID", "X", "Y"),
            help="id of a robot and its goal, um; may be repeated (default: the scenario's goals)",
        )
        parser.add_argument("--assign", action="store_true", help="let robots take each other's goals")
        parser.add_argument(
            "--tolerance", type=positive, default=30.0, metavar="T", help="distance that counts as there, um (default: %(default)g)"
        )
        parser.add_argument(
            "--time-limit", type=positive, default=600.0, metavar="S", help="seconds for all of it (default: %(default)g)"
        )


def run(options: argparse.Namespace) -> int:
    """Do it. Return 1 if nobody answers, or what is asked for is refused."""
    from stressbot_planner.ros.client import command_client

    with command_client(f"stressbot_{options.command}", options.namespace) as client:
        try:
            if options.command == "status":
                return _status(client, options)
            if options.command == "move":
                return _move(client, options)
            return _trigger(client, options)
        except TimeoutError as error:
            where = client.node.get_namespace()
            return _failed(options, f"{error}: does a driver run in namespace '{where}', in this ROS domain?")


def _finite(text: str) -> float:
    return number(text, "a number")


def _failed(options: argparse.Namespace, why: str) -> int:
    if options.json:
        print_refusal(None, why)
    streams.complain("stressbot", why)
    return streams.FAILED


def _status(client: "SwarmClient", options: argparse.Namespace) -> int:
    from stressbot_planner.ros import operating

    told = operating.status(client, options.timeout)
    report = CommandReport(**told)
    progress = ""
    if told["time_left"]:
        progress = f", epoch {told['epoch']} of {told['epoch_count']}, {told['time_left']:.1f} s left"
    where = "simulated substrate" if told["backend"] == "simulated" else f"instrument: {told['backend']}"
    rows = [
        ("driver", f"{told['state']}{progress} ({where})"),
        ("swarm", f"{told['swarm']}: {told['robot_count']} robots, {len(told['robots'])} of them seen"),
        ("plan", told["plan_id"] or "none"),
        ("output", f"{told['output_level']:g} V"),
        ("sequencer", told["sequencer"] or "not heard of"),
    ]
    if told["missing"]:
        rows.append(("missing", ", ".join(told["missing"])))
    if told["message"]:
        rows.append(("error", told["message"]))
    report.pairs(rows)
    if len(told["robots"]) <= MOST_LISTED:
        lines = [
            [str(robot["id"]), f"{MICRO * robot['x']:.2f}", f"{MICRO * robot['y']:.2f}", f"{robot['heading']:.3f}"]
            for robot in told["robots"]
        ]
        report.table("Robots (um, rad)", ["id", "x", "y", "heading"], lines)
    report.print(options.json)
    return streams.SOLVED


def _trigger(client: "SwarmClient", options: argparse.Namespace) -> int:
    from stressbot_planner.ros import operating

    success, message = operating.trigger(client, options.command, options.timeout)
    if not success:
        return _failed(options, f"{options.command}: {message}")
    report = CommandReport(success=True, message=message)
    report.lines(message)
    report.print(options.json)
    return streams.SOLVED


def _move(client: "SwarmClient", options: argparse.Namespace) -> int:
    from stressbot_planner.ros import operating

    goals = []
    for robot, x, y in options.goal:
        if robot != int(robot) or not 0 <= robot < 2**32:
            raise StressbotError(ErrorCode.UNKNOWN_ROBOT, "--goal", f"is for robot {robot:g}: give an id, a whole number")
        goals.append((int(robot), x / MICRO, y / MICRO))
    told = operating.move(
        client, goals, options.assign, options.tolerance / MICRO, options.time_limit, options.timeout, _show
    )
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    report = CommandReport(**told)
    furthest = MICRO * max(told["errors"], default=0.0)
    stuck = f"; stuck: {', '.join(map(str, told['stuck']))}" if told["stuck"] else ""
    report.lines(f"the furthest is {furthest:.1f} um from its goal; {told['activations']} activations{stuck}")
    report.print(options.json)
    if told["success"]:
        return streams.SOLVED
    streams.complain("stressbot", f"move: {told['message'] or 'not all robots are at their goals'}")
    return streams.INTERRUPTED if told["interrupted"] else streams.FAILED


def _show(feedback: Any) -> None:
    if sys.stderr.isatty():
        furthest = MICRO * max(feedback.errors, default=0.0)
        sys.stderr.write(f"\r\x1b[K{100 * feedback.progress:.0f} %, furthest {furthest:.1f} um; Ctrl-C ends it at rest")
        sys.stderr.flush()
