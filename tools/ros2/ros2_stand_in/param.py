"""`ros2 param`: list, get, set, describe, dump, load."""

import argparse
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
import yaml
from rcl_interfaces.msg import Parameter, ParameterType
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, parameter_dict_from_yaml_file, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from ros2_stand_in.graph import absolute, looking, name_completer, node_names
from ros2_stand_in.verbs import argument, discovery, verb, verbs

PATIENCE = 5.0
"""s for the parameter services of a node that is there"""

KINDS = {
    ParameterType.PARAMETER_BOOL: ("boolean", "Boolean value is:"),
    ParameterType.PARAMETER_INTEGER: ("integer", "Integer value is:"),
    ParameterType.PARAMETER_DOUBLE: ("double", "Double value is:"),
    ParameterType.PARAMETER_STRING: ("string", "String value is:"),
    ParameterType.PARAMETER_BYTE_ARRAY: ("byte array", "Byte values are:"),
    ParameterType.PARAMETER_BOOL_ARRAY: ("boolean array", "Boolean values are:"),
    ParameterType.PARAMETER_INTEGER_ARRAY: ("integer array", "Integer values are:"),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("double array", "Double values are:"),
    ParameterType.PARAMETER_STRING_ARRAY: ("string array", "String values are:"),
    ParameterType.PARAMETER_NOT_SET: ("not set", "Parameter not set."),
}


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    added = verbs(family)

    described = _verb(added, "describe", _describe, "Show descriptive information about declared parameters")
    argument(described, _complete_parameters, "parameter_names", nargs="+", help="Names of the parameters")

    _verb(added, "dump", _dump, "Show all of the parameters of a node in a YAML file format")

    get = _verb(added, "get", _get, "Get parameter")
    argument(get, _complete_parameters, "parameter_name", help="Name of the parameter")
    get.add_argument("--hide-type", action="store_true", help="Hide the type information")

    listed = _verb(added, "list", _list, "Output a list of available parameters", of_one_node=False)
    listed.add_argument(
        "--filter", nargs=1, help="Only parameters matching the regex expression will be showed. Supports `re` regex syntax."
    )
    listed.add_argument(
        "--param-prefixes", nargs="+", default=[], help="Only list parameters with the provided prefixes"
    )
    listed.add_argument("--param-type", action="store_true", help="Print parameter types with parameter names")

    load = _verb(added, "load", _load, "Load parameter file for a node")
    load.add_argument("parameter_file", help="Parameter file")
    load.add_argument(
        "--no-use-wildcard", action="store_true", help="Do not load parameters in the '/**' namespace into the node"
    )

    setter = _verb(added, "set", _set, "Set parameter")
    argument(setter, _complete_parameters, "parameter_name", help="Name of the parameter")
    setter.add_argument("value", help="Value of the parameter")


def _verb(added: Any, name: str, main: Any, text: str, of_one_node: bool = True) -> argparse.ArgumentParser:
    parser = verb(added, name, main, text)
    discovery(parser)
    argument(
        parser, name_completer(node_names), "node_name", nargs=None if of_one_node else "?", help="Name of the ROS node"
    )
    parser.add_argument("--include-hidden-nodes", action="store_true", help="Consider hidden nodes as well")
    if of_one_node:
        parser.add_argument(
            "--timeout", metavar="N", type=int, default=1,
            help="Wait for N seconds until node becomes available (default %(default)s sec)",
        )
    return parser


def _complete_parameters(prefix, parsed_args, **_):
    with looking(parsed_args, _is_there(absolute(parsed_args.node_name), hidden=True), at_once=True) as node:
        names = _names(_client(node, absolute(parsed_args.node_name)))
        return [name for name in names if name.startswith(prefix)]


# --- calls --------------------------------------------------------------------------------------------------------


class _NotFound(RuntimeError):
    def __init__(self) -> None:
        super().__init__("Node not found")


@contextmanager
def _parameters_of(options: argparse.Namespace) -> Iterator[AsyncParameterClient]:
    """Yield a client of the node that the command line names, once that is there."""
    name = absolute(options.node_name)
    is_there = _is_there(name, options.include_hidden_nodes)
    deadline = time.monotonic() + options.timeout
    with looking(options, is_there, at_once=True) as node:
        while not is_there(node) and time.monotonic() < deadline:
            time.sleep(0.02)
        if not is_there(node):
            raise _NotFound
        yield _client(node, name)


def _is_there(name: str, hidden: bool):
    return lambda node: name in node_names(node, hidden)


def _client(node: Node, name: str) -> AsyncParameterClient:
    client = AsyncParameterClient(node, name)
    if not client.wait_for_services(timeout_sec=PATIENCE):
        raise RuntimeError(f"Wait for service timed out waiting for parameter services for node {name}")
    return client


def _answer(client: AsyncParameterClient, future: Any) -> Any:
    rclpy.spin_until_future_complete(client.node, future)
    if future.result() is None:
        raise RuntimeError(f"Exception while calling service of node {client.remote_node_name}: {future.exception()}")
    return future.result()


def _names(client: AsyncParameterClient, prefixes: list[str] | None = None) -> list[str]:
    return sorted(_answer(client, client.list_parameters(prefixes=prefixes)).result.names)


# --- verbs --------------------------------------------------------------------------------------------------------


def _list(options: argparse.Namespace) -> str | None:
    wanted = options.node_name and absolute(options.node_name)
    pattern = re.compile(options.filter[0] if options.filter else "")
    is_there = _is_there(wanted, options.include_hidden_nodes) if wanted else None
    with looking(options, is_there, at_once=bool(wanted)) as node:
        names = node_names(node, options.include_hidden_nodes)
        if wanted and wanted not in names:
            return "Node not found"
        for name in [wanted] if wanted else sorted(names):
            try:
                client = _client(node, name)
            except RuntimeError as error:
                print(error)
                continue
            parameters = [parameter for parameter in _names(client, options.param_prefixes) if pattern.match(parameter)]
            kinds = {}
            if options.param_type:
                for descriptor in _answer(client, client.describe_parameters(parameters)).descriptors:
                    kinds[descriptor.name] = f" (type: {KINDS[descriptor.type][0]})"
            if not wanted and parameters:
                print(f"{name}:")
            for parameter in parameters:
                print(f"  {parameter}{kinds.get(parameter, '')}")
    return None


def _get(options: argparse.Namespace) -> str | None:
    with _parameters_of(options) as client:
        found = _answer(client, client.get_parameters([options.parameter_name])).values
    if not found:
        return "Parameter not set"
    value = parameter_value_to_python(found[0])
    label = KINDS[found[0].type][1]
    if options.hide_type:
        print(value)
    else:
        print(label, *([] if value is None else [value]))
    return None


def _set(options: argparse.Namespace) -> None:
    parameter = Parameter(name=options.parameter_name, value=get_parameter_value(string_value=options.value))
    with _parameters_of(options) as client:
        (result,) = _answer(client, client.set_parameters([parameter])).results
    text = "Set parameter successful" if result.successful else "Setting parameter failed"
    print(f"{text}: {result.reason}" if result.reason else text, file=sys.stdout if result.successful else sys.stderr)


def _describe(options: argparse.Namespace) -> None:
    with _parameters_of(options) as client:
        descriptors = _answer(client, client.describe_parameters(options.parameter_names)).descriptors
    for descriptor in descriptors:
        print("Parameter name:", descriptor.name)
        print("  Type:", KINDS[descriptor.type][0])
        if descriptor.description:
            print("  Description:", descriptor.description)
        print("  Constraints:")
        if descriptor.read_only:
            print("    Read only: true")
        for limits in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
            print("    Min value:", limits.from_value)
            print("    Max value:", limits.to_value)
            if limits.step:
                print("    Step:", limits.step)
        if descriptor.additional_constraints:
            print("    Additional constraints:", descriptor.additional_constraints)


def _dump(options: argparse.Namespace) -> None:
    with _parameters_of(options) as client:
        names = _names(client)
        found = _answer(client, client.get_parameters(names)).values
    tree: dict = {}
    for name, value in zip(names, found, strict=False):
        *branches, leaf = name.split(".")
        branch = tree
        for part in branches:
            branch = branch.setdefault(part, {})
        branch[leaf] = parameter_value_to_python(value)
    print(yaml.dump({absolute(options.node_name): {"ros__parameters": tree}}, default_flow_style=False))


def _load(options: argparse.Namespace) -> None:
    use_wildcard = not options.no_use_wildcard
    with _parameters_of(options) as client:
        try:
            parameters = parameter_dict_from_yaml_file(options.parameter_file, use_wildcard)
        except (OSError, yaml.YAMLError, RuntimeError) as error:
            raise RuntimeError(f"{options.parameter_file} cannot be loaded: {error}") from None
        results = _answer(client, client.load_parameter_file(options.parameter_file, use_wildcard)).results
    for name, result in zip(parameters, results, strict=True):
        text = f"Set parameter {name} {'successful' if result.successful else 'failed'}"
        print(f"{text}: {result.reason}" if result.reason else text, file=sys.stdout if result.successful else sys.stderr)
