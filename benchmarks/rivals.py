"""Ways to tell robots apart under one signal, on the same bench: plans by the same planner, then driven from volts."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import witness
import yaml
from closed_loop import TOLERANCE, Run, closed, opened
from joblib import Parallel, delayed
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from stressbot_planner import planners
from stressbot_planner.formats import scenario
from stressbot_planner.reporting.palette import COLOURS
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table
from stressbot_planner.sequencing import encode

AGREEMENT = 1e-9
"""units between the end of a plan and that of robots that saw its volts."""

LIMITS = {2: 1.0, 6: 5.0, 14: 15.0, 30: 40.0, 62: 100.0}
"""Robots: s of processor for a plan."""

FIRST_SEED = 2000

TICKS = 1, 2, 5, 10, 20, 50, 100

LOWEST, HIGHEST = 150.0, 190.0
"""V, of arms that come down at levels of their own."""

RADII = 0.5, 1.5
"""Turning radii of robots that are told apart by them."""

SPREAD = 0.1
"""Relative sigma of speeds and radii that fabrication leaves, where robots are told apart by these."""

FLAWS: dict[str, dict[str, float]] = {
    "none": {},
    "speeds and radii 3 %": {"speed_error": 0.03, "radius_error": 0.03},
    "speeds and radii 10 %": {"speed_error": 0.1, "radius_error": 0.1},
    "thresholds 1 V": {"threshold_error": 1.0},
    "thresholds 4 V": {"threshold_error": 4.0},
    "headings 2 deg": {"heading_noise": float(np.radians(2.0))},
    "symbols missed 1 %": {"dropped_symbols": 0.01},
}
"""Of open and closed loops, one at a time."""


def group_control(content: dict[str, Any], rng: np.random.Generator) -> None:
    """The paper's: as few groups as its binary codewords take."""


def one_code(content: dict[str, Any], rng: np.random.Generator) -> None:
    """A PFSM code each: n + 1 groups."""
    n = len(content["robots"])
    content["swarm"]["groups"] = ["0" * k + "1" + "0" * (n - k - 1) for k in range(n)]


def gcsr(content: dict[str, Any], rng: np.random.Generator) -> None:
    """Global control, selective response: no PFSM, each arm comes down at a level of its own, in no order."""
    n = len(content["robots"])
    content["swarm"]["groups"] = "by_level"
    levels = np.linspace(LOWEST, HIGHEST, n) if n > 1 else np.array([LOWEST])
    content["electrical"]["pull_down"] = rng.permutation(levels).tolist()


def tsc(content: dict[str, Any], rng: np.random.Generator) -> None:
    """Turning-rate selective control: two groups, turning radii apart by design."""
    n = len(content["robots"])
    content["swarm"] |= {"groups": "by_radius", "turning_radius": rng.permutation(np.linspace(*RADII, n)).tolist()}


def ensemble(content: dict[str, Any], rng: np.random.Generator) -> None:
    """Ensemble control: two groups, speeds and radii that fabrication has left apart and calibration knows."""
    n = len(content["robots"])
    speed, radius = 1.0 + SPREAD * np.clip(rng.standard_normal((2, n)), -3.0, 3.0)
    content["swarm"] |= {"groups": "by_radius", "speed": speed.tolist(), "turning_radius": radius.tolist()}


PARADIGMS: dict[str, Callable[[dict[str, Any], np.random.Generator], None]] = {
    "group control": group_control, "one code a robot": one_code, "GCSR": gcsr, "TSC": tsc, "ensemble control": ensemble,
}


def text_of(paradigm: str, text: str, seed: int) -> str:
    """Return a scenario of the paper's robots as one of a paradigm's, with pulses."""
    content = yaml.safe_load(text)
    content["electrical"] = {"drive": "pulses"}
    PARADIGMS[paradigm](content, np.random.default_rng([seed, len(content["robots"])]))
    return scenario.text(content)


class Planned(NamedTuple):
    """A plan: times (s of the substrate) and path, each ÷ that of straight lines; counts; s of processor until the first one."""

    driving: float
    total: float
    path: float
    activations: int
    first: float
    error: float


def plan(paradigm: str, n: int, discs: bool, seed: int) -> Planned | None:
    """Plan for the time, drive it from volts; None: no plan within the limit."""
    text = text_of(paradigm, instances.random(n, discs, seed), seed)
    loaded = scenario.parse(text)
    swarm, electrical = loaded.swarm, loaded.electrical
    begin, first = time.process_time(), []

    def listen(progress: planners.Progress) -> None:
        if np.isfinite(progress.execution_time) and not first:
            first.append(time.process_time() - begin)

    settings = planners.Settings(
        objective="time", time_limit=LIMITS[n], seed=seed, pulse_length=electrical.pulse_length(swarm.speed),
        selection_time=electrical.selection_time, clock=time.process_time, on_progress=listen,
    )
    found = planners.solve(loaded.problem, "optimize", settings).plan
    if found is None:
        return None
    places = witness.driven(text, encode(swarm, electrical, found.groups, found.lengths)) / loaded.length_unit
    straight = np.hypot(*(found.problem.goals - found.problem.starts[:, :2]).T)
    least = float((straight / (swarm.speed * swarm.pace)).max())
    selection = electrical.selection_time * len(found.groups)
    return Planned(
        found.execution_time / least, (found.execution_time + selection) / least, found.path_length / float(straight.sum()),
        len(found.groups), first[0] if first else time.process_time() - begin, float(np.abs(places - found.poses[-1, :, :2]).max()),
    )


def tables(full: bool, folder: Path) -> list[Table]:
    """Return both tables, and draw the first."""
    return [growth(full, folder), flawed(full)]


def growth(full: bool, folder: Path) -> Table:
    """Plans for growing swarms, with and without discs."""
    sizes, seeds = (tuple(LIMITS), 10) if full else ((2, 6, 14), 3)
    rows, points = [], []
    for n in sizes:
        for discs in (False, True):
            for paradigm in PARADIGMS:
                found = Parallel()(delayed(plan)(paradigm, n, discs, FIRST_SEED + k) for k in range(seeds))
                plans = [one for one in found if one is not None]
                ratio = float(np.median([one.total for one in plans])) if 2 * len(plans) > seeds else None
                points.append((paradigm, n, discs, ratio))
                rows.append((str(n), "discs" if discs else "open", paradigm, f"{len(plans)}/{seeds}", *_cells(plans)))
    folder.mkdir(parents=True, exist_ok=True)
    _draw(points).savefig(folder / "rivals.png")
    return Table(
        "Plans by paradigm",
        (
            "n", "plane", "paradigm", "plans", "driving", "driving + selection", "path", "activations", "first plan (s)",
            "from volts",
        ),
        tuple(rows),
        "- Random fields of the paper's density, pulses of 12 nm. `optimize` for the time, in "
        f"{', '.join(f'{limit:g} s ({n} robots)' for n, limit in LIMITS.items() if n in sizes)} of processor. Medians (largest) "
        "over plans; times ÷ that of the longest straight line at full speed, paths ÷ the sum of straight lines. Volts alone reach "
        "the simulated robots.",
    )


def _cells(plans: list[Planned]) -> tuple[str, ...]:
    if not plans:
        return ("-",) * 6
    error = max(one.error for one in plans)
    return (
        *(_spread([getattr(one, name) for one in plans]) for name in ("driving", "total", "path", "activations", "first")),
        "same" if error <= AGREEMENT else f"DIFFERS by {error:.1e}",
    )


def _spread(values: list[float]) -> str:
    return f"{np.median(values):.3g} ({max(values):.3g})"


def flawed(full: bool) -> Table:
    """The paper's six robots past two discs, imperfect in one way at a time."""
    seeds = range(FIRST_SEED, FIRST_SEED + (20 if full else 2))
    rows = []
    for paradigm in PARADIGMS:
        for name, flaws in FLAWS.items():
            runs = Parallel()(delayed(drive)(paradigm, flaws, seed) for seed in seeds)
            blind, looking = zip(*runs, strict=True)
            rows.append((
                paradigm, name, _reached(blind), f"{np.median([run.error for run in blind]):.2f}", _reached(looking),
                f"{np.median([run.error for run in looking]):.2f}", f"{np.median([run.seconds for run in looking]):.0f}",
                f"{np.median([run.activations for run in looking]):.0f}",
            ))
    return Table(
        "Six robots, two discs, imperfect",
        (
            "paradigm", "what is off", "open loop: there, no touch", "largest error", "closed loop: there, no touch",
            "largest error", "s on the substrate", "activations",
        ),
        tuple(rows),
        f"- There: within {TOLERANCE} units. Errors of true poses, units, medians over {len(seeds)} seeds. Sigmas, but for "
        "symbols.",
    )


def drive(paradigm: str, flaws: dict[str, float], seed: int) -> tuple[Run, Run]:
    """Return an open and a closed loop."""
    text = text_of(paradigm, instances.paper(True), seed)
    ideal = {"speed_error": 0.0, "heading_bias": 0.0, "heading_noise": 0.0}
    return opened(text, seed, 0.5, **(ideal | flaws)), closed(text, seed, 0.5, **(ideal | flaws))


def _reached(runs: tuple[Run, ...]) -> str:
    return f"{sum(run.error <= TOLERANCE and run.gap >= 0.0 for run in runs)}/{len(runs)}"


def _draw(points: list[tuple[str, int, bool, float | None]]) -> Figure:
    figure = Figure(figsize=(9.0, 4.0), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, discs in zip(figure.subplots(1, 2, sharey=True), (False, True), strict=True):
        for colour, paradigm in zip(COLOURS, PARADIGMS, strict=False):
            mine = [(n, ratio) for name, n, among, ratio in points if (name, among) == (paradigm, discs) and ratio is not None]
            axes.plot(*zip(*mine, strict=True) if mine else ((), ()), "o-", color=colour, label=paradigm)
        axes.set(xscale="log", yscale="log", xlabel="robots", title="among discs" if discs else "open plane")
        sizes = sorted({n for _, n, _, _ in points})
        axes.set_xticks(sizes, [str(n) for n in sizes])
        axes.set_yticks(TICKS, [str(tick) for tick in TICKS])
        axes.minorticks_off()
        axes.grid(color="#e6e6e6")
    figure.axes[0].set_ylabel("driving and selection ÷ longest straight line")
    figure.axes[0].legend(frameon=False)
    return figure
