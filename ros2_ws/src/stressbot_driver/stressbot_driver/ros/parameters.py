"""Declared parameters: described, ranged, and nothing else accepted, not even at start-up."""

from collections.abc import Iterable, Sequence

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from stressbot_driver.declaration import Declaration
from stressbot_driver.errors import ErrorCode, StressbotError

NO_SIMULATED_TIME = (
    "cannot be true: stamps are compared with those of trackers and other machines, and nobody publishes /clock. "
    "Take the substrate's time from sequence_time in swarm_poses and driver_status"
)


def declare(node: Node, declarations: Sequence[Declaration]) -> None:
    """Declare all; refuse overrides that do not fit. Raises StressbotError."""
    for declaration in declarations:
        descriptor = ParameterDescriptor(description=declaration.description, read_only=declaration.read_only, dynamic_typing=True)
        if isinstance(declaration.default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=declaration.low, to_value=declaration.high, step=0.0)]
        elif declaration.low is not None:
            descriptor.integer_range = [IntegerRange(from_value=declaration.low, to_value=declaration.high, step=1)]
        override = node._parameter_overrides.get(declaration.name)  # rclpy offers no public view of the overrides
        if override is not None and (problem := declaration.problem(override.value)):
            raise StressbotError(ErrorCode.OUT_OF_RANGE, declaration.name, f"{problem}: change this parameter")
        default = list(declaration.default) if isinstance(declaration.default, tuple) else declaration.default
        node.declare_parameter(declaration.name, default, descriptor)


def refuse_unknown(node: Node, declarations: Sequence[Declaration]) -> None:
    """Refuse overrides that nobody declared, and `use_sim_time` also later. Raises StressbotError, naming the declared ones."""
    if not _is_real_time(node._parameter_overrides.values()):
        raise StressbotError(ErrorCode.UNSUPPORTED, "use_sim_time", NO_SIMULATED_TIME)

    def may_set(parameters: list[Parameter]) -> SetParametersResult:
        successful = _is_real_time(parameters)
        return SetParametersResult(successful=successful, reason="" if successful else f"use_sim_time: {NO_SIMULATED_TIME}")

    node.add_on_set_parameters_callback(may_set)
    unknown = [name for name in node._parameter_overrides if not node.has_parameter(name) and not name.startswith("qos_overrides.")]
    if unknown:
        known = ", ".join(declaration.name for declaration in declarations)
        raise StressbotError(ErrorCode.UNKNOWN_FIELD, unknown[0], f"there is no such parameter: use one of {known}")


def _is_real_time(parameters: Iterable[Parameter]) -> bool:
    return not any(parameter.name == "use_sim_time" and parameter.value is not False for parameter in parameters)


def first_problem(declarations: Sequence[Declaration], parameters: list[Parameter]) -> str | None:
    """Why a change of `parameters` is refused, or None."""
    by_name = {declaration.name: declaration for declaration in declarations}
    for parameter in parameters:
        declaration = by_name.get(parameter.name)
        if declaration and (problem := declaration.problem(parameter.value)):
            return f"{parameter.name}: {problem}"
    return None
