"""What a message may hold at most: whoever sends more is refused, by all nodes alike, and holds nobody up.

ROS turns whatever comes into Python objects before a node sees it, under the interpreter's lock: half a second for a request of
20 000 parameters, in which no thread runs. So the parameter services look at what came before that.
"""

import ctypes
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.node import Node
from rclpy.service import Service
from stressbot_msgs.wording import sentence

LONGEST_NAME, LONGEST_TEXT = 200, 4096
"""Characters of a plan's, swarm's or planner's name, and of any other text but for codewords."""

MOST_ENTRIES = 100_000
"""Of a list, unless COUNTS says otherwise: 10 000 robots have 30 000 coordinates."""

MOST_PARAMETERS = 200
"""In one request; no node has a quarter of them."""

LENGTHS = dict.fromkeys(("plan_id", "refused_plan_id", "swarm_id", "planner", "objective"), LONGEST_NAME) | {"codewords": 10_000}

COUNTS = {
    "levels": 20_000_000,
    "dwells": 20_000_000,
    "epoch_ends": 20_000_000,
    "pulses": 20_000_000,
    "low_levels": 20_000_000,
    "codes": 20_000_000,
    "primitives": 500_000,
    "waypoint": 2_000_000,
}

_ASKING = (GetParameters, GetParameterTypes, DescribeParameters, ListParameters)
_SETTING = (SetParameters, SetParametersAtomically)


def excess(message: Any, place: str = "") -> tuple[str, str] | None:
    """Return the field of a message that holds too much, and what to change; None if there is none."""
    for field in message.get_fields_and_field_types():
        value, name = getattr(message, field), place + field
        if isinstance(value, str):
            problem = _too_long(value, field, name)
        elif hasattr(value, "get_fields_and_field_types"):
            problem = excess(value, f"{name}.")
        elif hasattr(value, "__len__"):
            problem = _too_many(value, field, name)
        else:
            continue
        if problem:
            return problem
    return None


def _too_long(text: str, field: str, name: str) -> tuple[str, str] | None:
    most = LENGTHS.get(field, LONGEST_TEXT)
    return (name, f"has {len(text)} characters, the most is {most}: shorten it") if len(text) > most else None


def _too_many(values: Any, field: str, name: str) -> tuple[str, str] | None:
    most = COUNTS.get(field, MOST_ENTRIES)
    if len(values) > most:
        return name, f"has {len(values)} entries, the most is {most}: send less"
    if isinstance(values, list):
        for index, value in enumerate(values):
            if isinstance(value, str):
                problem = _too_long(value, field, f"{name}[{index}]")
            elif hasattr(value, "get_fields_and_field_types"):
                problem = excess(value, f"{name}[{index}].")
            else:
                return None  # of numbers, as the others are
            if problem:
                return problem
    return None


def within(node: Node, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a callback of a subscription that leaves out messages that hold too much; the log says so once."""
    said = False

    def heard(message: Any) -> None:
        nonlocal said
        problem = excess(message)
        if problem is None:
            callback(message)
        elif not said:
            said = True
            node.get_logger().warning(f"{topic} is not heard: {problem[0]} {problem[1]}")

    return heard


def bound_parameter_requests(node: Node) -> None:
    """Refuse requests for more than MOST_PARAMETERS parameters before they cost anything, and those that cannot be answered."""
    for service in node.services:
        if service.srv_type in (*_ASKING, *_SETTING):
            _bound(service)


def _bound(service: Service) -> None:
    kind, answer = service.srv_type, service.callback

    def bounded(request: Any, response: Any) -> Any:
        problem = ("the request", f"has more than {MOST_PARAMETERS} entries: send less") if request is None else excess(request)
        if problem is None:
            try:
                return answer(request, response)
            except Exception as error:  # such as a type of value that does not exist, which would end the node
                problem, response = ("the request", f"cannot be answered ({error}): correct it"), kind.Response()
        refusal = SetParametersResult(successful=False, reason=sentence(" ".join(problem)))
        if kind is SetParameters:
            response.results = [refusal] * (1 if request is None else len(request.parameters))
        elif kind is SetParametersAtomically:
            response.result = refusal
        return response  # to the others the same as for a name that nobody has declared: nothing

    service.callback = bounded
    service.srv_type = SimpleNamespace(Request=_limited(kind.Request), Response=kind.Response)


def _limited(request: type) -> type:
    """Return a request type that ROS reads as None if it has too many entries; they are its first field.

    In C that is a pointer to the data, then their number.
    """
    metaclass = type(request)
    get, new = ctypes.pythonapi.PyCapsule_GetPointer, ctypes.pythonapi.PyCapsule_New
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    new.restype, new.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    reader = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
    whole = reader(get(metaclass._CONVERT_TO_PY, None))

    def read(message: int) -> Any:
        count = ctypes.c_size_t.from_address(message + ctypes.sizeof(ctypes.c_void_p)).value
        return None if count > MOST_PARAMETERS else whole(message)

    kept = reader(read)  # lives as long as the type does
    capsule = new(ctypes.cast(kept, ctypes.c_void_p), None, None)
    limited = type(metaclass)(metaclass.__name__, (metaclass,), {"_CONVERT_TO_PY": capsule})
    return limited(request.__name__, (), {"_kept": kept})
