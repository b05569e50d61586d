# PYTHON_ARGCOMPLETE_OK
"""The tool `stressbot`: plan, check, plot and show scenarios without ROS, drive them through it, operate nodes that run.

Exit codes: 0 done, 1 failed, 2 bad input, 3 no plan found, 130 interrupted; but for 0 one line on standard error says why. What is
heavy to import is imported by the command that needs it, so that help and refusals come at once.
"""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType
from typing import NoReturn

from stressbot_msgs.wording import sentence

from stressbot_planner import reproduce
from stressbot_planner.cli import allocate, check, init, listing, operate, plan, plot, recordings, show, view
from stressbot_planner.cli.printing import print_refusal
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.system import streams, threads

WITH_NODES = {
    "demo": "plan, then drive the simulated swarm through ROS 2",
    "run": "do the same for any scenario, and judge it",
}
"""Commands that start nodes: what they need is loaded only for them."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool and return its exit code."""
    threads.limit()
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # until here, see setup.py
        signal.signal(signal.SIGINT, signal.default_int_handler)
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if "_ARGCOMPLETE" in os.environ:
        _complete()

    def command() -> int:
        first = next((word for word in arguments if not word.startswith("-")), None)
        options = _parser(with_demo=first in WITH_NODES).parse_args(arguments)
        try:
            return options.run(options)
        except StressbotError as error:
            if options.json:
                print_refusal(error.code.name, error.message, error.field)
            raise
        except KeyboardInterrupt:
            if options.json:
                print_refusal(ErrorCode.CANCELLED.name, "interrupted")
            raise

    return streams.run("stressbot", command)


class _Parser(argparse.ArgumentParser):
    """Refuses in one line; argparse would print the usage as well."""

    def error(self, message: str) -> NoReturn:
        self.exit(streams.BAD_INPUT, f"{self.prog}: {sentence(message)}\n")


class _Version(argparse.Action):
    """Prints the version; it takes milliseconds to find, and few ask for it."""

    def __init__(self, option_strings: Sequence[str], dest: str, **_):
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_) -> NoReturn:
        from importlib.metadata import version

        print(f"stressbot {version('stressbot_planner')}")
        parser.exit()


def _parser(with_demo: bool) -> argparse.ArgumentParser:
    parser = _Parser(
        prog="stressbot",
        description="Plan for swarms of MicroStressBots under group control, and drive them.",
        epilog="Exit codes: 0 done, 1 failed, 2 bad input, 3 no plan found within the limit, 130 interrupted. "
        "The formats of scenario and plan files are described in docs/scenario-file.md and docs/plan-file.md.",
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")

    def add(
        name: str, text: str, run: Callable[[argparse.Namespace], int], declare: Callable[[argparse.ArgumentParser], None] = _none
    ) -> None:
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        declare(command)
        command.add_argument("--json", action="store_true", help="print one JSON object instead of text")
        command.set_defaults(run=run)

    add("init", "write a scenario file to begin with: the paper's six robots, or others at random", init.run, init.add_arguments)
    add("plan", "find a plan for a scenario", plan.run, plan.add_arguments)
    add("allocate", "choose who is in which group so that plans get short", allocate.run, allocate.add_arguments)
    add("check", "say what a plan would do, without driving it", check.run, check.add_arguments)
    add("plot", "draw a scenario or a plan", plot.run, plot.add_arguments)
    add("show", "describe a scenario: groups, codewords, PFSM codes, bounds", show.run, show.add_arguments)
    add("planners", "list the planners", listing.run)
    demo = _demo() if with_demo else None
    for word, text in WITH_NODES.items():
        if demo is None:
            add(word, text, _unloaded)
        else:
            add(word, text, demo.run, partial(demo.add_arguments, command=word))
    for word, text in operate.HELP.items():
        add(word, text, operate.run, partial(operate.add_arguments, word=word))
    add(
        "record", "record topics to a file until Ctrl-C, in MCAP, which ros2 bag and Foxglove read as well", recordings.record,
        recordings.add_record_arguments,
    )
    add(
        "replay", "publish again what was recorded, with the same times between", recordings.replay,
        recordings.add_replay_arguments,
    )
    add(
        "view", "show a swarm in a browser until Ctrl-C, and drive it from there: the nodes that run, a simulated system, a plan "
        "or a recording", view.run, view.add_arguments,
    )
    add(
        "reproduce", "measure all planners as in the paper's tables and figures, and beyond them", reproduce.run,
        reproduce.add_arguments,
    )
    return parser


def _none(_command: argparse.ArgumentParser) -> None:
    """Declare no arguments."""


def _unloaded(_options: argparse.Namespace) -> int:
    raise AssertionError("commands with nodes are parsed with what they need")


def _demo() -> ModuleType:
    try:
        from stressbot_planner.cli import demo
    except ModuleNotFoundError as error:
        raise ImportError(f"this needs ROS 2 Jazzy and a workspace built from the whole repository ({error})") from error
    return demo


def _complete() -> None:
    """Answer a shell that asks for the words that may follow, and end."""
    import argcomplete

    argcomplete.autocomplete(_parser(with_demo=True), exclude=["-h", "--help"])


if __name__ == "__main__":
    sys.exit(main())
