"""Declared parameters: described, ranged, and nothing else accepted, not even at start-up."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from stressbot_driver.errors import BenchError, ErrorCode


@dataclass(frozen=True)
class Declaration:
    """One parameter. Numbers may be given as whole numbers too: `0` means `0.0` to everybody but ROS.

    A tuple as default stands for a list; `listable` says that one number may also be a list. Whoever reads a list
    checks what is in it.
    """

    name: str
    default: Any
    description: str
    low: float | None = None
    high: float | None = None
    read_only: bool = False
    listable: bool = False

    def problem(self, value: Any) -> str | None:
        """Why `value` is refused, or None."""
        kind = type(self.default)
        is_list = isinstance(value, Sequence) and not isinstance(value, str) or isinstance(value, array)
        if kind is tuple:
            return None if is_list else f"{value!r} must be a list"
        if kind in (float, int):
            if self.listable and is_list:
                return None
            if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else int):
                return f"{value!r} is not a {'whole ' if kind is int else ''}number"
            if not self.low <= value <= self.high:  # NaN fails as well
                return f"{value!r} must lie between {self.low:g} and {self.high:g}"
        elif not isinstance(value, kind):
            return f"{value!r} must be {'true or false' if kind is bool else 'text'}"
        return None


def declare(node: Node, declarations: Sequence[Declaration]) -> None:
    """Declare all; refuse overrides that do not fit or that nobody declared. Raises BenchError."""
    for declaration in declarations:
        descriptor = ParameterDescriptor(description=declaration.description, read_only=declaration.read_only, dynamic_typing=True)
        if type(declaration.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=declaration.low, to_value=declaration.high, step=1)]
        elif declaration.low is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=declaration.low, to_value=declaration.high, step=0.0)]
        override = node._parameter_overrides.get(declaration.name)  # rclpy offers no public view of the overrides
        if override is not None and (problem := declaration.problem(override.value)):
            raise BenchError(ErrorCode.OUT_OF_RANGE, declaration.name, f"{problem}: change this parameter")
        default = list(declaration.default) if type(declaration.default) is tuple else declaration.default
        node.declare_parameter(declaration.name, default, descriptor)
    unknown = [name for name in node._parameter_overrides if not node.has_parameter(name) and not name.startswith("qos_overrides.")]
    if unknown:
        known = ", ".join(declaration.name for declaration in declarations)
        raise BenchError(ErrorCode.UNKNOWN_FIELD, unknown[0], f"there is no such parameter: use one of {known}")


def first_problem(declarations: Sequence[Declaration], parameters: list[Parameter]) -> str | None:
    """Why a change of `parameters` is refused, or None."""
    by_name = {declaration.name: declaration for declaration in declarations}
    for parameter in parameters:
        declaration = by_name.get(parameter.name)
        if declaration and (problem := declaration.problem(parameter.value)):
            return f"{parameter.name}: {problem}"
    return None
