"""What codewords cost, by plans for them: short searches of a planner, here or in processes side by side."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import NamedTuple

import numpy as np

from stressbot_planner import planners
from stressbot_planner.codesign.objective import Objective, with_codewords
from stressbot_planner.execution.worker import Report, Task, Worker, perform
from stressbot_planner.planners import LONGEST, Settings, seed_of

PLANNER = "optimize"

TRIES = 5
"""Of the planner in a run: enough to tell good codewords from bad ones, which more runs then do better than longer ones."""


SMALL = 10
"""Robots; of more the first plan, which takes a hundredth of the time of the next tries, tells enough for the first run."""


def tries_of(n: int, number: int) -> int:
    """Return how many tries a run of a candidate with n robots has, the first of which is number 0."""
    return 1 if n > SMALL and number == 0 else TRIES


class Figures(NamedTuple):
    """What a plan costs: s, s, units."""

    driving_time: float
    selection_time: float
    path_length: float
    activations: float
    planning_time: float


@dataclass
class Candidate:
    """Codewords, and the runs of the planner that there were for them.

    Attributes:
        codewords: one a robot.
        objective: that they are measured by.
        bound: of what any plan for them costs.
        runs: of each run the report on each task.
    """

    codewords: tuple[str, ...]
    objective: Objective
    bound: float
    runs: list[tuple[Report, ...]] = field(default_factory=list)

    @classmethod
    def of(cls, codewords: Sequence[str], objective: Objective) -> "Candidate":
        return cls(tuple(codewords), objective, objective.bound(codewords))

    @property
    def value(self) -> float:
        """The objective with the best plan for each task; infinite if one has none."""
        return self.after(len(self.runs))

    def after(self, runs: int) -> float:
        """Return the value that was known after so many runs."""
        if not runs:
            return np.inf
        return float(np.mean([min(self._cost(k, run[k]) for run in self.runs[:runs]) for k in range(len(self.objective.tasks))]))

    def figures(self) -> Figures | None:
        """Return the mean over tasks of what the best plans cost; None if there is no plan for one."""
        if not np.isfinite(self.value):
            return None
        best = [min((run[k] for run in self.runs), key=lambda r, k=k: self._cost(k, r)) for k in range(len(self.objective.tasks))]
        selection = self.objective.selection_time
        rows = [
            (report.execution_time, selection * report.activations, report.path_length, report.activations, spent)
            for k, report in enumerate(best)
            for spent in [sum(run[k].planning_time for run in self.runs)]
        ]
        return Figures(*np.mean(rows, axis=0).tolist())

    def _cost(self, task: int, report: Report) -> float:
        if not report.success:
            return np.inf
        return self.objective.of_plan(task, report.path_length, report.execution_time, report.activations)


class Ended(Exception):
    """Time is over."""


class Measuring:
    """Runs the planner for candidates.

    The n-th run of any candidate has the same seed, so that differences are theirs and not luck's, and as many tries, so that they
    do not depend on the machine.
    """

    def __init__(
        self, pulse_length: float | None, seed: int, clock: Callable[[], float], until: float, workers: Sequence[Worker] = ()
    ):
        """Runs end when the clock says `until`, s, and what they have found by then does not count."""
        self.pulse_length, self.seed, self.clock, self.until = pulse_length, seed, clock, until
        self._workers = workers
        self._idle: SimpleQueue[Worker] = SimpleQueue()
        for worker in workers:
            self._idle.put(worker)

    def run(self, candidates: Sequence[Candidate]) -> None:
        """Give each of some candidates a run more.

        Raises:
            Ended: time was over before all had theirs; those that had are kept.
        """
        work = [(candidate, task) for candidate in candidates for task in range(len(candidate.objective.tasks))]
        if self._workers:
            with ThreadPoolExecutor(len(self._workers)) as pool:
                futures = [pool.submit(self._elsewhere, *one) for one in work]
                reports = [_result(future) for future in futures]
        else:
            reports = [self._here(*one) for one in work]
        at = iter(reports)
        for candidate in candidates:
            found = [next(at) for _ in candidate.objective.tasks]
            whole = tuple(report for report in found if report is not None)
            if len(whole) == len(found):
                candidate.runs.append(whole)
        if self.over():
            raise Ended

    def over(self) -> bool:
        """Return whether time is over."""
        return self.clock() > self.until

    def _here(self, candidate: Candidate, task: int) -> Report | None:
        if self.over():
            return None
        report = perform(self._task(candidate, task, self.clock))
        return None if self.over() else report

    def _elsewhere(self, candidate: Candidate, task: int) -> Report | None:
        worker = self._idle.get()
        try:
            return worker.solve(self._task(candidate, task, time.monotonic), self._raise_if_over)
        finally:
            self._idle.put(worker)

    def _raise_if_over(self) -> None:
        if self.over():
            raise Ended

    def _task(self, candidate: Candidate, task: int, clock: Callable[[], float]) -> Task:
        problem = with_codewords(candidate.objective.tasks[task], candidate.codewords)
        settings = Settings(
            objective=candidate.objective.objective,
            max_tries=tries_of(problem.swarm.n, len(candidate.runs)),
            time_limit=min(max(self.until - self.clock(), 1e-3), LONGEST),
            selection_time=candidate.objective.selection_time,
            pulse_length=self.pulse_length,
            seed=seed_of(self.seed, len(candidate.runs)),
            clock=clock,
        )
        return Task.of(problem, PLANNER, settings)


def _result(future) -> Report | None:
    try:
        return future.result()
    except Ended:
        return None


@contextmanager
def workers(count: int) -> Iterator[list[Worker]]:
    """Give processes that plan, all of which have loaded their kernels; none for one: this process does it."""
    if count == 1:
        planners.prepare(PLANNER)
        yield []
        return
    started = [Worker() for _ in range(count)]
    try:
        for worker in started:
            worker.wait_until_ready()
        yield started
    finally:
        for worker in started:
            worker.close()
