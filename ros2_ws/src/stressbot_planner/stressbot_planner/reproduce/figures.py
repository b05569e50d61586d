"""Figures of the report: the paper's, from plans of this run, and those of order sweep and growth."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.kinematics import path_length, replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import Extract, expand
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reporting import icons
from stressbot_planner.reporting.palette import COLOURS, style
from stressbot_planner.reporting.plotting import draw_path, plot_plan
from stressbot_planner.reproduce.instances import LENGTH_UNIT
from stressbot_planner.reproduce.published import IC4
from stressbot_planner.reproduce.runs import Record
from stressbot_planner.reproduce.switching import Switching, order_of

MARKERS = "osD^vPX*"
"""One a planner, with the colours of robots."""

STEP, STEPS = 0.2, 5
"""The paper's epsilon, units, and how often it repeats the optimised primitive."""


_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")

_DRAWING_LIMIT = 60.0
"""For a step of the paper's optimisation, s. It takes about one, as one draw in six is solved."""


def panels(figures: Sequence[Figure], columns: int) -> Figure:
    """Return figures side by side as one picture."""
    images = [_image(figure) for figure in figures]
    height, width = (max(image.shape[axis] for image in images) for axis in (0, 1))
    rows = -(-len(images) // columns)
    sheet = np.full((rows * height, min(columns, len(images)) * width, 4), 255, dtype=np.uint8)
    for k, image in enumerate(images):
        top, left = k // columns * height, k % columns * width
        sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
    figure = Figure(figsize=(sheet.shape[1] / 100, sheet.shape[0] / 100), dpi=100)
    FigureCanvasAgg(figure)
    figure.figimage(sheet)
    return figure


def _image(figure: Figure) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


# --- the paper's figures ------------------------------------------------------------------------------------------


def plan_panel(plan: Plan, title: str) -> Figure:
    """Return the picture of a plan with its figures."""
    figures = f"path {plan.path_length:.1f}, driving {plan.execution_time:.1f} s, {len(plan.groups)} activations"
    return plot_plan(plan.problem, plan.poses, LENGTH_UNIT, f"{title}\n{figures}")


def subgroup_panels(plan: Plan, subgroups: Sequence[tuple[Sequence[int], int]], letters: str) -> list[Figure]:
    """Return a picture of each stretch of a sequential plan in which one subgroup moves, in the order of the paper's figures.

    Args:
        plan: of `sequential`.
        subgroups: as in its details: robots, and for how many primitives they move, in the order of the plan.
        letters: one a picture.
    """
    swarm = plan.problem.swarm
    drawn: dict[tuple[int, ...], tuple[str, Problem, np.ndarray]] = {}
    poses, first = plan.problem.starts, 0
    for robots, count in ((tuple(robots), count) for robots, count in subgroups if count):
        groups, lengths = expand(swarm, plan.primitives[first : first + count])
        first += count
        part = replay(swarm, poses, groups, lengths)
        problem = Problem(swarm, plan.problem.environment, poses, plan.problem.goals, plan.problem.tolerance)
        title = (
            f"IC4: robots {', '.join(map(str, robots))}, {_ORDINALS[len(drawn)]} to move\n"
            f"path {path_length(swarm, groups, lengths):.1f}, driving {lengths.sum() / swarm.speed:.1f} s, "
            f"{len(groups)} activations"
        )
        drawn[robots] = title, problem, part
        poses = part[-1]
    order = sorted(drawn, key=lambda robots: (IC4.index(robots) if robots in IC4 else len(IC4), robots))
    panels = ((letter, *drawn[robots]) for letter, robots in zip(letters, order, strict=False))
    return [plot_plan(problem, part, LENGTH_UNIT, f"({letter}) {title}") for letter, title, problem, part in panels]


def primitive(time_limit: float = 3.0) -> tuple[Figure, list[tuple[str, float, float]]]:
    """Return the picture of [h2, g1] moving robots 4 and 5 by 1, three ways, and (name, path, driving time) of each.

    Args:
        time_limit: of the optimisation in one step, s; those in small steps end with the first plan found.
    """
    ways = [
        ("optimised in one step", _optimised("optimize", 1, STEP * STEPS, time_limit)),
        (f"optimised as in the paper, {STEPS} × {STEP:g}", _optimised("optimize_paper", STEPS, STEP, _DRAWING_LIMIT)),
        ("designed by hand", _by_hand()),
    ]
    figure = Figure(figsize=(13.5, 4.8), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    measured = []
    for axes, letter, (name, (swarm, poses, groups, lengths)) in zip(figure.subplots(1, 3), "abc", ways, strict=True):
        length, time = path_length(swarm, groups, lengths), float(lengths.sum()) / swarm.speed
        _draw_primitive(axes, swarm, poses)
        axes.set_title(f"({letter}) {name}\npath {length:.2f}, driving {time:.2f} s, {len(groups)} activations", fontsize=10)
        measured.append((name, length, time))
    handles, labels = figure.axes[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=8, frameon=False)
    return figure, measured


def _draw_primitive(axes: Axes, swarm: Swarm, poses: np.ndarray) -> None:
    """Draw paths relative to each robot's start."""
    poses = np.concatenate([poses[:, :, :2] - poses[0, :, :2], poses[:, :, 2:]], axis=2)
    span = float(np.ptp(poses[:, :, :2], axis=(0, 1)).max())
    lengths, _ = icons.size(swarm.body_radius, LENGTH_UNIT, span)
    for j in reversed(range(swarm.n)):  # those that move alike remain to be seen
        draw_path(axes, poses[:, j], style(j), float(lengths[j]), width=2.6 - 0.3 * j)
    for j in range(swarm.n):
        axes.plot([], [], color=style(j).colour, label=f"robot {j + 1}")
    ends = {"linestyle": "none", "color": "#4d4d4d", "zorder": 5, "markersize": 9}
    axes.plot(0, 0, "o", markerfacecolor="none", label="start", **ends)
    axes.plot(STEP * STEPS, 0, "x", markeredgewidth=2, label="goal of robots 4 and 5", **ends)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.15)
    axes.grid(color="#e6e6e6")
    axes.set_xlabel("x from the start (units)")
    axes.set_ylabel("y from the start (units)")


def _row_of_robots() -> tuple[Swarm, np.ndarray]:
    """Return six robots far apart, all looking along x: where they stand does not matter here."""
    starts = np.zeros((6, 3))
    starts[:, 1] = 20.0 * np.arange(6)
    return Swarm(1.0, 1.0, 0.3, binary(6)), starts


def _by_hand():
    swarm, starts = _row_of_robots()
    groups, lengths = expand(swarm, [Extract((4, 5), 1, STEP * STEPS)])
    return swarm, replay(swarm, starts, groups, lengths), groups, lengths


def _optimised(planner: str, steps: int, step: float, time_limit: float):
    swarm, starts = _row_of_robots()
    poses, parts = starts, []
    for k in range(steps):
        goals = starts[:, :2] + np.outer([0, 0, 0, 1, 1, 0], [(k + 1) * step, 0.0])
        problem = Problem(swarm, Environment(), poses, goals)
        settings = planners.Settings(time_limit=time_limit, clock=time.process_time)  # the same however busy the machine is
        result = planners.solve(problem, planner, settings)
        plan = result.plan
        if plan is None:
            raise StressbotError(ErrorCode.NO_PLAN_FOUND, "primitive", result.reason)
        parts.append((plan.groups, plan.lengths))
        poses = plan.poses[-1]
    groups, lengths = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return swarm, replay(swarm, starts, groups, lengths), groups, lengths


def switching(rows: Sequence[Switching]) -> Figure:
    """Return the error of both cycles over the length of an epoch, in logarithms, with slopes 1 and 2."""
    figure = Figure(figsize=(6.4, 4.4), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for k, (symmetric, label) in enumerate(((False, "G1 … Gm"), (True, "G1 … Gm … G1"))):
        mine = [row for row in rows if row.symmetric == symmetric]
        lengths, errors = np.array([row.epoch_length for row in mine]), np.array([row.error for row in mine])
        axes.loglog(lengths, errors, marker=MARKERS[k], color=COLOURS[k], label=f"{label}: slope {order_of(mine):.2f}")
        axes.loglog(lengths, 0.5 * errors[-1] * (lengths / lengths[-1]) ** (k + 1), ":", color="#7f7f7f", label=f"slope {k + 1}")
    axes.set_xlabel("length of an epoch (units)")
    axes.set_ylabel("largest position error at the end (units)")
    axes.grid(color="#e6e6e6", which="major")
    axes.legend(frameon=False)
    return figure


# --- order sweep and growth ---------------------------------------------------------------------------------------


def orders(records: Sequence[Record]) -> Figure:
    """Return planning time and path of M(n, r) over r, one row an instance."""
    scenarios = list(dict.fromkeys(record["scenario"] for record in records))
    figure = Figure(figsize=(12.0, 3.6 * len(scenarios)), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    for row, scenario in zip(figure.subplots(len(scenarios), 3, squeeze=False), scenarios, strict=True):
        mine = [record for record in records if record["scenario"] == scenario]
        _curves(row, mine, "order", (_TIME, _PATH, _EXECUTION))
        for axes in row:
            axes.set_xticks(sorted({record["order"] for record in mine}))
            axes.set_xlabel("order r of the primitives")
        row[0].set_title(scenario, fontsize=10, loc="left")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncol=4, frameon=False)
    return figure


def growth(records: Sequence[Record]) -> Figure:
    """Return how planning time, path, execution, activations and memory grow with n; above without, below with discs."""
    figure = Figure(figsize=(19.0, 7.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for row, section in zip(figure.subplots(2, 5, sharex=True), ("growth", "growth-discs"), strict=True):
        mine = [record for record in records if record["section"] == section]
        _curves(row, mine, "n", (_TIME, _PATH, _EXECUTION, _ACTIVATIONS, _MEMORY))
        for axes in row:
            axes.set_xscale("log")
            ticks = sorted({record["n"] for record in records})
            axes.set_xticks(ticks, [str(n) for n in ticks])
            axes.minorticks_off()
            axes.set_xlabel("robots n")
        row[0].set_title("open plane" if section == "growth" else "with n/3 discs and walls", fontsize=10, loc="left")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncol=7, frameon=False)
    return figure


_Quantity = tuple[str, Callable[[Record], float]]
_TIME: _Quantity = ("planning time (s)", lambda r: r["planning_time"])
_PATH: _Quantity = ("path ÷ lower bound", lambda r: r["path_length"] / r["lower_bounds"]["path_length"])
_EXECUTION: _Quantity = ("driving time ÷ lower bound", lambda r: r["execution_time"] / r["lower_bounds"]["execution_time"])
_ACTIVATIONS: _Quantity = ("activations", lambda r: r["activations"])
_MEMORY: _Quantity = ("peak memory (MB)", lambda r: (r["peak_memory"] or np.nan) / 1e6)


def _curves(row: Sequence[Axes], records: Sequence[Record], variable: str, quantities: Sequence[_Quantity]) -> None:
    """Draw medians of solved runs over a variable, one curve a planner; hollow where some runs were not solved."""
    names = list(dict.fromkeys(record["row"] for record in records))
    for axes, (label, quantity) in zip(row, quantities, strict=True):
        for k, name in enumerate(names):
            style = {"marker": MARKERS[k % len(MARKERS)], "markersize": 6, "color": COLOURS[k % len(COLOURS)]}
            points = []
            for value in sorted({record[variable] for record in records}):
                mine = [record for record in records if record["row"] == name and record[variable] == value]
                solved = [quantity(record) for record in mine if record["solved"]]
                if solved:
                    points.append((value, float(np.median(solved)), len(solved) == len(mine)))
            xs, ys = [point[0] for point in points], [point[1] for point in points]
            axes.plot(xs, ys, linewidth=1.5, label=name, **style)
            partly = [(x, y) for x, y, all_solved in points if not all_solved]
            if partly:
                axes.plot(*zip(*partly, strict=True), linestyle="none", markerfacecolor="white", zorder=4, **style)
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high > 10 * low else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylabel(label)
        axes.grid(color="#e6e6e6", which="major")
