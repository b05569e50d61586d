"""The search: only codewords that are allowed, never worse than what was given, the same at any number of processes."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.codesign import measuring as module
from stressbot_planner.codesign import tasks
from stressbot_planner.codesign.allocating import allocate
from stressbot_planner.codesign.measuring import TRIES, Candidate, Measuring, workers
from stressbot_planner.codesign.objective import Objective, with_codewords
from stressbot_planner.codesign.search import Race
from stressbot_planner.codesign.words import Words
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.execution.worker import Report
from stressbot_planner.formats import scenario
from stressbot_planner.model.environment import Environment, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import solve
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances

PAPER = scenario.parse(instances.paper(False)).problem
DISCS = scenario.parse(instances.paper(True)).problem
FOUR = Words(6, 3, 3)


class Scored:
    """Measures by a score of codewords and the number of the run instead of plans; ends after some candidates."""

    def __init__(self, score, most=10**6):
        self.score, self.left, self.until = score, most, np.inf

    def clock(self):
        return 0.0

    def run(self, candidates):
        for candidate in candidates:
            if self.left == 0:
                raise module.Ended
            self.left -= 1
            value = self.score(candidate.codewords, len(candidate.runs))
            report = Report(value is not None, ErrorCode.NONE, "", 0.1, execution_time=value or 0.0)
            candidate.runs.append((report,) * len(candidate.objective.tasks))


def noisy(seed):
    """Return a score that depends on who is in which group with whom, and a little on luck."""
    weights = np.random.default_rng(seed).uniform(0, 1, (6, 6))

    def score(codewords, number):
        table = np.array([[bit == "1" for bit in word] for word in codewords], dtype=float)
        luck = np.random.default_rng((seed, number, *(int(word, 2) for word in codewords))).uniform(0, 0.5)
        return 100.0 + float((weights * (table @ table.T)).sum()) + luck

    return score


def search(score, given, words=FOUR, most=10**6, max_tries=None, seed=0):
    objective = Objective("time", (PAPER,), 0.05)
    return Race(objective, words, Candidate.of(given, objective), Scored(score, most), np.random.default_rng(seed), max_tries)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**16), st.integers(1, 80))
def test_it_is_never_worse_than_what_was_given_however_early_it_ends(seed, most):
    rng = np.random.default_rng(seed)
    given = FOUR.random(rng)
    one = search(noisy(seed), given, most=most, seed=seed)
    best = one.run([])
    assert best is not None and FOUR.fits(best.codewords)
    runs = min(len(best.runs), len(one.given.runs))
    assert best.value <= one.given.value and best.after(runs) <= one.given.after(runs) + 0.5


def test_it_finds_the_best_of_all_or_nearly():
    words = Words(6, 3, 3)
    rows = words.all_bits()
    choices = {words.as_text(rows[list(order)]) for order in itertools.permutations(range(7), 6)}
    assert len(choices) == 840
    for seed in range(5):
        score = noisy(seed)
        ranked = sorted(score(choice, 0) for choice in choices)
        best = search(score, words.random(np.random.default_rng(seed)), max_tries=250, seed=seed).run([])
        assert best.value <= ranked[8] + 0.5


def test_the_given_one_has_as_many_runs_as_the_best():
    given = ("001", "010", "011", "100", "101", "110")
    one = search(noisy(3), given, max_tries=200)
    best = one.run([])
    assert one.tries == 200
    assert len(one.given.runs) >= len(best.runs) > 1


def test_all_of_few_choices_are_tried_and_the_best_is_confirmed():
    two = scenario.parse(instances.field(2, None, 0)).problem
    objective = Objective("time", (two,), 0.05)
    words = Words(2, 2, 2)
    score = {("11", "10"): 30.0, ("10", "11"): 20.0, ("10", "01"): 25.0}
    given = Candidate.of(("01", "10"), objective)
    one = Race(objective, words, given, Scored(lambda codewords, _: score[words.in_order(codewords)]), np.random.default_rng(0))
    best = one.run([])
    assert (best.codewords, len(one.found)) == (("10", "11"), 3)
    assert len(best.runs) == len(given.runs) == 16


def test_codewords_whose_bound_is_above_what_was_found_have_no_run():
    one = search(lambda codewords, _: 40.0, ("111", "110", "010", "101", "011", "100"), max_tries=100)
    one.run([])
    assert one.screened and not set(one.screened) & set(one.found)
    assert all(one.objective.bound(codewords) >= 40.0 for codewords in one.screened)


def test_who_has_no_plan_is_nobodys_parent_and_never_the_best():
    def score(codewords, _):
        return None if codewords[0] != "111" else 50.0 + codewords[1].count("1")

    best = search(score, FOUR.random(np.random.default_rng(1)), max_tries=120).run([])
    assert np.isfinite(best.value) and best.codewords[0] == "111"
    assert search(lambda *_: None, FOUR.random(np.random.default_rng(1)), max_tries=30).run([]).value == np.inf


# --- with plans -----------------------------------------------------------------------------------------------------


def allocated(problems, seed, tries, processes=(), objective="time", words=FOUR):
    own = Objective(objective, problems, 0.05)
    measuring = Measuring(None, seed, lambda: 0.0, np.inf, processes)
    return allocate(own, words, Candidate.of(problems[0].swarm.codewords, own), measuring, seed, tries)


def test_the_same_seed_gives_the_same_codewords_at_any_number_of_processes():
    with workers(2) as processes:
        beside = allocated((PAPER,), 5, 14, processes)
    with workers(1) as processes:
        alone, again = (allocated((PAPER,), 5, 14, processes) for _ in range(2))
    assert alone.found.codewords == again.found.codewords == beside.found.codewords
    assert alone.found.value == again.found.value == beside.found.value
    assert alone.progress == beside.progress and alone.progress.tries == 14


@pytest.mark.parametrize("objective", ["time", "path", "0.5"])
def test_what_was_found_has_plans_of_its_cost(objective):
    found = allocated((DISCS,), 1, 16, objective=objective).found
    costs = []
    measuring = Measuring(None, 1, lambda: 0.0, np.inf)
    for number in range(len(found.runs)):
        before = Candidate(found.codewords, found.objective, 0.0, found.runs[:number])
        task = measuring._task(before, 0, lambda: 0.0)
        result = solve(with_codewords(DISCS, found.codewords), task.planner, task.settings)
        plan: Plan = result.plan
        assert plan.valid
        costs.append(found.objective.of_plan(0, plan.path_length, plan.execution_time, len(plan.groups)))
    assert min(costs) == pytest.approx(found.value)
    assert found.objective.least() <= found.bound <= found.value


def test_the_papers_robots_save_time():
    result = allocated((DISCS,), 0, 60)
    assert result.saved > 0.2
    assert result.bound.proved <= result.found.bound <= result.found.value
    assert result.given.codewords == DISCS.swarm.codewords


def test_a_mean_over_tasks_is_that_of_each():
    rng = np.random.default_rng(0)
    problems = tuple(tasks.random_task(DISCS, rng) for _ in range(3))
    found = allocated(problems, 2, 14).found
    each = [Candidate(found.codewords, Objective("time", (one,), 0.05), 0.0, [(run[k],) for run in found.runs])
            for k, one in enumerate(problems)]
    assert found.value == pytest.approx(np.mean([one.value for one in each]))
    assert len(found.runs[0]) == 3


# --- tasks ----------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=30)
@given(st.sampled_from([PAPER, DISCS, scenario.parse(instances.band(0)).problem]), st.integers(0, 2**32 - 1))
def test_random_tasks_are_problems_as_sparse_as_the_one_that_they_are_like(problem, seed):
    task = tasks.random_task(problem, np.random.default_rng(seed))  # which refuses bodies that overlap
    assert task.swarm is problem.swarm and task.environment is problem.environment
    assert not np.array_equal(task.goals, problem.goals)
    if problem is not PAPER:
        return
    for places, like in ((task.starts[:, :2], problem.starts[:, :2]), (task.goals, problem.goals)):
        assert closest(places) >= 0.3 * closest(like)


def closest(places):
    return min(np.hypot(*(a - b)) for a, b in itertools.combinations(places, 2))


def test_a_task_for_another_number_of_robots_is_refused():
    with pytest.raises(StressbotError, match="x.yaml has 2 robots, the scenario 6") as refused:
        tasks.task_of(scenario.parse(instances.field(2, None, 0)).problem, PAPER, "x.yaml")
    assert refused.value.field == "--tasks"


def test_no_room_for_robots_at_random_is_refused():
    places = np.column_stack([1.0 + 2.05 * np.arange(6), np.full(6, 1.05)])
    swarm = Swarm(1.0, 1.0, 1.0, PAPER.swarm.codewords)
    poses = np.column_stack([places, np.zeros(6)])
    packed = Problem(swarm, Environment(Workspace(0, 12.4, 0, 2.1)), poses, places[::-1])
    with pytest.raises(StressbotError, match="no room for 6 robots") as refused:
        tasks.random_task(packed, np.random.default_rng(0))
    assert refused.value.field == "--tasks"


def test_runs_of_the_same_number_are_alike():
    for problem, first in ((PAPER, TRIES), (scenario.parse(instances.band(0)).problem, 1)):
        objective, words = Objective("time", (problem,), 0.05), Words(problem.swarm.n, 5, 5)
        one, other = (Candidate.of(words.random(np.random.default_rng(k)), objective) for k in range(2))
        measuring = Measuring(None, 7, lambda: 0.0, np.inf)
        a, b = (measuring._task(candidate, 0, lambda: 0.0).settings for candidate in (one, other))
        assert a == b and a.max_tries == first
