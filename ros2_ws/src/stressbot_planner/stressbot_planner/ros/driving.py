"""What commands that drive robots have in common: whatever ends them early stops the driver."""

import signal
from collections.abc import Callable

from stressbot_planner.ros.client import ALL_POSES, SwarmClient, command_client
from stressbot_planner.ros.remote_bench import stop
from stressbot_planner.system import streams


def driving(name: str, drive: Callable[[SwarmClient], int]) -> int:
    """Call `drive` with the topics and services, and return its exit code, or FAILED if it waits for something in vain.

    Args:
        name: of the command.
        drive: raises TimeoutError with what it has waited for; whatever it raises, and SIGINT and SIGTERM, stop the driver.
    """

    def interrupt(*_):
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    try:
        with command_client(name, poses_depth=ALL_POSES) as client:
            try:
                return drive(client)
            except BaseException:
                stop(client)
                raise
    except TimeoutError as error:
        streams.complain(name, str(error))
        return streams.FAILED
