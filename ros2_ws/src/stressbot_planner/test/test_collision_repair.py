"""Collision repair: the linear systems of a step, and when it ends."""

import numpy as np
import pytest

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners.optimization import collision_repair
from stressbot_planner.planners.optimization.central_path import CentralPath, Order, Point
from stressbot_planner.planners.optimization.collision_repair import LOOK_BACK, TOO_SLOW, _is_too_slow, _rows, _square, repair
from stressbot_planner.reproduce import instances

SIX, THIRTY = (scenario.parse(text).problem for text in (instances.paper(True), instances.random(30, False, 1)))


def path_and_guess(problem, cycles, seed=0, out_of_time=lambda: False):
    swarm, rng = problem.swarm, np.random.default_rng(seed)
    groups = np.tile(np.arange(1, swarm.m + 1), cycles)
    order = Order(groups, swarm.slides[groups - 1], np.ones(len(groups)))
    path = CentralPath(problem, Shapes.of(problem.environment), order, 0.1, out_of_time=out_of_time)
    return path, rng.uniform(0.5, 2.5, len(groups))


def test_rows_are_the_derivatives_of_goals_and_gaps_and_end_where_they_say():
    orders = [path_and_guess(SIX, 20, seed) for seed in range(20)]
    path, t = next((path, t) for path, guess in orders if (t := path.restore(guess, patient=True)) is not None)
    here = path.evaluate(t)
    rows, gaps, last = _rows(path, here)
    assert np.all(np.diff(last) <= 0)
    np.testing.assert_array_equal(np.sort(gaps), np.sort(here.gaps))
    for row, end in zip(rows, last, strict=True):
        assert not row[end:].any()
    step = 1e-7 * np.random.default_rng(1).normal(size=len(t))
    ahead, behind = path.evaluate(t + step), path.evaluate(t - step)
    moved = (ahead.poses - behind.poses)[-1, :, :2].ravel() / 2
    np.testing.assert_allclose(rows[:12] @ step, moved, atol=1e-10)
    assert len(ahead.gaps) == len(behind.gaps) == len(gaps)
    order, rank = np.argsort(here.gaps), np.argsort(gaps)
    assert np.median(np.abs((ahead.gaps - behind.gaps)[order] / 2 - (rows[12:] @ step)[rank])) < 1e-10


@pytest.mark.parametrize(("count", "columns"), [(3, 40), (90, 1000), (40, 4000)])
def test_products_of_rows_that_end_early_are_products_of_rows(count, columns):
    rng = np.random.default_rng(count)
    last = -np.sort(-rng.integers(0, columns + 1, count))
    last[0] = columns
    rows = rng.normal(size=(count, columns)) * (np.arange(columns) < last[:, None])
    np.testing.assert_allclose(_square(rows, last), rows @ rows.T, atol=1e-10)


@pytest.mark.parametrize(("cycles", "least"), [(12, 5), (25, 15)])
def test_what_is_repaired_reaches_its_goals_without_a_touch(cycles, least):
    """A quarter of short orders and three quarters of longer ones are, whatever the processor: 11 and 20 of 20 were."""
    count = 0
    for seed in range(20):
        path, guess = path_and_guess(SIX, cycles, seed)
        t = repair(path, guess, np.random.default_rng(seed))
        if t is None:
            continue
        poses = replay(SIX.swarm, SIX.starts, path.order.groups, t)
        np.testing.assert_allclose(poses[-1, :, :2], SIX.goals, atol=1e-8)
        assert clearance_of(SIX.swarm, path.shapes, poses, path.order.groups, t).gap > 0
        count += 1
    assert count >= least


def test_nothing_is_computed_after_time_is_over():
    looks = [0]

    def out_of_time():
        looks[0] += 1
        return looks[0] > 12

    path, guess = path_and_guess(THIRTY, 60, out_of_time=out_of_time)
    evaluate, late = path.evaluate, []
    path.evaluate = lambda *arguments: (late.append(looks[0]), evaluate(*arguments))[1]
    assert repair(path, guess, np.random.default_rng(0)) is None
    assert looks[0] > 12
    assert sum(look > 12 for look in late) <= 1


@pytest.mark.parametrize(("share", "too_slow"), [(0.5, True), (2.0, False)])
@pytest.mark.parametrize("overlap", [0.006, 1.0, 500.0])
def test_a_descent_is_given_up_that_would_take_too_many_steps_at_its_rate(overlap, share, too_slow):
    half_a_contact = 0.25 * 0.1**2
    rate = share * np.log(overlap / half_a_contact) / TOO_SLOW
    values = [overlap * np.exp(rate * steps) for steps in range(LOOK_BACK, -1, -1)]
    assert _is_too_slow([1e6, *values], 0.1) is too_slow


def test_a_perturbation_makes_no_descent_worse():
    for seed in range(6):
        path, guess = path_and_guess(SIX, 12, seed)
        without, perturbed = (repair(path, guess, np.random.default_rng(seed), perturbations) for perturbations in (0, 2))
        if without is not None:
            np.testing.assert_array_equal(perturbed, without)
        elif perturbed is not None:
            assert path.evaluate(perturbed).gaps.min(initial=1.0) > 0


@pytest.mark.parametrize(
    ("ends", "perturbations", "taken", "descents"),
    [
        ([-0.3, -0.1, 0.2], 2, 2, 3),  # each nearer than the one before
        ([-0.3, 0.2, 0.2], 2, 1, 2),  # clear: nothing more is tried
        ([-0.3, -0.4, 0.2], 2, 2, 3),  # one that is worse is left
        ([-0.3, None, 0.2], 2, 2, 3),  # and one that leads nowhere
        ([-0.3, -0.1, 0.2], 1, None, 2),
        ([None, 0.2], 2, None, 1),
    ],
)
def test_perturbations_save_a_descent_that_has_come_to_its_end(monkeypatch, ends, perturbations, taken, descents):
    """Descents as they are played here: each ends with one gap of that size, or nowhere."""
    path, guess = path_and_guess(SIX, 12)
    points = [end and Point(guess + number, None, np.array([end]), None) for number, end in enumerate(ends)]
    begun = []

    def descend(path, t):
        begun.append(t)
        return points[len(begun) - 1]

    monkeypatch.setattr(collision_repair, "_descend", descend)
    t = repair(path, guess, np.random.default_rng(0), perturbations)
    assert len(begun) == descents
    assert (t is None) == (taken is None)
    if taken is not None:
        np.testing.assert_array_equal(t, points[taken].t)
    for perturbed in begun[1:]:  # from the best so far, all durations changed a little
        assert np.all(perturbed != guess)
        assert min(np.abs(np.log(perturbed / point.t)).max() for point in points if point is not None) < 0.3
