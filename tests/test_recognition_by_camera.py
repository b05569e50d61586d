"""Robots of which nobody knows who they are become known by how they move, as a simulated microscope sees them."""

import camera_loop
import pytest

from stressbot_planner.reproduce import instances


@pytest.mark.parametrize(("text", "seed"), [(instances.paper(True), 0), (instances.band(1), 1)], ids=["6", "14"])
def test_robots_are_known_without_a_touch(text, seed):
    run = camera_loop.recognised(text, seed)
    assert not run.reason
    assert run.seconds < 120.0
    assert run.swapped == 0
    assert run.gap > 0.0
