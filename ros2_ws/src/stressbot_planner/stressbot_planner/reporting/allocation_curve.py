"""The trade-off between groups and what plans cost, as a picture."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stressbot_planner.reporting.palette import COLOURS

GRID = "#e6e6e6"

CURVES = (
    ("time (s)", (("total_time", "total"), ("driving_time", "driving"), ("selection_time", "selection"))),
    ("path, all robots (units)", (("path_length", "path"),)),
    ("of a robot", (("modules", "modules, at most"), ("symbols", "symbols a code"))),
)
"""One panel each: its label, and the figures in it with theirs."""


BOUND = ("bound", "lower bound of these words")

PANEL_OF = {"s": 0, "units": 1}
"""Where the bound is drawn, by its unit."""


def draw(points: Sequence[Mapping[str, Any]], given: Mapping[str, Any], name: str, unit: str) -> Figure:
    """Return the picture of allocations to growing numbers of groups.

    Args:
        points: of each what `stressbot allocate --json` tells of an allocation, one a number of groups.
        given: the same of the scenario's own allocation, hollow marks.
        name: of the scenario.
        unit: of the bounds; those of a mixed objective are not drawn.
    """
    figure = Figure(figsize=(12.0, 4.0), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    for panel, (axes, (label, curves)) in enumerate(zip(figure.subplots(1, 3), CURVES, strict=True)):
        for k, (key, text) in enumerate((*curves, BOUND) if PANEL_OF.get(unit) == panel else curves):
            _curve(axes, points, given, key, text, COLOURS[k])
        axes.set_xlabel("groups")
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        axes.set_xticks([point["groups"] for point in points][:: -(-len(points) // 16)])
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(color=GRID)
        axes.legend(frameon=False)
    figure.axes[0].set_title(f"{name}; hollow: as given", fontsize=10, loc="left")
    return figure


def _curve(axes: Axes, points: Sequence[Mapping[str, Any]], given: Mapping[str, Any], key: str, text: str, colour: str) -> None:
    axes.plot([point["groups"] for point in points], [_value(point, key) for point in points], "o-", color=colour, label=text)
    if given["cost"] is not None:
        axes.plot(given["groups"], _value(given, key), "o", markerfacecolor="white", color=colour, zorder=4)


def _value(point: Mapping[str, Any], key: str) -> float:
    if key == "total_time":
        return point["driving_time"] + point["selection_time"]
    return max(point["modules"]) if key == "modules" else point[key]
