"""How a node's process runs and ends: signals, threads and exit codes in one place."""

import signal
import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from stressbot_driver.errors import BenchError

BAD_INPUT = 2


def run(name: str, make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Make a node called `name`, spin it until SIGINT, SIGTERM, SIGHUP or a shutdown, close it; the exit code.

    0 after a signal, 2 with one line on stderr if the node refuses its parameters, 1 after a defect. The node's
    `close()` runs in every case before ROS goes down, so that it can still bring its output to rest and say so.
    """
    # rclpy's own handlers would shut the context down first, and nothing could be published any more. The executor
    # spins on a thread because a signal handler only runs once the main thread leaves C code.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy has no narrower class for arguments that it does not understand
        reason = str(error).splitlines()[0] if str(error) else repr(error)
        sys.stderr.write(f"{name}: --ros-args: {reason}: correct the command line\n")
        return BAD_INPUT
    # The one thing to wait on that a signal handler may touch: an Event's lock is not re-entrant, and a second signal, or one
    # in the wrong moment, would hang the process.
    ended: SimpleQueue[None] = SimpleQueue()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: ended.put(None))
    failures: list[BaseException] = []
    node = None
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        down = threading.Event()

        def spin() -> None:
            try:
                executor.spin()
            except (KeyboardInterrupt, ExternalShutdownException):
                pass
            except BaseException as error:
                if not down.is_set():  # ROS going down under its feet shows as one of many errors
                    failures.append(error)
            finally:
                ended.put(None)

        thread = threading.Thread(target=spin, name="executor")
        thread.start()
        try:
            ended.get()
        finally:
            try:
                node.close()
            finally:
                down.set()
                rclpy.try_shutdown()  # wakes the executor; shutting it down would pull its guards from under it
                thread.join()
    except BenchError as error:
        sys.stderr.write(f"{name}: {error}\n")
        return BAD_INPUT
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if failures:
        raise failures[0]
    return 0
