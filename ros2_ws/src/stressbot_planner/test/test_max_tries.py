"""A limit of tries: it is kept, and a plan that no time limit ends follows from the seed, whatever the clock says."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Environment, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import LONGEST, Settings, assignment, names, solve
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances

EXACT = ("optimize", "optimize_paper", "pure_control")
PAPER = scenario.parse(instances.paper(True), tolerance=1.5).problem
FOURTEEN = scenario.parse(instances.random(14, True, 0), tolerance=1.5).problem
IN_A_CORRIDOR = Problem(
    Swarm(1.0, 1.0, 0.3, binary(2)), Environment(Workspace(0, 4, 0, 0.7)), [[1, 0.35, 0], [3, 0.35, 0]], [[3, 0.35], [1, 0.35]], 0.3
)
"""Two robots, none of which gets past the other; alone each would."""


class Clock:
    """Goes on by a step whenever it is looked at."""

    def __init__(self, step):
        self.step, self.looks = step, 0

    def __call__(self):
        self.looks += 1
        return self.looks * self.step


def outcome(problem, planner, clock, **settings):
    result = assignment.solve(problem, planner, Settings(**{"time_limit": LONGEST, **settings}, clock=clock))
    return result, (result.success, result.reason, result.plan and result.plan.primitives, result.details)


@pytest.mark.parametrize("planner", names())
@pytest.mark.parametrize(
    ("problem", "max_tries"), [(PAPER, 12), (FOURTEEN, 5), (IN_A_CORRIDOR, 7)], ids=["six", "fourteen", "corridor"]
)
def test_a_plan_of_so_many_tries_does_not_depend_on_the_clock(planner, problem, max_tries):
    if planner in EXACT:
        problem = replace(problem, tolerance=1e-6)
    for seed in range(2):
        quick = Clock(1e-9)
        _, expected = outcome(problem, planner, quick, seed=seed, max_tries=max_tries)
        slow = Clock(0.99 * LONGEST / quick.looks)  # as slow a machine as can keep the limit
        result, found = outcome(problem, planner, slow, seed=seed, max_tries=max_tries)
        assert result.planning_time > 0.8 * LONGEST
        assert found == expected
        _, found = outcome(problem, planner, Clock(1e-9), seed=seed, max_tries=max_tries, time_limit=1.0)
        assert found == expected


@pytest.mark.parametrize("max_tries", [1, 3])
def test_nor_does_that_of_a_crowd_among_obstacles(max_tries):
    """Beyond twenty robots `optimize` goes another way."""
    problem = scenario.parse(instances.random(22, True, 0)).problem
    quick = Clock(1e-9)
    _, expected = outcome(problem, "optimize", quick, max_tries=max_tries, first=True)
    _, found = outcome(problem, "optimize", Clock(0.99 * LONGEST / quick.looks), max_tries=max_tries, first=True)
    assert found == expected


@pytest.mark.parametrize("planner", names())
@pytest.mark.parametrize("max_tries", [1, 2, 9])
def test_tries_that_lead_nowhere_end_the_search_with_a_reason(planner, max_tries):
    problem = replace(IN_A_CORRIDOR, tolerance=1e-6) if planner in EXACT else IN_A_CORRIDOR
    result = solve(problem, planner, Settings(time_limit=LONGEST, max_tries=max_tries, clock=Clock(1e-9)))
    assert not result.success
    assert result.code == ErrorCode.NO_PLAN_FOUND
    assert re.search(rf"\b{max_tries} (tries|starts)\b", result.reason)
    assert " s;" not in result.reason


def test_optimize_changes_its_plan_so_often_and_more_tries_make_it_no_worse():
    problem = scenario.parse(instances.paper(True)).problem
    for seed in range(3):
        lengths = []
        for max_tries in (1, 2, 5, 11, 30):
            result = solve(problem, "optimize", Settings(time_limit=LONGEST, seed=seed, max_tries=max_tries))
            assert result.success, result.reason
            assert result.details["tries"] <= max_tries
            lengths.append(result.plan.path_length)
        assert result.details["tries"] == max_tries
        assert lengths == sorted(lengths, reverse=True)


def test_processes_that_search_side_by_side_repeat_themselves():
    problem = scenario.parse(instances.paper(True)).problem
    settings = Settings(time_limit=LONGEST, max_tries=8, jobs=2)
    first, again = (solve(problem, "optimize", settings) for _ in range(2))
    assert first.plan.primitives == again.plan.primitives
    assert first.details["tries"] == 16


@pytest.mark.parametrize("value", [0, -1, 1.5, np.nan, np.inf])
@pytest.mark.parametrize("name", ["max_tries", "max_epochs", "jobs"])
def test_a_number_of_tries_is_a_whole_number(name, value):
    with pytest.raises(StressbotError) as caught:
        Settings(**{name: value})
    assert (caught.value.code, caught.value.field) == (ErrorCode.OUT_OF_RANGE, name)
