"""Types of messages, services and actions: by their names, and where they are defined."""

import importlib
import os

from ament_index_python import get_resource, get_resources, has_resource

KINDS = {"msg": "message", "srv": "service", "action": "action"}
PARTS = {"msg": ("SLOT_TYPES",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}


class OtherKind(LookupError):
    """What is asked for is there, but of another kind."""


def load(name: str, kind: str) -> type:
    """Return a type by its name, `package/Name` or `package/msg/Name`.

    Raises:
        LookupError: there is no such type of this kind; OtherKind if there is one of another kind.
    """
    parts = name.split("/")
    if len(parts) == 2:
        parts.insert(1, kind)
    try:
        found = getattr(importlib.import_module(".".join(parts[:-1])), parts[-1])
    except (AttributeError, ModuleNotFoundError, ValueError) as error:
        raise LookupError(name) from error
    if not all(hasattr(found, part) for part in PARTS[kind]):
        raise OtherKind(name)
    return found


def all_of(kind: str) -> list[str]:
    """Return the names of all types of a kind, in alphabetic order."""
    endings = (".idl", f".{kind}")
    names = set()
    for package in get_resources("rosidl_interfaces"):
        for line in get_resource("rosidl_interfaces", package)[0].splitlines():
            stem, ending = os.path.splitext(line)
            if "_" not in line and line.startswith(f"{kind}/") and ending in endings:
                names.add(f"{package}/{stem}")
    return sorted(names, key=lambda name: (name.split("/")[0], name))


def definition_file(name: str) -> str:
    """Return the path of a type's definition.

    Raises:
        ValueError: it is no name of a type.
        LookupError: there is no such type.
    """
    parts = name.split("/")
    if len(parts) != 3:
        raise ValueError(f"Invalid name '{name}'. Expected three parts separated by '/'")
    if not all(parts):
        raise ValueError(f"Invalid name '{name}'. Must not contain empty parts")
    if ".." in parts:
        raise ValueError(f"Invalid name '{name}'. Must not contain '..'")
    prefix = has_resource("packages", parts[0])
    if not prefix:
        raise LookupError(f"Unknown package '{parts[0]}'")
    path = os.path.join(prefix, "share", name)
    if "." not in parts[2]:
        if os.path.exists(f"{path}.{parts[1]}"):
            return f"{path}.{parts[1]}"
        path += ".idl"
    if not os.path.exists(path):
        raise LookupError(f"Could not find the interface '{path}'")
    return path


def type_completer(kind: str):
    """Return what completes a word with types of a kind."""
    return lambda **_: all_of(kind)
