"""From voltage sequences to waveforms and repeats: exact to the sample, within the instrument's capacity, or refused."""

import numpy as np
import pytest
from driver_support import bench, encode, sequence
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.instruments.program import Capacity, Scale, compile_sequence

BENCH = bench(6)
LEVELS = [0.0, 40.0, 60.0, 90.0, 140.0]
CAPACITY = Capacity(min_points=8, memory=1_000_000, points_block=128, max_entries=512, max_repeats=1_000_000)
SCALE = Scale(gain=20.0, offset=5.0, amplitude=10.0, full_scale=32767)
RATE = 50e6


def compiled(played, rate=RATE, scale=SCALE, **capacity):
    return compile_sequence(played, 0.0, rate, scale, Capacity(**{**vars(CAPACITY), **capacity}))


def played_back(loads):
    """(code, samples) of all blocks in order, neighbours of one code joined."""
    runs = []
    for load in loads:
        for block in load.blocks:
            for entry in block.entries:
                waveform = load.waveforms[entry.name]
                assert (waveform == waveform[0]).all()
                if runs and runs[-1][0] == waveform[0]:
                    runs[-1][1] += len(waveform) * entry.repeats
                else:
                    runs.append([int(waveform[0]), len(waveform) * entry.repeats])
    return runs


def entries_of(load):
    return sum(len(block.entries) + 1 for block in load.blocks) + 1


def points_of(load):
    return sum(-(-len(w) // 128) * 128 for w in load.waveforms.values()) + 128 * entries_of(load)


epochs = st.lists(
    st.tuples(st.sampled_from(LEVELS[1:]), st.floats(2e-7, 300.0), st.floats(2e-7, 0.01)), min_size=1, max_size=40
)


@settings(deadline=None, max_examples=60)
@given(epochs, st.sampled_from([1e5, 1e6, 50e6, 48.1e6]), st.integers(8, 64), st.integers(600, 4000))
def test_every_edge_is_within_half_a_sample_of_its_time(drawn, rate, max_entries, max_repeats):
    floor = 9 / rate
    levels, dwells = [], []
    for level, drive, rest in drawn:
        levels += [level, 0.0]
        dwells += [max(drive, floor), max(rest, floor)]
    played = sequence(BENCH, levels, dwells, range(2, len(levels) + 1, 2))
    try:
        loads = compiled(played, rate, max_entries=max_entries, max_repeats=max_repeats)
    except StressbotError as refused:  # an epoch of hundreds of seconds may need more entries than this instrument has
        assert refused.code == ErrorCode.LIMIT_EXCEEDED and max(drive for _, drive, _ in drawn) * rate > 250 * max_repeats
        return
    runs = played_back(loads)
    assert [code for code, _ in runs] == [SCALE.code(level) for level in levels]
    edges = np.cumsum([samples for _, samples in runs]) / rate
    assert np.abs(edges - np.cumsum(dwells)).max() <= 0.5 / rate + 1e-12 * edges[-1]
    for load in loads:
        assert entries_of(load) <= max_entries and points_of(load) <= CAPACITY.memory
        assert load.waveforms[load.rest][0] == SCALE.code(0.0)
        assert all(len(waveform) >= 8 for waveform in load.waveforms.values())
        assert all(1 <= entry.repeats <= max_repeats for block in load.blocks for entry in block.entries)


def test_blocks_are_epochs_that_end_at_rest():
    played = encode(BENCH, [(1, 0.5), (4, 0.25)])
    (load,) = compiled(played)
    assert [block.epochs for block in load.blocks] == [1, 1]
    assert [block.begin for block in load.blocks] == pytest.approx([0.0, 0.55])
    assert [block.duration for block in load.blocks] == pytest.approx([0.55, 0.30])


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.floats(0.001, 40.0), st.floats(0.001, 40.0), st.floats(0.001, 0.01)), min_size=1, max_size=8),
    st.floats(0.2, 30.0),
)
def test_no_block_is_longer_than_it_may_be_and_none_begins_or_ends_but_at_rest_or_in_a_drive(drawn, max_block):
    levels, dwells = [], []
    for first, second, rest in drawn:
        levels += [90.0, 0.0, 140.0, 0.0, 150.0, 0.0]
        dwells += [0.01, rest, first, rest, second, rest]
    played = sequence(BENCH, levels, dwells, range(6, len(levels) + 1, 6))
    loads = compile_sequence(played, 0.0, RATE, SCALE, CAPACITY, drive_above=115.0, max_block=max_block)
    blocks = [block for load in loads for block in load.blocks]
    assert max(block.duration for block in blocks) <= max_block
    assert sum(block.epochs for block in blocks) == len(drawn)
    begins = np.cumsum([0.0, *(block.duration for block in blocks)])
    assert [block.begin for block in blocks] == pytest.approx(begins[:-1])
    joined = compiled(played) if sum(dwells) < 20.0 else None  # cut or not, every level lasts as long
    assert joined is None or played_back(loads) == played_back(joined)


def test_a_plan_of_any_length_takes_few_waveforms_and_several_loads():
    rng = np.random.default_rng(5)
    played = encode(BENCH, [(int(group), float(rng.uniform(0.01, 20.0))) for group in rng.integers(1, 5, 1000)])
    loads = compiled(played)
    assert sum(len(load.blocks) for load in loads) == 1000
    assert len(loads) == pytest.approx(1000 * 10 / 512, rel=0.2)
    assert max(sum(len(w) for w in load.waveforms.values()) for load in loads) < 20_000


def test_a_dwell_of_the_code_takes_one_entry_wherever_the_drive_before_it_ended():
    played = encode(BENCH, [(1, 0.123456789), (2, 0.2), (3, 0.1)])
    (load,) = compiled(played)
    dwells_an_epoch = 4 + 2 * len(BENCH.electrical.codes[0])
    assert [len(block.entries) for block in load.blocks] == [dwells_an_epoch + 1, dwells_an_epoch, dwells_an_epoch]


def test_short_dwells_take_a_waveform_each_and_a_new_load_when_the_memory_is_full():
    played = encode(BENCH, [(1, (50_249 + 250 * k) / RATE) for k in range(25)])
    loads = compiled(played)
    assert len(loads) > 1
    assert max(points_of(load) for load in loads) <= CAPACITY.memory


@pytest.mark.parametrize(
    ("levels", "dwells", "ends", "capacity", "field"),
    [
        ([140.0, 0.0], [1e-7, 0.01], [2], {}, r"dwells[0]"),
        ([140.0, 0.0], [0.01, 0.01], [2], {"min_points": 1_000_000}, r"dwells[0]"),
        ([200.1, 0.0], [0.01, 0.01], [2], {}, "levels"),
        ([-0.1, 0.0], [0.01, 0.01], [2], {}, "levels"),
        ([40.0, 60.0] * 300 + [0.0], [0.01] * 601, [601], {}, "levels[0]"),
        ([40.0, 60.0, 0.0, 90.0], [0.01] * 4, [1, 3, 4], {}, "levels[0]"),
        ([40.0, 0.0, 90.0], [0.01] * 3, [2, 3], {}, "levels[2]"),
        ([140.0, 0.0, 40.0, 60.0, 0.0], [0.01] * 5, [2, 5], {"max_entries": 4}, "levels[2]"),
        ([140.0, 0.0], [0.01, 0.01], [2], {"memory": 500}, "levels[0]"),
    ],
)
def test_what_the_instrument_cannot_hold_is_refused(levels, dwells, ends, capacity, field):
    with pytest.raises(StressbotError) as refused:
        compiled(sequence(BENCH, levels, dwells, ends), **capacity)
    assert (refused.value.code, refused.value.field) == (ErrorCode.LIMIT_EXCEEDED, field)


def test_codes_span_the_scale_and_nothing_more():
    assert [SCALE.code(level) for level in (0.0, 100.0, 200.0)] == [-32767, 0, 32767]
    with pytest.raises(StressbotError, match="beyond the generator's scale"):
        SCALE.code(200.1)
