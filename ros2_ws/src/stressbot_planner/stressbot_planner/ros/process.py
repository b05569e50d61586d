"""How a node's process runs and ends: signals, threads and exit codes in one place."""

import os
import signal
import sys
import threading
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from stressbot_msgs import lifeline
from stressbot_msgs.bounds import bound_parameter_requests
from stressbot_msgs.console import Console
from stressbot_msgs.transports import avoid_shared_memory
from stressbot_msgs.wording import why_no_ros

from stressbot_planner.errors import StressbotError

BAD_INPUT = 2


class ProcessNode(Node):
    """A node that `run` can end."""

    def close(self) -> None:
        """End whatever callbacks wait for: nothing, unless a node says otherwise."""

    def wake(self) -> None:
        """Let the executor look at callbacks whose futures are done now."""
        if (executor := self.executor) is not None:
            executor.wake()


def run(name: str, make_node: Callable[[], ProcessNode], args: list[str] | None = None) -> int:
    """Make a node called `name`, spin it until SIGINT, SIGTERM, SIGHUP or a shutdown, close it; return the exit code.

    0 after a signal, 2 with one line on stderr if the node refuses its parameters; a defect raises. Before this is called, while
    modules are loaded, a signal ends the process by itself (see setup.py). If the process that started this one says so in the
    environment (see `lifeline`), its death is a SIGTERM here. The node's `close()` ends whatever its callbacks wait for.
    """
    with Console():
        return _run(name, make_node, args)


def _run(name: str, make_node: Callable[[], ProcessNode], args: list[str] | None) -> int:
    # A pipe, which the interpreter's own C handler writes to, on whatever thread a signal arrives. A handler in Python that sets an
    # Event, or puts into a SimpleQueue, hangs the process now and then when several signals come in a row.
    ended, end = os.pipe()
    os.set_blocking(end, False)
    signal.set_wakeup_fd(end, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    lifeline.follow_starter(lambda: os.kill(os.getpid(), signal.SIGTERM))
    avoid_shared_memory(os.environ)
    # The executor spins on a thread because a signal handler only runs once the main thread leaves C code.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy has no narrower class for arguments that it does not understand
        sys.stderr.write(f"{name}: {': '.join(why_no_ros(error))}\n")
        return BAD_INPUT
    failures: list[BaseException] = []
    try:
        node = make_node()
        bound_parameter_requests(node)
    except StressbotError as error:
        sys.stderr.write(f"{name}: {error}\n")
        rclpy.try_shutdown()
        return BAD_INPUT
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    closing = threading.Event()

    def spin() -> None:
        try:
            executor.spin()
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        except BaseException as error:
            if not closing.is_set():  # ROS going down under its feet shows as one of many errors
                failures.append(error)
        finally:
            os.write(end, b"\0")

    thread = threading.Thread(target=spin, name="executor")
    thread.start()
    try:
        os.read(ended, 1)
    finally:
        closing.set()
        node.close()
        rclpy.try_shutdown()
        thread.join()
        executor.shutdown()  # else the garbage collector may end it in the wrong order, with a traceback
        node.destroy_node()
    if failures:
        raise failures[0]
    return 0
