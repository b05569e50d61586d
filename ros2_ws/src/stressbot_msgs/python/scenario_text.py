"""From the text of a scenario file to plain data that the schema allows: the one way in, for the planner and the driver alike.

YAML has versions that read the same text differently: `010` is 8 or 10, `1:30` is 90 or text, `no` is false or text. Here a number
is what its decimal digits say, and plain text that some version takes for something else is refused. The limits of all values, and
how many there may be of each, stand in `scenario.schema.json` and nowhere else.
"""

import difflib
import errno
import json
import math
import os
import re
import stat
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jsonschema
import yaml
from stressbot_msgs.errors import ErrorCode, StressbotError
from stressbot_msgs.wording import printable, quoted, shortened

MAX_BYTES = 4_000_000
"""Of a file: more than twice what 10 000 robots need."""

MAX_DEPTH = 20
"""Levels of nesting; a scenario needs 5. Far more would end the YAML library, and with it the process."""


def read_regular(path: str | Path, most: int) -> bytes:
    """Return what a file holds, and one byte more than `most` if it holds more. Pipes and devices may never end.

    Raises:
        OSError: it cannot be read, or is no regular file.
        ValueError: the path has a null character.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        return stream.read(most + 1)


def read(path: str | Path) -> dict[str, Any]:
    """Return the content of a scenario file.

    Raises:
        StressbotError: UNREADABLE_FILE, MALFORMED_FILE, NOT_FINITE, MISSING_FIELD, UNKNOWN_FIELD, WRONG_TYPE, OUT_OF_RANGE,
            WRONG_COUNT, INVALID_CODEWORD, NO_ROBOTS or TOO_MANY_ROBOTS.
    """
    try:
        content = read_regular(path, MAX_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise StressbotError(
            ErrorCode.UNREADABLE_FILE, "scenario", f"{path} cannot be read ({reason}): name a scenario file"
        ) from error
    if len(content) > MAX_BYTES:
        raise _malformed(f"{path} has more than {MAX_BYTES} bytes: is it a scenario file?")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise StressbotError(ErrorCode.UNREADABLE_FILE, "scenario", f"{path} is not UTF-8 text: save it as UTF-8") from error
    return parse(text)


def parse(text: str) -> dict[str, Any]:
    """As `read`, from text."""
    content = plain(text)
    if not isinstance(content, dict):
        raise _malformed(f"holds {_kind(content)}, not a mapping: write name: …, swarm: …, robots: …")
    if content.keys() >= {"primitives", "activations"}:
        raise _malformed("this is a plan file: give the scenario file here; a plan comes behind it")
    error = next(_validator().iter_errors(content), None)
    if error is not None:
        raise _refusal(_meant(error), text)
    return content


def plain(text: str) -> Any:
    """Return what YAML text holds, of a scenario file or another: mappings, lists, text and numbers. Raises MALFORMED_FILE."""
    return _content(text, _scalar)


@cache
def schema() -> dict[str, Any]:
    """Return the schema of scenario files."""
    return json.loads((resources.files("stressbot_msgs") / "scenario.schema.json").read_text("utf-8"))


def defaults(section: str) -> dict[str, Any]:
    """Return the values that the schema gives for what a section leaves out."""
    properties = schema()["properties"][section]["properties"]
    return {key: value["default"] for key, value in properties.items() if "default" in value}


# --- YAML ---------------------------------------------------------------------------------------------------------


class _Ambiguous:
    """A plain scalar that readers of YAML take for different values."""


_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9]*)")
_DECIMAL = re.compile(r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"([-+]?)\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
_OTHER_NUMBERS = re.compile(r"[-+]?0[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?|[-+]?0o[0-7]+|[-+]?0[xX][0-9a-fA-F]+")
_WORDS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_WORDS |= dict.fromkeys(("", "~", "null", "Null", "NULL"))
_LONGEST_INTEGER = 400
"""Digits; longer ones are no doubles anyway, and Python refuses to convert far longer ones."""


def _scalar(event: yaml.ScalarEvent) -> Any:
    text = event.value
    if not event.implicit[0]:  # in quotes, or a block
        return text
    if _DECIMAL.fullmatch(text):
        return int(text) if _INTEGER.fullmatch(text) and len(text) <= _LONGEST_INTEGER else float(text)
    if text in _WORDS:
        return _WORDS[text]
    if match := _NOT_FINITE.fullmatch(text):
        return math.nan if match[1] is None else math.copysign(math.inf, -1.0 if match[1] == "-" else 1.0)
    yaml_1_1 = yaml.SafeLoader.yaml_implicit_resolvers.get(text[:1], ())
    if _OTHER_NUMBERS.fullmatch(text) or any(pattern.match(text) for _, pattern in yaml_1_1):
        return _Ambiguous()
    return text


def _as_written(event: yaml.ScalarEvent) -> str:
    return event.value


def _content(text: str, scalar) -> Any:
    """Build what YAML text holds, each scalar by a function of its event."""
    try:
        return _built(text, scalar)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: lone surrogates
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or "cannot be read as YAML"
        raise _malformed(f"{where}{problem}: is the file complete, and YAML?") from error


_NOTHING = object()


def _built(text: str, scalar) -> Any:
    """Read events, and refuse what a hostile file can do to whoever builds its values: unfold without end, or nest too deep."""
    whole, documents = None, 0
    parents: list[list] = []  # container, key that waits for a value
    for event in yaml.parse(text, Loader=_PARSER):
        line = f"line {event.start_mark.line + 1}"
        if isinstance(event, yaml.DocumentStartEvent):
            documents += 1
            if documents > 1:
                raise _malformed(f"{line}: a second document begins with ---: leave one")
        if isinstance(event, yaml.CollectionEndEvent):
            parents.pop()
        if not isinstance(event, yaml.NodeEvent):
            continue
        if isinstance(event, yaml.AliasEvent):
            raise _malformed(f"{line}: *{event.anchor} is an alias: write the value out")
        if event.tag:
            raise _malformed(f"{line}: {event.tag} is a tag: leave it out")
        is_key = bool(parents) and isinstance(parents[-1][0], dict) and parents[-1][1] is _NOTHING
        if is_key:
            container = parents[-1][0]
            if not isinstance(event, yaml.ScalarEvent):
                raise _malformed(f"{line}: a key must be a word")
            if event.value in container:
                raise _malformed(f"{line}: the key {quoted(event.value)} stands twice: keep one")
            container[event.value] = None
            parents[-1][1] = event.value
            continue
        if isinstance(event, yaml.ScalarEvent):
            value = scalar(event)
        else:
            value = {} if isinstance(event, yaml.MappingStartEvent) else []
        if not parents:
            whole = value
        elif isinstance(parents[-1][0], dict):
            parents[-1][0][parents[-1][1]] = value
            parents[-1][1] = _NOTHING
        else:
            parents[-1][0].append(value)
        if isinstance(event, yaml.CollectionStartEvent):
            parents.append([value, _NOTHING])
            if len(parents) > MAX_DEPTH:
                raise _malformed(f"{line}: nests deeper than {MAX_DEPTH} levels")
    return whole


def _malformed(message: str) -> StressbotError:
    return StressbotError(ErrorCode.MALFORMED_FILE, "scenario", message)


# --- schema -------------------------------------------------------------------------------------------------------


@cache
def _validator() -> jsonschema.protocols.Validator:
    base = jsonschema.Draft202012Validator
    types = base.TYPE_CHECKER.redefine("number", lambda _, value: _is_number(value) and _is_finite(value))
    return jsonschema.validators.extend(base, type_checker=types)(schema())


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_finite(value: float) -> bool:
    return value.bit_length() < 1024 if isinstance(value, int) else math.isfinite(value)


def _meant(error: jsonschema.ValidationError) -> jsonschema.ValidationError:
    """Return what is wrong with the alternative that was meant: the one of the right type."""
    while error.context:
        other = {inner.schema_path[0] for inner in error.context if inner.validator == "type" and not inner.path}
        meant = [inner for inner in error.context if inner.schema_path[0] not in other]
        if not meant:
            break
        error = max(meant, key=lambda e: (len(e.absolute_path), e.validator != "type"))
    return error


def _refusal(error: jsonschema.ValidationError, text: str) -> StressbotError:
    path, value, limit, rule = list(error.absolute_path), error.instance, error.validator_value, error.schema
    if error.validator in ("required", "additionalProperties"):
        return _wrong_keys(path, value, rule)
    field = _field(path) or "scenario"
    match error.validator:
        case "type" | "oneOf":
            return _wrong_type(path, field, value, _written(text, path), error)
        case "minimum" | "maximum":
            return StressbotError(ErrorCode.OUT_OF_RANGE, field, f"is {_written(text, path)}: give a number {_range(rule)}")
        case "enum":
            meaning = error.parent.schema.get("description") if error.parent else None
            return StressbotError(
                ErrorCode.OUT_OF_RANGE, field, f"is {quoted(value)}: give {meaning or ' or '.join(map(str, limit))}"
            )
        case "minLength":
            return StressbotError(ErrorCode.OUT_OF_RANGE, field, "is empty: write something")
        case "maxLength":
            code = ErrorCode.INVALID_CODEWORD if path[:2] == ["swarm", "groups"] else ErrorCode.OUT_OF_RANGE
            return StressbotError(code, field, f"has {len(value)} characters: give at most {limit}")
        case "pattern":
            wrong = next(character for character in value if not re.search(limit, character))
            return StressbotError(
                ErrorCode.OUT_OF_RANGE, field, f"holds the control character U+{ord(wrong):04X}: use printable characters only"
            )
        case "minItems" | "maxItems" if path == ["robots"]:
            if value:
                return StressbotError(ErrorCode.TOO_MANY_ROBOTS, field, f"lists {len(value)} robots: give at most {limit}")
            return StressbotError(ErrorCode.NO_ROBOTS, field, "is empty: list at least one robot")
        case "minItems" | "maxItems":
            return StressbotError(ErrorCode.WRONG_COUNT, field, f"has {len(value)} entries: give {_count(rule)}")
        case "minProperties" | "maxProperties":
            code = ErrorCode.MISSING_FIELD if error.validator == "minProperties" else ErrorCode.UNKNOWN_FIELD
            return StressbotError(code, field, f"must hold exactly one of {', '.join(rule['properties'])}")
    raise AssertionError(f"the schema has a rule without a sentence: {error.validator}")


def _wrong_keys(path: list, value: dict, rule: dict) -> StressbotError:
    """An unknown key comes first: more often than not it is the missing one, misspelt."""
    known = list(rule["properties"])
    unknown = next((key for key in value if key not in known), None)
    if unknown is None:
        missing = next(key for key in rule["required"] if key not in value)
        return StressbotError(ErrorCode.MISSING_FIELD, _field([*path, missing]), "is missing: add it")
    near = difflib.get_close_matches(unknown[:100], [key for key in known if key not in value], n=1)
    hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(known)}"
    return StressbotError(ErrorCode.UNKNOWN_FIELD, _field([*path, unknown]), f"is unknown here: {hint}")


def _wrong_type(path: list, field: str, value: Any, shown: str, error: jsonschema.ValidationError) -> StressbotError:
    if path[:2] == ["swarm", "groups"] and len(path) == 3:
        example = shown if shown and not set(shown) - {"0", "1"} else "0110"
        return StressbotError(ErrorCode.INVALID_CODEWORD, field, f'is {shown}: put codewords in quotes, as in "{example}"')
    if _is_number(value) and not _is_finite(value):
        return StressbotError(ErrorCode.NOT_FINITE, field, f"is {shown}, which is no finite double: give a finite number")
    wanted = error.schema["description"] if error.validator == "oneOf" else _TYPES[error.validator_value]
    if isinstance(value, _Ambiguous):
        hint = "put text in quotes" if wanted == "text" else f"give {wanted}, in plain decimal digits if it is one"
        return StressbotError(ErrorCode.WRONG_TYPE, field, f"is {shown}, which readers of YAML take for different values: {hint}")
    is_plain = _is_number(value) or isinstance(value, str) and value
    return StressbotError(ErrorCode.WRONG_TYPE, field, f"is {shown if is_plain else _kind(value)}: give {wanted}")


_TYPES = {"object": "a mapping", "array": "a list", "string": "text", "number": "a number", "integer": "a whole number"}


def _kind(value: Any) -> str:
    if value is None or value == "":
        return "empty"
    if isinstance(value, bool):
        return "true or false"
    return "a mapping" if isinstance(value, dict) else "a list" if isinstance(value, list) else "text or a number"


def _range(rule: dict) -> str:
    return f"from {rule['minimum']:g} to {rule['maximum']:g}"


def _count(rule: dict) -> str:
    least, most = rule.get("minItems", 0), rule.get("maxItems")
    if least == most:
        return f"[{rule['description']}]"
    return f"at least {least}" if most is None else f"{least} to {most}"


def _field(path: list) -> str:
    """Return `robots[2].start[0]` for ["robots", 2, "start", 0]."""
    text = ""
    for part in path:
        name = printable(shortened(part)) or "''" if isinstance(part, str) else ""
        text += f"[{part}]" if isinstance(part, int) else f".{name}" if text else name
    return text


def _written(text: str, path: list) -> str:
    """Return a scalar of the file as it was written there."""
    content = _content(text, _as_written)
    for part in path:
        content = content[part]
    return printable(shortened(str(content)))
