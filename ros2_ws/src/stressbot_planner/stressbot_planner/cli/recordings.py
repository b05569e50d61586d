"""`stressbot record` and `stressbot replay`: what is said on topics, into a file and back."""

import argparse
import time
from pathlib import Path

from stressbot_planner.system import files


def record(options: argparse.Namespace) -> int:
    """Record until Ctrl-C."""
    output = options.output or Path(time.strftime("recording-%Y%m%d-%H%M%S.mcap"))
    files.check_output(output)
    from stressbot_planner.ros import recorder_node

    return recorder_node.record(str(output), options.topics, [])


def replay(options: argparse.Namespace) -> int:
    """Replay a whole file."""
    from stressbot_planner.ros import replay as player

    return player.replay(options.recording, options.topics, options.rate)
