"""A plan as a film: robots move by the model along their paths, the active group is filled, its arms raised."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.kinematics import advance
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reporting import icons
from stressbot_planner.reporting.palette import style
from stressbot_planner.reporting.plotting import draw_scene
from stressbot_planner.system import files

WRITERS: dict[str, type[PillowWriter | FFMpegWriter]] = {"gif": PillowWriter, "mp4": FFMpegWriter}

RATE = 12
"""Frames a second."""

LONGEST = 15.0
"""s of film; a longer plan is shown faster."""

DOTS = 80
"""Per inch: a film of seven inches is as wide as a column of a page."""

LINGER = 1.0
"""s that the last frame stays."""


def check_format(ending: str) -> None:
    """Raise StressbotError if no film with this ending can be made here."""
    if not WRITERS[ending].isAvailable():
        raise StressbotError(ErrorCode.UNSUPPORTED, "--output", "ends in '.mp4', which takes ffmpeg: install it, or write a .gif")


def write(path: Path, plan: Plan, length_unit: float, title: str) -> None:
    """Write the film of a plan; the ending says the format.

    Args:
        path: of the file.
        plan: to be shown.
        length_unit: m per unit.
        title: above the picture.

    Raises:
        StressbotError: UNSUPPORTED if the format takes a program that is not here; what `files.replacing` raises.
    """
    ending = path.suffix[1:]
    check_format(ending)
    figure, axes, lengths = draw_scene(plan.problem, plan.poses, length_unit, title)
    robots = range(plan.problem.swarm.n)
    lines = [style(j).line for j in robots]
    colours = [style(j).colour for j in robots]
    ahead = [to_rgba(colour, 0.3) for colour in colours]
    axes.add_collection(LineCollection([plan.poses[:, j, :2] for j in robots], colors=ahead, linestyles=lines, zorder=3))
    trails = LineCollection([], colors=colours, linestyles=lines, linewidths=1.4, zorder=4)
    bodies = PolyCollection([], edgecolors=colours, linewidths=1.2, zorder=8)
    for collection in (trails, bodies):
        axes.add_collection(collection)
    clock = axes.text(0.01, 0.01, "", transform=axes.transAxes, fontsize=9, zorder=9)
    writer = WRITERS[ending](fps=RATE)
    with TemporaryDirectory() as folder:
        whole = Path(folder) / f"film.{ending}"
        with writer.saving(figure, str(whole), DOTS):
            for time, index, poses in _frames(plan):
                lit = np.zeros(len(robots)) if index is None else plan.problem.swarm.membership[plan.groups[index] - 1]
                before = plan.poses[: len(plan.poses) if index is None else index + 1]
                trails.set_segments([np.vstack([before[:, j, :2], poses[j, :2]]) for j in robots])
                bodies.set_verts([icons.polygons(poses[j : j + 1], float(lengths[j]))[0] for j in robots])
                bodies.set_facecolor([to_rgba(colours[j], 0.9 if lit[j] else 0.15) for j in robots])
                clock.set_text(f"{time:.1f} s" + ("" if index is None else f"   group {plan.groups[index]}"))
                writer.grab_frame()
        with files.replacing(path) as stream:
            stream.write(whole.read_bytes())


def _frames(plan: Plan) -> Iterator[tuple[float, int | None, np.ndarray]]:
    """Yield driving time, s, the activation that is under way (None at the end) and the poses, (n, 3), of each frame."""
    swarm = plan.problem.swarm
    ends = np.cumsum(plan.lengths) / swarm.speed
    duration = float(ends[-1]) if len(ends) else 0.0
    count = int(np.ceil(RATE * min(duration, LONGEST)))
    for time in np.linspace(0.0, duration, count, endpoint=False):
        index = int(np.searchsorted(ends, time, side="right"))
        begun = ends[index - 1] if index else 0.0
        yield time, index, advance(swarm, plan.poses[index], int(plan.groups[index]), swarm.speed * (time - begun))
    for _ in range(round(RATE * LINGER)):
        yield duration, None, plan.poses[-1]
