"""How a node's process runs and ends: signals, threads and exit codes in one place."""

import os
import signal
import sys
import threading
from collections.abc import Callable

import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from stressbot_msgs import lifeline
from stressbot_msgs.bounds import bound_parameter_requests
from stressbot_msgs.console import Console
from stressbot_msgs.errors import StressbotError
from stressbot_msgs.transports import avoid_shared_memory
from stressbot_msgs.wording import why_no_ros

BAD_INPUT = 2

MADE = b"\xff"
"""What the pipe of signals says when the node is there; no signal has this number."""

PATIENCE = 0.5
"""s that a node which is still being made has to become one, once a signal asks for its end."""


class ProcessNode(Node):
    """A node that `run` can end.

    Attributes:
        vital: what must go on whatever else there is to do; None: nothing more than the rest.
    """

    vital: CallbackGroup | None = None

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
    environment (see `lifeline`), its death is a SIGTERM here. The node's `close()` runs in every case before ROS goes down, so
    that it can still bring its output to rest and say so. What is in the callback group `vital` is served on a thread of its own.
    """
    with Console() as console:
        return _run(console, name, make_node, args)


def _run(console: Console, name: str, make_node: Callable[[], ProcessNode], args: list[str] | None) -> int:
    # A pipe, which the interpreter's own C handler writes to, on whatever thread a signal arrives. A handler in Python that sets an
    # Event, or puts into a SimpleQueue, hangs the process now and then when several signals come in a row.
    ended, end = os.pipe()
    os.set_blocking(end, False)
    signal.set_wakeup_fd(end, warn_on_full_buffer=False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    lifeline.follow_starter(lambda: os.kill(os.getpid(), signal.SIGTERM))
    avoid_shared_memory(os.environ)
    # rclpy's own handlers would shut the context down first, and nothing could be published any more. The node is made and
    # served on other threads because a signal handler only runs once the main thread leaves C code.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy has no narrower class for arguments that it does not understand
        sys.stderr.write(f"{name}: {': '.join(why_no_ros(error))}\n")
        return BAD_INPUT
    failures: list[BaseException] = []
    nodes: list[ProcessNode] = []

    def make() -> None:
        try:
            node = make_node()
            bound_parameter_requests(node)
            nodes.append(node)
        except BaseException as error:
            failures.append(error)
        finally:
            os.write(end, MADE)

    maker = threading.Thread(target=make, name="node")
    maker.start()
    signalled = os.read(ended, 1) != MADE
    maker.join(PATIENCE if signalled else None)
    if maker.is_alive():  # in a file that does not end, at an instrument that does not answer, in a compiler; no volts were ever on
        console.close()
        os._exit(0)
    try:
        if nodes:
            _serve(nodes[0], ended, end, failures, signalled)
    except StressbotError as error:
        failures.append(error)
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    for failure in failures:
        if isinstance(failure, StressbotError):
            sys.stderr.write(f"{name}: {failure}\n")
            return BAD_INPUT
        raise failure
    return 0


def _serve(node: ProcessNode, ended: int, end: int, failures: list[BaseException], signalled: bool) -> None:
    """Spin a node until a byte comes out of `ended`, then close it. What breaks on a thread is added to `failures`."""
    executors = _executors(node)

    def spin(executor: SingleThreadedExecutor) -> None:
        try:
            executor.spin()
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        except BaseException as error:
            if rclpy.ok():  # else ROS going down under its feet shows as one of many errors
                failures.append(error)
        finally:
            os.write(end, b"\0")

    threads = [threading.Thread(target=spin, args=(executor,), name="executor") for executor in executors]
    for thread in threads:
        thread.start()
    try:
        if not signalled:
            os.read(ended, 1)
    finally:
        try:
            node.close()
        finally:
            rclpy.try_shutdown()  # wakes the executors; shutting them down before would pull their guards from under them
            for thread, executor in zip(threads, executors, strict=True):
                thread.join()
                executor.shutdown()  # else the garbage collector may end it in the wrong order, with a traceback


class _PartExecutor(SingleThreadedExecutor):
    """Serves what of a node is in a callback group, or what is not. rclpy has no other way to let two executors share a node."""

    def __init__(self, node: Node, group: CallbackGroup, within: bool) -> None:
        super().__init__()
        self._node, self._group, self._within = node, group, within

    def get_nodes(self) -> list[Node]:
        return [self._node]

    def can_execute(self, entity) -> bool:
        return (entity.callback_group is self._group) is self._within and super().can_execute(entity)


def _executors(node: ProcessNode) -> list[SingleThreadedExecutor]:
    group = node.vital
    everything_else = SingleThreadedExecutor() if group is None else _PartExecutor(node, group, within=False)
    everything_else.add_node(node)
    return [everything_else] if group is None else [everything_else, _PartExecutor(node, group, within=True)]
