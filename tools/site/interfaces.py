"""Pages of messages, services and actions, made from their files and the comments in them."""

import re
from dataclasses import dataclass
from pathlib import Path

PARTS = {"msg": ("",), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
"""What the sections of a file are, by its ending; `---` stands between them."""

FIELD = re.compile(
    r"(?P<kind>[\w/]+(?:<=\d+)?(?:\[[<=\d]*\])?)\s+(?P<name>\w+)\s*(?P<value>=\s*\S+|[^\s#=]\S*)?\s*(?:#\s*(?P<text>.*))?"
)


@dataclass(frozen=True)
class Field:
    """A line of an interface: a field, or a constant if its value begins with an equals sign."""

    kind: str
    name: str
    value: str
    text: str


def read(path: Path) -> tuple[str, list[list[Field]]]:
    """Return what a file says of itself, and the fields of each section.

    Raises:
        ValueError: a line is neither a comment nor a field.
    """
    about: list[str] = []
    sections: list[list[Field]] = [[]]
    for line in path.read_text(encoding="utf-8").splitlines():
        line = line.strip()
        if line == "---":
            sections.append([])
        elif line.startswith("#"):
            text = line.lstrip("# ")
            if sections == [[]]:
                about.append(text)
            elif sections[-1]:
                sections[-1].append(Field("", "", "", text))
        elif line:
            match = FIELD.fullmatch(line)
            if match is None:
                raise ValueError(f"{path.name}: no field: {line}")
            sections[-1].append(Field(match["kind"], match["name"], (match["value"] or "").strip(), match["text"] or ""))
    return " ".join(about), sections


def page(path: Path) -> str:
    """Return the page of one interface."""
    about, sections = read(path)
    kind = path.suffix[1:]
    lines = [f"# {path.stem}", "", f"`stressbot_msgs/{kind}/{path.stem}`", "", about, ""]
    for title, fields in zip(PARTS[kind], sections, strict=True):
        if title:
            lines += [f"## {title}", ""]
        if not fields:
            lines += ["Empty.", ""]
            continue
        lines += ["| type | name | value | |", "|---|---|---|---|"]
        for field in fields:
            cells = [f"`{field.kind}`" if field.kind else "", f"`{field.name}`" if field.name else ""]
            value = field.value.lstrip("= ")
            cells += [f"`{value}`" if value else "", field.text.replace("|", "\\|").replace("<", "&lt;")]
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)
