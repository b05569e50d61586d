"""What hostile data looks like. Everything starts from something good, since what is all wrong is refused at the first look."""

import copy
from array import array
from collections.abc import Callable
from importlib import import_module
from math import inf, nan
from typing import Any

from hypothesis import strategies as st
from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    BasicType,
    NamespacedType,
)

NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, nan, inf, -inf, 5e-324, 1e-300, 1e-12, 1e9, 1e12, 1e18, 1e300, 1.7976931348623157e308]),
    st.floats(),
    st.floats(-300.0, 300.0),
)
"""Any double, the awkward ones often."""

INTEGERS = st.one_of(st.sampled_from([0, 1, -1, 2**31, 2**63 - 1, 2**64, -(2**63), 10**400]), st.integers(-20, 20), st.integers())

NAMES = st.one_of(
    st.sampled_from(["", "path", "time", "0.5", "nan", "optimize", "rrt", "plan", "\0", "ä" * 40, "{0}{x}%s\n\r"]),
    st.text(max_size=20),
    st.integers(60, 90_000).map(lambda count: "a" * count),
)
"""Texts where somebody reads a name."""

ANYTHING = st.recursive(
    st.one_of(st.none(), st.booleans(), INTEGERS, NUMBERS, NAMES),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(NAMES, inner, max_size=3)),
    max_leaves=6,
)
"""Plain data of any kind."""

COUNTS = st.one_of(st.integers(0, 9), st.sampled_from([0, 1, 255, 256, 1000, 20_000]))
"""Lengths of arrays."""


def _places(data: Any, path: tuple = ()) -> list[tuple]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path] * bool(path) + [place for key, item in items for place in _places(item, (*path, key))]


def _numeric(draw: Callable, value: Any) -> Any:
    """Another value of the same kind, most often."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        near = st.floats(0.5, 2.0).map(lambda factor: factor * value if abs(value) < 1e300 else value)
        return draw(st.one_of(NUMBERS, INTEGERS, st.just(-value), near))
    return draw(ANYTHING)


@st.composite
def damaged(draw: Callable, good: Any, most: int = 4) -> Any:
    """Plain data (dicts, lists, scalars) with up to `most` places changed, removed, doubled or added to."""
    data = copy.deepcopy(good)
    for _ in range(draw(st.sampled_from([0, 1, 1, 1, 2, most]))):
        places = _places(data)
        if not places:
            break
        *parents, key = draw(st.sampled_from(places))
        target = data
        for parent in parents:
            target = target[parent]
        match draw(st.sampled_from(["change", "change", "kind", "remove", "double", "add", "grow"])):
            case "change":
                target[key] = _numeric(draw, target[key])
            case "kind":
                target[key] = draw(ANYTHING)
            case "remove":
                del target[key]
            case "double" if isinstance(target, list):
                target.insert(key, copy.deepcopy(target[key]))
            case "grow" if isinstance(target[key], list) and len(str(target[key])) < 10_000:
                target[key] = target[key] * draw(st.integers(0, 40))
            case _ if isinstance(target, dict):
                target[draw(NAMES)] = draw(ANYTHING)
    return data


@st.composite
def spliced(draw: Callable, texts: list[str], tokens: list[str], most: int = 6) -> str:
    """A good text, cut, doubled and mixed with tokens of its language."""
    text = draw(st.sampled_from(texts))
    for _ in range(draw(st.sampled_from([1, 1, 2, most]))):
        begin = draw(st.integers(0, len(text)))
        end = min(len(text), begin + draw(st.integers(0, 40)))
        insert = draw(
            st.one_of(
                st.sampled_from(tokens),
                st.just(text[begin:end] * 2),
                NUMBERS.map(repr),
                INTEGERS.map(lambda n: str(n)[:300]),
                st.text(max_size=4),
            )
        )
        text = text[:begin] + insert + text[end:]
    return text


# ROS messages: only what the wire can carry, any of it

_INTEGER_BITS = {"uint8": (0, 8), "uint16": (0, 16), "uint32": (0, 32), "uint64": (0, 64), "int32": (1, 32), "octet": (0, 8)}


def _of_type(kind: Any) -> st.SearchStrategy:
    if isinstance(kind, AbstractNestedType):
        inner = _of_type(kind.value_type)
        few = st.lists(inner, max_size=6)
        return (
            few if isinstance(kind.value_type, NamespacedType) else st.one_of(few, st.builds(lambda v, n: [v] * n, inner, COUNTS))
        )
    if isinstance(kind, AbstractString):
        return NAMES.map(lambda text: text.encode("utf-8", "replace").decode())
    if isinstance(kind, NamespacedType):
        return messages(_class(kind))
    if isinstance(kind, BasicType) and kind.typename in ("double", "float"):
        return NUMBERS
    if kind.typename == "boolean":
        return st.booleans()
    signed, bits = _INTEGER_BITS[kind.typename]
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    return st.one_of(st.sampled_from([low, high]), st.integers(max(low, -3), min(high, 12)), st.integers(low, high))


def _class(kind: NamespacedType) -> type:
    return getattr(import_module(".".join(kind.namespaces)), kind.name)


def messages(message_class: type, most: int = 3, /, **plausible: Any) -> st.SearchStrategy:
    """Messages: their fields are as in `plausible` (strategies or values), but for up to `most` that are anything of their type.

    Fields that are not named are empty.
    """
    return _messages(message_class, most, plausible)


@st.composite
def _messages(draw: Callable, message_class: type, most: int, plausible: dict[str, Any]) -> Any:
    types = dict(zip(message_class.get_fields_and_field_types(), message_class.SLOT_TYPES, strict=True))
    most = min(draw(st.sampled_from([0, 0, 1, most])), len(types))
    hostile = draw(st.sets(st.sampled_from(sorted(types)), max_size=most)) if most else ()
    values = {name: draw(value) if isinstance(value, st.SearchStrategy) else value for name, value in plausible.items()}
    for name in sorted(hostile):
        values[name] = draw(_of_type(types[name]))
    return message_class(**{name: _packed(types[name], value) for name, value in values.items()})


_PACKED = {"double": "d", "uint8": "B", "uint16": "H", "uint32": "I"}


def _packed(kind: Any, value: Any) -> Any:
    """Numbers as rclpy hands them to callbacks: in arrays."""
    if isinstance(kind, AbstractNestedType) and isinstance(kind.value_type, BasicType) and isinstance(value, list):
        return array(_PACKED[kind.value_type.typename], value) if kind.value_type.typename in _PACKED else value
    return value


def fields_of(message: Any) -> dict[str, Any]:
    """Return the fields of a message, for `messages` to start from."""
    return {name: getattr(message, name) for name in message.get_fields_and_field_types()}
