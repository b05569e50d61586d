"""`ros2 run stressbot_planner recognise`: drives robots of which the camera tracker does not know who they are until it does."""

import argparse
import sys

import numpy as np
from geometry_msgs.msg import PoseArray
from rclpy.utilities import remove_ros_args
from stressbot_msgs.bounds import within
from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.stamps import nanoseconds
from stressbot_msgs.wording import sentence

from stressbot_planner.estimation.recognition import Bodies, recognise
from stressbot_planner.ros import conversion
from stressbot_planner.ros.client import SwarmClient
from stressbot_planner.ros.driving import driving
from stressbot_planner.ros.remote_bench import RemoteBench
from stressbot_planner.system import streams

PICTURES, MOST_PICTURES = 6, 90
"""Pictures that are looked at at rest, and at most, while robots are missed."""

SEEN_WITHIN = 20.0
"""s for these."""


class Watch:
    """What the tracker says of the newest pictures."""

    def __init__(self, client: SwarmClient, bench: RemoteBench) -> None:
        self._client, self._bench = client, bench
        self._nameless: list[PoseArray] = []
        heard = within(client.node, "nameless_poses", self._nameless.append)
        client.node.create_subscription(PoseArray, "nameless_poses", heard, 50)

    def look(self) -> Bodies:
        """Return what is seen at rest. Raises TimeoutError if no pictures come."""
        self._client.forget_poses()
        self._nameless.clear()
        scene = self._bench.scene

        def seen() -> Bodies | None:
            arrays = list(self._nameless)
            if len(arrays) < PICTURES:
                return None
            stamps = {nanoseconds(message.header.stamp): message for message in self._client.poses}
            told = stamps.get(nanoseconds(arrays[-1].header.stamp), SwarmPoses())
            bodies = Bodies(conversion.measured_poses(told, scene), nameless(arrays[-1], scene.unit))
            known = int(np.isfinite(bodies.known[:, 0]).sum())
            return bodies if known + len(bodies.nameless) >= scene.swarm.n or len(arrays) >= MOST_PICTURES else None

        return self._client.wait_for(seen, SEEN_WITHIN, "nameless_poses of the camera tracker")


def nameless(message: PoseArray, unit: float) -> np.ndarray:
    """Return poses, shape (k, 3), units and rad."""
    return np.array(
        [
            (pose.position.x / unit, pose.position.y / unit, conversion.heading_of(pose.orientation))
            for pose in message.poses
        ]
    ).reshape(-1, 3)


def run(client: SwarmClient) -> int:
    """Drive until all robots are known, say how long it took, return the exit code.

    Raises:
        StressbotError, TimeoutError: with the reason.
    """
    bench = RemoteBench(client, "recognise", seen=False)
    watch, driven = Watch(client, bench), 0.0
    print(f"{sentence(bench.scene.name)}: {bench.scene.swarm.n} robots in {bench.scene.swarm.m} groups; driving", flush=True)

    def drive(group: int, length: float) -> None:
        nonlocal driven
        bench.play((np.array([group]), np.array([length])))
        driven += client.driver.duration
        print(f"  {driven:.0f} s: group {group}", flush=True)

    count = recognise(bench.scene.swarm, bench.scene.environment, watch.look, drive)
    print(f"all robots are known after {count} activations, driven for {driven:.0f} s", flush=True)
    return streams.SOLVED


def main() -> None:
    """Entry point of `ros2 run stressbot_planner recognise`."""
    parser = argparse.ArgumentParser(
        prog="recognise",
        description="Drive robots of which the camera tracker does not know who they are, group by group and clear of each other "
        "whoever is where, until it knows all. Driver, sequencer and camera_tracker must be running.",
    )
    parser.parse_args(remove_ros_args(sys.argv)[1:])
    sys.exit(streams.run("recognise", lambda: driving("recognise", run)))
