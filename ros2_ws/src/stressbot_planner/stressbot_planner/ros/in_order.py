"""Work for an executor's thread, done in the order in which it comes: tasks of rclpy that wait together run newest first."""

from collections import deque
from collections.abc import Callable

from rclpy.executors import Executor


class InOrder:
    """A queue of work that any thread may add to."""

    def __init__(self) -> None:
        self._work: deque[Callable[[], None]] = deque()

    def add(self, executor: Executor, work: Callable[[], None]) -> None:
        """Let an executor do something after all that was added before."""
        self._work.append(work)
        executor.create_task(self._do_next)  # whichever of them runs first does what came first
        executor.wake()

    def _do_next(self) -> None:
        self._work.popleft()()
