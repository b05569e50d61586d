"""An instrument is lost, its driver is killed, or its record cannot be written."""

import json
import os
import re
import resource
import signal
import socket
import time
from collections.abc import Callable

from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.drivers import restarted_driver
from faults.settings import instrument, start_emulator
from faults.stage import Outcome, Stage


def recording_disk_full(stage: Stage) -> Outcome:
    """The record of what is sent to the instrument may not grow any more: a write fails as on a full disk."""
    stage.running()
    record = max(stage.folder.glob("instrument-*.jsonl"), key=lambda path: path.stat().st_mtime)
    (pid,) = stage.children("driver")
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    since = time.monotonic()
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (record.stat().st_size, before[1]))
    zero, status = stage.at_rest(since, DriverStatus.FAULT, ErrorCode.BACKEND_FAILURE)
    assert "cannot be written" in status.error_msg
    resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
    seen = re.sub(r"/\S*/", "", status.error_msg)
    return Outcome(f"{seen} (after the epoch that ran, {zero:.1f} s)", None, "FAULT BACKEND_FAILURE", stage.recover())


def driver_killed_at_an_instrument(stage: Stage) -> Outcome:
    """The instrument itself is asked whether its output is on."""
    stage.running()
    with Output(stage.port) as output:
        stage.until(output.is_on, "volts")
        since = stage.kill("driver")
        zero = stage.until(lambda: not output.is_on() and time.monotonic() - since, "the output off")
    return Outcome("driver_status falls silent", zero, "none; the output is off", restarted_driver(stage))


def gate_killed_at_an_instrument(stage: Stage) -> Outcome:
    """The driver starts another gate, whose opening switches the output off; until then the epoch goes on."""
    stage.running()
    (gate,) = stage.children("driver")
    with Output(stage.port) as output:
        stage.until(output.is_on, "volts")
        since = time.monotonic()
        os.kill(gate, signal.SIGKILL)
        off = stage.until(lambda: not output.is_on() and time.monotonic() - since, "the output off")
    stage.at_rest(since, DriverStatus.FAULT, ErrorCode.BACKEND_FAILURE)
    return Outcome(f"the output is off after {off:.1f} s", None, "FAULT BACKEND_FAILURE", stage.recover())


def sequencer_lost_at_an_instrument(stage: Stage) -> Outcome:
    stage.running()
    with Output(stage.port) as output:
        stage.until(output.is_on, "volts")
        since = stage.kill("sequencer")
        zero = stage.until(lambda: not output.is_on() and time.monotonic() - since, "the output off")
    status = stage.first(lambda s: s.state == DriverStatus.FAULT, since, "the fault")[1]
    assert status.error_code == ErrorCode.PEER_LOST, status.error_msg
    stage.start("sequencer")
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"sequencer restarted, {stage.recover()}")


def switched_on_at_rest(stage: Stage) -> Outcome:
    """Another client selects what was played last and switches the output on."""
    stage.recover()
    record = max(stage.folder.glob("instrument-*.jsonl"), key=lambda path: path.stat().st_mtime)
    sent = [json.loads(line).get("sent", "") for line in record.read_text().splitlines()]
    with Output(stage.port) as output:
        for command in (line for line in sent if line.startswith("SOUR1:FUNC") and not line.endswith("?")):
            output.send(command)
        since = time.monotonic()
        output.send("OUTP1 ON")
        status = stage.first(lambda s: s.state == DriverStatus.FAULT, since, "the fault")[1]  # it may be off before we look
        zero = stage.until(lambda: not output.is_on() and time.monotonic() - since, "the output off")
    assert status.error_code == ErrorCode.BACKEND_FAILURE, status.error_msg
    return Outcome(status.error_msg, zero, "FAULT BACKEND_FAILURE", stage.recover())


def another_client(command: str) -> Callable[[Stage], Outcome]:
    """Somebody else sends a command to the same instrument: what differs from what was set is a fault, by the next block."""

    def fault(stage: Stage) -> Outcome:
        stage.running()
        with Output(stage.port) as output:
            since = time.monotonic()
            output.send(command)
            status = stage.first(lambda s: s.state == DriverStatus.FAULT, since, "the fault")[1]
            assert status.error_code == ErrorCode.BACKEND_FAILURE, status.error_msg
            zero = stage.until(lambda: not output.is_on() and time.monotonic() - since, "the output off")
        return Outcome(f"{status.error_msg} (off after {zero:.1f} s)", None, "FAULT BACKEND_FAILURE", stage.recover())

    return fault


class Output:
    """Asks an instrument over a connection of its own."""

    def __init__(self, port: str) -> None:
        self._connection = socket.create_connection(("127.0.0.1", int(port)))
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> "Output":
        return self

    def __exit__(self, *_error: object) -> None:
        self._connection.close()

    def send(self, command: str) -> None:
        self._connection.sendall(f"{command}\n".encode())

    def is_on(self) -> bool:
        self._connection.sendall(b"OUTP1?\n")
        return self._connection.recv(64).strip() == b"1"


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
    "instrument: gate kill -9": (instrument, gate_killed_at_an_instrument),
    "instrument: kill -9": (instrument, instrument_killed),
    "instrument: sequencer kill -9": (instrument, sequencer_lost_at_an_instrument),
    "instrument: another client switches on at rest": (instrument, switched_on_at_rest),
    "instrument: another client changes the offset": (instrument, another_client("SOUR1:VOLT:OFFS 1")),
    "instrument: another client changes the byte order": (instrument, another_client("FORM:BORD NORM")),
}
