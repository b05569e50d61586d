"""`stressbot record` and `stressbot replay`: what is said on topics, into a file and back."""

import argparse
import time
from pathlib import Path

from stressbot_planner.cli.arguments import not_negative
from stressbot_planner.cli.printing import print_json
from stressbot_planner.system import files


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `record`."""
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help="topic to record (default: all)")
    parser.add_argument(
        "--output", type=Path, metavar="X.mcap",
        help="file that is not there yet (default: recording-DATE-TIME.mcap)",
    )


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `replay`."""
    parser.add_argument("recording", type=Path, metavar="X.mcap", help="recording")
    parser.add_argument(
        "topics", nargs="*", metavar="TOPIC", help="topic to replay (default: all but hidden ones and those of ROS)"
    )
    parser.add_argument(
        "--rate", type=not_negative, default=1.0, metavar="F",
        help="recorded seconds per second; 0: as fast as possible (default: %(default)g)",
    )


def record(options: argparse.Namespace) -> int:
    """Record until Ctrl-C."""
    output = options.output or Path(time.strftime("recording-%Y%m%d-%H%M%S.mcap"))
    files.check_output(output)
    from stressbot_planner.ros import recorder_node

    code = recorder_node.record(str(output), options.topics, [])
    if options.json:
        print_json({"success": not code, "written": str(output)})
    return code


def replay(options: argparse.Namespace) -> int:
    """Replay a whole file."""
    from stressbot_planner.ros import replay as player

    code = player.replay(options.recording, options.topics, options.rate)
    if options.json:
        print_json({"success": not code, "replayed": str(options.recording)})
    return code
