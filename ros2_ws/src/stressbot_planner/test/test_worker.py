"""The planning process: answers, refuses, is ended at any time, and comes back when it dies."""

import os
import pickle
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from stressbot_planner.collision import clearance as collision
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.execution.worker import Task, Worker, WorkerEnded, perform, warm_up
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import LONGEST, Settings

pytestmark = pytest.mark.xdist_group("worker")


WAIT = 100.0
"""s, for what happens soon, on however busy a machine."""


def make_task(seed=1, **changes):
    values = {
        "swarm": Swarm(1.0, 1.0, 0.3, binary(2)),
        "environment": Environment(),
        "starts": np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0]]),
        "goals": np.array([[4.0, 1.0], [4.0, 4.0]]),
        "tolerance": 1e-6,
        "planner": "optimize",
        "settings": Settings(max_tries=5, seed=seed),
    }
    return Task(**{**values, **changes})


def hopeless_task(time_limit=LONGEST):
    """A wall between starts and goals that leaves a gap 0.02 too narrow, for a planner that tries as long as it may."""
    wall = Polygon([[1.9, -2.0], [2.1, -2.0], [2.1, 5.42], [1.9, 5.42]])
    environment = Environment(Workspace(-2.0, 6.0, -2.0, 6.0), (wall,))
    return make_task(environment=environment, planner="rrt", tolerance=0.5, settings=Settings(time_limit=time_limit))


def once_told(worker, monkeypatch, action):
    """Call a function in a thread of its own as soon as the process has been sent a task."""
    told, send = threading.Event(), worker._connection.send

    def act():
        if told.wait(WAIT):
            action()

    monkeypatch.setattr(worker._connection, "send", lambda task: (send(task), told.set()))
    thread = threading.Thread(target=act)
    thread.start()
    return thread


@pytest.fixture(scope="module")
def worker():
    worker = Worker()
    worker.wait_until_ready()
    yield worker
    worker.close()


def test_the_process_answers_as_the_function_does(worker):
    there, here = worker.solve(make_task()), perform(make_task())
    assert there.success
    assert there.primitives == here.primitives
    np.testing.assert_array_equal(there.end, here.end)
    assert (there.path_length, there.gap, there.activations) == (here.path_length, here.gap, here.activations)


def test_a_task_from_another_process_needs_no_kernels_of_its_own():
    def compiled():
        return sum(len(item.signatures) for item in vars(collision).values() if hasattr(item, "signatures"))

    warm_up()
    before = compiled()
    assert before
    assert perform(pickle.loads(pickle.dumps(hopeless_task(0.1)))).code == ErrorCode.NO_PLAN_FOUND
    assert perform(pickle.loads(pickle.dumps(make_task()))).success
    assert compiled() == before


def test_seeds_differ(worker):
    three = {
        "swarm": Swarm(1.0, 1.0, 0.3, binary(3)),
        "starts": np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 6.0, 0.0]]),
        "goals": np.array([[4.0, 1.0], [4.0, 4.0], [4.0, 7.0]]),
    }
    assert worker.solve(make_task(seed=1, **three)).primitives != worker.solve(make_task(seed=2, **three)).primitives


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"planner": "magic"}, ErrorCode.UNKNOWN_PLANNER),
        ({"goals": np.array([[4.0, 1.0], [4.0, 1.1]])}, ErrorCode.GOALS_TOO_CLOSE),
        ({"tolerance": -1.0}, ErrorCode.OUT_OF_RANGE),
        ({"swarm": None}, ErrorCode.INTERNAL),
    ],
)
def test_refusals_come_through_and_the_process_lives_on(worker, changes, code):
    with pytest.raises(StressbotError) as refusal:
        worker.solve(make_task(**changes))
    assert refusal.value.code == code
    assert worker.solve(make_task()).success


def test_no_plan_in_time_is_a_report(worker):
    report = worker.solve(hopeless_task(0.2))
    assert not report.success
    assert report.code == ErrorCode.NO_PLAN_FOUND
    assert report.reason


def test_signals_to_the_group_leave_the_process_to_its_owner(worker):
    os.kill(worker._process.pid, signal.SIGINT)
    os.kill(worker._process.pid, signal.SIGTERM)
    assert worker.solve(make_task()).success


def test_a_process_that_dies_is_an_error_and_comes_back(worker, monkeypatch):
    killer = once_told(worker, monkeypatch, lambda: os.kill(worker._process.pid, signal.SIGKILL))
    with pytest.raises(StressbotError, match="died") as refusal:
        worker.solve(hopeless_task())
    killer.join()
    assert refusal.value.code == ErrorCode.INTERNAL
    assert worker.solve(make_task()).success


class GaveUp(Exception):
    pass


def give_up_after(seconds):
    deadline = time.monotonic() + seconds

    def check():
        if time.monotonic() > deadline:
            raise GaveUp

    return check


@pytest.mark.parametrize("planner", ["rrt", "optimize", "optimize_paper", "pure_control"])
def test_a_search_that_is_given_up_ends_at_once_and_the_next_is_answered(worker, planner, monkeypatch):
    monkeypatch.setattr("stressbot_planner.execution.worker.STOPPED_WITHIN", WAIT)
    process = worker._process
    task = replace(hopeless_task(1000.0), planner=planner)
    for _ in range(3):
        with pytest.raises(GaveUp):
            worker.solve(task, give_up_after(0.3))
        assert worker.solve(make_task()).success
    assert worker._process is process  # a word was enough


def test_a_search_that_does_not_listen_is_ended_with_its_process(worker, monkeypatch):
    monkeypatch.setattr("stressbot_planner.execution.worker.STOPPED_WITHIN", 0.0)
    process = worker._process
    with pytest.raises(GaveUp):
        worker.solve(hopeless_task(1000.0), give_up_after(0.3))
    assert process.poll() is not None
    assert worker.solve(make_task()).success


def test_a_word_that_comes_when_the_search_has_just_ended_stops_nothing_else(worker):
    worker._connection.send(None)
    assert worker.solve(make_task()).success


def test_progress_is_told(worker):
    heard = []
    worker.solve(hopeless_task(2.0), on_progress=heard.append)
    tries = [entry.tries for entry in heard]
    assert tries == sorted(tries) and tries[-1] > 1 and not any(np.isfinite(entry.path_length) for entry in heard)


def test_better_plans_are_told_as_they_are_found():
    heard = []
    crossing = make_task(
        swarm=Swarm(1.0, 1.0, 0.3, binary(4)),
        starts=np.array([[0.0, 3.0 * k, 0.0] for k in range(4)]),
        goals=np.array([[5.0, 9.0], [5.0, 0.0], [5.0, 3.0], [5.0, 6.0]]),
    )
    report = perform(replace(crossing, settings=Settings(max_tries=12, time_limit=1000.0, on_progress=heard.append)))
    assert report.success
    paths = [entry.path_length for entry in heard]
    assert len(heard) >= 2 and paths == sorted(paths, reverse=True)
    assert paths[-1] == pytest.approx(report.path_length)
    assert [entry.tries for entry in heard] == sorted(entry.tries for entry in heard)


def test_closing_ends_a_plan_in_the_making(monkeypatch):
    worker = Worker()
    worker.wait_until_ready()
    closer = once_told(worker, monkeypatch, worker.close)
    with pytest.raises(WorkerEnded):
        worker.solve(hopeless_task())  # which would take days
    closer.join()


def test_a_task_may_be_given_up_while_the_process_loads():
    worker = Worker()

    def give_up():
        raise GaveUp

    try:
        with pytest.raises(GaveUp):
            worker.solve(make_task(), give_up)
        assert worker.solve(make_task()).success
    finally:
        worker.close()
