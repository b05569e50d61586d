"""Which nodes make up a system, and what must be there before one starts: for the launch file, the demo and the tests."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace
from stressbot_msgs import lifeline
from stressbot_msgs.transports import RANGE

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario


@dataclass(frozen=True)
class NodeEntry:
    """One node, which is one process.

    Attributes:
        package: that installs the executable.
        executable: its name, and the node's.
        arguments: of the launch file that become parameters of this node, with their types.
        options: arguments of the launch file of which one must ask for it; none: always started.
    """

    package: str
    executable: str
    arguments: dict[str, type] = field(default_factory=dict)
    options: tuple[str, ...] = ()


ENCLAVES = "/stressbot"
"""Where the policy file has what each process may do; of no effect unless ROS_SECURITY_ENABLE is set."""

NODES = (
    NodeEntry("stressbot_driver", "driver", {"scenario": str, "real_time_factor": float, "auto_start": bool}),
    NodeEntry("stressbot_planner", "sequencer"),
    NodeEntry("stressbot_planner", "planner"),
    NodeEntry("stressbot_planner", "mover", options=("move",)),
    NodeEntry("stressbot_driver", "simulated_camera", {"camera": str}, ("simulated camera",)),
    NodeEntry("stressbot_driver", "camera_tracker", {"camera": str}, ("camera",)),
    NodeEntry("stressbot_driver", "viewer", options=("view", "rviz")),
    NodeEntry("stressbot_planner", "paths", options=("view", "rviz")),
    NodeEntry("stressbot_planner", "clicks", options=("click", "rviz")),
)


SIMULATED, BENCH = "simulated", "bench"
"""Value of the argument `camera` that asks for pictures of the simulated substrate, and what its nodes call that camera."""


def environment() -> dict[str, str]:
    """Return what launched processes find in their environment: they end with us, and other machines hear them if asked to."""
    return lifeline.environment() | {RANGE: os.environ.get(RANGE, "LOCALHOST")}


def share(*parts: str) -> Path:
    """Return a path below the installed share folder of this package."""
    return Path(get_package_share_directory("stressbot_planner")).joinpath(*parts)


def arguments() -> dict[str, tuple[str, str]]:
    """Return name, default and meaning of each argument of the launch file; what is empty is as in the parameter file."""
    return {
        "scenario": (str(share("scenarios", "paper-six.yaml")), "scenario file that says what lies on the bench"),
        "real_time_factor": ("", "substrate seconds per wall second; 0: as fast as possible"),
        "auto_start": ("", "start each accepted voltage sequence at once"),
        "parameters": (str(share("config", "stressbot.yaml")), "ROS 2 parameter file for all nodes"),
        "namespace": ("", "of all nodes and names, for more than one system in a ROS domain"),
        "camera": ("", f"camera file: poses come from pictures on image_raw; {SIMULATED}: from those of a simulated camera"),
        "move": ("false", "start the mover, which serves the action move_swarm"),
        "view": ("false", "start viewer and paths, which publish markers, a pose array and paths"),
        "click": ("false", "start clicks, which makes goals of clicks in RViz or Foxglove, and plans for them"),
        "rviz": ("false", "start viewer, paths and clicks, and RViz for them"),
    }


@dataclass(frozen=True)
class Start:
    """A process of a launched system: executable, namespace, parameters, their file, and what else stands on its command line."""

    package: str
    executable: str
    namespace: str
    parameters: dict[str, Any] = field(default_factory=dict)
    parameter_file: str = ""
    arguments: tuple[str, ...] = ()
    ros_arguments: tuple[str, ...] = ()
    prefix: str = ""


def launched(values: Mapping[str, str]) -> list[Start]:
    """Return what the launch file starts, once everything that it needs is there.

    Args:
        values: of all `arguments`, as text.

    Raises:
        StressbotError: one cannot be, a file cannot be read, or RViz is asked for and missing.
    """
    asked = {name: _truth(name, values[name]) for name in ("move", "view", "click", "rviz")}
    simulated = values["camera"] == SIMULATED
    asked |= {"camera": bool(values["camera"]), "simulated camera": simulated}
    values = {**values, "camera": BENCH if simulated else values["camera"]}
    scenario.load(Path(values["scenario"]))
    file = values["parameters"]
    if not os.path.isfile(file) or not os.access(file, os.R_OK):
        raise StressbotError(ErrorCode.UNREADABLE_FILE, "parameters", f"cannot read {file}: give the path of a parameter file")
    namespace = values["namespace"] and "/" + values["namespace"].strip("/")
    try:
        validate_namespace(namespace or "/")
    except InvalidNamespaceException as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise StressbotError(ErrorCode.OUT_OF_RANGE, "namespace", f"is '{values['namespace']}': {reason}") from error
    readers = {float: _number, bool: _truth, str: lambda _, text: text}
    starts = [
        Start(
            entry.package,
            entry.executable,
            namespace,
            {name: readers[kind](name, values[name]) for name, kind in entry.arguments.items() if values[name]}
            | ({"tracked": True} if simulated and entry.executable == "driver" else {}),
            file,
            ros_arguments=("--enclave", f"{ENCLAVES}/{entry.executable}"),
        )
        for entry in NODES
        if not entry.options or any(asked[option] for option in entry.options)
    ]
    if asked["rviz"]:
        try:
            get_package_prefix("rviz2")
        except PackageNotFoundError as error:
            message = "cannot be true, rviz2 is not installed: sudo apt install ros-jazzy-rviz2, or view:=true for markers alone"
            raise StressbotError(ErrorCode.UNSUPPORTED, "rviz", message) from error
        config = ("-d", str(share("rviz", "stressbot.rviz")))
        # RViz does not know our lifeline: the kernel ends it with the process that starts it.
        starts.append(Start("rviz2", "rviz2", namespace, arguments=config, prefix="setpriv --pdeathsig TERM"))
    return starts


def _truth(name: str, text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise StressbotError(ErrorCode.WRONG_TYPE, name, f"is '{text}': give true or false")
    return text.lower() == "true"


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise StressbotError(ErrorCode.WRONG_TYPE, name, f"is '{text}': give a number") from error


def command(entry: NodeEntry, parameters: dict[str, Any], parameter_file: Path | None = None, namespace: str = "") -> list[str]:
    """Return the command line that starts a node.

    Args:
        entry: the node.
        parameters: in addition to those of the file; a value is written as YAML would have it.
        parameter_file: ROS 2 parameter file; the installed one if None.
        namespace: of the node.
    """
    executable = Path(get_package_prefix(entry.package), "lib", entry.package, entry.executable)
    line = [str(executable), "--ros-args", "--params-file", str(parameter_file or share("config", "stressbot.yaml"))]
    line += ["--enclave", f"{ENCLAVES}/{entry.executable}"]
    if namespace:
        line += ["-r", f"__ns:={namespace}"]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        line += ["-p", f"{name}:={text}"]
    return line
