"""The command line as a whole: families of commands, exit codes, completion. Only the family that is asked for is loaded."""

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Sequence

FAMILIES = {
    "action": "Various action related sub-commands",
    "interface": "Show information about ROS interfaces",
    "launch": "Run a launch file",
    "node": "Various node related sub-commands",
    "param": "Various param related sub-commands",
    "pkg": "Various package related sub-commands",
    "run": "Run a package specific executable",
    "service": "Various service related sub-commands",
    "topic": "Various topic related sub-commands",
}

DESCRIPTION = """\
ros2 is a command-line tool for ROS 2. This is a stand-in for the official one,
which the ROS 2 wheels do not bring: the same words, arguments, output and exit
codes, for what it covers. A native ROS 2 brings the official one, which is then used.

It lacks: bag, component, control, daemon, doctor, extension_points, extensions,
lifecycle, multicast, security, test, wtf; action type|find;
interface package|packages|proto; launch of any file but
stressbot_planner stressbot.launch.py, and its options but -n and -s; param delete;
pkg create|list|xml; service echo|find|info; topic bw|delay|find.
It keeps no daemon: each call looks round by itself for --spin-time seconds or longer."""


def main(arguments: Sequence[str] | None = None) -> int | str:
    """Run a command and return its exit code, or a text that says what is wrong, for `sys.exit`."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    completed = os.environ.get("COMP_LINE", "").split() if "_ARGCOMPLETE" in os.environ else None
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # until here, see ../ros2
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        parser = make_parser(_family(words if completed is None else completed[1:]))
        if completed is not None:
            import argcomplete

            argcomplete.autocomplete(parser, exclude=["-h", "--help"])
        options = parser.parse_args(words)
        if not options.use_python_default_buffering:
            sys.stdout.reconfigure(line_buffering=True)
        return options.main(options) or 0
    except KeyboardInterrupt:
        return int(signal.SIGINT)
    except BrokenPipeError:  # who reads has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except RuntimeError as error:
        from rclpy.executors import ExternalShutdownException

        return int(signal.SIGTERM) if isinstance(error, ExternalShutdownException) else str(error)


def make_parser(family: str | None) -> argparse.ArgumentParser:
    """Return the parser, with all that belongs to one family."""
    parser = argparse.ArgumentParser("ros2", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--use-python-default-buffering",
        action="store_true",
        help="Do not force line buffering in stdout and instead use the python default buffering, which might be affected by "
        "PYTHONUNBUFFERED/-u and depends on whatever stdout is interactive or not",
    )
    parser.set_defaults(main=lambda options: parser.print_help())
    families = parser.add_subparsers(title="Commands", metavar="Call `ros2 <command> -h` for more detailed usage.")
    for name, text in FAMILIES.items():
        part = families.add_parser(
            name, help=text, description=text, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        if name == family:
            importlib.import_module(f"ros2_stand_in.{name}").add_arguments(part)
    return parser


def _family(words: Sequence[str]) -> str | None:
    return next((word for word in words if not word.startswith("-")), None)
