"""From a scenario file to a checked mapping: YAML, finite numbers, and the schema that stressbot_msgs ships."""

import json
import math
import re
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from stressbot_driver.errors import BenchError, ErrorCode

MAX_DEPTH = 20
_TYPE_NAMES = {
    dict: "a mapping",
    list: "a list",
    str: "text",
    bool: "true or false",
    int: "a number",
    float: "a number",
    type(None): "empty",
}


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """The safe loader, in C where PyYAML has it, that refuses a key given twice instead of keeping the last.

    Floats are those of YAML 1.2: 1e-4 is a number, which YAML 1.1 takes for text.
    """

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key_node, _ in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} is given twice: keep one", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


def read_scenario(path: str | Path) -> dict[str, Any]:
    """The content of a scenario file, valid by the schema, every number finite.

    Raises BenchError: UNREADABLE_FILE, MALFORMED_FILE, NOT_FINITE, MISSING_FIELD, UNKNOWN_FIELD, WRONG_TYPE,
    OUT_OF_RANGE, WRONG_COUNT or INVALID_CODEWORD.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BenchError(ErrorCode.MALFORMED_FILE, "scenario", f"{path} is not UTF-8 text: save it as UTF-8 YAML") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise BenchError(
            ErrorCode.UNREADABLE_FILE, "scenario", f"{path} cannot be read ({reason}): give the path of a scenario file"
        ) from error
    return parse_scenario(text)


def parse_scenario(text: str) -> dict[str, Any]:
    """As `read_scenario`, from text."""
    try:
        _check_structure(text)
        content = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        where = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        line = f" at line {where.line + 1}" if where else ""
        raise BenchError(
            ErrorCode.MALFORMED_FILE, "scenario", f"not valid YAML{line} ({problem}): is the file cut short?"
        ) from error
    if not isinstance(content, dict):
        raise BenchError(
            ErrorCode.MALFORMED_FILE,
            "scenario",
            f"the file holds {_kind(content)}, not a mapping: start with `name: …`, `swarm: …`, `robots: …`",
        )
    _check_numbers(content)
    _check_schema(content)
    return content


def _check_structure(text: str) -> None:
    """Refuse what a hostile file can do to a loader: aliases unfold without end, and deep nesting overflows the
    stack of the C loader, which ends the process without an exception. Reading events is safe from both. Tags on the wrong kind
    of value end the loader in exceptions of any class.
    """
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise BenchError(
                ErrorCode.MALFORMED_FILE,
                "scenario",
                f"the alias *{event.anchor} at line {event.start_mark.line + 1} is not supported: write the value out",
            )
        if getattr(event, "tag", None):
            raise BenchError(
                ErrorCode.MALFORMED_FILE,
                "scenario",
                f"the tag {event.tag!r} at line {event.start_mark.line + 1} is not supported: leave it out",
            )
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                raise BenchError(
                    ErrorCode.MALFORMED_FILE,
                    "scenario",
                    f"nested deeper than {MAX_DEPTH} levels at line {event.start_mark.line + 1}: a scenario needs 5",
                )
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _check_numbers(content: dict) -> None:
    """Refuse NaN, infinities and integers beyond a double."""
    pending: list[tuple[tuple, Any]] = [((), content)]
    while pending:
        path, value = pending.pop()
        if isinstance(value, (dict, list)):
            items = value.items() if isinstance(value, dict) else enumerate(value)
            pending.extend(((*path, key), item) for key, item in items)
        elif isinstance(value, float) and not math.isfinite(value):
            raise BenchError(ErrorCode.NOT_FINITE, _name(path), f"{value} is not a finite number: write a finite one")
        elif isinstance(value, int) and value.bit_length() > 1000:
            raise BenchError(ErrorCode.NOT_FINITE, _name(path), "this number is too large for a double")


def _is_number(_checker: Any, value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _validator() -> jsonschema.protocols.Validator:
    schema = json.loads(resources.files("stressbot_msgs").joinpath("scenario.schema.json").read_text("utf-8"))
    strict = jsonschema.validators.extend(
        jsonschema.Draft202012Validator,
        type_checker=jsonschema.Draft202012Validator.TYPE_CHECKER.redefine("number", _is_number),
    )
    return strict(schema)


def _check_schema(content: dict) -> None:
    problems = _problems(_validator().iter_errors(content))
    first = min(problems, key=lambda error: [str(part) for part in error.absolute_path], default=None)
    if first is not None:
        raise _refusal(first)


def _problems(errors: Iterator) -> Iterator:
    """Leaves of the error tree: of a `oneOf`, those of the alternative that was meant."""
    for error in errors:
        if error.validator == "oneOf" and error.context:
            by_alternative: dict[int, list] = {}
            for inner in error.context:
                by_alternative.setdefault(inner.schema_path[0], []).append(inner)
            # The alternative of the right type, if there is one, fails deeper than with "wrong type" at its top.
            meant = [
                inner
                for alternative in by_alternative.values()
                if not any(e.validator == "type" and not e.path for e in alternative)
                for inner in alternative
            ]
            yield from _problems(meant) if meant else [error]
        else:
            yield error


def _refusal(error: Any) -> BenchError:
    """The numbered refusal for one schema error."""
    path, value, limit = tuple(error.absolute_path), error.instance, error.validator_value
    field, keyword = _name(path), error.validator
    if keyword == "required":
        missing = next(key for key in limit if key not in value)
        return BenchError(ErrorCode.MISSING_FIELD, _name((*path, missing)), "is missing: add it")
    if keyword == "additionalProperties":
        known = error.schema["properties"]
        extra = next(key for key in value if key not in known)
        return BenchError(
            ErrorCode.UNKNOWN_FIELD,
            _name((*path, extra)),
            f"nothing reads this key: remove it, or use one of {', '.join(known)}",
        )
    if keyword in ("minProperties", "maxProperties"):
        code = ErrorCode.MISSING_FIELD if keyword == "minProperties" else ErrorCode.UNKNOWN_FIELD
        return BenchError(code, field, f"must hold exactly one of {', '.join(error.schema['properties'])}")
    if keyword in ("minItems", "maxItems"):
        bound = "at least" if keyword == "minItems" else "at most"
        return BenchError(ErrorCode.WRONG_COUNT, field, f"has {len(value)} entries: give {bound} {limit}")
    if keyword == "exclusiveMinimum":
        return BenchError(ErrorCode.OUT_OF_RANGE, field, f"is {value}: must be greater than {limit}")
    if keyword == "minimum":
        return BenchError(ErrorCode.OUT_OF_RANGE, field, f"is {value}: must be at least {limit}")
    if keyword == "enum":
        meaning = error.parent.schema.get("description") if error.parent else None
        return BenchError(ErrorCode.OUT_OF_RANGE, field, f"is {value!r}: write {meaning or ' or '.join(map(str, limit))}")
    if keyword == "minLength":
        return BenchError(ErrorCode.OUT_OF_RANGE, field, "is empty: write something")
    if path[:2] == ("swarm", "groups") and len(path) == 3:
        return BenchError(
            ErrorCode.INVALID_CODEWORD,
            field,
            f'{value!r} is not a string: quote them, as in ["001", "010"], or YAML reads a number',
        )
    if keyword == "oneOf":
        return BenchError(ErrorCode.WRONG_TYPE, field, f"is {_kind(value)}: {error.schema.get('description', 'see the schema')}")
    if keyword == "type":
        return BenchError(ErrorCode.WRONG_TYPE, field, f"is {_kind(value)}: must be {_article(limit)}")
    return BenchError(ErrorCode.WRONG_TYPE, field, error.message)


def _kind(value: Any) -> str:
    return _TYPE_NAMES.get(type(value), type(value).__name__)


def _article(json_type: str) -> str:
    return {
        "object": "a mapping",
        "array": "a list",
        "string": "text",
        "number": "a number",
        "integer": "a whole number",
    }.get(json_type, json_type)


def _name(path: tuple) -> str:
    """`robots[2].start[0]` for ("robots", 2, "start", 0)."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.lstrip(".") or "scenario"
