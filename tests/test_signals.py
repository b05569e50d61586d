"""Executables at any moment of their start: a signal ends them, and none shows a traceback."""

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from system_rig import SCENARIOS

pytestmark = [pytest.mark.xdist_group("signals"), pytest.mark.timeout(300)]

PARAMETERS = {
    "driver": {"scenario": SCENARIOS / "paper-six.yaml"},
    "instrument_emulator": {"scenario": SCENARIOS / "paper-six.yaml", "port": 0},
    "viewer": {},
    "sequencer": {},
    "tracker_relay": {},
    "paths": {},
    "clicks": {},
    "mover": {},
    "planner": {},
}
PACKAGES = {
    "stressbot_driver": ("driver", "instrument_emulator", "viewer"),
    "stressbot_planner": ("sequencer", "tracker_relay", "mover", "planner", "paths", "clicks"),
}
MOMENTS = 6
EARLIEST, LATEST = 0.01, 4.0
"""s after the start; a node is up after 0.5 to 3 s, on a machine that is not busy."""


def start(package, executable, folder):
    """Start an installed executable as a shell would, its output in a file."""
    path = Path(get_package_prefix(package), "lib", package, executable)
    arguments = [item for name, value in PARAMETERS[executable].items() for item in ("-p", f"{name}:={value}")]
    log = folder / f"{executable}-{random.getrandbits(32):x}.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [path, "--ros-args", *arguments], stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, start_new_session=True,
            env=os.environ | {"ROS_LOG_DIR": str(folder)},
        )
    return process, log


def ended(process, number):
    """Return the exit code; ask again now and then, since Ctrl-C in the first milliseconds is ignored."""
    for _ in range(12):
        try:
            return process.wait(10.0)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, number)
    raise AssertionError("it does not end")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("package", "executable"), [(package, name) for package, names in PACKAGES.items() for name in names])
def test_a_signal_at_any_moment_ends_a_node_without_a_traceback(tmp_path, package, executable, number):
    moments = [EARLIEST * (LATEST / EARLIEST) ** random.random() for _ in range(MOMENTS)]
    running = []
    for moment in sorted(moments):
        running.append((time.monotonic() + moment, moment, *start(package, executable, tmp_path)))
    for due, _, process, _ in sorted(running, key=lambda entry: entry[0]):
        time.sleep(max(0.0, due - time.monotonic()))
        os.killpg(process.pid, number)  # as a terminal does
    for _, moment, process, log in running:
        code, text = ended(process, number), log.read_text(errors="replace")
        assert code in (0, -number), (moment, code, text)
        assert "Traceback" not in text and "Fatal" not in text, (moment, text)
