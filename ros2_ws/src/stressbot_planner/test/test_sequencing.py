"""Encoding and decoding are inverse to each other, and refuse what they cannot encode."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.electrical import Electrical, default_codes
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import Activate, Turn
from stressbot_planner.sequencing import MAX_ACTIVATIONS, VoltageProgram, decode, encode, expand_bounded


def make_swarm(n=6, speed=1.0):
    return Swarm(speed, 1.0, 0.3, binary(n))


def make_electrical(m, level_count=2):
    symbols = tuple(10.0 + 10.0 * s for s in range(level_count))
    levels = (0.0, *symbols, symbols[-1] + 20.0, symbols[-1] + 60.0)
    return Electrical(
        rest_level=0.0, symbol_levels=symbols, reset_level=levels[-2], drive_level=levels[-1],
        thresholds=tuple((a + b) / 2 for a, b in zip(levels, levels[1:], strict=False)), hysteresis=2.0,
        pull_down=levels[-1] - 1.0, release=5.0, reset_dwell=0.01, symbol_dwell=0.011, guard_dwell=0.005, min_dwell=0.002,
        codes=default_codes(m, level_count), min_level=0.0, max_level=1000.0,
    )


@st.composite
def plans(draw):
    n = draw(st.integers(1, 200))
    swarm = make_swarm(n, draw(st.sampled_from([1.0, 0.3, 1e-4, 17.0])))
    count = draw(st.integers(0, 30))
    groups = draw(st.lists(st.integers(1, swarm.m), min_size=count, max_size=count))
    length = st.just(0.0) | st.floats(1e-300, 1e6)  # dwells that are not subnormal, which have fewer digits
    lengths = draw(st.lists(length, min_size=count, max_size=count))
    return swarm, make_electrical(swarm.m, draw(st.integers(2, 9))), np.array(groups, dtype=int), np.array(lengths)


@given(plans())
@settings(max_examples=300, deadline=None)
def test_decode_is_the_inverse_of_encode_for_any_m_and_any_number_of_levels(plan):
    swarm, electrical, groups, lengths = plan
    program = encode(swarm, electrical, groups, lengths)
    decoded_groups, decoded_lengths = decode(swarm, electrical, program)
    np.testing.assert_array_equal(decoded_groups, groups[lengths > 0])
    np.testing.assert_allclose(decoded_lengths, lengths[lengths > 0], rtol=4e-16)
    assert program.epoch_count == np.count_nonzero(lengths)
    assert np.all(program.dwells > 0)
    np.testing.assert_allclose(
        program.duration, lengths.sum() / swarm.speed + electrical.selection_time * program.epoch_count, rtol=1e-12
    )


def test_an_epoch_is_reset_symbols_and_drive_with_rests_between():
    swarm = make_swarm(6, speed=2.0)
    program = encode(swarm, make_electrical(4), np.array([3, 1]), np.array([5.0, 1.0]))
    assert program.levels.tolist() == [40.0, 0, 20, 0, 10, 0, 80, 0, 40, 0, 10, 0, 10, 0, 80, 0]
    assert program.dwells.tolist()[:8] == [0.01, 0.005, 0.011, 0.005, 0.011, 0.005, 2.5, 0.005]
    assert program.epoch_ends.tolist() == [8, 16]


def test_neighbours_of_the_same_group_stay_two_epochs():
    assert encode(make_swarm(), make_electrical(4), np.array([2, 2]), np.array([1.0, 1.0])).epoch_count == 2


@pytest.mark.parametrize(
    ("groups", "lengths", "code"),
    [
        ([0], [1.0], ErrorCode.UNKNOWN_GROUP),
        ([5], [1.0], ErrorCode.UNKNOWN_GROUP),
        ([-1], [1.0], ErrorCode.UNKNOWN_GROUP),
        ([1], [np.nan], ErrorCode.NOT_FINITE),
        ([1], [np.inf], ErrorCode.NOT_FINITE),
        ([1], [-1e-9], ErrorCode.OUT_OF_RANGE),
        ([1, 2], [1.0], ErrorCode.WRONG_COUNT),
        ([1.0], [1.0], ErrorCode.WRONG_TYPE),
        ([[1]], [[1.0]], ErrorCode.WRONG_COUNT),
    ],
)
def test_refused_activations_are_named(groups, lengths, code):
    with pytest.raises(StressbotError) as refusal:
        encode(make_swarm(), make_electrical(4), np.array(groups), np.array(lengths))
    assert refusal.value.code == code


def test_a_length_that_takes_no_time_is_refused():
    with pytest.raises(StressbotError, match="takes no time"):
        encode(make_swarm(speed=1e9), make_electrical(4), np.array([1]), np.array([5e-324]))


def test_codes_for_another_number_of_groups_are_refused():
    with pytest.raises(StressbotError) as refusal:
        encode(make_swarm(), make_electrical(5), np.array([1]), np.array([1.0]))
    assert refusal.value.code == ErrorCode.WRONG_COUNT


def changed(program, **changes):
    return VoltageProgram(**{**vars(program), **changes})


@pytest.mark.parametrize("change", ["level", "dwell", "ends", "cut", "drive"])
def test_decode_refuses_what_encode_would_not_make(change):
    swarm, electrical = make_swarm(), make_electrical(4)
    program = encode(swarm, electrical, np.array([1, 2, 3]), np.array([1.0, 2.0, 3.0]))
    levels, dwells = program.levels.copy(), program.dwells.copy()
    if change == "level":
        levels[10] = 33.0
        program = changed(program, levels=levels)
    elif change == "dwell":
        dwells[8] = 0.5
        program = changed(program, dwells=dwells)
    elif change == "ends":
        program = changed(program, epoch_ends=[7, 16, 24])
    elif change == "cut":
        program = changed(program, levels=levels[:-1], dwells=dwells[:-1])
    else:
        dwells[14] = np.nan
        program = changed(program, dwells=dwells)
    with pytest.raises(StressbotError) as refusal:
        decode(swarm, electrical, program)
    assert refusal.value.code == ErrorCode.INVALID_SEQUENCE


def test_programs_compare_by_value_and_cannot_be_changed():
    swarm, electrical = make_swarm(), make_electrical(4)
    program = encode(swarm, electrical, np.array([1]), np.array([1.0]))
    assert program == encode(swarm, electrical, np.array([1]), np.array([1.0]))
    assert program != encode(swarm, electrical, np.array([1]), np.array([2.0]))
    with pytest.raises(ValueError, match="read-only"):
        program.levels[0] = 1.0


@pytest.mark.timing
def test_a_hundred_thousand_epochs_take_less_than_a_second():
    swarm, electrical = make_swarm(1022), make_electrical(11)
    rng = np.random.default_rng(1)
    groups, lengths = rng.integers(1, swarm.m + 1, 100_000), rng.uniform(0.1, 1.0, 100_000)
    begin = time.process_time()
    program = encode(swarm, electrical, groups, lengths)
    assert time.process_time() - begin < 1.0
    np.testing.assert_array_equal(decode(swarm, electrical, program)[0], groups)


def test_expansion_joins_primitives_and_names_the_refused_one():
    swarm = make_swarm()
    groups, lengths = expand_bounded(swarm, [Activate(1, 2.0), Turn(2, np.pi)])
    assert groups.tolist() == [1, 2, 4, 2, 4]
    assert lengths[0] == 2.0
    assert len(expand_bounded(swarm, [])[0]) == 0
    with pytest.raises(StressbotError, match=r"primitives\[1\]\.group") as refusal:
        expand_bounded(swarm, [Activate(1, 2.0), Activate(9, 1.0)])
    assert refusal.value.code == ErrorCode.UNKNOWN_GROUP


def test_a_plan_that_would_fill_the_memory_is_refused():
    swarm = make_swarm()
    many = [Turn(1, np.pi, 1e-5)] * 100
    with pytest.raises(StressbotError, match=str(MAX_ACTIVATIONS)) as refusal:
        expand_bounded(swarm, many)
    assert refusal.value.code == ErrorCode.INVALID_PLAN
