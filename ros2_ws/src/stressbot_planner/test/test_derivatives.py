"""The optimiser's derivatives against finite differences."""

import numpy as np
import pytest

from stressbot_planner.collision.clearance import Shapes, clearance
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.goal_reaching import end_jacobian
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners.optimization.derivatives import goal_functionals, jacobian, weighted_hessian
from stressbot_planner.planners.optimization.gaps import near_gaps

ENVIRONMENT = Environment(
    Workspace(-3, 12, -3, 12),
    (Circle((5, 3), 1.0), Polygon([(1, 7), (4, 6), (3, 9)]), Polygon([(8, 8), (9, 8), (9, 10), (8.5, 8.5)])),
)


def motion(seed: int, radii=1.0, pace=1.0, count=12):
    rng = np.random.default_rng(seed)
    swarm = Swarm(1.0, radii, 0.3, binary(6), pace)
    start = np.column_stack([rng.uniform(0, 9, (6, 2)), rng.uniform(0, 6, 6)])
    groups = rng.integers(1, 5, count)
    return swarm, swarm.slides[groups - 1], start, groups, rng.uniform(0.2, 1.5, count)


PACES = [0.6, 1.0, 0.8, 0.9, 0.7, 0.5]


@pytest.mark.parametrize(("radii", "pace"), [(1.0, 1.0), ([0.5, 0.6, 0.8, 1.0, 1.3, 1.7], 1.0), (1.0, PACES)])
@pytest.mark.parametrize("seed", range(3))
def test_first_and_second_derivatives_of_final_positions(seed, radii, pace):
    swarm, slides, start, _, t = motion(seed, radii, pace)
    multipliers = np.random.default_rng(seed).normal(size=12)

    def rows(t):
        poses = trajectory(slides, swarm.turning_length, start, t)
        return jacobian(12, goal_functionals(poses), slides, swarm.turning_length, poses)

    def final(t):
        return trajectory(slides, swarm.turning_length, start, t)[-1, :, :2].ravel()

    poses = trajectory(slides, swarm.turning_length, start, t)
    goals, half = goal_functionals(poses), 0.5 * multipliers
    hessian = weighted_hessian(half, goals, half, goals, slides, swarm.turning_length, poses, t) / np.outer(t, t)
    ends, relative = end_jacobian(slides, swarm.turning_length, start, t, t)
    np.testing.assert_allclose(ends.ravel(), final(t), atol=1e-12)
    np.testing.assert_allclose(relative, rows(t) * t, atol=1e-12)
    for k, step in enumerate(1e-6 * np.eye(len(t))):
        np.testing.assert_allclose(rows(t)[:, k], (final(t + step) - final(t - step)) / 2e-6, atol=1e-7)
        np.testing.assert_allclose(hessian[k], multipliers @ (rows(t + step) - rows(t - step)) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("pace", [1.0, PACES])
@pytest.mark.parametrize("seed", range(8))
def test_gaps_and_their_derivatives(seed, pace):
    swarm, slides, start, groups, t = motion(seed, pace=pace)
    shapes = Shapes.of(ENVIRONMENT)

    def gaps(t):
        poses = trajectory(slides, swarm.turning_length, start, t)
        return near_gaps(100.0, slides, poses, t, swarm.body_radius, shapes)

    here, near = gaps(t)
    poses = trajectory(slides, swarm.turning_length, start, t)
    rows = jacobian(len(here), near, slides, swarm.turning_length, poses)
    # a center inside a polygon is pushed out from a place that is not stationary
    outside = here > -0.299
    smooth = np.zeros(len(here), dtype=bool)
    for k, step in enumerate(1e-6 * np.eye(len(t))):
        ahead, behind = gaps(t + step)[0], gaps(t - step)[0]
        # where the closest place jumps (a corner, an end, a symmetric crossing) one-sided slopes differ
        kink = np.abs((ahead - here) - (here - behind)) > 1e-9
        steady = outside & ~kink
        smooth |= steady
        np.testing.assert_allclose(rows[steady, k], ((ahead - behind) / 2e-6)[steady], atol=1e-5)
    assert smooth.mean() > 0.9


@pytest.mark.parametrize("seed", range(8))
def test_gaps_within_reach_are_those_of_all_that_are_small(seed):
    swarm, slides, start, _, t = motion(seed, count=150)
    t[::20] *= 10
    poses = trajectory(slides, swarm.turning_length, start, t)
    gaps, near = (near_gaps(reach, slides, poses, t, swarm.body_radius, Shapes.of(ENVIRONMENT))[0] for reach in (100.0, 1.0))
    np.testing.assert_array_equal(near, gaps[gaps < 1.0])


@pytest.mark.parametrize("seed", range(8))
def test_of_each_meeting_of_two_robots_the_smallest_gap_is_kept(seed):
    swarm, slides, start, _, t = motion(seed, count=60)
    poses = trajectory(slides, swarm.turning_length, start, t)
    nothing = Shapes.of(Environment())
    every, near = near_gaps(2.0, slides, poses, t, swarm.body_radius, nothing)
    kept, near_kept = near_gaps(2.0, slides, poses, t, swarm.body_radius, nothing, meetings=True)
    pairs, pairs_kept = (list(zip(f.robot[::2], f.robot[1::2], strict=True)) for f in (near, near_kept))
    assert set(pairs_kept) == set(pairs) and len(kept) <= len(every)
    np.testing.assert_array_equal(near_kept.row, np.repeat(np.arange(len(kept)), 2))
    for pair in set(pairs):
        of_pair = [gap for gap, other in zip(every, pairs, strict=True) if other == pair]
        assert min(of_pair) == min(gap for gap, other in zip(kept, pairs_kept, strict=True) if other == pair)


@pytest.mark.parametrize("pace", [1.0, PACES])
@pytest.mark.parametrize("seed", range(8))
def test_the_smallest_near_gap_is_the_clearance(seed, pace):
    swarm, slides, start, groups, t = motion(seed, pace=pace)
    environment = Environment(ENVIRONMENT.workspace, ENVIRONMENT.obstacles[:1])
    poses = trajectory(slides, swarm.turning_length, start, t)
    gaps, _ = near_gaps(100.0, slides, poses, t, swarm.body_radius, Shapes.of(environment))
    found = clearance(swarm, environment, start, groups, t).gap
    # those of the first and last places are nobody's to change
    ends = (clearance(swarm, environment, place, groups[:0], t[:0]).gap for place in (start, poses[-1]))
    assert gaps.min() >= found - 1e-12
    assert min(gaps.min(), *ends) == pytest.approx(found, abs=1e-12)
