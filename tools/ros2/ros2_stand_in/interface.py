"""`ros2 interface`: list, show."""

import argparse
import sys
from pathlib import Path

from rosidl_adapter.parser import Field, parse_message_string

from ros2_stand_in.interfaces import KINDS, all_of, definition_file
from ros2_stand_in.verbs import argument, verb, verbs


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    added = verbs(family)

    listed = verb(added, "list", _list, "List all interface types available")
    for kind, word in KINDS.items():
        listed.add_argument(
            f"-{kind[0]}", f"--only-{kind}s", dest=kind, action="store_true", help=f"Print out only the {word} types"
        )

    show = verb(added, "show", _show, "Output the interface definition")
    group = show.add_mutually_exclusive_group()
    group.add_argument(
        "--all-comments", action="store_true", help="Show all comments, including for nested interface definitions"
    )
    group.add_argument("--no-comments", action="store_true", help="Show no comments or whitespace")
    argument(
        show, lambda **_: sorted(name for kind in KINDS for name in all_of(kind)), "type", action=_FromStandardInput,
        help="Show an interface definition (e.g. 'example_interfaces/msg/String'). Passing '-' reads the argument from stdin (e.g. "
        "'ros2 topic type /chatter | ros2 interface show -').",
    )


class _FromStandardInput(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        if values == "-":
            if sys.stdin.isatty():
                parser.error("expected stdin pipe")
            values = sys.stdin.readline().strip()
        if not values:
            parser.error("the passed value is empty")
        setattr(namespace, self.dest, values)


def _list(options: argparse.Namespace) -> None:
    chosen = [kind for kind in KINDS if getattr(options, kind)] or list(KINDS)
    for kind in chosen:
        print(f"{KINDS[kind].capitalize()}s:")
        for name in all_of(kind):
            print(f"    {name}")


def _show(options: argparse.Namespace) -> str | None:
    try:
        _print_definition(options.type, not options.no_comments, options.all_comments, "")
    except (ValueError, LookupError) as error:
        return str(error.args[0])
    return None


def _print_definition(name: str, comments: bool, comments_inside: bool, indent: str) -> None:
    package, _, message = name.split("/")
    for line in Path(definition_file(name)).read_text(encoding="utf-8").splitlines():
        line = line.rstrip()
        field, comment = (None, []) if line == "---" else _parsed(package, message, line)
        if comments:
            print(indent + line if line else "")
        elif line and comment is not None:
            print(indent + (line[: line.find(comment[0]) - 1].strip() if comment else line))
        if field is not None and "/" in str(field.type):
            inner = str(field.type).partition("[")[0].replace("/", "/msg/")
            _print_definition(inner, comments_inside, comments_inside, indent + "\t")


def _parsed(package: str, message: str, line: str) -> tuple[Field | None, list[str] | None]:
    """Return the field that a line defines, if it does, and the comment behind it; None for a line that is all comment."""
    definition = parse_message_string(package, message, line)
    if definition.annotations["comment"]:
        return None, None
    (element,) = [*definition.fields, *definition.constants] or [None]
    comment = element.annotations["comment"] if element is not None else []
    return next(iter(definition.fields), None), comment
