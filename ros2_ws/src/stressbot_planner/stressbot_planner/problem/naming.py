"""Robots that sentences name by number."""

import re
from collections.abc import Callable

_ROBOTS = re.compile(r"(\brobots? )(\d+(?:, \d+)*)(?!\.?\d| units)")


def renamed(text: str, names: Callable[[int], str | None]) -> str:
    """Return a sentence with other names for its robots, by their numbers from 1; those of which the name is None are left out."""

    def named(match: re.Match) -> str:
        found = (names(int(number)) for number in match[2].split(", "))
        return match[1] + ", ".join(name for name in found if name is not None)

    return _ROBOTS.sub(named, text)
