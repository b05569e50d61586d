"""Which nodes make up a system: one table for the launch file, the demo and the tests."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix, get_package_share_directory


@dataclass(frozen=True)
class NodeEntry:
    """One node, which is one process.

    Attributes:
        package: that installs the executable.
        executable: its name, and the node's.
        arguments: of the launch file that become parameters of this node, with their types.
        option: argument of the launch file that asks for it; empty: always started.
    """

    package: str
    executable: str
    arguments: dict[str, type] = field(default_factory=dict)
    option: str = ""


ENCLAVES = "/stressbot"
"""Where the policy file has what each process may do; of no effect unless ROS_SECURITY_ENABLE is set."""

NODES = (
    NodeEntry("stressbot_driver", "driver", {"scenario": str, "real_time_factor": float, "auto_start": bool}),
    NodeEntry("stressbot_planner", "sequencer"),
    NodeEntry("stressbot_planner", "planner"),
    NodeEntry("stressbot_planner", "mover", option="move"),
    NodeEntry("stressbot_driver", "viewer", option="view"),
)


def share(*parts: str) -> Path:
    """Return a path below the installed share folder of this package."""
    return Path(get_package_share_directory("stressbot_planner")).joinpath(*parts)


def command(
    entry: NodeEntry, parameters: dict[str, Any], parameter_file: Path | None = None, namespace: str = ""
) -> list[str]:
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
