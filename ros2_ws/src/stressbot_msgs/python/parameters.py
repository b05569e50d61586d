"""Parameters that no node takes: those that nobody declared, and simulated time."""

from collections.abc import Iterable

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from stressbot_msgs.errors import ErrorCode, StressbotError

NO_SIMULATED_TIME = (
    "cannot be true: stamps are compared with those of trackers and other machines, and nobody publishes /clock. "
    "Take the substrate's time from sequence_time in swarm_poses and driver_status"
)


def refuse_simulated_time(node: Node) -> None:
    """Let nobody set `use_sim_time`, now or later.

    Raises:
        StressbotError: UNSUPPORTED, it is set.
    """

    def problem(parameters: Iterable[Parameter]) -> StressbotError | None:
        if any(parameter.name == "use_sim_time" and parameter.value is not False for parameter in parameters):
            return StressbotError(ErrorCode.UNSUPPORTED, "use_sim_time", NO_SIMULATED_TIME)
        return None

    def may_set(parameters: list[Parameter]) -> SetParametersResult:
        error = problem(parameters)
        return SetParametersResult(successful=error is None, reason=str(error or ""))

    if error := problem(node._parameter_overrides.values()):  # rclpy offers no public view of them
        raise error
    node.add_on_set_parameters_callback(may_set)


def refuse_others(node: Node, names: Iterable[str]) -> None:
    """Take no start-up value of a parameter that is not declared by now, and no simulated time; a refusal lists `names`.

    Raises:
        StressbotError: UNSUPPORTED, UNKNOWN_FIELD.
    """
    refuse_simulated_time(node)
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            known = ", ".join(names) or "none at all"
            raise StressbotError(ErrorCode.UNKNOWN_FIELD, name, f"is no parameter of this node: it has {known}")
