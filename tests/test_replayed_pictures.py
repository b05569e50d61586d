"""Pictures that were recorded, and what the driver said meanwhile, lead the tracker to the same poses again."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage
from stressbot_msgs.msg import DriverStatus, SwarmPoses
from system_rig import DEADLINE
from three_robots import SCENARIO

from stressbot_planner.formats import recording
from stressbot_planner.ros.bringup import BENCH

pytestmark = pytest.mark.timing  # a loop through pictures is as good as their times, which a busy machine tells late

STRESSBOT = Path(__file__).parents[1] / ".venv/bin/stressbot"
NAMES = ("swarm_description", "driver_status", "voltage_sequence", "image_raw/compressed")
"""What a tracker hears."""

UNITS = (3e-5, 3e-5, 1.0)
"""A body's radius, and a radian."""

MANY = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000)


def stamp_of(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def poses_of(message) -> dict[int, np.ndarray]:
    return {robot: np.array(pose) for robot, *pose in zip(message.ids, message.x, message.y, message.heading, strict=True)}


def kept(path, name, kind) -> list:
    return [deserialize_message(message.data, kind) for message in recording.read(path) if message.topic.name == name]


def test_a_recording_leads_the_tracker_to_the_same_poses(new_system, tmp_path):
    scenario, path = tmp_path / "three.yaml", tmp_path / "run.mcap"
    scenario.write_text(SCENARIO)
    system = new_system(nodes=())
    place = system.namespace + "/"
    system.start("driver", scenario=scenario, tracked=True)
    for name in ("sequencer", "planner"):
        system.start(name)
    system.start("camera_tracker", camera=BENCH, compressed=True)
    system.processes.start("record", [str(STRESSBOT), "record", "--output", str(path)])
    system.wait_for(lambda: hears(system, place + "swarm_poses") and hears(system, place + "driver_status"), "the recorder")
    # last, so that tracker and recorder hear its first picture
    system.start("simulated_camera", camera=BENCH, rate=15.0, latency=0.04, drift_x=4e-7, wander=2e-7)
    system.wait_for(lambda: system.client.is_system_ready() and system.client.poses, "poses from pictures")
    plan = system.plan(first=True).plan
    system.wait_until_loaded(plan.plan_id)
    assert system.client.trigger("start").success
    system.wait_for(lambda: system.client.driver_status.sequence_time > 20.0, "motion", 3 * DEADLINE)
    assert system.client.trigger("stop").success
    system.wait_for(lambda: system.client.driver_status.state == DriverStatus.STOPPED, "rest")
    system.client.forget_poses()
    system.wait_for(lambda: len(system.client.poses) > 20, "poses at rest")
    for name in ("record", "camera_tracker", "simulated_camera", "planner", "sequencer", "driver"):
        system.processes.stop(name)

    pictures, poses = [], []
    node = system.client.node
    node.create_subscription(CompressedImage, place + NAMES[-1], lambda message: pictures.append(stamp_of(message)), MANY)
    node.create_subscription(SwarmPoses, place + "swarm_poses", poses.append, MANY)
    system.start("camera_tracker", camera=BENCH, compressed=True)
    system.wait_for(lambda: node.count_publishers(place + "swarm_poses"), "the tracker")
    done = subprocess.run(
        [STRESSBOT, "replay", path, *(place + name for name in NAMES)], capture_output=True, text=True, timeout=3 * DEADLINE
    )
    assert done.returncode == 0, done
    system.wait_for(lambda: poses and stamp_of(poses[-1]) == pictures[-1], "poses of the last picture")

    recorded = {stamp_of(message) for message in kept(path, place + NAMES[-1], CompressedImage)}
    later = [pictures[-1] - stamp for stamp in sorted(recorded)[-20:]]
    shown = max(([stamp for stamp in pictures if stamp - shift in recorded] for shift in later), key=len)
    assert len(shown) > 0.95 * len(pictures) > 200  # but for the first, which would be from before the replay
    shift = max(later, key=lambda shift: sum(stamp - shift in recorded for stamp in pictures))
    before = {stamp_of(message): poses_of(message) for message in kept(path, place + "swarm_poses", SwarmPoses)}
    after = {stamp_of(message): poses_of(message) for message in poses}
    pairs = [(before[stamp - shift], after[stamp]) for stamp in shown if stamp - shift in before and stamp in after]
    assert len(pairs) > 0.95 * len(before)
    assert sum(was.keys() == again.keys() for was, again in pairs) > 0.99 * len(pairs)
    off = np.array([np.abs(was[robot] - again[robot]) for was, again in pairs for robot in was.keys() & again.keys()]) / UNITS
    # Not to the last bit: the driver's words and pictures come in another order now and then.
    assert off.max() < 0.02 and np.all(np.median(off, axis=0) < 0.002), (off.max(axis=0), np.median(off, axis=0))


def hears(system, topic):
    return any(end.node_name == "recorder" for end in system.client.node.get_subscriptions_info_by_topic(topic))
