"""Runs are recorded from outside and replayed: by real processes, read by an independent reader."""

import signal
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import CompressedImage
from stressbot_msgs.msg import DriverStatus, SwarmPoses
from stressbot_msgs.srv import PlanMotion
from system_rig import DEADLINE, SCENARIOS

from stressbot_planner.formats import recording
from stressbot_planner.ros.bringup import NodeEntry, command

STRESSBOT = Path(__file__).parents[1] / ".venv/bin/stressbot"
RECORDER = NodeEntry("stressbot_planner", "recorder")


def stressbot(*words) -> subprocess.CompletedProcess:
    return subprocess.run([STRESSBOT, *map(str, words)], capture_output=True, text=True, timeout=DEADLINE)


@pytest.fixture(scope="module")
def system(new_system):
    return new_system(scenario=SCENARIOS / "paper-six.yaml", real_time_factor=0.0)


def recorded(path, topic: str) -> list:
    """Return a topic's messages, decoded by others."""
    with AnyReader([path]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        return [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages(connections)]


def topics_in(path) -> set[str]:
    try:
        return {message.topic.name for message in recording.read(path)}
    except recording.StressbotError:  # there is nothing yet
        return set()


def after(message, stamp) -> bool:
    return (message.header.stamp.sec, message.header.stamp.nanosec) >= (stamp.sec, stamp.nanosec)


def places(message) -> np.ndarray:
    return np.stack([message.x, message.y, message.heading])


@pytest.fixture(scope="module")
def run(system, tmp_path_factory):
    """A plan that was executed while all topics were recorded: the recording, the plan's name and the poses at its end."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    recorder = system.processes.start("record", [str(STRESSBOT), "record", "--output", str(path)])
    wanted = {f"{system.namespace}/{name}" for name in ("swarm_description", "swarm_poses", "driver_status", "sequencer_status")}
    system.wait_for(lambda: wanted <= topics_in(path), "a record of all topics")
    poses = f"{system.namespace}/swarm_poses"
    for name, others in (("voltage_sequence", 2), ("plan_motion/_service_event", 0)):
        topic = f"{system.namespace}/{name}"
        system.wait_for(lambda topic=topic, others=others: system.client.node.count_subscribers(topic) > others, "the recorder")
    answer = system.plan(first=True)
    system.execute(answer.plan)
    at_rest = system.client.driver_status.header.stamp

    def is_kept() -> bool:
        kept = (message.data for message in recording.read(path) if message.topic.name == poses)
        return any(after(deserialize_message(data, SwarmPoses), at_rest) for data in kept)

    system.wait_for(is_kept, "the last poses on the disk")
    assert system.processes.stop("record") == 0
    assert recorder.returncode == 0 and "messages of" in system.log("record")
    return path, answer.plan.plan_id


def test_a_run_is_recorded_as_it_was_heard(system, run):
    path, plan_id = run
    (sequence,) = recorded(path, f"{system.namespace}/voltage_sequence")
    assert sequence.plan_id == plan_id
    statuses = recorded(path, f"{system.namespace}/driver_status")
    assert statuses[-1].state == DriverStatus.DONE and statuses[-1].plan_id == plan_id
    assert recorded(path, f"{system.namespace}/swarm_description")[0].name == "paper-six"
    spoken = [message for message in recording.read(path) if message.topic.name.endswith("/plan_motion/_service_event")]
    assert "MSG: stressbot_msgs/PlanMotion_Request" in spoken[0].topic.definition
    requests = [deserialize_message(message.data, PlanMotion.Event) for message in spoken]
    assert [event.info.event_type for event in requests] == [1, 2]
    assert requests[0].request[0].first and requests[1].response[0].plan.plan_id == plan_id
    with AnyReader([path]) as reader:
        (quality,) = next(c for c in reader.connections if c.topic.endswith("/driver_status")).ext.offered_qos_profiles
        assert (quality.reliability.name, quality.durability.name) == ("RELIABLE", "TRANSIENT_LOCAL")
    kinds = {message.topic.type: message.topic.type_hash for message in recording.read(path)}
    assert all(value.startswith("RIHS01_") and len(value) == 71 for value in kinds.values()), kinds


def test_pictures_are_kept_compressed_and_replayed(system, tmp_path):
    folder, path, name = tmp_path / "pictures", tmp_path / "pictures.mcap", f"{system.namespace}/image_raw/compressed"
    folder.mkdir()
    pictures = [np.full((40, 60), 60 * k, dtype=np.uint8) for k in range(4)]
    for k, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{k}.png"), picture)
    source = NodeEntry("stressbot_driver", "image_source")
    settings = {"source": folder, "repeat": True, "format": "png"}
    system.processes.start("image_source", command(source, settings, namespace=system.namespace))
    system.processes.start("record_pictures", [str(STRESSBOT), "record", "--output", str(path)])
    system.wait_for(lambda: name in topics_in(path) and len(recorded(path, name)) > 8, "pictures in the record")
    assert system.processes.stop("record_pictures") == 0
    assert system.processes.stop("image_source") == 0
    assert f"{system.namespace}/image_raw" not in topics_in(path)
    assert "image_raw is not recorded" in system.log("record_pictures")
    kept = [bytes(message.data) for message in recorded(path, name)]
    assert [cv2.imdecode(np.frombuffer(data, np.uint8), 0)[0, 0] for data in kept[:8]] == 2 * [0, 60, 120, 180]
    heard = []
    system.client.node.create_subscription(CompressedImage, name, lambda message: heard.append(bytes(message.data)), 100)
    assert stressbot("replay", path, name, "--rate", "10").returncode == 0
    system.wait_for(lambda: len(heard) == len(kept), "all pictures again")
    assert heard == kept


def test_a_replayed_voltage_sequence_moves_the_robots_to_the_same_bits(system, run):
    path, plan_id = run
    driven = recorded(path, f"{system.namespace}/swarm_poses")[-1]
    system.reset()
    done = stressbot("replay", path, f"{system.namespace}/voltage_sequence", "--rate", "0")
    assert done.returncode == 0, done
    system.wait_until_loaded(plan_id)
    assert system.client.trigger("start").success
    system.wait_for(system.has_reached(DriverStatus.DONE, plan_id), "end of the sequence")
    stamp = system.client.driver_status.header.stamp
    system.poses_after(stamp)
    again = system.wait_for(lambda: system.client.poses and system.client.poses[-1], "poses at the end")
    assert list(again.ids) == list(driven.ids)
    assert places(again).tobytes() == places(driven).tobytes()


def test_a_recorder_that_is_killed_leaves_what_it_had_heard(system, tmp_path):
    path = tmp_path / "x.mcap"
    process = system.processes.start("recorder", command(RECORDER, {"output": path}, namespace=system.namespace))
    system.wait_for(lambda: f"{system.namespace}/swarm_poses" in topics_in(path), "a first write to the disk")
    before = sum(1 for _ in recording.read(path))
    system.processes.stop("recorder", signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    messages = list(recording.read(path))
    assert len(messages) >= before


def test_a_full_disk_ends_the_record_with_one_line_and_not_the_run(system, tmp_path):
    path = tmp_path / "x.mcap"
    line = " ".join(command(RECORDER, {"output": path}, namespace=system.namespace))
    process = system.processes.start("limited", ["sh", "-c", f"ulimit -f 16; exec {line}"])  # 8 or 16 kB
    system.wait_for(lambda: process.poll() is not None, "the end of the record")
    assert process.returncode == 1
    log = system.log("limited")
    system.processes.ended()
    (said,) = (line for line in log.splitlines() if "the record has ended" in line)
    kept = len(list(recording.read(path)))
    assert f"{path}: File too large; its first {kept} messages are kept" in said and "Traceback" not in log
    assert system.client.trigger("stop").success
    system.processes.stop("limited")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("replay", "NO"), "recording: NO cannot be read (No such file or directory): name a recording"),
        (("replay", "BAD"), "recording: BAD is no MCAP file: give a recording of ROS 2"),
        (("replay", "RUN", "nothing"), "topic: RUN does not hold /nothing"),
        (("record", "--output", "BAD"), "output: BAD exists: give another name, or take it away"),
        (("replay", "RUN"), "is published by somebody else already: end that, or name the topics to replay"),
    ],
)
def test_what_cannot_be_recorded_or_replayed_is_said_in_one_line(run, tmp_path, words, reason):
    files = {"NO": tmp_path / "no.mcap", "BAD": tmp_path / "bad.mcap", "RUN": run[0]}
    files["BAD"].write_text("x" * 1000)
    done = stressbot(*(files.get(word, word) for word in words))
    for name, path in files.items():
        reason = reason.replace(name, str(path))
    assert done.returncode == 2 and reason in done.stderr and done.stderr.count("\n") == 1, done
