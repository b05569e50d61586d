"""How robots differ in pictures: a colour that colour-blind readers tell apart, then a line style, then hollow icons."""

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from matplotlib.typing import LineStyleType

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#332288", "#882255")
"""Okabe and Ito's without yellow, which white paper swallows, and black, which is the obstacles'; then indigo and wine of Tol's."""

_LINES: "tuple[LineStyleType, ...]" = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))


class Style(NamedTuple):
    """How a robot is drawn.

    Attributes:
        colour: of everything that is its own.
        line: style of its path, as matplotlib takes it.
        filled: whether its icons are.
    """

    colour: str
    line: "LineStyleType"
    filled: bool


def style(index: int) -> Style:
    """Return the style of a robot, counted from 0; after 64 of them they come again."""
    around = index // len(COLOURS)
    return Style(COLOURS[index % len(COLOURS)], _LINES[around % len(_LINES)], around // len(_LINES) % 2 == 0)
