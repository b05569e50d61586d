"""`ros2 topic`: list, info, type; echo, hz and pub are in `streams`."""

import argparse

from ros2_stand_in import streams
from ros2_stand_in.graph import looking, name_completer, topics
from ros2_stand_in.verbs import argument, discovery, verb, verbs

TOPICS = name_completer(lambda node: [name for name, _ in topics(node)])


def add_arguments(family: argparse.ArgumentParser) -> None:
    """Add the verbs."""
    family.add_argument("--include-hidden-topics", action="store_true", help="Consider hidden topics as well")
    added = verbs(family)
    streams.add_echo(added, TOPICS)
    streams.add_hz(added, TOPICS)

    info = verb(added, "info", _info, "Print information about a topic")
    discovery(info)
    argument(info, TOPICS, "topic_name", help="Name of the ROS topic to get info (e.g. '/chatter')")
    info.add_argument(
        "--verbose", "-v", action="store_true",
        help="Prints detailed information like the node name, node namespace, topic type, topic type hash, GUID, and QoS Profile "
        "of the publishers and subscribers to this topic",
    )

    listed = verb(added, "list", _list, "Output a list of available topics")
    discovery(listed)
    listed.add_argument("-t", "--show-types", action="store_true", help="Additionally show the topic type")
    listed.add_argument("-c", "--count-topics", action="store_true", help="Only display the number of topics discovered")
    listed.add_argument("--include-hidden-topics", action="store_true", help="Consider hidden topics as well")
    listed.add_argument("-v", "--verbose", action="store_true", help="List full details about each topic")

    streams.add_pub(added, TOPICS)

    kind = verb(added, "type", _type, "Print a topic's type")
    discovery(kind)
    argument(kind, TOPICS, "topic_name", help="Name of the ROS topic to get type (e.g. '/chatter')")


def _list(options: argparse.Namespace) -> None:
    with looking(options) as node:
        found = topics(node, options.include_hidden_topics)
        counts = {name: (node.count_publishers(name), node.count_subscribers(name)) for name, _ in found}
    if options.count_topics:
        print(len(found))
    elif options.verbose and found:
        for number, (title, word) in enumerate((("Published", "publisher"), ("Subscribed", "subscriber"))):
            print(f"{title} topics:")
            for name, types in found:
                if count := counts[name][number]:
                    print(f" * {name} [{', '.join(types)}] {count} {word}{'s' if count > 1 else ''}")
            print()
    else:
        for name, types in found:
            print(f"{name} [{', '.join(types)}]" if options.show_types else name)


def _info(options: argparse.Namespace) -> str | None:
    wanted = options.topic_name
    with looking(options, lambda node: wanted in dict(topics(node, hidden=True))) as node:
        types = dict(topics(node, hidden=True)).get(wanted)
        if types is None:
            return f"Unknown topic '{wanted}'"
        end = "\n\n" if options.verbose else "\n"
        print(f"Type: {types[0] if len(types) == 1 else types}", end=end)
        print(f"Publisher count: {node.count_publishers(wanted)}", end=end)
        if options.verbose:
            for endpoint in node.get_publishers_info_by_topic(wanted):
                print(endpoint, end=end)
        print(f"Subscription count: {node.count_subscribers(wanted)}", end=end)
        if options.verbose:
            for endpoint in node.get_subscriptions_info_by_topic(wanted):
                print(endpoint, end=end)
    return None


def _type(options: argparse.Namespace) -> int:
    def types(node):
        return dict(topics(node, options.include_hidden_topics)).get(options.topic_name, [])

    with looking(options, types, at_once=True) as node:
        found = types(node)
    for name in found:
        print(name)
    return 0 if found else 1
