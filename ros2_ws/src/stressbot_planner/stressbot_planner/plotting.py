"""Pictures of plans, as in the paper's figures, and of voltages. Figures are returned, never shown or written here.

Nothing touches pyplot or another global state, so that any process may draw, with or without a display.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Polygon as Area
from matplotlib.patches import Rectangle

from stressbot_planner.environment import Circle
from stressbot_planner.plan import StoredPlan
from stressbot_planner.problem import Problem

FORMATS = ("png", "pdf", "svg")

_COLOURS = (
    "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#e377c2", "#17becf", "#7f7f7f", "#bcbd22", "#393b79", "#843c39",
)
"""One a robot, in turn; green and red are left to starts and goals."""

_START, _GOAL = "#2ca02c", "#d62728"
_MOST_NAMES = 30
_MOST_LEGEND_ENTRIES = 14
_MOST_ARROWS = 14
"""Arrows along the path of one robot, at most."""


def plan_title(scenario: str, stored: StoredPlan) -> str:
    """Return two lines: what was planned, and its figures."""
    plan = stored.plan
    gap = plan.clearance.gap
    clearance = f"clearance {gap:.3g}" if np.isfinite(gap) else "nothing to hit"
    first = f"{scenario}, {stored.planner}" + ("" if stored.success else " (no plan found: closest attempt)")
    return (
        f"{first}\npath {plan.path_length:.2f}, driving {plan.execution_time:.2f} s, {len(plan.groups)} activations, {clearance}"
    )


def plot_plan(
    problem: Problem,
    poses: np.ndarray,
    title: str = "",
    executed: np.ndarray | Mapping[int, np.ndarray] | None = None,
) -> Figure:
    """Draw the paths of a plan among walls and obstacles; start circles are green, goal crosses red.

    Args:
        problem: starts, goals, environment and bodies, units.
        poses: planned, before the first and after each activation, shape (K + 1, n, 3), units and rad.
        title: above the picture.
        executed: measured positions or poses, drawn as dots: shape (T, n, 2 or 3), or per robot id (T, 2 or 3).
    """
    poses = np.asarray(poses, dtype=float)
    measured = _per_robot(executed, problem.swarm.n)
    low, high = _limits(problem, poses, measured)
    span = high - low
    few = problem.swarm.n <= _MOST_LEGEND_ENTRIES
    size = span * min(7.0 / span[0], 9.0 / span[1])
    left, right, bottom, top = 0.85, 1.65 if few else 0.25, 0.65 if few else 1.1, 0.35 + 0.25 * len(title.splitlines())
    whole = size[0] + left + right, size[1] + bottom + top
    figure = Figure(figsize=whole, dpi=130)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((left / whole[0], bottom / whole[1], size[0] / whole[0], size[1] / whole[1]))
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel("x (units)")
    axes.set_ylabel("y (units)")
    axes.grid(color="#e6e6e6", linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
    _draw_environment(axes, problem)
    for j in range(problem.swarm.n):
        colour = _COLOURS[j % len(_COLOURS)]
        _draw_path(axes, poses[:, j], colour, spacing=float(span.max()) / 22)
        if j in measured:
            axes.plot(*measured[j][:, :2].T, ".", color="black", markersize=3.5, zorder=4)
    _draw_ends(axes, problem)
    if title:
        axes.set_title(title, fontsize=11, parse_math=False, usetex=False)  # a name is no formula
    _add_legend(axes, problem, poses, bool(measured), few)
    return figure


def plot_voltages(
    levels: Sequence[float],
    dwells: Sequence[float],
    epoch_ends: Sequence[int],
    epochs: int = 4,
    symbols: Mapping[float, str] | Sequence[str] | None = None,
) -> Figure:
    """Draw the first epochs of a voltage sequence as steps over time.

    A drive takes a hundred times as long as a symbol: what is much longer than the rest is cut short, marked by a
    break and named with its duration. The ticks of the time axis tell the true time.

    Args:
        levels: V, one per segment.
        dwells: s, one per segment.
        epoch_ends: epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1.
        epochs: how many to draw.
        symbols: what levels mean: a text per level in volts, or one per segment; empty texts are left out.
    """
    ends = np.asarray(epoch_ends, dtype=int)[:epochs]
    count = int(ends[-1]) if len(ends) else 0
    levels, dwells = np.asarray(levels, dtype=float)[:count], np.asarray(dwells, dtype=float)[:count]
    longest = 7 * float(np.median(dwells)) if count else 1.0
    cut = dwells > 1.5 * longest
    times = np.concatenate([[0.0], np.cumsum(dwells)])
    drawn = np.concatenate([[0.0], np.cumsum(np.where(cut, longest, dwells))])
    top, bottom = (max(float(levels.max()), 0.0), min(float(levels.min()), 0.0)) if count else (1.0, 0.0)
    span = max(top - bottom, 1e-9)
    figure = Figure(figsize=(12.0, 4.4), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_xlim(0, drawn[-1] or 1.0)
    axes.set_ylim(bottom - 0.05 * span, top + 0.32 * span)
    boundaries = np.concatenate([[0], ends])
    for e, (first, end) in enumerate(zip(boundaries, boundaries[1:], strict=False)):
        axes.axvspan(drawn[first], drawn[end], color="#e9f0f9" if e % 2 == 0 else "#f8f8f8", linewidth=0, zorder=0)
        axes.text((drawn[first] + drawn[end]) / 2, top + 0.24 * span, f"epoch {e + 1}", ha="center", va="center", weight="bold")
    axes.stairs(levels, drawn, baseline=None, color="#1f4e8c", linewidth=1.6)
    for k in range(count):
        middle = (drawn[k] + drawn[k + 1]) / 2
        text = _symbol_text(symbols, k, levels[k])
        if cut[k]:
            text = f"{text} {dwells[k]:.3g} s".strip()
            axes.text(middle, levels[k], "//", ha="center", va="center", fontsize=11, color="#1f4e8c",
                      bbox={"boxstyle": "square,pad=0.05", "facecolor": "white", "edgecolor": "none"})
        if text:
            axes.text(middle, levels[k] + 0.05 * span, text, ha="center", va="bottom", fontsize=9)
    axes.set_xticks(drawn[boundaries], [f"{time:.3f}".rstrip("0").rstrip(".") for time in times[boundaries]])
    axes.set_xlabel("time (s), long drives cut short" if cut.any() else "time (s)")
    axes.set_ylabel("substrate voltage (V)")
    axes.set_yticks(np.unique(levels))
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_title(f"The first {len(ends)} of {len(epoch_ends)} epochs: each selects a group, then drives", fontsize=11)
    return figure


def _symbol_text(symbols: Mapping[float, str] | Sequence[str] | None, segment: int, level: float) -> str:
    if symbols is None:
        return ""
    return symbols.get(float(level), "") if isinstance(symbols, Mapping) else symbols[segment]


def _per_robot(executed: np.ndarray | Mapping[int, np.ndarray] | None, n: int) -> dict[int, np.ndarray]:
    """Return measured rows by robot index, from 0."""
    if executed is None:
        return {}
    if isinstance(executed, Mapping):
        return {robot - 1: np.asarray(rows, dtype=float).reshape(len(rows), -1) for robot, rows in executed.items() if len(rows)}
    executed = np.asarray(executed, dtype=float)
    return {j: executed[:, j] for j in range(n)} if len(executed) else {}


def _limits(problem: Problem, poses: np.ndarray, measured: Mapping[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower left and the upper right corner of what is to be seen."""
    body = float(problem.swarm.girth.max())
    places = [poses[:, :, :2].reshape(-1, 2), problem.goals, *(rows[:, :2] for rows in measured.values())]
    for obstacle in problem.environment.obstacles:
        if isinstance(obstacle, Circle):
            places.append(obstacle.center + obstacle.radius * np.array([[-1, -1], [1, 1]]))
        else:
            places.append(obstacle.vertices)
    everything = np.vstack(places)
    low, high = everything.min(axis=0) - 2 * body, everything.max(axis=0) + 2 * body
    walls = problem.environment.workspace
    if walls is not None:
        low, high = np.minimum(low, [walls.x_min, walls.y_min]), np.maximum(high, [walls.x_max, walls.y_max])
    margin = 0.02 * float((high - low).max())
    low, high = low - margin, high + margin
    # a swarm in a row still gets a picture that one can look at
    short = np.maximum((high - low).max() / 3 - (high - low), 0) / 2
    return low - short, high + short


def _draw_environment(axes: Axes, problem: Problem) -> None:
    for obstacle in problem.environment.obstacles:
        if isinstance(obstacle, Circle):
            axes.add_patch(Disc(tuple(obstacle.center), obstacle.radius, color="black", zorder=2))
        else:
            axes.add_patch(Area(obstacle.vertices, closed=True, color="black", zorder=2))
    walls = problem.environment.workspace
    if walls is not None:
        size = walls.x_max - walls.x_min, walls.y_max - walls.y_min
        axes.add_patch(Rectangle((walls.x_min, walls.y_min), *size, fill=False, edgecolor="black", linewidth=2.0, zorder=2))


def _draw_path(axes: Axes, poses: np.ndarray, colour: str, spacing: float) -> None:
    """Draw the path of one robot, poses (K + 1, 3), with arrows along its heading where it slides."""
    steps = np.diff(poses[:, :2], axis=0)
    lengths = np.hypot(*steps.T)
    slid = lengths > 0
    if not np.any(slid):
        return
    segments = np.stack([poses[:-1, :2][slid], poses[1:, :2][slid]], axis=1)
    axes.add_collection(LineCollection(segments, colors=colour, linewidths=1.2, alpha=0.85, zorder=3))
    along = np.cumsum(lengths)
    wanted = np.linspace(0, along[-1], int(np.clip(along[-1] / spacing / 2, 2, _MOST_ARROWS)), endpoint=False)
    wanted += (wanted[1] - wanted[0]) / 2
    at = np.minimum(np.searchsorted(along, wanted), len(lengths) - 1)
    share = 1 - (along[at] - wanted) / np.where(lengths[at] > 0, lengths[at], 1.0)
    places = poses[at, :2] + share[:, None] * steps[at]
    heading = poses[at, 2]
    size = 0.7 * spacing
    axes.quiver(
        *(places - 0.5 * size * np.column_stack([np.cos(heading), np.sin(heading)])).T,
        size * np.cos(heading), size * np.sin(heading), color=colour, angles="xy", scale_units="xy", scale=1.0,
        width=0.0022, headwidth=6, headlength=7, headaxislength=6, zorder=3,
    )


def _draw_ends(axes: Axes, problem: Problem) -> None:
    """Draw start circles as large as the bodies, dots for points, headings, goal crosses and, in a small swarm, names."""
    small = problem.swarm.n <= _MOST_NAMES
    for j in range(problem.swarm.n):
        x, y, heading = problem.starts[j]
        radius = float(problem.swarm.girth[j])
        if problem.swarm.body_radius[j] > 0:
            axes.add_patch(Disc((x, y), radius, facecolor="#2ca02c55", edgecolor=_START, linewidth=1.5, zorder=5))
        else:
            axes.plot(x, y, ".", color=_START, markersize=6, zorder=5)
        axes.plot([x, x + radius * np.cos(heading)], [y, y + radius * np.sin(heading)], color=_START, linewidth=1.5, zorder=5)
        if small:
            for place, colour in ((problem.starts[j, :2], _START), (problem.goals[j], _GOAL)):
                axes.annotate(
                    str(j + 1), tuple(place), xytext=(6, 6), textcoords="offset points", fontsize=9, color=colour,
                    weight="bold", zorder=7,
                    bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7},
                )
    axes.plot(*problem.goals.T, "x", color=_GOAL, markersize=8 if small else 4, markeredgewidth=2 if small else 1, zorder=6)


def _add_legend(axes: Axes, problem: Problem, poses: np.ndarray, measured: bool, few: bool) -> None:
    handles = [
        Line2D([], [], marker="o", color=_START, markerfacecolor="#2ca02c55", linestyle="none", markersize=9, label="start"),
        Line2D([], [], marker="x", color=_GOAL, linestyle="none", markersize=8, markeredgewidth=2, label="goal"),
    ]
    if measured:
        handles.append(Line2D([], [], marker=".", color="black", linestyle="none", label="executed"))
    if len(poses) > 1 and few:
        handles += [
            Line2D([], [], color=_COLOURS[j % len(_COLOURS)], linewidth=2, label=f"robot {j + 1}") for j in range(problem.swarm.n)
        ]
    if few:
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    else:
        axes.figure.legend(handles=handles, loc="lower center", ncol=len(handles), frameon=False)
