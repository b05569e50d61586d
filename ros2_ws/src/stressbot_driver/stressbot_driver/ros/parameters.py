"""Declared parameters: described, ranged, and nothing else accepted, not even at start-up."""

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter
from stressbot_msgs.parameters import refuse_others

from stressbot_driver.declaration import Declaration
from stressbot_driver.errors import ErrorCode, StressbotError


def declare(node: Node, declarations: Sequence[Declaration]) -> None:
    """Declare all; refuse overrides that do not fit. Raises StressbotError."""
    for declaration in declarations:
        descriptor = ParameterDescriptor(description=declaration.description, read_only=declaration.read_only, dynamic_typing=True)
        if isinstance(declaration.default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=declaration.low, to_value=declaration.high, step=0.0)]
        elif type(declaration.default) is int:  # not a truth value
            descriptor.integer_range = [IntegerRange(from_value=declaration.low, to_value=declaration.high, step=1)]
        override = node._parameter_overrides.get(declaration.name)  # rclpy offers no public view of the overrides
        if override is not None and (problem := declaration.problem(override.value)):
            raise StressbotError(ErrorCode.OUT_OF_RANGE, declaration.name, f"{problem}: change this parameter")
        default = list(declaration.default) if isinstance(declaration.default, tuple) else declaration.default
        node.declare_parameter(declaration.name, default, descriptor)


def declare_all(node: Node, declarations: Sequence[Declaration]) -> None:
    """Declare all that a node has: any other start-up value is refused, too. Raises StressbotError."""
    declare(node, declarations)
    refuse_others(node, (declaration.name for declaration in declarations))


def value_of(node: Node, name: str) -> Any:
    """What a declared parameter is now: of the kind of its default, see `Declaration.problem`."""
    return node.get_parameter(name).value


def number_of(node: Node, name: str) -> float:
    """What a declared number is now, which may have been given as a whole one."""
    return float(value_of(node, name))


def first_problem(declarations: Sequence[Declaration], parameters: list[Parameter]) -> str | None:
    """Why a change of `parameters` is refused, or None."""
    by_name = {declaration.name: declaration for declaration in declarations}
    for parameter in parameters:
        declaration = by_name.get(parameter.name)
        if declaration and (problem := declaration.problem(parameter.value)):
            return f"{parameter.name}: {problem}"
    return None
