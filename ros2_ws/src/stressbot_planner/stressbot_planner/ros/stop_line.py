"""A line to the driver's `stop` that nothing else uses: a node, a client and a thread of its own."""

import threading
import time
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.task import Future
from std_srvs.srv import Trigger

AGAIN = 0.3
"""s after which a stop that nobody has answered is asked for again"""
TIMES = 30


class StopLine:
    """Asks for a stop until the driver has answered. `press` may be called on any thread, and returns at once."""

    def __init__(self, namespace: str, tell: Callable[[str], None]):
        """Make the node.

        Args:
            namespace: of the driver.
            tell: is told, on this line's thread, what became of a stop.
        """
        self._tell = tell
        self._node = rclpy.create_node("view_stop", namespace=namespace)
        self._client = self._node.create_client(Trigger, "stop")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._left, self._asked, self._answer = 0, 0.0, None
        self._lock = threading.RLock()  # an answer may be there before it is asked for what to do with it
        self._node.create_timer(AGAIN / 3, self._look)
        self._thread = threading.Thread(target=self._spin, name="stop", daemon=True)
        self._thread.start()

    def press(self) -> None:
        """Ask for a stop."""
        with self._lock:
            self._left = TIMES
            self._ask()

    def close(self) -> None:
        """End the thread; ROS must have been shut down."""
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        except Exception:
            if rclpy.ok():  # else it is ROS that goes down under its feet
                raise

    def _ask(self) -> None:
        self._asked, self._left = time.monotonic(), self._left - 1
        if self._client.service_is_ready():
            if self._answer is not None:
                self._client.remove_pending_request(self._answer)
            self._answer = self._client.call_async(Trigger.Request())
            self._answer.add_done_callback(self._answered)

    def _answered(self, answer: Future) -> None:
        with self._lock:
            if self._answer is answer:
                self._left, self._answer = 0, None
        result = answer.result()
        if result is not None:
            self._tell(f"stop: {result.message or ('at rest' if result.success else 'refused')}")

    def _look(self) -> None:
        with self._lock:
            if self._left == 0 or time.monotonic() < self._asked + AGAIN:
                return
            self._ask()
            if self._left:
                return
        self._tell("stop: no driver answers; see whether it runs, and switch the amplifier off by hand")
