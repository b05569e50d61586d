"""Several processes that search for one plan: never worse than one, and nobody is left over."""

import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stressbot_planner import planners
from stressbot_planner.cli import tool as cli
from stressbot_planner.errors import StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.planners import Settings, side_by_side, solve
from stressbot_planner.planners.side_by_side import READY_WITHIN, Others
from stressbot_planner.reproduce import instances

HOPELESS = "--planner", "rrt", "--tolerance", "0.031"
"""Of `stressbot plan`: a tree that must come within a tenth of a body of its goals grows for as long as it may."""

PATIENCE = 300.0
"""s that a busy machine may take."""

DISCS = scenario.parse(instances.paper(True)).problem


@pytest.fixture(autouse=True)
def many_processors(monkeypatch):
    """Let tests have the processes that they ask for on any machine."""
    monkeypatch.setattr(planners, "usable_jobs", lambda jobs: jobs)


@pytest.fixture
def others():
    planners.prepare("optimize")
    with Others("optimize", 2) as found:
        found.wait_until_ready(READY_WITHIN)
        yield found


def test_the_plan_follows_from_seed_and_jobs_and_is_never_worse_than_that_of_one():
    alone = solve(DISCS, "optimize", Settings(max_tries=6, seed=1))
    first, second = (solve(DISCS, "optimize", Settings(max_tries=6, seed=1, jobs=2)) for _ in range(2))
    np.testing.assert_array_equal(first.plan.groups, second.plan.groups)
    np.testing.assert_array_equal(first.plan.lengths, second.plan.lengths)
    assert first.plan.path_length <= alone.plan.path_length
    assert first.seed == 1
    assert first.details["jobs"] == 2
    assert first.details["tries"] == 12
    values = [path for _, path, _ in first.history]
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(first.plan.path_length)


def test_any_planner_searches_side_by_side():
    result = solve(DISCS, "pure_control", Settings(max_tries=50, jobs=2))
    assert result.success, result.reason
    assert result.plan.path_length <= solve(DISCS, "pure_control", Settings(max_tries=50)).plan.path_length


def test_goals_in_stages_are_searched_by_the_same_processes(monkeypatch):
    started, start = [], Others._start
    monkeypatch.setattr(Others, "_start", lambda self, *entries: (started.append(entries), start(self, *entries)))
    staged = replace(DISCS, waypoints=[np.roll(DISCS.goals, stage, axis=0) for stage in (1, 2, 3)])
    first, second = (solve(staged, "optimize", Settings(max_tries=3, seed=1, jobs=2)) for _ in range(2))
    assert len(started) == 2 and first.plan.primitives == second.plan.primitives
    assert [(stage["jobs"], stage["tries"]) for stage in first.details["stages"]] == [(2, 6)] * 4
    fast = solve(staged, "optimize", Settings(first=True, jobs=2, time_limit=100))
    assert fast.success and fast.plan.valid, fast.reason


def test_a_refusal_is_that_of_one():
    with pytest.raises(StressbotError, match="tolerance"):
        solve(DISCS, "rrt", Settings(max_tries=50, jobs=2))


@pytest.mark.parametrize("harm", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_is_dead_or_frozen_costs_no_more_than_its_share(others, harm):
    os.kill(others._processes[0].pid, harm)
    for _ in range(2):
        outcome = others.search(DISCS, "optimize", Settings(time_limit=3.0))
        assert outcome.primitives and not outcome.reason


def test_who_dies_while_it_loads_is_left_out():
    with Others("optimize", 1) as others:
        others._processes[0].kill()
        others.wait_until_ready(READY_WITHIN)
        assert others.search(DISCS, "optimize", Settings(max_tries=2)).details["jobs"] == 1


def test_the_first_plan_of_any_ends_the_search_of_all(others, monkeypatch):
    def endless(problem, planner, settings):
        while True:
            settings.clock()

    monkeypatch.setattr(side_by_side, "search", endless)
    outcome = others.search(DISCS, "optimize", Settings(first=True, time_limit=600.0))
    assert outcome.primitives and not outcome.reason


def test_no_process_is_left_when_its_asker_is_killed():
    script = (
        "import time\nfrom stressbot_planner.planners.side_by_side import READY_WITHIN, Others\n"
        "others = Others('optimize', 2)\nothers.wait_until_ready(READY_WITHIN)\nprint(flush=True)\ntime.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as asker:
        asker.stdout.readline()
        pids = children(asker.pid)
        asker.kill()
    assert len(pids) == 2
    wait_until_gone(pids)


def test_an_interrupted_tool_says_so_in_a_line_and_leaves_no_process():
    scenario_file = Path(__file__).parents[1] / "scenarios" / "paper-six-two-discs.yaml"
    script = (
        "import sys\nfrom stressbot_planner import planners\nfrom stressbot_planner.cli import tool as cli\n"
        "planners.usable_jobs = lambda jobs: jobs\n"
        f"sys.exit(cli.main(['plan', {str(scenario_file)!r}, '--jobs', '3', '--time-limit', '600', *{HOPELESS}]))"
    )
    with subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True) as tool:
        until = time.monotonic() + PATIENCE
        while len(pids := children(tool.pid)) < 2 and time.monotonic() < until:
            time.sleep(0.01)
        tool.send_signal(signal.SIGINT)
        complaint = tool.communicate()[1]
    assert len(pids) == 2
    assert tool.returncode == 130
    assert complaint == "stressbot: interrupted\n"
    wait_until_gone(pids)


def children(pid: int) -> list[int]:
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def wait_until_gone(pids: list[int]) -> None:
    """Wait until processes have ended, whoever collects them."""
    until = time.monotonic() + PATIENCE
    while any(is_running(pid) for pid in pids):
        assert time.monotonic() < until
        time.sleep(0.01)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_problems_come_out_of_a_pickle_as_the_kernels_know_them():
    again = pickle.loads(pickle.dumps(DISCS))
    for array in (again.starts, again.goals, again.swarm.body_radius, again.environment.obstacles[0].center):
        assert not array.flags.writeable


def test_the_tool_says_that_it_uses_no_more_processes_than_processors(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(planners, "usable_jobs", lambda jobs: 1)
    path = tmp_path / "two.yaml"
    path.write_text("name: one\nswarm: {speed: 1, turning_radius: 1, body_radius: 0.3, groups: ['1']}\n"
                    "robots: [{start: [0, 0, 0], goal: [1, 0]}]\n")
    assert cli.main(["plan", str(path), "--jobs", "16", "--first"]) == 0
    assert "--jobs: is 16, more than there are processors: 1" in capsys.readouterr().err
