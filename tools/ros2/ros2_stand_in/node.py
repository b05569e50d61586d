"""`ros2 node`: list, info."""

import argparse
import sys

from rclpy.action import graph as actions
from rclpy.node import Node

from ros2_stand_in.graph import looking, name_completer, node_names, shown, split
from ros2_stand_in.verbs import argument, discovery, verb, verbs


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    added = verbs(family)

    info = verb(added, "info", _info, "Output information about a node")
    discovery(info)
    argument(info, name_completer(node_names), "node_name", help="Node name to request information")
    info.add_argument("--include-hidden", action="store_true", help="Display hidden topics, services, and actions as well")

    listed = verb(added, "list", _list, "Output a list of available nodes")
    discovery(listed)
    listed.add_argument("-a", "--all", action="store_true", help="Display all nodes even hidden ones")
    listed.add_argument("-c", "--count-nodes", action="store_true", help="Only display the number of nodes discovered")


def _list(options: argparse.Namespace) -> None:
    with looking(options) as node:
        names = sorted(node_names(node, options.all))
    if options.count_nodes:
        print(len(names))
        return
    if len(set(names)) < len(names):
        print(
            "WARNING: Be aware that there are nodes in the graph that share an exact name, which can have unintended side effects.",
            file=sys.stderr,
        )
    for name in names:
        print(name)


def _info(options: argparse.Namespace) -> str | None:
    wanted = options.node_name
    with looking(options, lambda node: wanted in node_names(node, options.include_hidden)) as node:
        count = node_names(node, options.include_hidden).count(wanted)
        if count > 1:
            print(
                f'There are {count} nodes in the graph with the exact name "{wanted}". '
                "You are seeing information about only one of them.",
                file=sys.stderr,
            )
        if count == 0:
            return f"Unable to find node '{wanted}'"
        sections = _sections(node, *split(wanted))
    print(wanted)
    for title, names_and_types in sections:
        print(f"  {title}:")
        print(*(f"    {name}: {', '.join(types)}" for name, types in shown(names_and_types, options.include_hidden)), sep="\n")
    return None


def _sections(node: Node, name: str, namespace: str) -> list[tuple[str, list]]:
    return [
        ("Subscribers", node.get_subscriber_names_and_types_by_node(name, namespace)),
        ("Publishers", node.get_publisher_names_and_types_by_node(name, namespace)),
        ("Service Servers", node.get_service_names_and_types_by_node(name, namespace)),
        ("Service Clients", node.get_client_names_and_types_by_node(name, namespace)),
        ("Action Servers", actions.get_action_server_names_and_types_by_node(node, name, namespace)),
        ("Action Clients", actions.get_action_client_names_and_types_by_node(node, name, namespace)),
    ]
