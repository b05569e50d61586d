"""Messages as YAML or as comma-separated values, and their fields from YAML."""

import array
import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import yaml
from rosidl_parser import definition

SEQUENCES = (list, tuple, array.array, np.ndarray)


@dataclass(frozen=True)
class Limits:
    """How much of a message is written out: elements of arrays and characters of texts, and whether arrays and texts at all."""

    length: int | None = None
    no_arrays: bool = False
    no_texts: bool = False


class Mapping(dict):
    """Fields of a message, in the order of its definition."""


class _Dumper(yaml.Dumper):
    pass


def _represent(dumper: yaml.Dumper, fields: Mapping) -> yaml.MappingNode:
    pairs = [(dumper.represent_data(name), dumper.represent_data(value)) for name, value in fields.items()]
    return yaml.MappingNode("tag:yaml.org,2002:map", pairs)  # without a style: a block also where lists are in flow style


_Dumper.add_representer(Mapping, _represent)


def to_yaml(message: Any, limits: Limits = Limits(), flow_style: bool = False) -> str:
    """Return a message as YAML, ending in a new line."""
    plain = _plain_fields(message, limits)
    return yaml.dump(plain, Dumper=_Dumper, allow_unicode=True, width=sys.maxsize, default_flow_style=flow_style)


def _typed(message: Any) -> list[tuple[str, Any]]:
    return list(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))


def _plain_fields(message: Any, limits: Limits) -> Mapping:
    return Mapping({name: _plain(getattr(message, name), limits, kind) for name, kind in _typed(message)})


def _plain(value: Any, limits: Limits, kind: Any = None) -> Any:
    if isinstance(value, bytes):
        text = "".join(map(chr, value))
        return text[: limits.length] + "..." if _too_long(value, limits) else text
    if isinstance(value, str):
        if limits.no_texts:
            return f"<string length: <{len(value)}>>"
        return value[: limits.length] + "..." if _too_long(value, limits) else value
    if isinstance(value, SEQUENCES):
        if limits.no_arrays and kind is not None:
            return _array_in_words(value, kind)
        elements = [_plain(element, limits) for element in value[: limits.length]]
        return [*elements, "..."] if _too_long(value, limits) else elements
    if isinstance(value, np.number):
        return value.item()
    if isinstance(value, bool | float | int):
        return value
    return _plain_fields(value, limits)


def _too_long(value: Any, limits: Limits) -> bool:
    return limits.length is not None and len(value) > limits.length


def _array_in_words(value: Any, kind: Any) -> str:
    element = kind.value_type
    if isinstance(element, definition.BasicType):
        name = element.typename
    elif isinstance(element, definition.AbstractString):
        name = "string"
    elif isinstance(element, definition.AbstractWString):
        name = "wstring"
    else:
        name = "/".join(element.namespaced_name())
    if isinstance(kind, definition.Array):
        return f"<array type: {name}[{kind.size}]>"
    bound = f"[{kind.maximum_size}]" if isinstance(kind, definition.BoundedSequence) else ""
    return f"<sequence type: {name}{bound}, length: {len(value)}>"


def to_csv(message: Any, limits: Limits) -> str:
    """Return all fields of a message, in the order of its definition, separated by commas."""
    # What is empty leaves no comma where nothing stands before it, as in the official output.
    line = ""
    for name, kind in _typed(message):
        line += ("," if line else "") + _csv(getattr(message, name), limits, kind)
    return line


def _csv(value: Any, limits: Limits, kind: Any = None) -> str:
    if isinstance(value, SEQUENCES):
        if limits.no_arrays and kind is not None:
            return _array_in_words(value, kind)
        line = ""
        for number, element in enumerate(value):
            line += "," if line else ""
            if limits.length is not None and number >= limits.length:
                return line + "..."
            line += _csv(element, limits)
        return line
    if isinstance(value, bytes | str):
        if limits.no_texts and isinstance(value, str):
            return f"<string length: <{len(value)}>>"
        if _too_long(value, limits):
            value = value[: limits.length] + (b"..." if isinstance(value, bytes) else "...")
        return str(value)
    return str(value) if isinstance(value, bool | float | int | np.number) else to_csv(value, limits)


def fill(message: Any, values: Any, now: bool = False) -> list[Callable]:
    """Set fields of a message from a mapping.

    Args:
        message: to change.
        values: by name of the field; mappings for messages in it.
        now: whether a time may be `now` and a header `auto`.

    Returns:
        Functions to which the present time is given whenever the message goes out.

    Raises:
        AttributeError, TypeError, ValueError, AssertionError: the message does not take these values.
    """
    setters: list[Callable] = []
    _fill(message, values, now, setters)
    return setters


def _fill(message: Any, values: Any, now: bool, setters: list[Callable]) -> None:
    if not hasattr(values, "items"):
        raise TypeError(f"Value '{values}' is expected to be a dictionary but is a {type(values).__name__}")
    kinds = dict(_typed(message))
    for name, given in values.items():
        present = getattr(message, name)
        kind = type(present)
        full_name = f"{kind.__module__}.{kind.__name__}"
        if now and given == "auto" and full_name == "std_msgs.msg._header.Header":
            setters.append(partial(setattr, present, "stamp"))
            continue
        if now and given == "now" and full_name == "builtin_interfaces.msg._time.Time":
            setters.append(partial(setattr, message, name))
            continue
        if kind is array.array:
            value = array.array(present.typecode, given)
        elif kind is np.ndarray:
            value = np.array(given, dtype=present.dtype)
        elif type(given) is kind:
            value = given
        else:
            try:
                value = kind(given)
            except TypeError:
                value = kind()
                _fill(value, given, now, setters)
        nested = kinds[name]
        if isinstance(nested, definition.AbstractNestedType) and isinstance(nested.value_type, definition.NamespacedType):
            element = getattr(importlib.import_module(".".join(nested.value_type.namespaces)), nested.value_type.name)
            for number, given_element in enumerate(value):
                value[number] = element()
                _fill(value[number], given_element, now, setters)
        setattr(message, name, value)
