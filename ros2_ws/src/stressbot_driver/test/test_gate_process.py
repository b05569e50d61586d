"""The gate as a process: what becomes of volts when the driver, its terminal or the gate itself does not go on."""

import fcntl
import os
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from driver_support import DEADLINE, Recorder, bench, encode, scenario_text, sequence
from gate_support import Beating, Watch
from node_rig import NodeRig
from stressbot_msgs.msg import DriverStatus, ErrorCode

from stressbot_driver.backends.base import Pacing, backend_class
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.errors import StressbotError
from stressbot_driver.gate import claim
from stressbot_driver.gate import client as client_module
from stressbot_driver.gate.client import GateClient
from stressbot_driver.simulation.imperfections import Imperfections

pytestmark = pytest.mark.xdist_group("driver_processes")
PATIENT = 2.0  # [s] of gate_timeout: a busy machine is no reason for a test to fail


@pytest.fixture
def watch(tmp_path, monkeypatch):
    watch = Watch(tmp_path)
    for name, value in watch.environment.items():
        monkeypatch.setenv(name, value)
    return watch


@pytest.fixture
def rig():
    rig = NodeRig()
    yield rig
    rig.close()


@pytest.fixture
def beating():
    made = []

    def make(backend=SimulatedBackend, name="simulated", timeout=PATIENT, count=2):
        swarm = bench(count)
        made.append(Beating(GateClient(name, backend, swarm, Recorder(), timeout=timeout)))
        return made[-1].client, swarm

    yield make
    for one in made:
        one.close()


def children(pid):
    return [int(child) for path in Path(f"/proc/{pid}/task").glob("*/children") for child in path.read_text().split()]


def wait_until_gone(pid):
    limit = time.monotonic() + DEADLINE
    while Path(f"/proc/{pid}").exists() and Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < limit, "it is still there"
        time.sleep(0.001)


def driving(rig, tmp_path, **parameters):
    """A driver that drives, its process, and that of its gate."""
    (tmp_path / "scenario.yaml").write_text(scenario_text(6))
    process = rig.start_driver(tmp_path / "scenario.yaml", backend="watched", auto_start=True, **parameters)
    drive(rig)
    (gate,) = children(process.pid)
    return process, gate


def drive(rig, name="plan"):
    rig.send(encode(bench(6), [(4, 600.0)], plan_id=name))
    rig.status(lambda s: s.output_level == 140.0 and s.plan_id == name, "the drive")


def test_volts_end_with_the_driver_however_it_ends(rig, watch, tmp_path):
    process, gate = driving(rig, tmp_path)
    since = time.monotonic()
    process.kill()
    print(f"zero volts after {1e3 * watch.at_rest(since):.1f} ms")
    wait_until_gone(gate)
    assert watch.levels()[-1][1] == 0.0


def test_volts_end_while_the_driver_is_frozen(rig, watch, tmp_path):
    process, _ = driving(rig, tmp_path, gate_timeout=1.0)
    since = time.monotonic()
    process.send_signal(signal.SIGSTOP)
    try:
        print(f"zero volts after {1e3 * watch.at_rest(since):.1f} ms")
    finally:
        process.send_signal(signal.SIGCONT)
    fault = rig.state(DriverStatus.FAULT)
    assert (fault.error_code, fault.output_level) == (ErrorCode.NO_HEARTBEAT, 0.0)
    assert rig.call("reset").success
    drive(rig, "again")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_what_a_terminal_sends_to_all_leaves_the_gate_to_its_work(rig, watch, tmp_path, number):
    process, gate = driving(rig, tmp_path)
    os.kill(gate, number)  # it is in a session of its own; somebody may look for it by name
    assert os.getpgid(gate) == gate != os.getpgid(process.pid)
    code, errors = rig.end(process, number)
    assert code == 0 and "Traceback" not in errors
    assert rig.state(DriverStatus.STOPPED).output_level == 0.0
    wait_until_gone(gate)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_gate_that_dies_or_hangs_is_a_fault_and_replaced(rig, watch, tmp_path, number):
    process, gate = driving(rig, tmp_path, gate_timeout=1.0)
    os.kill(gate, number)
    fault = rig.state(DriverStatus.FAULT)
    assert fault.error_code == ErrorCode.BACKEND_FAILURE and "signal 9" in fault.error_msg
    assert children(process.pid) != [gate]
    assert watch.levels()[-1][1] == 0.0
    assert rig.call("stop").success and rig.call("reset").success
    drive(rig, "again")
    assert rig.call("stop").success


def test_a_log_that_nobody_reads_holds_up_neither_stop_nor_signals(rig, watch, tmp_path):
    """Standard error is a full pipe, and more lines are on their way to it."""
    process, _ = driving(rig, tmp_path)
    read = process.stderr.fileno()

    def refusals(name):
        for k in range(5):  # no more than fit into the queue of the topic
            rig.send(sequence(bench(6), [1.0], [1.0], plan_id=f"{name} {k}", swarm_id="another " * 20))
        rig.status(lambda s: s.refused_plan_id == f"{name} 4", "the refusals")

    waiting = [-1, 0]
    while waiting[-1] > waiting[-2]:
        for k in range(10):
            refusals(f"{len(waiting)} {k}")
        waiting.append(struct.unpack("i", fcntl.ioctl(read, termios.FIONREAD, bytes(4)))[0])
    assert waiting[-1] > 0.5 * fcntl.fcntl(read, fcntl.F_GETPIPE_SZ)
    refusals("more")
    assert rig.call("stop").success
    assert watch.levels()[-1][1] == 0.0
    drive(rig, "again")
    since = time.monotonic()
    process.send_signal(signal.SIGINT)
    watch.at_rest(since)
    assert process.wait(DEADLINE) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_driver_that_is_still_being_made_ends_at_once(rig, tmp_path, number):
    (tmp_path / "scenario.yaml").write_text(scenario_text(2))
    process = rig.start("driver", code=NEVER_MADE, scenario=tmp_path / "scenario.yaml")
    assert process.stderr.readline() == "being made\n"
    assert rig.end(process, number)[0] == 0


NEVER_MADE = """
import sys, time
from stressbot_driver.ros import driver_node

def load_bench(path):
    sys.stderr.write("being made\\n")
    time.sleep(600)

driver_node.load_bench = load_bench
driver_node.main()
"""


def test_silence_is_a_failure_that_only_a_reset_ends(beating):
    client, swarm = beating(timeout=1.0)
    client.upload(encode(swarm, [(1, 600.0)]))
    client.start(Pacing())
    one = client.listener
    silence(client, one)
    assert one.error.code == ErrorCode.NO_HEARTBEAT and client.progress().level == 0.0
    with pytest.raises(StressbotError) as refused:
        client.upload(encode(swarm, [(1, 1.0)]))
    assert refused.value.code == ErrorCode.NO_HEARTBEAT
    client.reset()
    client.upload(encode(swarm, [(1, 0.01)]))
    one.ended.clear()
    client.start(Pacing())
    assert one.ended.wait(DEADLINE) and one.done


def silence(client, listener):
    beat, client.beat = client.beat, lambda: None
    assert listener.ended.wait(DEADLINE)
    client.beat = beat


def test_a_stop_that_is_not_answered_kills_and_replaces_the_gate(beating, monkeypatch):
    monkeypatch.setattr(client_module, "STOP_PATIENCE", 3.0)
    client, swarm = beating(timeout=10.0)
    client.upload(encode(swarm, [(1, 600.0)]))
    client.start(Pacing())
    hung = client.pid
    os.kill(hung, signal.SIGSTOP)
    client.stop()
    assert client.pid != hung and client.progress().level == 0.0
    client.reset()


def test_errors_come_through_as_they_are(beating):
    client, _ = beating()
    with pytest.raises(StressbotError) as refused:
        client.impair(Imperfections(always_turn=(7,)))
    assert (refused.value.code, refused.value.field) == (ErrorCode.UNKNOWN_ROBOT, "imperfections.always_turn")
    with pytest.raises(StressbotError) as refused:
        client.start(Pacing())
    assert refused.value.code == ErrorCode.NOTHING_LOADED
    generator = backend_class("waveform_generator")
    with pytest.raises(StressbotError) as refused:
        beating(generator, "waveform_generator")
    assert (refused.value.code, refused.value.field) == (ErrorCode.MISSING_FIELD, "waveform_generator.visa_resource")


def test_a_sequence_of_a_million_segments_stops_at_once(beating):
    """Two steps of the playback may pass, not the preparation of what is left."""
    client, swarm = beating()
    played = encode(swarm, [(1, 0.05)] * 100_000)
    client.upload(played)
    client.start(Pacing())
    since = time.monotonic()
    client.stop()
    print(f"stopped after {1e3 * (time.monotonic() - since):.1f} ms")
    assert client.progress().level == 0.0 and client.progress().epoch < 1000


def test_no_descriptor_is_left_behind(beating):
    client, swarm = beating()
    before = None
    for _ in range(30):
        client.upload(encode(swarm, [(1, 0.01)]))
        client.poses()
        client.reset()
        now = (len(os.listdir("/proc/self/fd")), len(os.listdir(f"/proc/{client.pid}/fd")))
        before = before or now
        assert now[0] <= before[0] and now[1] <= before[1] + 1  # the sequence that is loaded


def test_two_drivers_at_one_instrument(tmp_path, monkeypatch):
    """The second is refused while the first lives, and takes over once it is dead, though the first gate hangs."""
    monkeypatch.setattr(claim, "FOLDER", tmp_path)
    monkeypatch.setattr(claim, "PATIENCE", 0.3)
    first = subprocess.Popen([sys.executable, "-c", DRIVER, GATE, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert first.stdout.readline() == "held\n"
        with pytest.raises(StressbotError) as refused:
            claim.claim(" tcpip0::NOWHERE")
        assert refused.value.code == ErrorCode.BUSY and f"driver {first.pid}" in refused.value.message
        os.close(claim.claim("TCPIP0::elsewhere")[0])
        (gate,) = children(first.pid)
        first.kill()
        first.wait()
        holder, done = claim.claim("TCPIP0::nowhere")
        assert f"killed gate {gate}" in done
        os.close(holder)
    finally:
        first.kill()
        first.communicate()


DRIVER = "import os, subprocess, sys; subprocess.run([sys.executable, '-c', *sys.argv[1:], str(os.getpid())])"
GATE = """
import pathlib, sys, time
from stressbot_driver.gate import claim
claim.FOLDER = pathlib.Path(sys.argv[1])
held = claim.claim("TCPIP0::nowhere")
print("held", flush=True)
time.sleep(600)
"""
