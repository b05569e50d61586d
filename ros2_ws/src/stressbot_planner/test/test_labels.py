"""No label hides another one or a mark, and lines are left free where that can be."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.reporting.labels import place

PAGE = (500.0, 500.0)


def overlap(low, high, other_low, other_high) -> bool:
    return bool(np.all((low < np.asarray(other_high) - 1e-9) & (np.asarray(high) > np.asarray(other_low) + 1e-9)))


def check(anchors, marks, sizes, middles):
    boxes = [(middle - size / 2, middle + size / 2) for middle, size in zip(middles, sizes, strict=True) if middle is not None]
    for low, high in boxes:
        assert np.all(low >= 0) and np.all(high <= PAGE)
        for anchor, mark in zip(anchors, marks, strict=True):
            assert not overlap(low, high, anchor - mark, anchor + mark)
    for one, other in combinations(boxes, 2):
        assert not overlap(*one, *other)


@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(10, 500))
def test_labels_hide_nothing_however_crowded_their_points_are(seed, count, extent):
    rng = np.random.default_rng(seed)
    anchors = rng.uniform(0, extent, (count, 2))
    marks, sizes = rng.uniform(0, 6, count), np.column_stack([rng.uniform(4, 20, count), np.full(count, 9.0)])
    check(anchors, marks, sizes, place(anchors, marks, sizes, rng.uniform(0, extent, (500, 2)), PAGE))


@pytest.mark.parametrize("seed", range(5))
def test_124_labels_on_a_page_all_find_room_near_their_points(seed):
    rng = np.random.default_rng(seed)
    anchors, marks, sizes = rng.uniform(0, 500, (124, 2)), np.full(124, 4.0), np.tile([14.0, 9.0], (124, 1))
    middles = place(anchors, marks, sizes, np.empty((0, 2)), PAGE)
    assert all(middle is not None for middle in middles)
    away = [float(np.hypot(*(middle - anchor))) for middle, anchor in zip(middles, anchors, strict=True)]
    assert np.median(away) < 20 and max(away) < 80


def test_a_label_leaves_a_line_through_its_point_free():
    anchor, size = np.array([[250.0, 250.0]]), np.array([[6.0, 9.0]])
    for angle in np.linspace(0, np.pi, 7):
        line = 250.0 + np.linspace(-200, 200, 400)[:, None] * [np.cos(angle), np.sin(angle)]
        (middle,) = place(anchor, np.array([4.0]), size, line, PAGE)
        assert not np.any(np.all(np.abs(line - middle) < size / 2, axis=1))


def test_where_there_is_no_room_nothing_is_written():
    assert place(np.array([[5.0, 5.0]]), np.array([4.0]), np.array([[30.0, 9.0]]), np.empty((0, 2)), (10.0, 10.0)) == [None]
