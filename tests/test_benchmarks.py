"""What the benchmarks measure with, apart from the planners."""

from dataclasses import replace

import comparison
import numpy as np
import optimizer
import pytest
import rivals
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_planner import planners
from stressbot_planner.planners import Settings
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.plan import Plan

ratio = st.floats(1, 9)


@given(st.lists(st.tuples(ratio, ratio), min_size=1))
def test_front_is_what_nobody_beats(points):
    front = comparison._front(points)
    assert set(front) <= set(points)
    for point in points:
        assert any(better[0] <= point[0] and better[1] <= point[1] for better in front)
    for one in front:
        assert not any(other != one and other[0] <= one[0] and other[1] <= one[1] for other in front)


def test_strayed_robots_are_a_little_off_the_rest_of_their_plan():
    problem = optimizer.CASES[1].problem(0)
    plan = planners.solve(problem, "optimize", Settings(max_tries=40, first=True)).plan
    for seed in range(5):
        rest, groups, lengths = optimizer._strayed(plan, np.random.default_rng(seed))
        assert np.all(lengths > 0)
        assert groups.tolist() == plan.groups[-len(groups) :].tolist()
        error = Plan(rest, as_primitives(groups, lengths)).goal_error
        assert 1e-3 < error < 3
        path = Plan(rest, as_primitives(groups, lengths)).path_length
        assert 0.2 - 1e-9 < path / plan.path_length < 0.8 + 1e-9


def test_library_that_is_missing_is_named_with_what_to_do(monkeypatch):
    missing = comparison.Contestant("somebody", module="nowhere", library="no_such_library")
    open_only = comparison.Contestant("somebody else", discs=False, module="nowhere", library="no_such_library")
    monkeypatch.setattr(comparison, "CONTESTANTS", (comparison.CONTESTANTS[0], missing, open_only))
    case = replace(optimizer.CASES[0], seconds=0.1)
    ours, theirs, others = comparison._compared([case], "path", 1).rows
    assert others[1:3] == ("somebody else", comparison.MISSING)
    among_discs = replace(optimizer.CASES[1], seconds=0.1)
    assert [row[1] for row in comparison._compared([among_discs], "path", 1).rows] == ["optimize", "somebody"]
    assert ours[1:4] == ("optimize", "exact", "1/1")
    assert theirs[1:3] == ("somebody", comparison.MISSING)


@pytest.mark.parametrize("discs", [False, True])
@pytest.mark.parametrize("paradigm", rivals.PARADIGMS)
def test_rivals_are_swarms_that_plan_and_count_from_volts(paradigm, discs, monkeypatch):
    monkeypatch.setitem(rivals.LIMITS, 2, 0.3)
    planned = rivals.plan(paradigm, 2, discs, 0)
    assert planned is not None and planned.error <= rivals.AGREEMENT
    assert planned.path >= 1.0 - 1e-3 and planned.total > planned.driving > 0.99 and planned.activations > 0


def test_flaws_of_rivals_are_settings_of_the_substrate():
    for flaws in rivals.FLAWS.values():
        assert len(Imperfections(**flaws).active) == len(flaws)
