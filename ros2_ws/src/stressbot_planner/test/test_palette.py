"""Robots look different to everybody."""

from itertools import combinations

import numpy as np
import pytest
from colours import SIGHT, contrast_on_white, difference, lab

from stressbot_planner.reporting.palette import COLOURS, style


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0009), 7.1792),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_differences_are_those_of_the_published_test_data(one, other, expected):
    # Sharma, Wu and Dalal 2005
    assert difference(np.array(one), np.array(other)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("sight", SIGHT)
def test_all_colours_differ_clearly_for_every_kind_of_sight(sight):
    seen = [lab(colour, sight) for colour in (*COLOURS, "black")]
    assert min(difference(one, other) for one, other in combinations(seen, 2)) > 10


def test_the_colours_that_were_used_before_would_not_do():
    before = "#1f77b4", "#9467bd"
    assert difference(*(lab(colour, "protanopia") for colour in before)) < 3


def test_every_colour_is_seen_on_white():
    assert min(map(contrast_on_white, COLOURS)) > 2.2


def test_64_robots_have_styles_of_their_own_and_the_first_ones_differ_in_colour():
    styles = [style(j) for j in range(64)]
    assert len(set(styles)) == 64
    assert [one.colour for one in styles[: len(COLOURS)]] == list(COLOURS)
    assert style(64) == style(0)
