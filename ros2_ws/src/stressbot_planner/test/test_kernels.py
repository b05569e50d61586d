"""Loops are compiled whether or not there is a place to keep them."""

import pytest
from numba.core import caching

from stressbot_planner.model.allocation import binary
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.system.kernels import kernel


def _triple(x):
    return 3 * x


@pytest.mark.parametrize("places", [None, []])
def test_a_kernel_needs_no_place_for_its_cache(monkeypatch, places):
    if places is not None:
        for owner in (caching.CodeLibraryCacheImpl, caching.CompileResultCacheImpl):
            monkeypatch.setattr(owner, "_locator_classes", places)
    assert kernel()(_triple)(2) == 6


@pytest.mark.parametrize("n", [1, 2, 6, 14])
def test_swarms_of_any_size_ask_for_the_same_kernels(n):
    swarm = Swarm(1.0, 1.0, 0.3, binary(n))
    for rows in (swarm.membership, swarm.slides):
        assert rows.flags.c_contiguous and rows[0].flags.c_contiguous  # of one robot they are, whatever the layout
