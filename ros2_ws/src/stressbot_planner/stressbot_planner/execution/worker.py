"""Planning in a process of its own, which leaves the asking one free to talk and can be ended at any time.

In one process a planner and a ROS executor fight for Python's interpreter lock: planning then takes several times as
long, and messages wait.
"""

import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, Pipe

import numpy as np
from stressbot_msgs import lifeline

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Progress, Settings, assignment
from stressbot_planner.primitives.expansion import Primitive
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Failed
from stressbot_planner.system import threads
from stressbot_planner.system.clock import StoppableClock
from stressbot_planner.system.fields import FREE, NO_ENTRIES

OVERTIME = 10.0
"""A planner that exceeds its time limit by this, s, is ended."""

STOPPED_WITHIN = 1.0
"""A planner that is told to stop and goes on for so long, s, is ended: a new process takes its place."""

_SLICE = 0.05
"""s from one look at what else happens to the next, on both sides."""

READY_WITHIN = 120.0
"""The first start of all compiles the kernels, which takes seconds."""

_CHILD = f"from {__name__} import main; main()"


@dataclass(frozen=True, eq=False)
class Task:
    """What to plan: the arguments of `Problem` and of `assignment.solve`."""

    swarm: Swarm
    environment: Environment
    starts: np.ndarray
    goals: np.ndarray
    tolerance: float
    planner: str
    settings: Settings
    exchangeable: tuple[int, ...] = ()
    goal_headings: np.ndarray | float = FREE
    parked: tuple[int, ...] = ()
    waypoints: np.ndarray = NO_ENTRIES
    contacts: tuple[tuple[int, int], ...] = ()
    contact_depth: float = 0.0

    @classmethod
    def of(cls, problem: Problem, planner: str, settings: Settings) -> "Task":
        """Return the task of solving a problem that exists already."""
        return cls(
            problem.swarm, problem.environment, problem.starts, problem.goals, problem.tolerance, planner, settings,
            problem.exchangeable, problem.goal_headings, problem.parked, problem.waypoints,
            problem.contacts, problem.contact_depth,
        )


@dataclass(frozen=True, eq=False)
class Report:
    """What came of it: the parts of a `Result` and its plan that others need, without the poses on the way.

    Attributes:
        success, code, reason, planning_time: of the `Result`.
        primitives: of the plan; empty unless success, and so are the figures.
        end: poses at the end, shape (n, 3), units and rad.
        activations: number of those that are longer than 0.
        path_length, execution_time, goal_error: of the plan.
        gap: smallest clearance, units.
        goals: of each robot, as they were assigned, shape (n, 2), units.
        goal_headings: rad, shape (n,), NaN where they are free.
    """

    success: bool
    code: ErrorCode
    reason: str
    planning_time: float
    primitives: tuple[Primitive, ...] = ()
    end: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    activations: int = 0
    path_length: float = 0.0
    execution_time: float = 0.0
    goal_error: float = 0.0
    gap: float = 0.0
    goals: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    goal_headings: np.ndarray = field(default_factory=lambda: np.empty(0))


class WorkerEnded(Exception):
    """The process ended before it answered."""


class Worker:
    """A planning process; a new one is started if it dies. `solve` takes one task at a time."""

    def __init__(self):
        self._closed = False
        self._changing = threading.Lock()  # guards process and connection while they come and go
        self._start()

    def wait_until_ready(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Wait until all kernels are loaded; `meanwhile` is called some times a second, and may raise to give up.

        Raises:
            WorkerEnded: the process could not start.
        """
        deadline = time.monotonic() + READY_WITHIN
        while not self._connection.poll(_SLICE):
            meanwhile()
            if time.monotonic() > deadline:
                raise WorkerEnded
        self._receive()
        self._ready = True

    def solve(
        self,
        task: Task,
        meanwhile: Callable[[], None] = lambda: None,
        on_progress: Callable[[Progress], None] = lambda _: None,
    ) -> Report:
        """Plan.

        Args:
            task: what to plan.
            meanwhile: called some times a second; what it raises ends the search and leaves this call.
            on_progress: told of tries and better plans.

        Raises:
            StressbotError: the problem or the planner is refused, or the planner failed (INTERNAL).
            WorkerEnded: `close` was called meanwhile.
        """
        if self._process.poll() is not None:
            self._restart()
        if not self._ready:
            self.wait_until_ready(meanwhile)
        try:
            limit = task.settings.time_limit
            self._connection.send(task)
            answer = self._answer(limit + OVERTIME, meanwhile, on_progress)
        except (OSError, WorkerEnded):
            if self._closed:
                raise WorkerEnded from None
            self._restart()
            raise StressbotError(
                ErrorCode.INTERNAL, "planner", "the planning process died, perhaps for want of memory; it runs again"
            ) from None
        if answer is None:
            self._restart()
            reason = f"did not end within {OVERTIME:g} s after its time limit of {limit:g} s"
            return Report(False, ErrorCode.NO_PLAN_FOUND, reason, limit + OVERTIME)
        if isinstance(answer, Report):
            return answer
        raise StressbotError(*answer)

    def _answer(
        self, patience: float, meanwhile: Callable[[], None], on_progress: Callable[[Progress], None]
    ) -> Report | tuple[ErrorCode, str, str] | None:
        """Return the answer to a task, or None if there is none within `patience` s."""
        deadline = time.monotonic() + patience
        while (left := deadline - time.monotonic()) > 0:
            if self._connection.poll(min(_SLICE, left)):
                message = self._receive()
                if not isinstance(message, Progress):
                    return message
                on_progress(message)
            try:
                meanwhile()
            except BaseException:
                self._stop()
                raise
        return None

    def _stop(self) -> None:
        """End a search: by a word, or with the process if that is of no use."""
        with suppress(OSError, WorkerEnded):
            self._connection.send(None)
            if self._answer(STOPPED_WITHIN, lambda: None, lambda _: None) is None:
                self._restart()

    def close(self) -> None:
        """End the process, whatever it does."""
        with self._changing:
            self._closed = True
            self._process.kill()
        self._process.wait()

    def _receive(self):
        try:
            return self._connection.recv()
        except (EOFError, OSError):
            raise WorkerEnded from None

    def _start(self) -> None:
        self._connection, theirs = Pipe()
        environment = os.environ | lifeline.environment()
        threads.limit(environment)
        self._process = subprocess.Popen(
            [sys.executable, "-c", _CHILD, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            env=environment,
            process_group=0,  # Ctrl-C in the terminal is for the process that asks, also while this one is loading
        )
        theirs.close()
        self._ready = False

    def _restart(self) -> None:
        """Start a new process, which gets ready by itself."""
        with self._changing:
            if self._closed:
                raise WorkerEnded
            self._process.kill()
            self._process.wait()
            self._connection.close()
            self._start()


# The other side


def main() -> None:
    """Answer tasks until the other side goes away."""
    lifeline.follow_starter()
    connection = Connection(int(sys.argv[1]))
    # Who asks ends this process; so does its death.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        warm_up()
        connection.send(None)
        while True:
            task = connection.recv()
            if task is not None:  # otherwise it was told to stop when it had just ended
                connection.send(_answer(task, connection))


class _Clock(StoppableClock):
    """The time as a planner knows it: when the other side says stop, time is over. Tells the other side of progress."""

    def __init__(self, connection: Connection):
        super().__init__()
        self._connection, self._look, self._tell = connection, 0.0, 0.0

    def __call__(self) -> float:
        now = time.monotonic()
        if not self.stopped and now >= self._look:
            self._look = now + _SLICE
            if self._connection.poll():
                self._connection.recv()
                self.stopped = True
        return super().__call__()

    def on_progress(self, progress: Progress) -> None:
        """Send it, but not too often."""
        if time.monotonic() >= self._tell:
            self._tell = time.monotonic() + _SLICE
            self._connection.send(progress)


def _answer(task: Task, connection: Connection) -> Report | tuple[ErrorCode, str, str]:
    clock = _Clock(connection)
    try:
        return perform(replace(task, settings=replace(task.settings, clock=clock, on_progress=clock.on_progress)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        raise
    except StressbotError as error:
        return error.code, error.field, error.message
    except Exception as error:
        traceback.print_exc()
        return ErrorCode.INTERNAL, "planner", f"a defect ({error!r}), please report it with the traceback in the log"


def perform(task: Task) -> Report:
    """Plan here and now; raises StressbotError as `Problem` and `assignment.solve` do."""
    problem = Problem(
        task.swarm, task.environment, task.starts, task.goals, task.tolerance, task.exchangeable, task.goal_headings,
        parked=task.parked, waypoints=task.waypoints, contacts=task.contacts, contact_depth=task.contact_depth,
    )
    result = assignment.solve(problem, task.planner, task.settings)
    if isinstance(result, Failed):
        return Report(False, result.code, result.reason, result.planning_time)
    plan = result.plan
    return Report(
        success=True,
        code=result.code,
        reason="",
        planning_time=result.planning_time,
        primitives=plan.primitives,
        end=np.array(plan.poses[-1]),
        activations=int(np.count_nonzero(plan.lengths)),
        path_length=plan.path_length,
        execution_time=plan.execution_time,
        goal_error=plan.goal_error,
        gap=float(plan.clearance.gap),
        goals=plan.problem.goals,
        goal_headings=plan.problem.goal_headings,
    )


def warm_up() -> None:
    """Load and compile what planning needs, so that the first task is as quick as the next."""
    for name in planners.names():
        planners.prepare(name)
