"""`ros2 topic echo`, `hz` and `pub`: what goes on until it is ended."""

import argparse
import math
import time
from collections import deque
from typing import Any

import rclpy
import yaml
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future
from rclpy.validate_full_topic_name import validate_full_topic_name

from ros2_stand_in import fields, interfaces, qos
from ros2_stand_in.graph import looking, topics
from ros2_stand_in.verbs import argument, direct_node, discovery, given, positive, positive_whole, values, verb, whole

TRUNCATED = 128


def add_echo(added: Any, completer: Any) -> None:
    """Add the verb echo."""
    echo = verb(added, "echo", _echo, "Output messages from a topic")
    discovery(echo)
    argument(echo, completer, "topic_name", help="Name of the ROS topic to listen to (e.g. '/chatter')")
    argument(
        echo, interfaces.type_completer("msg"), "message_type", nargs="?",
        help="Type of the ROS message (e.g. 'std_msgs/msg/String')",
    )
    qos.add_arguments(echo, "subscribe", "sensor_data")
    echo.add_argument(
        "--csv", action="store_true",
        help="Output all recursive fields separated by commas (e.g. for plotting). If --include-message-info is also passed, the "
        "following fields are prepended: source_timestamp, received_timestamp, publication_sequence_number, "
        "reception_sequence_number.",
    )
    echo.add_argument("--field", help="Echo a selected field of a message. Use '.' to select sub-fields.")
    echo.add_argument(
        "--full-length", "-f", action="store_true",
        help="Output all elements for arrays, bytes, and string with a length > '--truncate-length', by default they are truncated "
        "after '--truncate-length' elements with '...'",
    )
    echo.add_argument(
        "--truncate-length", "-l", type=whole, default=TRUNCATED,
        help="The length to truncate arrays, bytes, and string to (default: %(default)s)",
    )
    echo.add_argument("--no-arr", action="store_true", help="Don't print array fields of messages")
    echo.add_argument("--no-str", action="store_true", help="Don't print string fields of messages")
    echo.add_argument("--flow-style", action="store_true", help="Print collections in the flow style (not with --csv)")
    echo.add_argument("--no-lost-messages", action="store_true", help="Don't report when a message is lost")
    echo.add_argument("--raw", action="store_true", help="Echo the raw binary representation")
    echo.add_argument(
        "--filter", dest="filter_expr",
        help="Python expression to filter messages that are printed. Expression can use Python builtins as well as m (the "
        "message).",
    )
    echo.add_argument("--once", action="store_true", help="Print the first message received and then exit.")
    echo.add_argument("--timeout", metavar="N", type=positive, help="Set a timeout in seconds for waiting")
    echo.add_argument("--include-message-info", "-i", action="store_true", help="Shows the associated message info.")


def add_hz(added: Any, completer: Any) -> None:
    """Add the verb hz."""
    hz = verb(added, "hz", _hz, "Print the average publishing rate to screen")
    argument(hz, completer, "topic_name", help="Name of the ROS topic to listen to (e.g. '/chatter')")
    hz.add_argument(
        "--window", "-w", dest="window_size", type=positive_whole, default=10000, metavar="WINDOW",
        help="window size, in # of messages, for calculating rate (default: %(default)s)",
    )
    hz.add_argument(
        "--filter", dest="filter_expr", metavar="EXPR", help="only measure messages matching the specified Python expression"
    )
    hz.add_argument(
        "--wall-time", dest="use_wtime", action="store_true",
        help="calculates rate using wall time which can be helpful when clock is not published during simulation",
    )
    direct_node(hz)


def add_pub(added: Any, completer: Any) -> None:
    """Add the verb pub."""
    pub = verb(added, "pub", _pub, "Publish a message to a topic")
    argument(pub, completer, "topic_name", help="Name of the ROS topic to publish to (e.g. '/chatter')")
    argument(
        pub, interfaces.type_completer("msg"), "message_type", help="Type of the ROS message (e.g. 'std_msgs/String')"
    )
    values(
        pub, "values",
        "Values to fill the message with in YAML format (e.g. 'data: Hello World'), otherwise the message will be published with "
        "default values",
        lambda parsed_args, **_: [fields.to_yaml(interfaces.load(parsed_args.message_type, "msg")())],
    )
    pub.add_argument(
        "-r", "--rate", metavar="N", type=positive, default=1.0, help="Publishing rate in Hz (default: %(default)g)"
    )
    pub.add_argument(
        "-p", "--print", metavar="N", type=int, default=1, help="Only print every N-th published message (default: %(default)s)"
    )
    group = pub.add_mutually_exclusive_group()
    group.add_argument("-1", "--once", action="store_true", help="Publish one message and exit")
    group.add_argument("-t", "--times", type=whole, default=0, help="Publish this number of times and then exit")
    pub.add_argument(
        "-w", "--wait-matching-subscriptions", type=whole,
        help='Wait until finding the specified number of matching subscriptions. Defaults to 1 when using "-1"/"--once"/"--times", '
        "otherwise defaults to 0.",
    )
    pub.add_argument(
        "--max-wait-time-secs", type=positive,
        help="This sets the maximum wait time in seconds if --wait-until-matching-subscriptions is set. By default, this flag is "
        "not set meaning the subscriber will wait endlessly.",
    )
    pub.add_argument(
        "--keep-alive", metavar="N", type=positive, default=0.1,
        help="Keep publishing node alive for N seconds after the last msg (default: %(default)s)",
    )
    pub.add_argument("-n", "--node-name", help="Name of the created publishing node")
    qos.add_arguments(pub, "publish", "default")
    direct_node(pub)


def _type_of(node: Node, topic: str) -> type | None:
    """Return the type of a topic; None if nobody has it."""
    try:
        name = expand_topic_name(topic, node.get_name(), node.get_namespace())
        validate_full_topic_name(name)
    except (ValueError, InvalidTopicNameException) as error:
        raise RuntimeError(error) from error
    types = dict(topics(node, hidden=True)).get(name)
    if types is None:
        return None
    if len(types) > 1:
        raise RuntimeError(f"Cannot echo topic '{topic}', as it contains more than one type: [{', '.join(types)}]")
    try:
        return interfaces.load(types[0], "msg")
    except LookupError:
        raise RuntimeError(f"The message type '{types[0]}' is invalid") from None


def _filter(expression: str | None):
    return (lambda m: eval(expression, {}, {"m": m})) if expression else None


# --- echo ---------------------------------------------------------------------------------------------------------


def _echo(options: argparse.Namespace) -> None:
    path = [] if options.field is None else [part for part in options.field.split(".") if part]
    if options.field is not None and not path:
        raise RuntimeError(f"Invalid field value '{options.field}'")
    chosen = None
    if options.message_type is not None:
        try:
            chosen = interfaces.load(options.message_type, "msg")
        except LookupError:
            raise RuntimeError("The passed message type is invalid") from None
    limits = fields.Limits(None if options.full_length else options.truncate_length, options.no_arr, options.no_str)
    is_wanted = _filter(options.filter_expr)
    end = Future() if options.once or options.timeout else None

    def heard(message: Any, info: dict) -> None:
        for part in path:
            try:
                message = getattr(message, part)
            except AttributeError as error:
                raise RuntimeError(f"Invalid field '{'.'.join(path)}': {error}") from error
        if is_wanted is not None and not is_wanted(message):
            return
        if options.once:
            end.set_result(True)
        _print_message(message, info, options, limits)

    with looking(options, lambda node: chosen or _type_of(node, options.topic_name)) as node:
        profile = qos.profile_to_hear(node, options.topic_name, options)
        chosen = chosen or _type_of(node, options.topic_name)
        if chosen is None:
            print(f"WARNING: topic [{options.topic_name}] does not appear to be published yet")
            raise RuntimeError("Could not determine the type for the passed topic")
        if options.timeout is not None:
            node.create_timer(options.timeout, lambda: end.set_result(True))
        events = None if options.no_lost_messages else SubscriptionEventCallbacks(message_lost=_print_lost)
        node.create_subscription(chosen, options.topic_name, heard, profile, event_callbacks=events, raw=options.raw)
        if end is None:
            rclpy.spin(node)
        else:
            rclpy.spin_until_future_complete(node, end)


def _print_message(message: Any, info: dict, options: argparse.Namespace, limits: fields.Limits) -> None:
    if not hasattr(message, "__slots__"):
        if options.include_message_info:
            print("---Got new message, message info:---")
            print(info)
            print("---Message data:---")
        print(message, end="\n---\n")
    elif options.csv:
        line = fields.to_csv(message, limits)
        print(f"{','.join(map(str, info.values()))},{line}" if options.include_message_info else line)
    else:
        if options.include_message_info:
            print(yaml.dump(info), end="---\n")
        print(fields.to_yaml(message, limits, options.flow_style), end="---\n")


def _print_lost(status: Any) -> None:
    print(
        f"A message was lost!!!\n\ttotal count change:{status.total_count_change}\n\ttotal count: {status.total_count}", end="---\n"
    )


# --- hz -----------------------------------------------------------------------------------------------------------


class _Rate:
    """Intervals between messages, ns, and what they are like, once a second."""

    def __init__(self, window: int):
        self._intervals: deque[int] = deque(maxlen=window)
        self._last = self._said = 0

    def came(self, now: int) -> None:
        if self._last > now:
            self._intervals.clear()
        elif self._last:
            self._intervals.append(now - self._last)
        self._last = now

    def line(self) -> str | None:
        """Return what to print, if it is time."""
        if not self._intervals:
            return None
        if not self._said:
            self._said = self._last
            return None
        if self._last < self._said + 1e9:
            return None
        self._said = self._last
        count = len(self._intervals)
        mean = sum(self._intervals) / count
        deviation = math.sqrt(sum((interval - mean) ** 2 for interval in self._intervals) / count)
        return (
            f"average rate: {1e9 / mean if mean else 0.0:.3f}\n\tmin: {min(self._intervals) * 1e-9:.3f}s "
            f"max: {max(self._intervals) * 1e-9:.3f}s std dev: {deviation * 1e-9:.5f}s window: {count}"
        )


def _hz(options: argparse.Namespace) -> None:
    is_wanted = _filter(options.filter_expr)
    rate = _Rate(options.window_size)
    with looking(options, lambda node: _type_of(node, options.topic_name), at_once=True) as node:
        chosen = _type_of(node, options.topic_name)
        if chosen is None:
            print(f"WARNING: topic [{options.topic_name}] does not appear to be published yet")
        while chosen is None:
            time.sleep(0.1)
            chosen = _type_of(node, options.topic_name)
        clock = Clock(clock_type=ClockType.SYSTEM_TIME) if options.use_wtime else node.get_clock()

        def heard(message: Any) -> None:
            if is_wanted is not None and not is_wanted(message):
                return
            rate.came(clock.now().nanoseconds)

        node.create_subscription(chosen, options.topic_name, heard, qos_profile_sensor_data, raw=is_wanted is None)
        while rclpy.ok():
            rclpy.spin_once(node)
            if line := rate.line():
                print(line)


# --- pub ----------------------------------------------------------------------------------------------------------


def _pub(options: argparse.Namespace) -> str | None:
    times = 1 if options.once else options.times
    text = given(options, "values")
    wanted = options.wait_matching_subscriptions
    wanted = int(times != 0) if wanted is None else wanted
    try:
        message = interfaces.load(options.message_type, "msg")()
    except LookupError:
        raise RuntimeError("The passed message type is invalid") from None
    given_values = yaml.safe_load(text)
    if not isinstance(given_values, dict):
        return "The passed value needs to be a dictionary in YAML format"
    if wanted == 0 and options.max_wait_time_secs is not None:
        return "--max-wait-time-secs option is only effective with --wait-matching-subscriptions, --once or --times"
    # No wait for discovery: those who should hear it are waited for, or nobody.
    with looking(options, lambda node: True, at_once=True, name=options.node_name) as node:
        publisher = node.create_publisher(type(message), options.topic_name, qos.profile(options))
        if problem := _wait_for_subscriptions(publisher, wanted, options.max_wait_time_secs):
            return problem
        try:
            stamps = fields.fill(message, given_values, now=True)
        except Exception as error:
            return f"Failed to populate field: {error}"
        print("publisher: beginning loop")
        count = 0

        def publish() -> None:
            nonlocal count
            for stamp in stamps:
                stamp(node.get_clock().now().to_msg())
            count += 1
            if options.print and count % options.print == 0:
                print(f"publishing #{count}: {message!r}\n")
            publisher.publish(message)

        publish()
        if times != 1:
            timer = node.create_timer(1.0 / options.rate, publish)
            while times == 0 or count < times:
                rclpy.spin_once(node)
            timer.cancel()
        time.sleep(options.keep_alive)
    return None


def _wait_for_subscriptions(publisher: Any, wanted: int, longest: float | None) -> str | None:
    begin = time.monotonic()
    waits = 0
    while (present := publisher.get_subscription_count()) < wanted:
        if waits % 10 == 0:
            print(f"Waiting for at least {wanted} matching subscription(s)...")
        if longest is not None and time.monotonic() - begin >= longest:
            return f"Timed out waiting for subscribers: Expected {wanted} subcribers but only got {present} subscribers"
        waits += 1
        time.sleep(0.1)
    return None
