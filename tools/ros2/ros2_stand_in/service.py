"""`ros2 service`: list, type, call."""

import argparse
import time

import rclpy
import yaml

from ros2_stand_in import fields, interfaces
from ros2_stand_in.graph import PREFIX, looking, name_completer, own, services
from ros2_stand_in.verbs import argument, discovery, given, values, verb, verbs

SERVICES = name_completer(lambda node: [name for name, _ in services(node)])


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    family.add_argument("--include-hidden-services", action="store_true", help="Consider hidden services as well")
    added = verbs(family)

    call = verb(added, "call", _call, "Call a service")
    argument(call, SERVICES, "service_name", help="Name of the ROS service to call to (e.g. '/add_two_ints')")
    argument(
        call, interfaces.type_completer("srv"), "service_type", help="Type of the ROS service (e.g. 'std_srvs/srv/Empty')"
    )
    values(
        call, "values",
        "Values to fill the service request with in YAML format (e.g. '{a: 1, b: 2}'), otherwise the service request will be "
        "published with default values",
        lambda parsed_args, **_: [fields.to_yaml(interfaces.load(parsed_args.service_type, "srv").Request())],
    )
    call.add_argument("-r", "--rate", metavar="N", type=float, help="Repeat the call at a specific rate in Hz")

    listed = verb(added, "list", _list, "Output a list of available services")
    discovery(listed)
    listed.add_argument("-t", "--show-types", action="store_true", help="Additionally show the service type")
    listed.add_argument("-c", "--count-services", action="store_true", help="Only display the number of services discovered")
    listed.add_argument("--include-hidden-services", action="store_true", help="Consider hidden services as well")

    kind = verb(added, "type", _type, "Output a service's type")
    argument(kind, SERVICES, "service_name", help="Name of the ROS service to get type (e.g. '/talker/list_parameters')")


def _list(options: argparse.Namespace) -> None:
    with looking(options) as node:
        found = services(node, options.include_hidden_services)
    if options.count_services:
        print(len(found))
        return
    for name, types in found:
        print(f"{name} [{', '.join(types)}]" if options.show_types else name)


def _type(options: argparse.Namespace) -> int:
    def types(node):
        return dict(services(node, options.include_hidden_services)).get(options.service_name, [])

    with looking(options, types, at_once=True) as node:
        found = types(node)
    for name in found:
        print(name)
    return 0 if found else 1


def _call(options: argparse.Namespace) -> str | None:
    if options.rate is not None and options.rate <= 0:
        raise RuntimeError("rate must be greater than zero")
    try:
        kind = interfaces.load(options.service_type, "srv")
    except interfaces.OtherKind:
        raise RuntimeError("The passed type is not a service") from None
    except LookupError:
        raise RuntimeError("The passed service type is invalid") from None
    request = kind.Request()
    try:
        fields.fill(request, yaml.safe_load(given(options, "values")))
    except Exception as error:
        return f"Failed to populate field: {error}"
    parts = options.service_type.split("/")
    with own(f"{PREFIX}_requester_{parts[0]}_{parts[-1]}") as node:
        client = node.create_client(kind, options.service_name)
        if not client.service_is_ready():
            print("waiting for service to become available...")
            client.wait_for_service()
        while True:
            print(f"requester: making request: {request!r}\n")
            begin = time.monotonic()
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future)
            if future.result() is None:
                raise RuntimeError(f"Exception while calling service: {future.exception()!r}")
            print(f"response:\n{future.result()!r}\n")
            if options.rate is None or not rclpy.ok():
                return None
            time.sleep(max(0.0, begin + 1.0 / options.rate - time.monotonic()))
