"""`ros2 action`: list, info, send_goal."""

import argparse
from typing import Any

import rclpy
import yaml
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action import graph as actions
from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name

from ros2_stand_in import fields, interfaces
from ros2_stand_in.graph import PREFIX, looking, name_completer, own
from ros2_stand_in.verbs import argument, given, values, verb, verbs

ACTIONS = name_completer(lambda node: [name for name, _ in actions.get_action_names_and_types(node)])
STATES = {
    GoalStatus.STATUS_ACCEPTED: "ACCEPTED",
    GoalStatus.STATUS_EXECUTING: "EXECUTING",
    GoalStatus.STATUS_CANCELING: "CANCELING",
    GoalStatus.STATUS_SUCCEEDED: "SUCCEEDED",
    GoalStatus.STATUS_CANCELED: "CANCELED",
    GoalStatus.STATUS_ABORTED: "ABORTED",
}


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    added = verbs(family)

    info = verb(added, "info", _info, "Print information about an action")
    argument(info, ACTIONS, "action_name", help="Name of the ROS action to get info (e.g. '/fibonacci')")
    info.add_argument("-t", "--show-types", action="store_true", help="Additionally show the action type")
    info.add_argument(
        "-c", "--count", action="store_true", help="Only display the number of action clients and action servers"
    )

    listed = verb(added, "list", _list, "Output a list of action names")
    listed.add_argument("-t", "--show-types", action="store_true", help="Additionally show the action type")
    listed.add_argument("-c", "--count-actions", action="store_true", help="Only display the number of actions discovered")

    send = verb(added, "send_goal", _send_goal, "Send an action goal")
    argument(send, ACTIONS, "action_name", help="Name of the ROS action (e.g. '/fibonacci')")
    argument(
        send, interfaces.type_completer("action"), "action_type",
        help="Type of the ROS action (e.g. 'example_interfaces/action/Fibonacci')",
    )
    values(
        send, "goal", "Goal request values in YAML format (e.g. '{order: 10}')",
        lambda parsed_args, **_: [fields.to_yaml(interfaces.load(parsed_args.action_type, "action").Goal())],
    )
    send.add_argument("-f", "--feedback", action="store_true", help="Echo feedback messages for the goal")


def _list(options: argparse.Namespace) -> None:
    with looking(options) as node:
        found = actions.get_action_names_and_types(node)
    if options.count_actions:
        print(len(found))
        return
    for name, types in found:
        print(f"{name} [{', '.join(types)}]" if options.show_types else name)


def _info(options: argparse.Namespace) -> None:
    clients, servers = [], []
    with looking(options, lambda node: options.action_name in dict(actions.get_action_names_and_types(node))) as node:
        try:
            wanted = expand_topic_name(options.action_name, node.get_name(), node.get_namespace())
            validate_full_topic_name(wanted)
        except (ValueError, InvalidTopicNameException) as error:
            raise RuntimeError(error) from error
        for name, namespace in node.get_node_names_and_namespaces():
            full = namespace.rstrip("/") + "/" + name
            of_clients = actions.get_action_client_names_and_types_by_node(node, name, namespace)
            of_servers = actions.get_action_server_names_and_types_by_node(node, name, namespace)
            clients += [(full, types) for action, types in of_clients if action == wanted]
            servers += [(full, types) for action, types in of_servers if action == wanted]
    print(f"Action: {options.action_name}")
    for title, found in (("clients", clients), ("servers", servers)):
        print(f"Action {title}: {len(found)}")
        for name, types in [] if options.count else found:
            print(f"    {name} [{', '.join(types)}]" if options.show_types else f"    {name}")


def _send_goal(options: argparse.Namespace) -> str | None:
    try:
        kind = interfaces.load(options.action_type, "action")
    except LookupError:
        raise RuntimeError("The passed action type is invalid") from None
    goal = kind.Goal()
    try:
        fields.fill(goal, yaml.safe_load(given(options, "goal")))
    except Exception as error:
        return f"Failed to populate message fields: {error!r}"
    with own(f"{PREFIX}_send_goal_{options.action_type.replace('/', '_')}", outlives_ctrl_c=True) as node:
        client = ActionClient(node, kind, options.action_name)
        handle = None
        try:
            print("Waiting for an action server to become available...")
            client.wait_for_server()
            print(f"Sending goal:\n     {fields.to_yaml(goal)}")
            handle = _answer(node, client.send_goal_async(goal, _print_feedback if options.feedback else None), "sending goal")
            if not handle.accepted:
                print("Goal was rejected.")
                return None
            print(f"Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n")
            answer = _answer(node, handle.get_result_async(), "getting result")
            print(f"Result:\n    {fields.to_yaml(answer.result)}")
            print(f"Goal finished with status: {STATES.get(answer.status, 'UNKNOWN')}")
            handle = None
        finally:
            if handle is not None and handle.accepted:
                _cancel(node, handle)
            client.destroy()
    return None


def _cancel(node: Any, handle: Any) -> None:
    if handle.status in (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED):
        return
    print("Canceling goal...")
    answer = _answer(node, handle.cancel_goal_async(), "canceling goal")
    if not answer.goals_canceling:
        raise RuntimeError("Failed to cancel goal")
    print("Goal canceled.")


SLICE = 0.1
"""s"""


def _answer(node: Any, future: Any, what: str) -> Any:
    while not future.done():  # in slices: without rclpy's handler, Ctrl-C is seen between them
        rclpy.spin_until_future_complete(node, future, timeout_sec=SLICE)
    if future.result() is None:
        raise RuntimeError(f"Exception while {what}: {future.exception()!r}")
    return future.result()


def _print_feedback(feedback: Any) -> None:
    print(f"Feedback:\n    {fields.to_yaml(feedback.feedback)}")
