"""A setting as data: what the driver node declares as a ROS parameter, without ROS."""

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Declaration:
    """One setting. Its kind is that of the default: a number, a whole number, text, true or false, or a list (a tuple).

    Numbers may be given as whole numbers too: `0` means `0.0` to everybody but ROS. `listable` says that instead of one
    number a list may be given. Who reads a list checks what is in it. `least` is the smallest number besides 0.
    """

    name: str
    default: Any
    description: str
    low: float = -math.inf
    high: float = math.inf
    read_only: bool = False
    listable: bool = False
    least: float = 0.0

    def problem(self, value: Any) -> str | None:
        """Why `value` is refused, or None."""
        kind = type(self.default)
        is_list = isinstance(value, Sequence) and not isinstance(value, str) or isinstance(value, array)
        if kind is tuple:
            return None if is_list else f"{value!r} must be a list"
        if self.listable and is_list:
            return None
        if kind in (int, float):
            if isinstance(value, bool) or not isinstance(value, (int, kind)):
                return f"{value!r} is not a {'whole ' if kind is int else ''}number"
            if not self.low <= value <= self.high:  # NaN fails as well
                return f"{value!r} must lie between {self.low:g} and {self.high:g}"
            if 0.0 < abs(value) < self.least:
                return f"{value!r} must be 0, or at least {self.least:g}"
        elif not isinstance(value, kind):
            return f"{value!r} must be {'true or false' if kind is bool else 'text'}"
        return None
