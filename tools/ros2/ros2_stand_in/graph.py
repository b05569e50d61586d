"""A node of ours that looks round among the others: names, types, and how long to wait until they are all known."""

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden
from stressbot_msgs.transports import avoid_shared_memory

PREFIX = "_ros2cli"
STEP = 0.02
HERE, ANYWHERE = 0.5, 3.2
"""s in which everybody has announced itself: each 0.3 s with discovery limited to this machine (localhost.xml), else each 3 s."""
QUIET, LONGEST, NAMED = 0.3, 5.0, 3.5
"""s: nothing new that long means that all is known; longest wait for that; longest wait for what must be there."""

NamesAndTypes = list[tuple[str, list[str]]]


@contextmanager
def looking(
    options: argparse.Namespace, found: Callable[[Node], object] | None = None, at_once: bool = False, name: str | None = None
) -> Iterator[Node]:
    """Yield a node that has looked round until nothing new has come for a while.

    Args:
        options: of the command line.
        found: whether what must be there is; longer is waited for that. Some node but this one if None.
        at_once: that is enough, whatever else there is.
        name: of the node.
    """
    least = getattr(options, "spin_time", None)
    if least is None:
        least = HERE if os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST" else ANYWHERE
    overrides = [Parameter("use_sim_time", value=getattr(options, "use_sim_time", False))]
    with own(
        name or f"{PREFIX}_{os.getpid()}",
        start_parameter_services=False,
        parameter_overrides=overrides,
        automatically_declare_parameters_from_overrides=True,
    ) as node:
        _look_round(node, least, found or (lambda node: len(node_names(node)) > 0), at_once)
        yield node


@contextmanager
def own(name: str, outlives_ctrl_c: bool = False, **options) -> Iterator[Node]:
    """Yield a node that has not looked round. rclpy's own handler of Ctrl-C ends all talk, unless the node outlives it."""
    avoid_shared_memory(os.environ)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO if outlives_ctrl_c else None)
    try:
        node = rclpy.create_node(name, **options)
        try:
            yield node
        finally:
            node.destroy_node()
    except NameValidationException as error:
        raise RuntimeError(str(error)) from error
    finally:
        rclpy.try_shutdown()


def _look_round(node: Node, least: float, found: Callable[[Node], object], at_once: bool) -> None:
    begin = changed = time.monotonic()
    seen = None
    while True:
        now = time.monotonic()
        picture = node.get_node_names_and_namespaces(), node.get_topic_names_and_types(), node.get_service_names_and_types()
        if picture != seen:
            seen, changed = picture, now
        is_found = found(node) or now - begin >= NAMED
        is_settled = now - begin >= least and (now - changed >= QUIET or now - begin >= LONGEST)
        if is_found and (is_settled or at_once):
            return
        time.sleep(STEP)


def node_names(node: Node, hidden: bool = False) -> list[str]:
    """Return full names, in the order in which they were met."""
    return [
        namespace.rstrip("/") + "/" + name
        for name, namespace in node.get_node_names_and_namespaces()
        if hidden or (name and not name.startswith("_"))
    ]


def topics(node: Node, hidden: bool = False) -> NamesAndTypes:
    """Return topics and their types, in alphabetic order."""
    return shown(node.get_topic_names_and_types(), hidden)


def services(node: Node, hidden: bool = False) -> NamesAndTypes:
    """Return services and their types, in alphabetic order."""
    return shown(node.get_service_names_and_types(), hidden)


def shown(names_and_types: NamesAndTypes, hidden: bool) -> NamesAndTypes:
    """Leave out what has a hidden name, unless `hidden`."""
    return [(name, types) for name, types in names_and_types if hidden or not topic_or_service_is_hidden(name)]


def absolute(node_name: str) -> str:
    return node_name if node_name.startswith("/") else "/" + node_name


def split(node_name: str) -> tuple[str, str]:
    """Return a node's name and namespace."""
    namespace, _, name = absolute(node_name).rpartition("/")
    return name, namespace or "/"


def name_completer(names: Callable[[Node], list[str]]) -> Callable:
    """Return what completes a word with names of the graph."""

    def complete(prefix, parsed_args, **_):
        with looking(parsed_args) as node:
            return names(node)

    return complete
