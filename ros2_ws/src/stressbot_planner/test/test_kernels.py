"""Loops are compiled whether or not there is a place to keep them."""

import pytest
from numba.core import caching

from stressbot_planner.system.kernels import kernel


def _triple(x):
    return 3 * x


@pytest.mark.parametrize("places", [None, []])
def test_a_kernel_needs_no_place_for_its_cache(monkeypatch, places):
    if places is not None:
        for owner in (caching.CodeLibraryCacheImpl, caching.CompileResultCacheImpl):
            monkeypatch.setattr(owner, "_locator_classes", places)
    assert kernel()(_triple)(2) == 6
