"""The best bound over all codewords is what trying them all gives, and no plan is below it."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.codesign import best_bound as module
from stressbot_planner.codesign.best_bound import best_bound
from stressbot_planner.codesign.objective import Objective, with_codewords
from stressbot_planner.codesign.words import Words
from stressbot_planner.formats import scenario
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.kinematics import execution_time, path_length, replay
from stressbot_planner.model.swarm import Swarm, fastest
from stressbot_planner.problem.bounds import lower_bounds
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances

OBJECTIVES = st.sampled_from(["time", "path", "0.3"])
KINDS = st.sampled_from([(1, 1, 1), (2, 2, 1), (2, 2, 2), (3, 2, 2), (3, 3, 1), (3, 3, 3), (4, 3, 2), (4, 3, 3), (5, 3, 3)])


def problems(n: int, count: int, rng: np.random.Generator) -> tuple[Problem, ...]:
    speed, pace = fastest(rng.choice([np.ones(n), rng.uniform(0.5, 1.5, n)]))
    swarm = Swarm(speed, 1.0, 0.0, tuple(f"{1 << k:0{n}b}" for k in range(n)), pace)
    starts = np.zeros((count, n, 3))
    starts[..., :2], goals = rng.uniform(-9, 9, (2, count, n, 2))
    starts[..., 2] = np.arctan2(*(goals - starts[..., :2]).T[::-1]).T  # nobody has to turn
    return tuple(Problem(swarm, Environment(), *one) for one in zip(starts, goals, strict=True))


@settings(deadline=None, max_examples=25)
@given(KINDS, OBJECTIVES, st.integers(1, 2), st.integers(0, 2**32 - 1))
def test_it_is_the_least_of_all_codewords(kind, name, count, seed):
    words = Words(*kind)
    objective = Objective(name, problems(words.n, count, np.random.default_rng(seed)), 0.05)
    choices = {words.as_text(words.all_bits()[list(rows)]) for rows in permutations(range(words.count), words.n)}
    least = min(objective.bound(choice) for choice in choices)
    found = best_bound(objective, words)
    assert found.proved == pytest.approx(least, rel=1e-3)
    assert found.proved <= least * (1 + 1e-6)
    assert words.fits(found.codewords)
    assert objective.bound(found.codewords) == pytest.approx(least, rel=1e-3)


@given(st.integers(1, 9), OBJECTIVES, st.integers(0, 2**32 - 1))
def test_no_plan_is_below_the_bound_of_its_codewords_and_no_bound_below_the_least(n, name, seed):
    rng = np.random.default_rng(seed)
    (problem,) = problems(n, 1, rng)
    codewords = Words(n, n, n).random(rng)
    swarm = with_codewords(problem, codewords).swarm
    count = int(rng.integers(1, 20))
    groups, lengths = rng.integers(1, swarm.m + 1, count), rng.exponential(1.0, count)
    starts = problem.starts
    reached = Problem(problem.swarm, Environment(), starts, replay(swarm, starts, groups, lengths)[-1, :, :2])
    objective = Objective(name, (reached,), 0.05)
    cost = objective.of_plan(0, path_length(swarm, groups, lengths), execution_time(swarm, lengths), count)
    assert objective.least() <= objective.bound(codewords) * (1 + 1e-6) + 1e-6
    assert objective.bound(codewords) <= cost * (1 + 1e-6) + 1e-6


@given(st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_the_bound_of_codewords_is_that_of_plans(n, seed):
    rng = np.random.default_rng(seed)
    (problem,) = problems(n, 1, rng)
    codewords = Words(n, n, n).random(rng)
    bounds = lower_bounds(with_codewords(problem, codewords).swarm, problem.starts, problem.goals, problem.tolerance)
    assert Objective("time", (problem,), 1.0).bound(codewords) == pytest.approx(bounds.execution_time, rel=1e-6, abs=1e-9)
    assert Objective("path", (problem,), 1.0).bound(codewords) == pytest.approx(bounds.path_length, rel=1e-6, abs=1e-9)
    turned = replace(problem, starts=problem.starts + (0.0, 0.0, 2.0))
    least = with_codewords(turned, codewords).turning_time
    assert Objective("time", (turned,), 1.0).bound(codewords) == pytest.approx(least, rel=1e-6, abs=1e-9)


def test_the_papers_robots_in_four_groups():
    problem = scenario.parse(instances.paper(True)).problem
    found = best_bound(Objective("time", (problem,), 0.05), Words(6, 3, 3))
    assert found.proved == pytest.approx(27.787, abs=0.01)


def test_where_there_are_too_many_words_everybody_goes_straight(monkeypatch):
    monkeypatch.setattr(module, "MOST_CHOICES", 5)
    problem = scenario.parse(instances.paper(True)).problem
    objective = Objective("time", (problem,), 0.05)
    assert best_bound(objective, Words(6, 3, 3)) == (objective.least(), None)
    assert objective.least() == pytest.approx(np.hypot(*(problem.goals - problem.starts[:, :2]).T).max(), rel=1e-5)


def test_robots_that_may_take_any_goal_need_to_reach_the_nearest():
    text = instances.paper(False)
    problem = scenario.parse(text).problem
    free = Problem(problem.swarm, problem.environment, problem.starts, problem.goals, exchangeable=(0, 3))
    needs = Objective("time", (free,), 0.0).needs(0)
    fixed = Objective("time", (problem,), 0.0).needs(0)
    np.testing.assert_allclose(needs[[1, 2, 4, 5]], fixed[[1, 2, 4, 5]])
    assert (needs <= fixed + 1e-12).all() and needs[0] < fixed[0]
