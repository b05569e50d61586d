"""The embedded system, and activations that follow it: what is kept exactly, and how fast the rest converges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import binary, by_radius
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.embedded import Weights, integrate, switch


def swarm_of(n: int) -> Swarm:
    return Swarm(1.0, np.linspace(0.7, 1.3, n), 0.3, binary(n))


def start_of(swarm: Swarm) -> np.ndarray:
    rng = np.random.default_rng(swarm.n)
    return np.column_stack([rng.uniform(-5, 5, (swarm.n, 2)), rng.uniform(-3, 3, swarm.n)])


def smooth(m: int) -> Weights:
    """Weights that sum to 1 everywhere, as the paper's do."""
    def v(way):
        raw = 1.2 + np.sin(np.arange(1, m + 1) * (0.7 * way + 0.3))
        return raw / raw.sum()

    return Weights.sampled(v, np.linspace(0.0, 5.0, 41))


def with_jumps(m: int) -> Weights:
    """Weights with jumps that no epoch begins at."""
    eye = np.eye(m)
    rows = [eye[0], eye[0] + eye[1], 0.4 + eye[-1], 0.2 + eye[1], 1.3 * eye[0], 0.8 + eye[1]]
    return Weights([0.0, 1.1, 1.1, 2.9, 2.9, 5.0], rows)


@st.composite
def weights(draw):
    """Return weights over up to six stretches, with jumps, zeros among them."""
    m, stretches = draw(st.integers(1, 5)), draw(st.integers(1, 6))
    ways = np.concatenate([[0.0], np.cumsum(draw(st.lists(st.floats(0.01, 3.0), min_size=stretches, max_size=stretches)))])
    value = st.one_of(st.just(0.0), st.floats(0.01, 2.0))
    rows = draw(st.lists(st.lists(value, min_size=m, max_size=m), min_size=2 * stretches, max_size=2 * stretches))
    return Weights(np.repeat(ways, 2)[1:-1], rows)


@given(weights(), st.integers(1, 20), st.booleans())
def test_lengths_sum_to_the_integrals_of_the_weights_and_none_is_negative(weights, epochs, symmetric):
    groups, lengths = switch(weights, epochs, symmetric)
    assert np.all(lengths > 0)
    assert np.all(np.diff(groups) != 0)
    m = weights.values.shape[1]
    areas = 0.5 * np.diff(weights.ways) @ (weights.values[1:] + weights.values[:-1])
    np.testing.assert_allclose(np.bincount(groups, lengths, m + 1)[1:], areas, atol=1e-9)
    assert len(groups) <= epochs * (2 * m - 1 if symmetric else m)


@given(weights(), st.floats(0, 1))
def test_weights_and_integrals_belong_together(weights, share):
    way = share * weights.length
    fine = np.unique(np.concatenate([weights.ways[weights.ways < way], [0.0, way]]))
    middles = (fine[1:] + fine[:-1]) / 2
    summed = sum((step * weights.at(middle) for step, middle in zip(np.diff(fine), middles, strict=True)), 0.0)
    np.testing.assert_allclose(weights.integrals([way])[0], summed, atol=1e-9)


@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("make", [smooth, with_jumps])
@pytest.mark.parametrize("n", [2, 6])
def test_headings_agree_with_the_embedded_system_at_the_end(n, make, symmetric):
    swarm = swarm_of(n)
    poses = replay(swarm, start_of(swarm), *switch(make(swarm.m), 7, symmetric))[-1]
    np.testing.assert_allclose(poses[:, 2], integrate(swarm, start_of(swarm), make(swarm.m))[:, 2], atol=1e-8)


@pytest.mark.parametrize("epochs", [1, 9])
def test_one_group_alone_needs_no_approximation(epochs):
    swarm = swarm_of(3)
    alone = Weights([0.0, 2.0], [[0.0, 1.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0]])
    groups, lengths = switch(alone, epochs)
    assert groups.tolist() == [2]
    poses = replay(swarm, start_of(swarm), groups, lengths)[-1]
    np.testing.assert_allclose(poses, integrate(swarm, start_of(swarm), alone), atol=1e-9)


def rate(swarm: Swarm, weights: Weights, symmetric: bool) -> float:
    """Return the slope of the final position error over the length of an epoch, in logarithms."""
    end = integrate(swarm, start_of(swarm), weights)
    epochs = 2 ** np.arange(5, 10)
    errors = []
    for count in epochs:
        poses = replay(swarm, start_of(swarm), *switch(weights, int(count), symmetric))[-1]
        errors.append(np.hypot(*(poses - end)[:, :2].T).max())
    return float(np.polyfit(np.log(weights.length / epochs), np.log(errors), 1)[0])


@pytest.mark.parametrize("swarm", [swarm_of(6), swarm_of(14), Swarm(1.0, [1.0, 0.7, 0.5], 0.3, by_radius([1.0, 0.7, 0.5]))],
                         ids=["6", "14", "two groups"])
def test_the_error_falls_with_the_epoch_in_first_order_and_in_second_for_the_symmetric_cycle(swarm):
    assert rate(swarm, smooth(swarm.m), symmetric=False) == pytest.approx(1.0, abs=0.1)
    assert rate(swarm, smooth(swarm.m), symmetric=True) == pytest.approx(2.0, abs=0.1)


def test_jumps_of_the_weights_keep_the_orders():
    swarm = swarm_of(6)
    assert rate(swarm, with_jumps(swarm.m), symmetric=False) == pytest.approx(1.0, abs=0.1)
    assert rate(swarm, with_jumps(swarm.m), symmetric=True) >= 1.7  # an epoch that holds a jump has its own constant


@pytest.mark.parametrize(
    ("ways", "values", "code", "field"),
    [
        ([0.0, 1.0], [[1.0, -0.1], [1.0, 0.0]], ErrorCode.OUT_OF_RANGE, "values"),
        ([0.0, 1.0], [[1.0, np.nan], [1.0, 0.0]], ErrorCode.NOT_FINITE, "values"),
        ([0.0, np.inf], [[1.0], [1.0]], ErrorCode.NOT_FINITE, "ways"),
        ([0.0, 1.0], [[1.0]], ErrorCode.WRONG_COUNT, "values"),
        ([0.0], [[1.0]], ErrorCode.WRONG_COUNT, "values"),
        ([0.5, 1.0], [[1.0], [1.0]], ErrorCode.OUT_OF_RANGE, "ways"),
        ([0.0, 2.0, 1.0], [[1.0], [1.0], [1.0]], ErrorCode.OUT_OF_RANGE, "ways"),
        ([0.0, 0.0], [[1.0], [1.0]], ErrorCode.OUT_OF_RANGE, "ways"),
    ],
)
def test_weights_that_nothing_could_follow_are_refused(ways, values, code, field):
    with pytest.raises(StressbotError) as caught:
        Weights(ways, values)
    assert (caught.value.code, caught.value.field) == (code, field)


def test_epochs_and_groups_are_checked():
    with pytest.raises(StressbotError, match="epochs"):
        switch(smooth(4), 0)
    with pytest.raises(StressbotError, match="3 groups: the swarm has 4"):
        integrate(swarm_of(6), start_of(swarm_of(6)), smooth(3))
