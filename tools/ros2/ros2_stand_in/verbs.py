"""What the families have in common: verbs, the options of calls that look round, and what completes a word."""

import argparse
import sys
from collections.abc import Callable
from typing import Any


def verbs(family: argparse.ArgumentParser) -> Any:
    """Return what `verb` adds verbs to; a family without a verb prints its help."""
    family.set_defaults(main=lambda options: family.print_help())
    return family.add_subparsers(title="Commands", metavar=f"Call `{family.prog} <command> -h` for more detailed usage.")


def verb(added: Any, name: str, main: Callable[[argparse.Namespace], int | str | None], text: str) -> argparse.ArgumentParser:
    """Add a verb that is carried out by `main`, and return its parser."""
    parser = added.add_parser(name, help=text, description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.set_defaults(main=main)
    return parser


def argument(parser: Any, completer: Callable | None, *names: str, **options: Any) -> None:
    """Add an argument whose words `completer` offers."""
    parser.add_argument(*names, **options).completer = completer


def discovery(parser: argparse.ArgumentParser) -> None:
    """Add the options of a call that looks round, directly or by the official daemon."""
    direct_node(parser)
    parser.add_argument(
        "--no-daemon", action="store_true", help="Do not spawn nor use an already running daemon (this stand-in never does)"
    )


def direct_node(parser: argparse.ArgumentParser) -> None:
    """Add the options of a call with a node of its own."""
    parser.add_argument(
        "--spin-time", type=float,
        help="Spin time in seconds to wait for discovery (default: 0.5 with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, where our "
        "nodes announce themselves often, otherwise 3.2)",
    )
    parser.add_argument("-s", "--use-sim-time", action="store_true", help="Enable ROS simulation time")


def values(parser: argparse.ArgumentParser, name: str, text: str, completer: Callable) -> None:
    """Add values in YAML, from the command line or from standard input."""
    group = parser.add_mutually_exclusive_group()
    argument(group, completer, name, nargs="?", default="{}", help=text)
    group.add_argument("--stdin", action="store_true", help="Read values from standard input")


def given(options: argparse.Namespace, name: str) -> str:
    """Return the values that `values` has added."""
    return sys.stdin.read() if options.stdin else getattr(options, name)


def whole(text: str) -> int:
    return _bounded(text, int, lambda value: value >= 0, "value must be non-negative integer")


def positive_whole(text: str) -> int:
    return _bounded(text, int, lambda value: value > 0, "value must be a positive integer")


def positive(text: str) -> float:
    return _bounded(text, float, lambda value: value > 0, "Value must be positive")


def _bounded(text, kind, is_allowed, wanted):
    try:
        value = kind(text)
    except ValueError:
        raise argparse.ArgumentTypeError(wanted) from None
    if not is_allowed(value):
        raise argparse.ArgumentTypeError(wanted)
    return value
