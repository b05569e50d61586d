"""Threads that run one at a time and change over where a test says so: every order of what they do can be gone through.

What may change over is every operation of a lock, an event, a thread, a clock or a socket made here, and every line of chosen
modules.
"""

import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace

PATIENCE = 60.0
"""[s] for one step of one thread, on however busy a machine."""


class Abandoned(BaseException):
    """The test is over; whoever still waits goes home."""


class Task:
    """One thread: what it waits for, and how it ended."""

    def __init__(self, name: str, run: Callable[[], object]):
        self.name, self.run = name, run
        self.parent: Task | None = None
        self.ready: Callable[[], bool] = lambda: True
        self.done = False
        self.error: BaseException | None = None
        self.go = threading.Semaphore(0)
        self.thread: threading.Thread | None = None


class Scheduler:
    """Runs tasks by a list of choices; where that ends, whoever runs goes on.

    Attributes:
        taken: the choice made at each step, and how many there were.
        files: of the modules whose every line may be the last before others run.
    """

    def __init__(self, choices: list[int], files: tuple[str, ...] = ()):
        self._choices, self.files = choices, files
        self.taken: list[tuple[int, int]] = []
        self.tasks: list[Task] = []
        self._current: Task | None = None
        self._back = threading.Semaphore(0)
        self._over = self._quietly = False
        self.threading = SimpleNamespace(
            Lock=lambda: Lock(self),
            RLock=lambda: Lock(self),
            Event=lambda: Event(self),
            Thread=lambda **options: Thread(self, **options),
            current_thread=lambda: self._current.handle,
        )

    def spawn(self, name: str, run: Callable[[], object], handle: object = None) -> Task:
        """A task that runs `run`."""
        task = Task(name, run)
        me = self._current
        task.handle, task.parent = handle, me if me is not None and threading.current_thread() is me.thread else None
        self.tasks.append(task)
        return task

    @property
    def current(self) -> Task | None:
        return self._current

    def point(self, ready: Callable[[], bool] = lambda: True) -> None:
        """Let others run, and go on when `ready` says so. Outside of tasks, it must say so already."""
        task = self._current
        if task is None or threading.current_thread() is not task.thread:
            assert ready(), "this would wait for ever"
            return
        if self._over:
            raise Abandoned
        task.ready = ready
        self._back.release()
        task.go.acquire()
        if self._over:
            raise Abandoned

    def run(self, quietly: bool = False) -> None:
        """Run until nobody can go on any more; quietly, by no choices and not line by line."""
        self._quietly = quietly
        while enabled := [task for task in self.tasks if not task.done and task.ready()]:
            # Who runs goes on unless a choice says otherwise: choice 0 changes nobody over.
            enabled.sort(key=lambda task: task is not self._current)
            choice = 0
            if len(enabled) > 1 and not quietly:
                step = len(self.taken)
                choice = self._choices[step] if step < len(self._choices) else 0
                self.taken.append((choice, len(enabled)))
            self._step(enabled[choice])

    def _step(self, task: Task) -> None:
        self._current = task
        if task.thread is None:
            task.thread = threading.Thread(target=self._work, args=(task,), daemon=True)
            task.thread.start()
        else:
            task.go.release()
        assert self._back.acquire(timeout=PATIENCE), f"{task.name} hangs outside of the scheduler"

    def _work(self, task: Task) -> None:
        try:
            if self.files:
                sys.settrace(self._trace)
            task.run()
        except Abandoned:
            pass
        except BaseException as error:
            task.error = error
        finally:
            sys.settrace(None)
            task.done = True
            self._back.release()

    def _trace(self, frame, event, argument):
        return self._lines if frame.f_code.co_filename in self.files else None

    def _lines(self, frame, event, argument):
        if event == "line" and not self._quietly:
            self.point()
        return self._lines

    def abandon(self) -> None:
        """End all tasks that still wait."""
        self._over = True
        for task in self.tasks:
            while not task.done and task.thread is not None:
                self._current = task
                task.go.release()
                assert self._back.acquire(timeout=PATIENCE), f"{task.name} does not go home"
        self._current = None

    @property
    def waiting(self) -> list[str]:
        return [task.name for task in self.tasks if not task.done]


class Lock:
    """A lock that may be taken again by whom has it, as RLock; for Lock that is a deadlock which no test here has."""

    def __init__(self, scheduler: Scheduler):
        self._scheduler, self._holder, self._depth = scheduler, None, 0

    def __enter__(self) -> "Lock":
        me = self._scheduler.current
        if self._holder is not me or me is None:
            self._scheduler.point(lambda: self._holder is None)
            self._holder = me
        self._depth += 1
        return self

    def __exit__(self, *_error: object) -> None:
        self._depth -= 1
        if not self._depth:
            self._holder = None


class Event:
    def __init__(self, scheduler: Scheduler):
        self._scheduler, self._set = scheduler, False

    def set(self) -> None:
        self._scheduler.point()
        self._set = True

    def clear(self) -> None:
        self._scheduler.point()
        self._set = False

    def is_set(self) -> bool:
        self._scheduler.point()
        return self._set

    def wait(self, timeout: float | None = None) -> bool:
        """`timeout` never comes: whoever waits for what never happens is found waiting."""
        self._scheduler.point(lambda: self._set)
        return True


class Thread:
    def __init__(self, scheduler: Scheduler, target: Callable, args: tuple = (), name: str = "", daemon: bool = False):
        self._scheduler, self._name, self._run, self._task = scheduler, name, lambda: target(*args), None

    def start(self) -> None:
        self._task = self._scheduler.spawn(self._name, self._run, self)
        self._scheduler.point()

    def join(self, timeout: float | None = None) -> None:
        if self._task is None:
            raise RuntimeError("cannot join thread before it is started")
        self._scheduler.point(lambda: self._task.done)


class Socket:
    """One end of a pair: messages whole and in order, with file descriptors."""

    def __init__(self, scheduler: Scheduler):
        self._scheduler = scheduler
        self.messages: deque[tuple[bytes, list[int]]] = deque()
        self.closed = self.shut = False
        self._blocking = True
        self.other: Socket = None

    @property
    def readable(self) -> bool:
        return bool(self.messages) or self.closed or self.shut

    def setblocking(self, flag: bool) -> None:
        self._blocking = flag

    def settimeout(self, timeout: float | None) -> None:
        self._blocking = True

    def send(self, message: bytes, flags: int = 0) -> None:
        self.send_fds([message], [])

    def send_fds(self, messages: list[bytes], descriptors: list[int]) -> None:
        self._scheduler.point()
        if self.closed:
            raise OSError("this end is closed")
        if self.shut or self.other.closed:
            raise BrokenPipeError("the other end is closed")
        self.other.messages.append((messages[0], descriptors))

    def recv(self, size: int, flags: int = 0) -> bytes:
        return self.recv_fds(size, flags=flags)[0]

    def recv_fds(self, size: int, most: int = 0, flags: int = 0) -> tuple[bytes, list[int], int, None]:
        if flags or not self._blocking:
            self._scheduler.point()
            if not self.readable:
                raise BlockingIOError
        else:
            self._scheduler.point(lambda: self.readable)
        if self.messages and not self.closed:
            message, descriptors = self.messages.popleft()
            return message, descriptors, 0, None
        if self.closed:
            raise OSError("this end is closed")
        return b"", [], 0, None

    def shutdown(self, how: int) -> None:
        if self.closed:
            raise OSError("this end is closed")
        self.shut = self.other.shut = True

    def close(self) -> None:
        self.closed = self.other.shut = True


def pair(scheduler: Scheduler) -> tuple[Socket, Socket]:
    one, other = Socket(scheduler), Socket(scheduler)
    one.other, other.other = other, one
    return one, other


def orders(run: Callable[[list[int]], list[tuple[int, int]]], changes: int) -> Iterator[list[int]]:
    """Go through all orders with at most so many changes from who would go on by itself; yields the choices of each.

    `run` runs one order and returns what was taken.
    """
    waiting = [([], 0)]
    while waiting:
        choices, spent = waiting.pop()
        taken = run(choices)
        yield choices
        if spent == changes:
            continue
        for step in range(len(choices), len(taken)):
            prefix = [choice for choice, _ in taken[:step]]
            waiting += [([*prefix, other], spent + 1) for other in range(1, taken[step][1])]
