"""Plan the scenarios of scenarios/gallery and draw each as docs/images/gallery/NAME.png: `make gallery`.

A planner's tries are limited, not its seconds, so that the same machine draws the same picture again.
"""

import argparse
import io
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from stressbot_planner import Scenario, Settings, Solved, load
from stressbot_planner.planners.assignment import solve
from stressbot_planner.reporting.plotting import plot_plan

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = ROOT / "scenarios/gallery"
PICTURES = ROOT / "docs/images/gallery"
SIZES = ((640, 48), (560, 32), (480, 24), (400, 16))
"""Pixels across and colours, the first that make a picture small enough."""

LARGEST = 60_000
"""Bytes of a picture."""

TRIES, MOST = 30, 20
"""How often a planner tries; and the number of robots above which the first plan will do, and lines lead straight from
start to end: paths would hide each other."""

TIME_LIMIT = 300.0
"""s, for a machine that is slow or busy."""


def settings(scenario: Scenario) -> Settings:
    """Return how a scenario of the gallery is planned."""
    return Settings(time_limit=TIME_LIMIT, max_tries=TRIES, first=scenario.swarm.n > MOST)


def picture(figure: Figure) -> bytes:
    """Return a figure as a PNG with a palette, of at most `LARGEST` bytes where one of `SIZES` allows it."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=2 * SIZES[0][0] / figure.get_figwidth())
    large = Image.open(drawn).convert("RGB")
    data = b""
    for width, colours in SIZES:
        image = large.resize((width, round(width * large.height / large.width)), Image.Resampling.LANCZOS)
        small = io.BytesIO()
        image.quantize(colours, dither=Image.Dither.NONE).save(small, format="png", optimize=True)
        data = small.getvalue()
        if len(data) <= LARGEST:
            break
    return data


def draw(path: Path) -> str:
    """Plan a scenario, write its picture, and return a line for people."""
    scenario = load(path)
    result = solve(scenario.problem, "optimize", settings(scenario))
    if not isinstance(result, Solved):
        raise SystemExit(f"gallery: {path.name}: no plan: {result.reason}")
    plan = result.plan
    large = scenario.swarm.n > MOST
    poses, title = (plan.poses[[0, -1]], f"{scenario.name}: starts and ends") if large else (plan.poses, scenario.name)
    figure = plot_plan(plan.problem, poses, scenario.length_unit, title)
    data = picture(figure)
    if len(data) > LARGEST:
        raise SystemExit(f"gallery: {path.name}: the picture has {len(data)} bytes, more than {LARGEST}: draw less")
    PICTURES.mkdir(parents=True, exist_ok=True)
    (PICTURES / f"{path.stem}.png").write_bytes(data)
    return (
        f"{path.stem}: {scenario.swarm.n} robots, {len(plan.groups)} activations, path {plan.path_length:.0f} units, "
        f"{result.planning_time:.1f} s, {len(data) // 1000} kB"
    )


def main() -> None:
    """Draw the scenarios that are named, or all."""
    parser = argparse.ArgumentParser(prog="gallery", description="Draw the gallery of scenarios.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="of a file in scenarios/gallery, without .yaml (default: all)")
    names = parser.parse_args().names
    for path in sorted(SCENARIOS.glob("*.yaml")):
        if not names or path.stem in names:
            print(draw(path), flush=True)


if __name__ == "__main__":
    main()
