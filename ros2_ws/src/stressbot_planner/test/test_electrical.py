"""The alphabet of the PFSMs: codes of every size, and values that no PFSM could read."""

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.electrical import Electrical, checked_codes, default_codes

GOOD = {
    "rest_level": 0.0, "symbol_levels": (40.0, 60.0), "reset_level": 90.0, "drive_level": 140.0,
    "thresholds": (20.0, 50.0, 75.0, 115.0), "hysteresis": 4.0, "pull_down": 120.0, "release": 30.0,
    "reset_dwell": 0.01, "symbol_dwell": 0.01, "guard_dwell": 0.005, "min_dwell": 0.002,
    "codes": ((0, 0), (0, 1), (1, 0), (1, 1)), "min_level": 0.0, "max_level": 200.0,
}


@given(st.integers(1, 400), st.integers(2, 9))
def test_codes_are_distinct_and_as_short_as_log_m_allows(m, level_count):
    codes = default_codes(m, level_count)
    assert len(set(codes)) == len(codes) == m
    length = len(codes[0])
    assert {len(code) for code in codes} == {length}
    assert level_count**length >= m
    assert length == 1 or level_count ** (length - 1) < m
    assert all(0 <= symbol < level_count for code in codes for symbol in code)


@given(st.integers(1, 300), st.integers(2, 9))
def test_one_wrong_symbol_makes_no_checked_code_another(m, level_count):
    shortest = default_codes(m, level_count)
    codes = checked_codes(shortest, level_count)
    assert [code[:-1] for code in codes] == list(shortest)
    table = np.array(codes)
    differences = (table[:, None] != table).sum(axis=2)
    assert differences[~np.eye(m, dtype=bool)].min(initial=2) >= 2


def test_codes_of_the_paper_swarm():
    assert default_codes(4, 2) == ((0, 0), (0, 1), (1, 0), (1, 1))


def test_selection_time_is_reset_symbols_and_guards():
    electrical = Electrical(**GOOD)
    assert electrical.levels == (0.0, 40.0, 60.0, 90.0, 140.0)
    # reset, guard, twice symbol and guard, and the guard after the drive
    assert electrical.selection_time == pytest.approx(0.01 + 0.005 + 2 * (0.01 + 0.005) + 0.005)


@pytest.mark.parametrize(
    ("name", "value", "code", "field"),
    [
        *((name, nan, ErrorCode.NOT_FINITE, name) for name in GOOD if isinstance(GOOD[name], float)),
        ("symbol_levels", (40.0, inf), ErrorCode.NOT_FINITE, "symbol_levels[1]"),
        ("thresholds", (20.0, nan, 75.0, 115.0), ErrorCode.NOT_FINITE, "thresholds[1]"),
        ("symbol_levels", (60.0, 40.0), ErrorCode.OUT_OF_RANGE, "symbol_levels[1]"),
        ("reset_level", 50.0, ErrorCode.OUT_OF_RANGE, "reset_level"),
        ("thresholds", (20.0, 50.0, 75.0), ErrorCode.WRONG_COUNT, "thresholds"),
        ("thresholds", (20.0, 61.0, 75.0, 115.0), ErrorCode.OUT_OF_RANGE, "thresholds[1]"),
        ("hysteresis", 25.0, ErrorCode.OUT_OF_RANGE, "hysteresis"),
        ("hysteresis", -1.0, ErrorCode.OUT_OF_RANGE, "hysteresis"),
        ("min_dwell", 0.0, ErrorCode.OUT_OF_RANGE, "min_dwell"),
        ("min_dwell", 0.011, ErrorCode.OUT_OF_RANGE, "reset_dwell"),
        ("guard_dwell", -1.0, ErrorCode.OUT_OF_RANGE, "guard_dwell"),
        ("max_level", 139.0, ErrorCode.OUT_OF_RANGE, "max_level"),
        ("min_level", 1.0, ErrorCode.OUT_OF_RANGE, "min_level"),
        ("pull_down", 20.0, ErrorCode.OUT_OF_RANGE, "pull_down"),
        ("pull_down", 150.0, ErrorCode.OUT_OF_RANGE, "pull_down"),
        ("release", -1.0, ErrorCode.OUT_OF_RANGE, "release"),
        ("codes", (), ErrorCode.WRONG_COUNT, "codes"),
        ("codes", ((), ()), ErrorCode.WRONG_COUNT, "codes"),
        ("codes", ((0, 0), (0, 0)), ErrorCode.OUT_OF_RANGE, "codes[1]"),
        ("codes", ((0, 0), (1,)), ErrorCode.WRONG_COUNT, "codes[1]"),
        ("codes", ((0, 0), (0, 2)), ErrorCode.OUT_OF_RANGE, "codes[1]"),
        ("codes", ((0, 0), (0, -1)), ErrorCode.OUT_OF_RANGE, "codes[1]"),
    ],
)
def test_refused_values_name_the_field(name, value, code, field):
    with pytest.raises(StressbotError) as caught:
        Electrical(**(GOOD | {name: value}))
    assert (caught.value.code, caught.value.field) == (code, f"electrical.{field}")
