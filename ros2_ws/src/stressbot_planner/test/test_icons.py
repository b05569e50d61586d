"""Icons are robots to scale, look where robots look, and stand where activations begin and end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stressbot_planner.reporting import icons

poses_strategy = st.integers(1, 60).flatmap(
    lambda count: arrays(float, (count, 3), elements=st.floats(-50, 50, allow_nan=False, width=32))
)


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e-4, 1.0])
def test_icons_are_120_by_60_micrometres_where_that_can_be_looked_at(unit):
    lengths, text = icons.size(np.array([30e-6, 60e-6, 0.0]) / unit, unit, 20e-4 / unit)
    np.testing.assert_allclose(lengths * unit, 120e-6)
    assert text == "robot, 120 × 60 µm"
    (corners,) = icons.polygons(np.array([[3.0, 4.0, 0.0]]) / unit, lengths[0])
    np.testing.assert_allclose(np.ptp(corners, axis=0) * unit, [120e-6, 60e-6])
    np.testing.assert_allclose((corners.min(axis=0) + corners.max(axis=0)) / 2 * unit, [3.0, 4.0])


@pytest.mark.parametrize("radius", [3.0, 100.0])
def test_other_robots_have_icons_that_fill_their_discs(radius):
    lengths, text = icons.size(np.array([radius]), 1.0, 30 * radius)
    corners = icons.polygons(np.zeros((1, 3)), lengths[0])
    assert np.hypot(*corners[0].T).max() == pytest.approx(radius)
    assert text == "robot"


@pytest.mark.parametrize(("span", "share"), [(1000.0, 1 / 80), (2.0, 1 / 12)])
def test_icons_that_could_not_be_seen_or_would_hide_everything_are_told_not_to_be_to_scale(span, share):
    lengths, text = icons.size(np.array([0.3]), 1e-4, span)
    assert lengths[0] == pytest.approx(share * span)
    assert "not to scale" in text


@given(st.floats(-10, 10), st.floats(0.1, 10))
def test_the_nose_is_in_front(heading, length):
    (corners,) = icons.polygons(np.array([[1.0, 2.0, heading]]), length)
    ahead = (corners - [1.0, 2.0]) @ [np.cos(heading), np.sin(heading)]
    nose = corners[np.argmax(ahead)] - [1.0, 2.0]
    np.testing.assert_allclose(nose, length / 2 * np.array([np.cos(heading), np.sin(heading)]), atol=1e-9)


@given(poses_strategy, st.floats(0.1, 10))
def test_every_pose_has_an_icon_that_looks_like_it_and_no_icon_is_drawn_twice(poses, length):
    kept = poses[icons.distinct(poses, length)]
    away = np.hypot(*(poses[:, None, :2] - kept[None, :, :2]).transpose(2, 0, 1)) / length
    turned = np.abs(np.angle(np.exp(1j * (poses[:, None, 2] - kept[None, :, 2]))))
    assert np.all(np.any((away <= 0.6) & (turned <= np.pi / 4 + 1e-6), axis=1))
    assert len(icons.distinct(np.vstack([poses, poses, poses]), length)) == len(kept)


@given(poses_strategy, st.integers(1, 59))
def test_more_activations_never_have_fewer_icons(poses, count):
    assert len(icons.polygons(poses[:count], 1.0)) <= len(icons.polygons(poses, 1.0))


def test_the_density_of_icons_is_that_of_activations():
    def along(count):
        return np.column_stack([np.linspace(0, 10, count), np.zeros(count), np.zeros(count)])

    assert [len(icons.polygons(along(count), 1.0)) for count in (2, 6, 11, 21)] == [2, 6, 11, 21]
    turning = np.column_stack([np.zeros((9, 2)), np.linspace(0, 2 * np.pi, 9)])
    assert len(icons.polygons(turning, 1.0)) == 8
