"""What commands say: rows and tables for people, or one JSON object for programs (`--json`)."""

import json
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

Row = tuple[str, str]

WORDS_WIDTH = 100
"""Of a line of codewords."""


class CommandReport:
    """What a command has to say at its end.

    Attributes:
        data: for programs: plain values, arrays of numpy's; lengths in scenario units, times in s, volts in V.
    """

    def __init__(self, **data: Any):
        self.data = data
        self._parts: list[Callable[[], None]] = []

    def pairs(self, rows: Sequence[Row]) -> None:
        """Say names with what they are, one a line."""
        self._parts.append(lambda: _print_pairs(rows))

    def table(self, title: str, header: list[str], rows: list[list[str]]) -> None:
        """Say a table."""
        self._parts.append(lambda: _print_table(title, header, rows))

    def lines(self, *lines: str) -> None:
        """Say lines as they are."""
        self._parts.append(lambda: print(*lines, sep="\n"))

    def print(self, as_json: bool) -> None:
        """Print it to standard output."""
        if as_json:
            print_json(self.data)
            return
        for part in self._parts:
            part()


def print_json(data: Any) -> None:
    """Print one object in one line; what is not finite is null."""
    print(json.dumps(_plain(data), allow_nan=False, ensure_ascii=False))


def print_refusal(error: str | None, message: str, field: str = "") -> None:
    """Print why something was not done, with the name of a code of error if it has one."""
    print_json({"success": False, "error": error, "field": field, "message": message})


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def ratio(value: float, bound: float) -> str:
    """Return how a figure stands to its lower bound."""
    return f"{value / bound:.3f} × the lower bound {bound:.2f}" if bound > 0 else "lower bound 0"


def ranges(numbers: Sequence[int]) -> str:
    """Return ascending numbers as text: 1-3, 5."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in parts) or "none"


def codeword_lines(codewords: Sequence[str]) -> list[str]:
    """Return codewords with the robots that have them, some a line."""
    words = [f"R{k} {word}" for k, word in enumerate(codewords, start=1)]
    per_line = max(1, WORDS_WIDTH // (max(map(len, words)) + 2))
    return ["  " + "  ".join(words[first : first + per_line]) for first in range(0, len(words), per_line)]


def _print_pairs(rows: Sequence[Row]) -> None:
    if not sys.stdout.isatty():
        for name, value in rows:
            print(f"{name + ':':<16}{value}")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in rows:
        table.add_row(Text(name, style="bold"), Text(value))
    Console().print(table)


def _print_table(title: str, header: list[str], rows: list[list[str]]) -> None:
    if not sys.stdout.isatty():
        widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
        print(title)
        for row in (header, *rows):
            print("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left")
    for name in header:
        table.add_column(name, no_wrap=name != "members", style="bold" if name == "Group" else None)
    for row in rows:
        table.add_row(*(Text(cell, style="dim" if cell == "0" else "") for cell in row))
    Console().print(table)
