"""The benchmark of a learned switcher: its layouts, noise and metrics; our closed loop from volts beside best-first searches.

What is the same as there and what is not: docs/successor.md.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from closed_loop import PLANNING_TIME, TOLERANCE, closed
from joblib import Parallel, delayed
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import NullFormatter
from successor_baselines import ORDERS, Child, best_first
from successor_layouts import BODY, LAYOUTS, SIDE, SPEED
from successor_model import COARSE_COST, PRECISE, SAFE, WAY_COST, Decisions

from stressbot_planner.formats.scenario import parse
from stressbot_planner.reporting.palette import COLOURS, style
from stressbot_planner.reproduce.tables import Table

FIRST_SEED = 1000
EPISODES = 100
QUICK = 3

MOST_DECISIONS = 120
NOISE = {"heading_bias": np.radians(5.0), "heading_noise": np.radians(2.0)}
EXACT = {"speed_error": 0.0}
"""Its robots are as fast as they should be."""

OURS = "our closed loop, from volts"

EXPANSIONS = 10
"""Seeds of the table of what steps expand into."""

EXPANDED = 40
"""Nodes that a search may expand for one decision: 920 transitions."""


class Method(NamedTuple):
    """A search: its order, and whether its policy knows of ways or is uniform."""

    order: str
    guided: bool


METHODS = {
    "A*": Method("A*", False),
    "LevinTS, uniform policy": Method("LevinTS", False),
    "LevinTS, policy by ways": Method("LevinTS", True),
    "PHS, uniform policy": Method("PHS", False),
    "PHS, policy by ways": Method("PHS", True),
    "PHS*, policy by ways": Method("PHS*", True),
}


class Episode(NamedTuple):
    """How one episode went: success, collision or time-out; units, s on the substrate, s of planning (CPU)."""

    outcome: str
    decisions: int
    coarse: int
    precise: int
    cost: float
    gap: float
    activations: int
    seconds: float
    planning: float


def driven(text: str, seed: int) -> Episode:
    """Drive from volts in closed loop. Each activation is priced as a whole coarse step of a group: more than it is of one."""
    run = closed(text, seed, PLANNING_TIME, **NOISE, **EXACT)
    outcome = "collision" if run.gap < 0 else "success" if run.error <= TOLERANCE else "time-out"
    cost = COARSE_COST[1] * run.activations
    return Episode(outcome, run.decisions, run.decisions, 0, cost, run.gap, run.activations, run.seconds, run.planning)


def searched(text: str, seed: int, method: Method, expanded: int = EXPANDED) -> Episode:
    """Decide anew from the true poses until all robots are at their goals; noise turns those that slide in a coarse step."""
    decisions = Decisions(parse(text).problem)
    noise = np.random.default_rng([seed, 3])
    poses = np.array(decisions.problem.starts)
    bias = NOISE["heading_bias"] * noise.standard_normal(len(poses))
    expand = _expansion(decisions, method)
    outcome, cost, gap, activations, length, planning, taken = "time-out", 0.0, np.inf, 0, 0.0, 0.0, []
    while len(taken) < MOST_DECISIONS:
        spent = time.process_time()
        way = best_first(poses, expand, ORDERS[method.order], expanded)
        planning += time.process_time() - spent
        action = way.actions[0] if way.actions else PRECISE
        taken.append(action)
        cost += decisions.cost(action, poses)
        step = decisions.step(action, poses, bias + NOISE["heading_noise"] * noise.standard_normal(len(poses)))
        more, longer = decisions.activations(action, step)
        poses, gap, activations, length = step.poses, min(gap, step.gap), activations + more, length + longer
        if gap < 0:
            outcome = "collision"
            break
        if not decisions.away(poses).any():
            outcome = "success"
            break
    precise = taken.count(PRECISE)
    return Episode(outcome, len(taken), len(taken) - precise, precise, cost, gap, activations, length / SPEED, planning)


def _expansion(decisions: Decisions, method: Method):
    """Return what `best_first` expands nodes with: coarse steps that keep their gap, and the precise one."""
    actions = range(PRECISE + 1)

    def expand(poses):
        here = decisions.left(poses)
        steps = [(action, decisions.step(action, poses)) for action in actions]
        steps = [(action, step) for action, step in steps if action == PRECISE or step.gap >= SAFE]
        costs = np.array([decisions.cost(action, poses) for action, _ in steps])
        left = np.array([decisions.left(step.poses) for _, step in steps])
        if method.guided:
            gains = (here - left - costs) / WAY_COST
            log_policy = gains - np.logaddexp.reduce(gains)
        else:
            log_policy = np.full(len(steps), -np.log(len(actions)))
        for k, (action, step) in enumerate(steps):
            end = not decisions.away(step.poses).any()
            yield Child(action, costs[k], step.poses, left[k], end, float(log_policy[k]))

    return expand


def tables(full: bool, folder: Path) -> list[Table]:
    """Return one table a layout, and draw all episodes."""
    seeds = range(FIRST_SEED, FIRST_SEED + (EPISODES if full else QUICK))
    episodes = {
        layout: {
            OURS: Parallel()(delayed(driven)(make(seed), seed) for seed in seeds),
            **{
                name: Parallel()(delayed(searched)(make(seed), seed, method) for seed in seeds)
                for name, method in METHODS.items()
            },
        }
        for layout, make in LAYOUTS.items()
    }
    folder.mkdir(parents=True, exist_ok=True)
    drawn(episodes).savefig(folder / "successor.png")
    return [*(table(layout, methods) for layout, methods in episodes.items()), expansions(seeds[:EXPANSIONS])]


def table(layout: str, methods: dict[str, list[Episode]]) -> Table:
    """Return a row for each method: counts of all its episodes, then medians of those that succeeded."""
    rows = []
    for name, episodes in methods.items():
        succeeded = [episode for episode in episodes if episode.outcome == "success"]
        counts = (str(sum(one.outcome == outcome for one in episodes)) for outcome in ("success", "collision", "time-out"))
        rows.append((
            name, str(len(episodes)), *counts, str(sum(one.decisions <= MOST_DECISIONS for one in succeeded)),
            *(_median(succeeded, field) for field in ("decisions", "coarse", "precise", "cost", "activations", "seconds")),
            _median(episodes, "planning", ".1f"), f"{min(one.gap for one in episodes):.3f}",
        ))
    return Table(
        f"Layout {layout}, seeds from {FIRST_SEED}",
        (
            "method", "episodes", "success", "collision", "time-out", f"success within {MOST_DECISIONS}", "decisions", "coarse",
            "precise", "cost", "activations", "on the substrate (s)", "planning (s, CPU)", "smallest gap",
        ),
        tuple(rows),
        "Decisions, cost, activations and time: medians of successes. A decision of the closed loop is a look and the activations "
        "until the next one; a decision of a search is a step, which expands into many activations.",
    )


def expansions(seeds: Sequence[int]) -> Table:
    """Return what its steps, from the starts of scattered episodes, expand into on the substrate."""
    found: dict[str, list[tuple[float, int, float]]] = {}
    for seed in seeds:
        decisions = Decisions(parse(LAYOUTS["scattered"](seed)).problem)
        poses = np.array(decisions.problem.starts)
        for action in range(PRECISE + 1):
            kind = "precise, all that are away" if action == PRECISE else f"coarse, {decisions.members[action].sum()} robots"
            count, length = decisions.activations(action, decisions.step(action, poses))
            found.setdefault(kind, []).append((decisions.cost(action, poses), count, length / SPEED))
    medians = {kind: np.median(figures, axis=0) for kind, figures in found.items()}
    rows = [
        (kind, str(len(found[kind])), f"{cost:.1f}", f"{count:.0f}", f"{seconds:.0f}")
        for kind, (cost, count, seconds) in sorted(medians.items())
    ]
    return Table(
        f"What a step takes on the substrate, medians over {len(seeds)} seeds",
        ("step", "steps", "cost", "activations", "time (s)"),
        tuple(rows),
        "By the primitives h_i, Rot, the subgroups of brackets and single robots, as `stressbot_planner.primitives` expands them.",
    )


def _median(episodes: list[Episode], field: str, form: str = ".0f") -> str:
    return f"{np.median([getattr(one, field) for one in episodes]):{form}}" if episodes else "-"


PANELS = (("cost", "cost"), ("activations", "activations"), ("seconds", "time on the substrate (s)"))
GRID = "#e6e6e6"
MARKS = {"success": "o", "collision": "x", "time-out": "|"}


def drawn(episodes: dict[str, dict[str, list[Episode]]]) -> Figure:
    """Return a picture: of each layout its first episode, then panels with a mark an episode, by how it ended."""
    figure = Figure(figsize=(13.0, 3.3 * len(episodes)), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    maps, panels = figure.subfigures(1, 2, width_ratios=(1.0, 3.2))
    for axes, layout in zip(maps.subplots(len(episodes), 1, squeeze=False)[:, 0], episodes, strict=True):
        _draw_map(axes, layout)
    grid = panels.subplots(len(episodes), len(PANELS), squeeze=False, sharex="col", sharey=True)
    for row, methods in zip(grid, episodes.values(), strict=True):
        for axes, (field, _) in zip(row, PANELS, strict=True):
            for k, runs in enumerate(methods.values()):
                heights = k + np.linspace(-0.3, 0.3, len(runs))
                for outcome, mark in MARKS.items():
                    which = [index for index, run in enumerate(runs) if run.outcome == outcome]
                    values = [getattr(runs[index], field) for index in which]
                    axes.plot(values, heights[which], mark, color=COLOURS[k], markersize=5, markerfacecolor="none")
            axes.set_xscale("log")
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(color=GRID)
        for k, runs in enumerate(methods.values()):
            row[-1].annotate(_ended_well(runs), (1.02, k), xycoords=("axes fraction", "data"), va="center", color=COLOURS[k])
    for axes, (_, label) in zip(grid[-1], PANELS, strict=True):
        axes.set_xlabel(label)
    names = list(next(iter(episodes.values())))
    grid[0, 0].set_yticks(range(len(names)), names)
    grid[0, 0].set_ylim(len(names) - 0.5, -0.5)
    grid[0, 0].set_title("o success, x collision, | time-out", fontsize=10, loc="left")
    return figure


def _draw_map(axes: Axes, layout: str) -> None:
    problem = parse(LAYOUTS[layout](FIRST_SEED)).problem
    for disc in problem.environment.obstacles:
        axes.add_patch(Circle(disc.center, disc.radius, color="#b0b0b0"))
    for k, (start, goal) in enumerate(zip(problem.starts, problem.goals, strict=True)):
        colour = style(k).colour
        axes.add_patch(Circle(start[:2], BODY, color=colour))
        axes.plot(*goal, "x", color=colour, markersize=5)
    axes.set(xlim=(0, SIDE), ylim=(0, SIDE), aspect="equal", xticks=(0, 5, 10, 15), yticks=(0, 5, 10, 15))
    axes.set_title(f"{layout}, seed {FIRST_SEED}", fontsize=10, loc="left")


def _ended_well(runs: list[Episode]) -> str:
    return f"{sum(run.outcome == 'success' for run in runs)}/{len(runs)}"
