"""`ros2 run`: a package's executable, as a child process that hears the signals of the terminal itself."""

import argparse
import os
import shlex
import signal
import subprocess
from contextlib import suppress

from ros2_stand_in.pkg import executable_paths, package_completer
from ros2_stand_in.verbs import argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.set_defaults(main=_run)
    parser.add_argument(
        "--prefix",
        help="Prefix command, which should go before the executable. Command must be wrapped in quotes if it contains spaces "
        "(e.g. --prefix 'gdb -ex run --args').",
    )
    argument(parser, package_completer, "package_name", help="Name of the ROS package")
    argument(parser, _complete_executables, "executable_name", help="Name of the executable")
    parser.add_argument("argv", nargs=argparse.REMAINDER, help="Pass arbitrary arguments to the executable")


def _complete_executables(prefix, parsed_args, **_):
    with suppress(RuntimeError):
        return [os.path.basename(path) for path in executable_paths(parsed_args.package_name)]
    return []


def _run(options: argparse.Namespace) -> int | str:
    paths = [path for path in executable_paths(options.package_name) if os.path.basename(path) == options.executable_name]
    if not paths:
        return "No executable found"
    if len(paths) > 1:
        raise RuntimeError("\n- ".join(["Multiple executables found:", *paths]))
    process = subprocess.Popen([*shlex.split(options.prefix or ""), paths[0], *options.argv])
    while process.returncode is None:
        with suppress(KeyboardInterrupt):  # the child hears it too, and ends
            process.wait()
    code = process.returncode
    if code < 0:
        print("[ros2run]:", signal.strsignal(-code))
    elif code > 0:
        print("[ros2run]:", f"Process exited with failure {code}")
    return code
