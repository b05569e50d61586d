"""What is driven between two moments: whatever moments pictures have, parts add up, and none is nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.vision.activations import Activations

SEQUENCE = Activations(np.array([1, 2, 3]), np.array([0.5, 2.0, 3.0]), np.array([1.5, 2.5, 3.25]))
moments = st.one_of(st.floats(0.0, 4.0), st.sampled_from([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.25]))


@given(st.lists(moments, min_size=2, max_size=8).map(sorted))
def test_parts_of_drives_add_up(times):
    driven = np.zeros(4)
    for start, end in zip(times, times[1:], strict=False):
        for group, seconds, begins in SEQUENCE.between(start, end):
            assert seconds > 0.0
            assert begins == (start <= SEQUENCE.begins[group - 1])
            driven[group] += seconds
    expected = np.clip(times[-1], SEQUENCE.begins, SEQUENCE.ends) - np.clip(times[0], SEQUENCE.begins, SEQUENCE.ends)
    assert driven[1:] == pytest.approx(expected)


def test_a_sequence_that_was_stopped_in_a_drive_drives_no_more():
    assert SEQUENCE.between(1.0, 1.0) == []
