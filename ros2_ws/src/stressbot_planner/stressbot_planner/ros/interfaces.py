"""Message types by their names, and their definitions in ROS 2's message language."""

import importlib
import re
from functools import cache
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

SEPARATOR = "=" * 80 + "\n"
PLAIN = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
OF_ACTION = {"FeedbackMessage": "Impl.FeedbackMessage", "Goal": "Goal", "Result": "Result", "Feedback": "Feedback"}
ARRAY = re.compile(r"(?:sequence<(?P<element>.*?)(?:, (?P<most>\d+))?>|(?P<of>.*)\[(?P<count>\d+)\])$")


@cache
def load(name: str) -> type:
    """Return a message type by its name, also one that belongs to a service or an action.

    Raises:
        LookupError: it is not installed here.
    """
    try:
        package, kind, short = name.split("/")
        module = importlib.import_module(f"{package}.{kind}")
        owner, _, part = short.rpartition("_")
        if kind == "action" and part in OF_ACTION:
            found = getattr(module, owner)
            for attribute in OF_ACTION[part].split("."):
                found = getattr(found, attribute)
            return found
        return getattr(module, short)
    except (ImportError, AttributeError, ValueError) as error:
        raise LookupError(name) from error


@cache
def definition(name: str) -> str:
    """Return the definition of a message type and, behind it, of all types in it. Raises LookupError as `load` does."""
    names = [name]
    for present in names:  # grows meanwhile
        for field in load(present).get_fields_and_field_types().values():
            element = _element(field)[0]
            if "/" in element and (nested := _full(element, present)) not in names:
                names.append(nested)
    first, *others = names
    return _own(first) + "".join(f"{SEPARATOR}MSG: {_short(other)}\n{_own(other)}" for other in others)


def _own(name: str) -> str:
    package, kind, short = name.split("/")
    if kind == "msg":
        try:
            text = Path(get_package_share_directory(package), kind, f"{short}.msg").read_text(encoding="utf-8")
            return text if text.endswith("\n") else text + "\n"
        except (PackageNotFoundError, OSError):
            pass
    fields = load(name).get_fields_and_field_types()
    return "".join(f"{_in_message_language(kind)} {field}\n" for field, kind in fields.items())


def _in_message_language(field: str) -> str:
    element, bounds = _element(field)
    bounded = re.fullmatch(r"(w?string)<(\d+)>", element)
    return (f"{bounded[1]}<={bounded[2]}" if bounded else PLAIN.get(element, element)) + bounds


def _element(field: str) -> tuple[str, str]:
    """Return the type of a field's elements, and its brackets, if it is an array."""
    match = ARRAY.match(field)
    if match is None:
        return field, ""
    if match["of"]:
        return match["of"], f"[{match['count']}]"
    return match["element"], f"[<={match['most']}]" if match["most"] else "[]"


def _full(short: str, where: str) -> str:
    """Return the full name of a type in a field of type `where`: one of the same service or action, or a plain message."""
    package, name = short.split("/")
    of_same = f"{package}/{where.split('/')[1]}/{name}"
    try:
        load(of_same)
        return of_same
    except LookupError:
        return f"{package}/msg/{name}"


def _short(name: str) -> str:
    package, _, short = name.split("/")
    return f"{package}/{short}"
