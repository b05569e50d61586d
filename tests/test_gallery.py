"""The gallery: ten scenarios from two robots to a hundred, each with a small picture and a place on its page."""

import re
from pathlib import Path

import gallery
import pytest
from PIL import Image

from stressbot_planner import Settings, Solved, load
from stressbot_planner.planners.assignment import solve

PAGE = (Path(__file__).resolve().parents[1] / "docs/gallery.md").read_text(encoding="utf-8")
SCENARIOS = sorted(gallery.SCENARIOS.glob("*.yaml"))
SMALL = [path for path in SCENARIOS if int(path.stem.split("-")[0]) <= 8]


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_loads_and_is_shown(path):
    scenario = load(path)
    assert scenario.name == path.stem and scenario.swarm.n == int(path.stem.split("-")[0])
    picture = gallery.PICTURES / f"{path.stem}.png"
    assert picture.stat().st_size <= gallery.LARGEST
    with Image.open(picture) as image:
        assert min(image.size) > 200
    assert f"(images/gallery/{path.stem}.png)" in PAGE and f"scenarios/gallery/{path.stem}.yaml" in PAGE


def test_there_are_ten_from_two_robots_to_a_hundred():
    counts = sorted(int(path.stem.split("-")[0]) for path in SCENARIOS)
    assert len(counts) == 10 and counts[0] == 2 and counts[-1] == 100
    assert {f"{path.stem}" for path in SCENARIOS} == set(re.findall(r"^## (.*)$", PAGE, re.MULTILINE))
    assert len(list(gallery.PICTURES.iterdir())) == 10


@pytest.mark.parametrize("path", SMALL, ids=lambda path: path.stem)
def test_small_ones_are_planned(path):
    assert isinstance(solve(load(path).problem, "optimize", Settings(first=True, max_tries=500, time_limit=300)), Solved)
