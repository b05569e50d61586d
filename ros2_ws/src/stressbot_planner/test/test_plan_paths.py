"""The path of a robot in a plan says where it is at any time, in as few poses as that takes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.model.allocation import SCHEMES
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.view import plan_paths as module
from stressbot_planner.view.plan_paths import plan_paths


@st.composite
def plans(draw):
    """Return (swarm, starts, groups, lengths), some of these 0."""
    n = draw(st.integers(1, 9))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    swarm = Swarm(1.0, rng.uniform(0.3, 2.0, n), 0.3, SCHEMES[draw(st.sampled_from(sorted(SCHEMES)))](n))
    count = draw(st.integers(0, 40))
    starts = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-4, 4, n)])
    lengths = rng.uniform(0, 4, count) * (rng.random(count) < 0.8)
    return swarm, starts, rng.integers(1, swarm.m + 1, count), lengths


def gap(points, line):
    """Distance of each of the points (p, 2) from a line through places (k, 2)."""
    begin, along = line[:-1], np.diff(line, axis=0)
    share = np.einsum("pkx,kx->pk", points[:, None] - begin, along) / np.maximum((along**2).sum(axis=1), 1e-300)
    nearest = begin + np.clip(share, 0, 1)[..., None] * along
    return np.hypot(*(points[:, None] - nearest).T).min(axis=0)


@pytest.mark.parametrize("chunk", [1, 10, module._CHUNK])
@given(plan=plans())
def test_a_path_leads_through_all_places_of_the_plan_and_each_stretch_is_a_slide_or_a_turn(chunk, plan):
    swarm = plan[0]
    rows = list(range(swarm.n))[::-2]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(module, "_CHUNK", chunk)
        paths = plan_paths(*plan, rows)
    track = replay(*plan)
    for row, path in zip(rows, paths, strict=True):
        np.testing.assert_allclose(path[[0, -1]], track[[0, -1], row], atol=1e-9)
        assert gap(track[:, row, :2], path[:, :2]).max() < 1e-9
        assert gap(path[:, :2], track[:, row, :2] if len(track) > 1 else path[:, :2]).max() < 1e-9
        step, turn = np.diff(path[:, :2], axis=0), np.diff(path[:, 2])
        slides = np.hypot(*step.T) > 0
        assert not (slides & (turn != 0)).any()
        ahead = np.column_stack([np.cos(path[:-1, 2]), np.sin(path[:-1, 2])])
        np.testing.assert_allclose(step, np.hypot(*step.T)[:, None] * ahead, atol=1e-9)
        assert (slides[1:] != slides[:-1]).all()


@given(plan=plans(), longest=st.integers(1, 6))
def test_a_long_path_is_cut_at_its_end(plan, longest):
    whole, cut = plan_paths(*plan, [0])[0], plan_paths(*plan, [0], longest)[0]
    np.testing.assert_array_equal(cut, whole[:longest])
