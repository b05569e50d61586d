"""Declared parameters: described, checked, and nothing else accepted, not even at start-up."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from stressbot_msgs.parameters import refuse_others

from stressbot_planner.errors import ErrorCode, StressbotError


@dataclass(frozen=True)
class Text:
    """A text parameter; `check` raises StressbotError if a value will not do."""

    name: str
    default: str
    description: str
    constraints: str
    check: Callable[[str], Any]

    def problem(self, value: Any) -> StressbotError | None:
        """Return why a value is refused, or None."""
        if not isinstance(value, str):
            return StressbotError(ErrorCode.WRONG_TYPE, self.name, f"is {value!r}: give text")
        try:
            self.check(value)
        except StressbotError as error:
            return error
        return None

    @property
    def descriptor(self) -> ParameterDescriptor:
        """What ROS is told."""
        return ParameterDescriptor(description=self.description, additional_constraints=self.constraints)


@dataclass(frozen=True)
class Number:
    """A number from `low` to `high`; whole numbers will do too. `read_only`: it holds from start to end."""

    name: str
    default: float
    description: str
    low: float
    high: float
    read_only: bool = False

    def problem(self, value: Any) -> StressbotError | None:
        """Return why a value is refused, or None."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            return StressbotError(ErrorCode.WRONG_TYPE, self.name, f"is {value!r}: give a number")
        if not self.low <= value <= self.high:  # NaN fails as well
            return StressbotError(ErrorCode.OUT_OF_RANGE, self.name, f"is {value}: give {self.low:g} to {self.high:g}")
        return None

    @property
    def descriptor(self) -> ParameterDescriptor:
        """What ROS is told."""
        limits = FloatingPointRange(from_value=self.low, to_value=self.high, step=0.0)
        return ParameterDescriptor(
            description=self.description, floating_point_range=[limits], dynamic_typing=True, read_only=self.read_only
        )


@dataclass(frozen=True)
class Robots:
    """Ids of robots, up to `most`, from start to end."""

    name: str
    description: str
    most: int
    default: tuple[int, ...] = ()

    def problem(self, value: Any) -> StressbotError | None:
        """Return why a value is refused, or None."""
        if not isinstance(value, list | tuple | array) or not all(type(one) is int and one >= 0 for one in value):
            return StressbotError(ErrorCode.WRONG_TYPE, self.name, f"is {value!r}: give a list of ids, such as [1, 2]")
        if len(value) > self.most:
            return StressbotError(ErrorCode.OUT_OF_RANGE, self.name, f"has {len(value)} ids: give at most {self.most}")
        return None

    @property
    def descriptor(self) -> ParameterDescriptor:
        """What ROS is told."""
        return ParameterDescriptor(description=self.description, dynamic_typing=True, read_only=True)


def declare(node: Node, declarations: tuple[Text | Number | Robots, ...] = ()) -> None:
    """Declare parameters and keep watch over later changes.

    Raises:
        StressbotError: a start-up value does not fit, or nobody declared it.
    """
    overrides = node._parameter_overrides
    for declaration in declarations:
        if declaration.name in overrides and (problem := declaration.problem(overrides[declaration.name].value)):
            raise problem
        node.declare_parameter(declaration.name, declaration.default, declaration.descriptor)
    refuse_others(node, (declaration.name for declaration in declarations))
    by_name = {declaration.name: declaration for declaration in declarations}

    def may_set(parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            declaration = by_name.get(parameter.name)
            if declaration and (problem := declaration.problem(parameter.value)):
                return SetParametersResult(successful=False, reason=str(problem))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(may_set)


def number_of(node: Node, name: str) -> float:
    """Return what a declared `Number` is now."""
    value: Any = node.get_parameter(name).value  # a number, see `Number.problem`
    return float(value)
