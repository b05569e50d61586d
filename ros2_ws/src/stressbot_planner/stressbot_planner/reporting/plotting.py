"""Pictures of plans, as in the paper's figures, and of voltages. Figures are returned, never shown or written here.

Nothing touches pyplot or another global state, so that any process may draw, with or without a display.
"""

import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, fontManager, get_font
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Polygon as Area
from matplotlib.patches import Rectangle
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation
from numpy.typing import ArrayLike

from stressbot_planner.formats.plan_file import StoredPlan
from stressbot_planner.model.environment import Circle
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reporting import icons, labels
from stressbot_planner.reporting.palette import Style, style

FORMATS = ("png", "pdf", "svg")

_MOST_NAMES = 100
_MOST_LEGEND_ENTRIES = 14
_WIDE, _HIGH = 7.0, 9.0
"""At most, of the plane of a small swarm, inches; with many robots half as much again."""

_MARGIN = 0.04
"""Around all bodies, relative to the longer side: half of the largest icon."""

_TEXT = 8.0
"""Size of names, points."""

_MARK = 4.0
"""Half the size of a goal's cross, points."""

_ARROW = 20.0
"""Length of the arrow that shows the heading at a goal, points."""

_HALO = (withStroke(linewidth=3, foreground="white"),)
"""Around what must be seen before icons and paths."""

_MOST_LINES = 5
"""Of a title, longer ones are cut."""


def plan_title(scenario: str, stored: StoredPlan) -> str:
    """Return two lines: what was planned, and its figures."""
    plan = stored.plan
    gap = plan.clearance.gap
    clearance = f"clearance {gap:.3g}" if np.isfinite(gap) else "nothing to hit"
    first = f"{scenario}, {stored.planner}" + ("" if stored.success else " (no plan found: closest attempt)")
    return (
        f"{first}\npath {plan.path_length:.2f}, driving {plan.execution_time:.2f} s, {len(plan.groups)} activations, {clearance}"
    )


def plot(plan: Plan, length_unit: float = 1e-4, title: str = "") -> Figure:
    """Draw the paths of a plan, see `plot_plan`; length_unit: m per unit of its scenario."""
    return plot_plan(plan.problem, plan.poses, length_unit, title)


def plot_plan(
    problem: Problem,
    poses: np.ndarray,
    length_unit: float,
    title: str = "",
    executed: np.ndarray | Mapping[int, np.ndarray] | None = None,
) -> Figure:
    """Draw the paths of a plan among walls and obstacles, with an icon of the robot where it begins and ends an activation.

    Each robot has a style of its own: a circle as large as its body where it starts, a cross at its goal, its number at both.

    Args:
        problem: starts, goals, environment and bodies, units.
        poses: planned, before the first and after each activation, shape (K + 1, n, 3), units and rad.
        length_unit: m per unit.
        title: above the picture.
        executed: measured positions or poses, drawn as dots: shape (T, n, 2 or 3), or per robot id (T, 2 or 3).
    """
    poses = np.asarray(poses, dtype=float)
    measured = _per_robot(executed, problem.swarm.n)
    figure, axes, lengths = draw_scene(problem, poses, length_unit, title, measured)
    for j in range(problem.swarm.n):
        draw_path(axes, poses[:, j], style(j), float(lengths[j]))
        if j in measured:
            axes.plot(*measured[j][:, :2].T, ".", color="black", markersize=3.5, zorder=5)
    return figure


def draw_scene(
    problem: Problem, poses: np.ndarray, length_unit: float, title: str, measured: Mapping[int, np.ndarray] | None = None
) -> tuple[Figure, Axes, np.ndarray]:
    """Draw all that is in a picture but paths; return it, its axes and the length of each robot's icon, shape (n,), units.

    The arguments are those of `plot_plan`; there is room for poses (K + 1, n, 3) and what was measured, (T, 2 or 3) per robot.
    """
    measured = measured or {}
    low, high = _limits(problem, poses, measured, length_unit)
    span = high - low
    few = problem.swarm.n <= _MOST_LEGEND_ENTRIES
    inches = float(min(_WIDE / span[0], _HIGH / span[1])) * (1.0 if few else 1.5)
    figure, axes = _plane(low, high, inches)
    icon = icons.size(problem.swarm.girth, length_unit, float(span.max()))
    _draw_environment(axes, problem)
    _draw_ends(axes, problem)
    if problem.swarm.n <= _MOST_NAMES:
        _draw_names(axes, problem, poses, low, 72 * inches, 72 * inches * span)
    _draw_scale_bar(axes, length_unit, float(span[0]))
    if title:
        text, families = _drawable(_wrapped(title, inches * float(span[0])))
        axes.set_title(text, fontsize=11, fontfamily=families, parse_math=False, usetex=False)  # a name is no formula
    _add_legend(axes, problem, len(poses) > 1, bool(measured), icon.text, few)
    _fit(figure, axes)
    return figure, axes, icon.lengths


def draw_path(axes: Axes, poses: np.ndarray, robot: Style, icon: float, width: float = 1.2) -> None:
    """Draw the path of one robot, poses of shape (K + 1, 3), and its icons; icon: their length, units; width: points."""
    axes.plot(*_corners(poses[:, :2]).T, linestyle=robot.line, color=robot.colour, linewidth=width, zorder=4)
    axes.add_collection(PolyCollection(
        list(icons.polygons(poses, icon)), facecolors=to_rgba(robot.colour, 0.13) if robot.filled else "none",
        edgecolors=to_rgba(robot.colour, 0.6), linewidths=0.6, zorder=3,
    ))


def plot_voltages(
    levels: ArrayLike,
    dwells: ArrayLike,
    epoch_ends: ArrayLike,
    epochs: int = 4,
    symbols: Mapping[float, str] | Sequence[str] | None = None,
    pulses: ArrayLike = (),
    low_levels: ArrayLike = (),
    duty: float = 0.0,
    alternating: bool = False,
) -> Figure:
    """Draw the first epochs of a voltage sequence as steps over time.

    A train of pulses is a band between its levels, with their number; an inset shows the first pulses of the first train.

    A drive takes a hundred times as long as a symbol: what is much longer than the rest is cut short, marked by a
    break and named with its duration. The ticks of the time axis tell the true time.

    Args:
        levels: V, one per segment.
        dwells: s, one per segment.
        epoch_ends: epoch e is segments epoch_ends[e-1] .. epoch_ends[e]-1.
        epochs: how many to draw.
        symbols: what levels mean: a text per level in volts, or one per segment; empty texts are left out.
        pulses: of each segment, 0 where its level is held; empty: no segment is a train.
        low_levels: V, as many as pulses.
        duty, alternating: of all trains, as in `voltage_sequence`.
    """
    ends = np.asarray(epoch_ends, dtype=int)[:epochs]
    count = int(ends[-1]) if len(ends) else 0
    volts, held = np.asarray(levels, dtype=float)[:count], np.asarray(dwells, dtype=float)[:count]
    longest = 7 * float(np.median(held)) if count else 1.0
    cut = held > 1.5 * longest
    times = np.concatenate([[0.0], np.cumsum(held)])
    drawn = np.concatenate([[0.0], np.cumsum(np.where(cut, longest, held))])
    trains = np.asarray(pulses, dtype=float)[:count] if np.size(pulses) else np.zeros(count)
    lows = np.asarray(low_levels, dtype=float)[:count] if np.size(pulses) else volts
    first_train = int(np.argmax(trains > 0)) if trains.any() else None
    seen = np.concatenate([volts, -volts[trains > 0]]) if alternating else volts
    top, bottom = (max(float(seen.max()), 0.0), min(float(seen.min()), 0.0)) if count else (1.0, 0.0)
    span = max(top - bottom, 1e-9)
    figure = Figure(figsize=(12.0, 4.4), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_xlim(0, drawn[-1] or 1.0)
    axes.set_ylim(bottom - 0.05 * span, top + (0.32 if first_train is None else 1.25) * span)
    boundaries = np.concatenate([[0], ends])
    for e, (first, end) in enumerate(pairwise(drawn[boundaries].tolist())):
        axes.axvspan(first, end, color="#e9f0f9" if e % 2 == 0 else "#f8f8f8", linewidth=0, zorder=0)
        axes.text((first + end) / 2, top + 0.24 * span, f"epoch {e + 1}", ha="center", va="center", weight="bold")
    axes.stairs(volts, drawn, baseline=None, color="#1f4e8c", linewidth=1.6)
    for k in range(count):
        middle = (drawn[k] + drawn[k + 1]) / 2
        text = _symbol_text(symbols, k, volts[k])
        if trains[k]:
            text = f"{text} {trains[k]:.0f} pulses".strip()
            for sign in (1.0, -1.0) if alternating else (1.0,):
                axes.fill_between(drawn[k : k + 2], sign * lows[k], sign * volts[k], color="#1f4e8c", alpha=0.35, linewidth=0)
        if cut[k]:
            text = f"{text} {held[k]:.3g} s".strip()
            axes.text(middle, volts[k], "//", ha="center", va="center", fontsize=11, color="#1f4e8c",
                      bbox={"boxstyle": "square,pad=0.05", "facecolor": "white", "edgecolor": "none"})
        if text:
            axes.text(middle, volts[k] + 0.05 * span, text, ha="center", va="bottom", fontsize=9)
    axes.set_xticks(drawn[boundaries], [f"{time:.3f}".rstrip("0").rstrip(".") for time in times[boundaries]])
    axes.set_xlabel("time (s), long drives cut short" if cut.any() else "time (s)")
    axes.set_ylabel("substrate voltage (V)")
    axes.set_yticks(np.unique(volts))
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    if first_train is not None:
        k = first_train
        _draw_pulses(axes, volts[k], lows[k], held[k] / trains[k], int(trains[k]), duty, alternating)
    axes.set_title(f"The first {len(ends)} of {np.size(epoch_ends)} epochs: each selects a group, then drives", fontsize=11)
    return figure


PULSES_SHOWN = 6


def _draw_pulses(axes: Axes, high: float, low: float, period: float, count: int, duty: float, alternating: bool) -> None:
    """Draw an inset with the first pulses of a train, in microseconds."""
    shown = min(count, PULSES_SHOWN)
    signs = np.where(np.arange(shown) % 2 == 1, -1.0, 1.0) if alternating else np.ones(shown)
    volts = np.column_stack([signs * high, signs * low]).ravel()
    edges = 1e6 * period * np.append((np.arange(shown)[:, None] + [0.0, duty]).ravel(), shown)
    inset = axes.inset_axes((0.62, 0.76, 0.36, 0.2))
    inset.stairs(np.append(volts, 0.0), np.append(edges, edges[-1] * 1.1), baseline=None, color="#1f4e8c", linewidth=1.2)
    inset.set_yticks(np.unique(np.append(volts, 0.0)))
    inset.tick_params(labelsize=7)
    inset.set_xlabel(f"the first {shown} pulses (µs), {1 / period:.6g} Hz", fontsize=8, labelpad=1)


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


def _limits(
    problem: Problem, poses: np.ndarray, measured: Mapping[int, np.ndarray], length_unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower left and the upper right corner of what is to be seen."""
    body = float(problem.swarm.girth.max())
    aims = np.vstack([*problem.waypoints, problem.goals])
    places = [poses[:, :, :2].reshape(-1, 2), aims, *(rows[:, :2] for rows in measured.values())]
    for obstacle in problem.environment.obstacles:
        if isinstance(obstacle, Circle):
            places.append(obstacle.center + obstacle.radius * np.array([[-1, -1], [1, 1]]))
        else:
            places.append(obstacle.vertices)
    everything = np.vstack(places)
    low, high = everything.min(axis=0) - body, everything.max(axis=0) + body
    margin = float((high - low).max()) * _MARGIN or icons.LENGTH / length_unit
    low, high = low - margin, high + margin
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


def _plane(low: np.ndarray, high: np.ndarray, inches: float) -> tuple[Figure, Axes]:
    """Return a picture of a plane between two corners, and its axes; inches: for each unit."""
    wide, tall = inches * (high - low)
    figure = Figure(figsize=(wide, tall), dpi=130)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel("x (units)", loc="left")
    axes.set_ylabel("y (units)")
    for axis, side in ((axes.xaxis, wide), (axes.yaxis, tall)):
        axis.set_major_locator(MaxNLocator(max(int(side / 0.9), 2), steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter(lambda value, _: f"{value:.9g}")
    axes.grid(color="#e6e6e6", linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
    return figure, axes


def _fit(figure: Figure, axes: Axes, margin: float = 0.12) -> None:
    """Make a picture as large as what was drawn beside its plane needs, which stays as large as it is."""
    plane = figure.get_size_inches()
    box = figure.get_tightbbox()
    corner = np.minimum([box.x0, box.y0], 0.0) - margin
    whole = np.maximum([box.x1, box.y1], plane) + margin - corner
    figure.set_size_inches(*whole)
    axes.set_position((*(-corner / whole), *(plane / whole)))


def _wrapped(title: str, inches: float) -> str:
    """Return a title in lines that are not much wider than a plane."""
    width = max(int(inches * 72 / 6.2), 30)
    lines = [part for line in title.splitlines() for part in textwrap.wrap(line, width)]
    return "\n".join(lines if len(lines) <= _MOST_LINES else [*lines[: _MOST_LINES - 2], "…", lines[-1]])


def _drawable(text: str) -> tuple[str, list[str]]:
    """Return a text, and the fonts that have its characters; what no font on this machine has becomes a question mark."""
    families = [FontProperties().get_name()]
    missing = set(map(ord, text)) - {ord("\n")} - set(get_font(findfont(FontProperties())).get_charmap())
    for entry in fontManager.ttflist if missing else ():
        if more := missing.intersection(get_font(entry.fname).get_charmap()):
            families.append(entry.name)
            missing -= more
    return text.translate(dict.fromkeys(missing, "\ufffd")), families


def _corners(places: np.ndarray) -> np.ndarray:
    """Return places, shape (K + 1, 2), without those at which nothing has moved since the one before."""
    return places[np.append(True, np.any(np.diff(places, axis=0) != 0, axis=1))]


def _draw_ends(axes: Axes, problem: Problem) -> None:
    """Draw a circle (of a point, a dot) where a robot starts, and a cross at its goal, an arrow if it has a heading
    there; a plus at each waypoint, a square for one that is parked, a bar between goals of a contact."""
    for j in range(problem.swarm.n):
        colour, radius = style(j).colour, float(problem.swarm.body_radius[j])
        place = tuple(problem.starts[j, :2])
        if radius > 0:
            axes.add_patch(Disc(
                place, radius, facecolor=to_rgba(colour, 0.3), edgecolor=colour, linewidth=1.4, zorder=6, path_effects=_HALO
            ))
        else:
            axes.plot(*place, ".", color=colour, markersize=6, zorder=6, path_effects=_HALO)
        if j in problem.parked:
            axes.plot(*place, "s", color=colour, markersize=_MARK, zorder=7, path_effects=_HALO, gid="parked")
            continue
        for waypoint in problem.waypoints[:, j]:
            axes.plot(*waypoint, "+", color=colour, markersize=2 * _MARK, zorder=7, path_effects=_HALO, gid="waypoint")
        axes.plot(
            *problem.goals[j], "x", color=colour, markersize=2 * _MARK, markeredgewidth=2, zorder=7, path_effects=_HALO
        )
    for pair in problem.contacts:
        axes.plot(*problem.goals[list(pair)].T, color="#4d4d4d", linewidth=3, alpha=0.6, zorder=6, gid="contact")
    for j in problem.headed.tolist():
        heading, (x, y) = float(problem.goal_headings[j]), problem.goals[j].tolist()
        tip = _ARROW * float(np.cos(heading)), _ARROW * float(np.sin(heading))
        axes.annotate(
            "", (x, y), tip, textcoords="offset points", gid="heading",
            arrowprops={"arrowstyle": "<-", "color": style(j).colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}, zorder=7,
        )


def _draw_names(axes: Axes, problem: Problem, poses: np.ndarray, low: np.ndarray, scale: float, page: np.ndarray) -> None:
    """Write its number beside start and goal of each robot, where it hides nothing; scale is points a unit, page in points."""
    anchors = scale * (np.vstack([problem.starts[:, :2], problem.goals]) - low)
    marks = np.concatenate([np.minimum(scale * problem.swarm.body_radius, 2 * _MARK), np.full(problem.swarm.n, _MARK)])
    names = [str(j + 1) for j in range(problem.swarm.n)] * 2
    sizes = np.array([[0.72 * _TEXT * len(name) + 2.0, _TEXT + 1.0] for name in names])
    lines = np.vstack([_dense(scale * (_corners(poses[:, j, :2]) - low), _TEXT / 2) for j in range(problem.swarm.n)])
    middles = labels.place(anchors, marks, sizes, lines, (float(page[0]), float(page[1])))
    for k, (anchor, middle) in enumerate(zip(anchors, middles, strict=True)):
        if middle is None or k >= problem.swarm.n and k - problem.swarm.n in problem.parked:
            continue
        colour = style(k % problem.swarm.n).colour
        if np.hypot(*(middle - anchor)) > marks[k] + 2 * _TEXT:
            axes.plot(*(low + np.array([anchor, middle]) / scale).T, color=colour, linewidth=0.5, zorder=7)
        x, y = low + middle / scale
        axes.text(
            x, y, names[k], fontsize=_TEXT, color=colour, weight="bold", ha="center", va="center",
            zorder=8, path_effects=_HALO, gid="name",
        )


def _dense(points: np.ndarray, spacing: float) -> np.ndarray:
    """Return points along a line, no farther apart than given."""
    steps = np.diff(points, axis=0)
    counts = np.maximum(np.ceil(np.hypot(*steps.T) / spacing), 1).astype(int)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    shares = (np.arange(counts.sum()) - first) / np.repeat(counts, counts)
    return np.vstack([np.repeat(points[:-1], counts, axis=0) + shares[:, None] * np.repeat(steps, counts, axis=0), points[-1:]])


def _draw_scale_bar(axes: Axes, length_unit: float, width: float) -> None:
    """Draw below the plane how long a round number of metres is."""
    metres = width * length_unit / 5
    power = 10.0 ** np.floor(np.log10(metres))
    metres = power * max(step for step in (1, 2, 5) if step * power <= metres * (1 + 1e-9))
    right, left = 1.0, 1.0 - metres / (width * length_unit)
    below = axes.transAxes + ScaledTranslation(0, -0.42, axes.figure.dpi_scale_trans)
    axes.add_line(Line2D([left, right], [0, 0], color="black", linewidth=3, solid_capstyle="butt", transform=below, clip_on=False))
    text = below + ScaledTranslation(-0.06, 0, axes.figure.dpi_scale_trans)
    axes.text(left, 0, _length_text(metres), transform=text, ha="right", va="center", fontsize=10, gid="scale")


def _length_text(metres: float) -> str:
    """Return a length in micrometres, or where the number would be a long one, in the unit that makes it short."""
    for factor, unit in ((1e6, "µm"), (1e9, "nm"), (1e3, "mm"), (1.0, "m")):
        if 1 <= round(metres * factor, 9) < 1e4:
            return f"{metres * factor:.3g} {unit}" if metres * factor < 1e3 else f"{metres * factor:.0f} {unit}"
    return f"{metres:.3g} m"


def _add_legend(axes: Axes, problem: Problem, moves: bool, measured: bool, icon: str, few: bool) -> None:
    grey: dict[str, Any] = {"linestyle": "none", "color": "#4d4d4d", "markerfacecolor": "#4d4d4d40"}
    handles = [
        Line2D([], [], marker="o", markersize=9, label="start, body", **grey),
        Line2D([], [], marker="x", markersize=8, markeredgewidth=2, label="goal", **grey),
        Line2D([], [], marker=Path(icons.outline()), markersize=14, markeredgewidth=0.7, label=icon, **grey),
    ]
    if len(problem.waypoints):
        handles.insert(2, Line2D([], [], marker="+", markersize=8, label="waypoint", **grey))
    if problem.contacts:
        handles.append(Line2D([], [], color="#4d4d4d", linewidth=3, alpha=0.6, label="contact"))
    if problem.parked:
        handles.insert(2, Line2D([], [], marker="s", markersize=6, label="parked", **grey))
    if measured:
        handles.append(Line2D([], [], marker=".", color="black", linestyle="none", label="executed"))
    if moves and few:
        handles += [
            Line2D([], [], color=style(j).colour, linestyle=style(j).line, linewidth=2, label=f"robot {j + 1}")
            for j in range(problem.swarm.n)
        ]
    if few:
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    else:
        below = axes.transAxes + ScaledTranslation(0, -0.55, axes.figure.dpi_scale_trans)
        axes.legend(
            handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=below, borderaxespad=0.0,
            ncol=len(handles), frameon=False,
        )
