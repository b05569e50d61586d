"""`ros2 launch` of the launch table of stressbot_planner, which needs no `launch` package."""

import argparse
import asyncio
import os
import signal
import sys
from asyncio.subprocess import PIPE, Process
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from stressbot_msgs import lifeline

from ros2_stand_in.pkg import package_completer
from ros2_stand_in.verbs import argument
from stressbot_planner.errors import StressbotError
from stressbot_planner.ros import bringup

PACKAGE, FILE = "stressbot_planner", "stressbot.launch.py"
TIMEOUTS = ("sigterm_timeout", "sigkill_timeout")
"""Launch arguments: how long, s, processes may take after SIGINT until they get SIGTERM, and after that until SIGKILL."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.set_defaults(main=_launch)
    parser.add_argument(
        "-n", "--noninteractive", action="store_true", default=not sys.stdin.isatty(),
        help="Run the launch system non-interactively, with no terminal associated",
    )
    parser.add_argument(
        "-s", "--show-args", "--show-arguments", action="store_true",
        help="Show arguments that may be given to the launch file.",
    )
    argument(parser, package_completer, "package_name", help="Name of the ROS package which contains the launch file")
    argument(parser, lambda **_: [FILE], "launch_file_name", nargs="?", help="Name of the launch file")
    argument(
        parser, lambda **_: [f"{name}:=" for name in bringup.arguments()], "launch_arguments", nargs="*",
        help="Arguments to the launch file; '<name>:=<value>' (for duplicates, last one wins)",
    )


def _launch(options: argparse.Namespace) -> int | str | None:
    words = options.launch_arguments
    if os.path.isfile(options.package_name):
        path = Path(options.package_name)
        words = [word for word in [options.launch_file_name, *words] if word is not None]
    else:
        path = _file_of_package(options.package_name, options.launch_file_name)
    if path.name != FILE or path.read_bytes() != _file_of_package(PACKAGE, FILE).read_bytes():
        return f"this stand-in launches {PACKAGE} {FILE} only; {path} needs the official ros2 launch"
    if options.show_args:
        print("Arguments (pass arguments as '<name>:=<value>'):")
        for name, (default, text) in bringup.arguments().items():
            print(f"\n    '{name}':\n        {text}\n        (default: '{default}')")
        return None
    values = {name: default for name, (default, _) in bringup.arguments().items()}
    for word in words:
        name, separator, value = word.partition(":=")
        if not separator or not name or not value:
            raise RuntimeError(f"malformed launch argument '{word}', expected format '<name>:=<value>'")
        values[name] = value
    try:
        graces = [float(values.pop(name, 5.0)) for name in TIMEOUTS]
    except ValueError as error:
        raise RuntimeError(f"malformed launch argument, expected seconds for {' and '.join(TIMEOUTS)}: {error}") from None
    _say("INFO", "launch", "Default logging verbosity is set to INFO")
    try:
        starts = bringup.launched(values)
    except StressbotError as error:
        _say("ERROR", "launch", f"Caught exception in launch (see debug for traceback): {error}")
        return 1
    return asyncio.run(_Launch(starts, options.noninteractive, graces).run())


def _file_of_package(package: str, name: str) -> Path:
    try:
        share = get_package_share_directory(package)
    except (PackageNotFoundError, ValueError) as error:
        raise RuntimeError(f"Package '{package}' not found: {error}") from None
    for path in Path(share).rglob(name or ""):
        if path.is_file():
            return path
    raise RuntimeError(f"file '{name}' was not found in the share directory of package '{package}' which is at '{share}'")


def _say(level: str, who: str, text: str) -> None:
    print(f"[{level}] [{who}]: {text}")


class _Launch:
    """Processes that run side by side until all have ended or one is asked to end them."""

    def __init__(self, starts: list[bringup.Start], noninteractive: bool, graces: list[float]):
        self._requests = zip((signal.SIGINT, signal.SIGTERM, signal.SIGKILL), [*graces, 5.0], strict=True)
        self._commands = {f"{start.executable}-{number}": _command(start) for number, start in enumerate(starts, start=1)}
        self._noninteractive = noninteractive
        self._running: dict[str, Process] = {}
        self._asked = asyncio.Event()
        self._code = 0

    async def run(self) -> int:
        """Return the exit code."""
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGINT, self._interrupted)
        loop.add_signal_handler(signal.SIGTERM, self._terminated)
        processes = [asyncio.create_task(self._run(name, command)) for name, command in self._commands.items()]
        ending = asyncio.create_task(self._end())
        await asyncio.gather(*processes)
        ending.cancel()
        return self._code

    async def _run(self, name: str, command: list[str]) -> None:
        process = await asyncio.create_subprocess_exec(
            *command, stdout=PIPE, stderr=PIPE, env=os.environ | lifeline.environment()
        )
        _say("INFO", name, f"process started with pid [{process.pid}]")
        self._running[name] = process
        await asyncio.gather(self._hand_on(name, process.stdout), self._hand_on(name, process.stderr), process.wait())
        del self._running[name]
        if process.returncode == 0:
            _say("INFO", name, f"process has finished cleanly [pid {process.pid}]")
        else:
            line = " ".join(command)
            _say("ERROR", name, f"process has died [pid {process.pid}, exit code {process.returncode}, cmd '{line}'].")

    async def _hand_on(self, name: str, stream: asyncio.StreamReader) -> None:
        rest = b""
        while chunk := await stream.read(65536):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                print(f"[{name}] {line.decode(errors='replace')}")
        if rest:
            print(f"[{name}] {rest.decode(errors='replace')}")

    def _interrupted(self) -> None:
        again = " again, ignoring..." if self._asked.is_set() else ""
        _say("WARNING", "launch", f"user interrupted with ctrl-c (SIGINT){again}")
        self._asked.set()

    def _terminated(self) -> None:
        self._code = 1
        self._noninteractive = True  # only this process has been told
        self._asked.set()

    async def _end(self) -> None:
        await self._asked.wait()
        for number, patience in self._requests:
            for name, process in self._running.items():
                if number != signal.SIGINT or self._noninteractive:
                    _say("INFO", name, f"sending signal '{number.name}' to process[{name}]")
                    process.send_signal(number)
            await asyncio.sleep(patience)


def _command(start: bringup.Start) -> list[str]:
    executable = Path(get_package_prefix(start.package), "lib", start.package, start.executable)
    line = [*start.prefix.split(), str(executable), *start.arguments, "--ros-args", *start.ros_arguments]
    if start.namespace:
        line += ["-r", f"__ns:={start.namespace}"]
    if start.parameter_file:
        line += ["--params-file", start.parameter_file]
    for name, value in start.parameters.items():
        line += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    return line
