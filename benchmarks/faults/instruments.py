"""An instrument is lost, its driver is killed, or its record cannot be written."""

import re
import resource
import time

import numpy as np
from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.drivers import restarted_driver
from faults.settings import instrument, start_emulator
from faults.stage import Outcome, Stage

LONGEST_EPOCH = 2.0
"""s; see `Stage.running`."""

SLACK = 0.15
"""s, of what this process knows of the moment in the sequence: poses come every 0.02 s, status every 0.1 s."""


def recording_disk_full(stage: Stage) -> Outcome:
    """The record of what is sent to the instrument may not grow any more: a write fails as on a full disk."""
    stage.running()
    record = max(stage.folder.glob("instrument-*.jsonl"), key=lambda path: path.stat().st_mtime)
    pid, before = stage.pid("driver"), resource.prlimit(stage.pid("driver"), resource.RLIMIT_FSIZE)
    since = time.monotonic()
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (record.stat().st_size, before[1]))
    zero, status = stage.at_rest(since, DriverStatus.FAULT, ErrorCode.BACKEND_FAILURE)
    assert "cannot be written" in status.error_msg
    resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
    seen = re.sub(r"/\S*/", "", status.error_msg)
    return Outcome(f"{seen} (after the epoch that ran, {zero:.1f} s)", None, "FAULT BACKEND_FAILURE", stage.recover())


def driver_killed_at_an_instrument(stage: Stage) -> Outcome:
    """The robots must lie still by the end of the epoch that runs: nobody is there any more to trigger the next."""
    stage.running()
    since = stage.kill("driver")
    heard, status = stage.heard[-1]
    reached = status.sequence_time + since - heard
    sequence = stage.system.client.sequence
    ends = np.cumsum(sequence.dwells)[np.asarray(sequence.epoch_ends) - 1]
    left = ends[np.searchsorted(ends, reached)] - reached
    stage.until(lambda: time.monotonic() - max(stage.moved, since) > LONGEST_EPOCH, "rest")
    still = max(stage.moved - since, 0.0)
    assert still < left + SLACK, f"robots moved for {still:.2f} s, the epoch ended after {left:.2f} s"
    return Outcome(
        f"driver_status falls silent; the generator plays its epoch to the end ({left:.2f} s), robots still after {still:.2f} s",
        None,
        "none; the generator waits at rest for a trigger",
        restarted_driver(stage),
    )


def instrument_killed(stage: Stage) -> Outcome:
    stage.running()
    stage.kill("instrument_emulator")
    stage.until(lambda: stage.status.state == DriverStatus.FAULT, "the fault")
    message = stage.status.error_msg
    assert "THE OUTPUT MAY BE ON" in message and not stage.call("reset").success
    start_emulator(stage.system, stage.folder, stage.port)
    return Outcome(message, None, "FAULT BACKEND_FAILURE", f"instrument restarted, {stage.recover()}")


FAULTS = {
    "instrument: disk full while recording": (instrument, recording_disk_full),
    "instrument: driver kill -9": (instrument, driver_killed_at_an_instrument),
    "instrument: kill -9": (instrument, instrument_killed),
}
