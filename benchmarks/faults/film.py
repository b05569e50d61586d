"""Pictures of the simulated microscope on their way to the tracker, and what comes of them."""

import time
from collections.abc import Callable

import numpy as np
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import Image
from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.stamps import nanoseconds

from faults.stage import Stage
from stressbot_driver.ros.qos import PICTURES, POSES

BODY = 3e-5
"""m, radius."""

KEPT = 2000


class Film:
    """Hands pictures on.

    Attributes:
        change: makes of each picture those that the tracker gets.
        told: what the tracker has told, and when.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self.change: Callable[[Image], list[Image]] | None = None
        self.told: list[tuple[float, SwarmPoses]] = []
        self._truth: dict[int, SwarmPoses] = {}
        node = stage.node
        self._out = node.create_publisher(Image, "image_raw", PICTURES)
        node.create_subscription(Image, "seen_raw", self._hand_on, PICTURES)
        node.create_subscription(SwarmPoses, "true_poses", self._see_truth, POSES)
        node.create_subscription(SwarmPoses, "swarm_poses", lambda message: self.told.append((time.monotonic(), message)), POSES)
        self._camera = AsyncParameterClient(node, "simulated_camera")

    def _hand_on(self, message: Image) -> None:
        for picture in self.change(message) if self.change else [message]:
            self._out.publish(picture)

    def _see_truth(self, message: SwarmPoses) -> None:
        self._truth[nanoseconds(message.header.stamp)] = message
        if len(self._truth) > KEPT:
            self._truth.pop(next(iter(self._truth)))

    def adjust(self, **values: object) -> None:
        """Set parameters of the camera."""
        self._stage.until(self._camera.services_are_ready, "the camera")
        changes = [Parameter(name, value=value) for name, value in values.items()]
        answer = self._stage.system.asked(lambda: self._camera.set_parameters(changes))
        self._stage.until(answer.done, "its parameters")
        assert all(result.successful for result in answer.result().results), answer.result()

    def ids(self, since: float) -> set[int]:
        """Return the robots of the newest poses, none if there are none since a moment."""
        return set(self.told[-1][1].ids) if self.told and self.told[-1][0] > since else set()

    def wait_for_all(self) -> None:
        """Wait until pictures from now on show all robots."""
        since, everybody = time.monotonic(), set(self._stage.system.client.description.ids)
        self._stage.until(lambda: self.ids(since) == everybody, "all robots")

    def worst(self, since: float) -> tuple[int, float]:
        """Return how many poses were told since a moment, and the largest error of a place, body radii."""
        errors = []
        for when, message in self.told:
            truth = self._truth.get(nanoseconds(message.header.stamp))
            if when > since and truth is not None:
                known = dict(zip(truth.ids, zip(truth.x, truth.y, strict=True), strict=True))
                assert set(message.ids) <= set(known), f"poses of {message.ids}"
                errors += [
                    np.hypot(x - known[robot][0], y - known[robot][1]) / BODY
                    for robot, x, y in zip(message.ids, message.x, message.y, strict=True)
                ]
        return len(errors), max(errors, default=0.0)
