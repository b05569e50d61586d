"""Searches side by side: this process with the seed it would use alone, others with seeds of their own; the best plan counts.

The others start, and load their kernels, before the clock does. They end with whoever asked: the operating system closes the
pipe that they listen at, however it ended. One that dies, or that is late, costs no more than what it would have found.
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, Pipe, wait
from queue import SimpleQueue
from time import monotonic

import numpy as np

from stressbot_planner.errors import StressbotError
from stressbot_planner.planners import Outcome, Settings, prepare, search, seed_of
from stressbot_planner.planners.cost import CLOSE_TO_BOUND, Cost
from stressbot_planner.primitives.expansion import expand
from stressbot_planner.problem.definition import Problem
from stressbot_planner.system import threads
from stressbot_planner.system.clock import StoppableClock

GRACE = 0.5
"""s after the time limit, or after the clock was stopped, in which others may still answer."""

SLICE = 0.05
"""s from one look at the clock to the next while others are waited for."""

READY_WITHIN, LATE = 120.0, 5.0
"""s that others may take to load their kernels, counted from when this process has: the second where the time is limited."""

_CHILD = f"from {__name__} import main; main()"


class _Beaten(Exception):
    """Another process has the first plan."""


class Others:
    """Processes that search for the same plans, one after the other; each has loaded what its planner needs."""

    def __init__(self, planner: str, count: int):
        """Start a number of processes for a planner; call `wait_until_ready` before they are to search."""
        self._processes: list[subprocess.Popen] = []
        self._places: dict[Connection, int] = {}
        self._waiting: dict[Connection, int] = {}  # those that have not answered yet
        self._outcomes: dict[int, Outcome] = {}
        for place in range(1, count + 1):
            self._start(planner, place)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
        for connection in self._places:
            connection.close()

    def wait_until_ready(self, seconds: float) -> None:
        """Wait until all have loaded their kernels; who has not by then is left out."""
        until, ready = monotonic() + seconds, set()
        while waiting := [connection for connection in self._places if connection not in ready]:
            answers = _ready(waiting, until - monotonic())
            if not answers:
                self._places = {connection: place for connection, place in self._places.items() if connection in ready}
            ready |= {connection for connection in answers if self._received(connection) is not None}

    def search(self, problem: Problem, planner: str, settings: Settings) -> Outcome:
        """Search together; return the best outcome, with the improvements of all in the order of time."""
        begin = settings.clock()
        self._ask(problem, settings)
        jobs = 1 + len(self._waiting)
        races = settings.first and settings.max_tries is None
        clock = self._watched(settings.clock) if races else settings.clock
        cost = Cost(problem, settings)
        found: dict[int, Outcome] = {}
        try:
            with suppress(_Beaten):
                own = found[0] = search(problem, planner, replace(settings, jobs=1, clock=clock))
                if not (own.infeasible or _value(problem, cost, own) <= CLOSE_TO_BOUND or races and not own.reason):
                    self._wait_for_others(settings, begin, races)
        finally:
            self._stop()
        found |= self._outcomes
        return _merged(problem, cost, [found[place] for place in sorted(found)], jobs)

    def _wait_for_others(self, settings: Settings, begin: float, races: bool) -> None:
        """Take what others find until time is over, and what they have found by then."""

        def found() -> bool:
            return not self._waiting or races and self._have_plan()

        while not found() and settings.clock() < begin + settings.time_limit:
            self._take(SLICE)
        self._stop()
        until = monotonic() + GRACE
        while not found() and self._take(until - monotonic()):
            pass

    def _ask(self, problem: Problem, settings: Settings) -> None:
        """Let all search but those that are still at the last search."""
        until = monotonic() + GRACE
        while self._waiting and self._take(until - monotonic()):
            pass
        for connection in self._waiting:
            del self._places[connection]
        self._waiting, self._outcomes = {}, {}
        for connection, place in list(self._places.items()):
            try:
                seed = seed_of(settings.seed, place)
                connection.send((problem, replace(settings, jobs=1, seed=seed, clock=monotonic, on_progress=None)))
                self._waiting[connection] = place
            except OSError:
                del self._places[connection]

    def _stop(self) -> None:
        """Tell those that are still searching that time is over."""
        for connection in self._waiting:
            with suppress(OSError):
                connection.send(None)

    def _start(self, planner: str, place: int) -> None:
        ours, theirs = Pipe()
        environment = dict(os.environ)
        threads.limit(environment)
        self._places[ours] = place
        with theirs, suppress(OSError):  # no process to be had: its pipe ends here
            self._processes.append(
                subprocess.Popen(
                    [sys.executable, "-c", _CHILD, str(theirs.fileno()), planner],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    env=environment,
                    start_new_session=True,  # Ctrl-C is for the process that asks; it ends this one
                )
            )

    def _watched(self, clock: Callable[[], float]) -> Callable[[], float]:
        """Return a clock that ends the search of whoever looks at it once another has a plan."""

        def watched() -> float:
            self._take(0.0)
            if self._have_plan():
                raise _Beaten
            return clock()

        return watched

    def _have_plan(self) -> bool:
        return any(not outcome.reason for outcome in self._outcomes.values())

    def _take(self, timeout: float) -> bool:
        """Take the outcomes that come in time; return whether any connection had something."""
        answers = _ready(list(self._waiting), max(timeout, 0.0)) if self._waiting else []
        for connection in answers:
            place = self._waiting.pop(connection)
            outcome = self._received(connection)
            if outcome is not None:
                self._outcomes[place] = outcome
        return bool(answers)

    def _received(self, connection: Connection):
        """Return what came: None of a refusal, and from a process that has died, which is left out from now on."""
        try:
            return connection.recv()
        except (EOFError, OSError):
            del self._places[connection]
            return None


def _ready(connections: list[Connection], timeout: float) -> list[Connection]:
    """Wait s for any of some connections to have something, and return those that have."""
    ready = wait(connections, timeout)
    return [connection for connection in connections if connection in ready]


def _value(problem: Problem, cost: Cost, outcome: Outcome) -> float:
    return np.inf if outcome.reason or outcome.primitives is None else cost.of(*expand(problem.swarm, outcome.primitives))


def _merged(problem: Problem, cost: Cost, outcomes: list[Outcome], jobs: int) -> Outcome:
    best = min(outcomes, key=lambda outcome: _value(problem, cost, outcome))
    history, least = [], np.inf
    for entry in sorted(entry for outcome in outcomes if not outcome.reason for entry in outcome.history):
        value = cost.of_figures(entry[1], entry[2])
        if value < least:
            history.append(entry)
            least = value
    counts = {
        key: sum(outcome.details.get(key, 0) for outcome in outcomes)
        for key, value in best.details.items()
        if isinstance(value, int)
    }
    return replace(best, history=tuple(history), details=best.details | counts | {"jobs": jobs})


# The other side


def main() -> None:
    """Search whenever asked to; end at once when the other side has gone."""
    connection, planner = Connection(int(sys.argv[1])), sys.argv[2]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked: SimpleQueue[tuple[Problem, Settings]] = SimpleQueue()
    with suppress(EOFError, OSError):
        prepare(planner)
        connection.send(True)
        threading.Thread(target=_hear, args=(connection, asked), daemon=True).start()
        while True:
            problem, settings = asked.get()
            outcome = None
            with suppress(StressbotError):  # refused, as the other side finds by itself
                outcome = search(problem, planner, settings)
            connection.send(outcome)


def _hear(connection: Connection, asked: "SimpleQueue[tuple[Problem, Settings]]") -> None:
    """Hand on what is asked for, stop a search when the other side says so, and end with it."""
    clock = StoppableClock()
    with suppress(EOFError, OSError):
        while True:
            task = connection.recv()
            if task is None:
                clock.stopped = True
            else:
                clock, (problem, settings) = StoppableClock(), task
                asked.put((problem, replace(settings, clock=clock)))
    os._exit(1)
