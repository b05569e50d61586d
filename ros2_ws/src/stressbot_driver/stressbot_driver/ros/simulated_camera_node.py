"""The simulated camera node: true poses in; pictures, as a microscope above the substrate would take them, out."""

import math
import sys
from collections import deque
from dataclasses import fields

import cv2
import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from stressbot_msgs.bounds import within
from stressbot_msgs.described import Described
from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.stamps import nanoseconds, stamp_of

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros import cameras
from stressbot_driver.ros.checks import check_description, check_poses, passes
from stressbot_driver.ros.parameters import Declaration, declare_all, first_problem, number_of, value_of
from stressbot_driver.ros.pictures import FORMAT, Pictures
from stressbot_driver.ros.qos import NEWEST
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline

MOST_STRANGERS, MOST_WAITING = 100, 100

OPTICS = tuple(
    Declaration(
        entry.name,
        entry.default,
        entry.metadata["description"],
        low=entry.metadata["low"],
        high=entry.metadata["high"],
    )
    for entry in fields(Optics)
)
PARAMETERS = (
    cameras.CAMERA,
    Declaration("rate", 30.0, "[Hz] Pictures per second.", low=0.1, high=240.0, read_only=True),
    FORMAT,
    Declaration("seed", 0, "Of dust, noise, the walk of the stage and lost pictures.", low=0, high=2**63 - 1, read_only=True),
    Declaration("latency", 0.0, "[s] From the middle of the exposure to the message.", low=0.0, high=1.0),
    Declaration("stamp_late", 0.0, "[s] From the middle of the exposure to the stamp; none is sent before.", low=0.0, high=1.0),
    Declaration("late", 0.0, "[s] Mean of a random delay besides (exponential); pictures stay in order.", low=0.0, high=1.0),
    Declaration("lost", 0.0, "Probability that a picture is lost.", low=0.0, high=1.0),
    Declaration("frozen", False, "Send the same picture again and again, with new stamps."),
    Declaration("strangers", (), f"x, y [m] and heading [rad] of objects that look like robots, at most {MOST_STRANGERS}."),
    *OPTICS,
)


class SimulatedCameraNode(ProcessNode):
    """Publishes `image_raw` and `image_raw/compressed` of the robots of `true_poses`. Nothing is drawn while nobody looks.

    A picture shows the robots at the moment of the newest poses, or now if these are older than a period. That is its stamp, unless
    `stamp_late` says otherwise.

    Raises StressbotError if the parameters or the camera file are refused.
    """

    def __init__(self) -> None:
        super().__init__("simulated_camera")
        cv2.setNumThreads(1)
        try:
            declare_all(self, PARAMETERS)
            self._loaded = cameras.load(value_of(self, "camera"))
            self._pictures = Pictures(self, value_of(self, "format"))
            self._optics, self._strangers = self._settings([])
        except BaseException:
            self.destroy_node()
            raise
        period = 1.0 / number_of(self, "rate")
        self._period = int(1e9 * period)  # [ns], as all times below
        self._random = np.random.default_rng(value_of(self, "seed"))
        self._microscope: Microscope | None = None
        self._rows: dict[int, int] = {}
        self._poses = np.empty((0, 3))
        self._swarm_id, self._seen_at = "", 0  # when the newest poses were so
        self._first, self._last = 0, 0  # when the first and the last picture were taken
        self._picture: np.ndarray | None = None
        self._waiting: deque[tuple[int, int, np.ndarray]] = deque(maxlen=MOST_WAITING)  # when to send, stamp, picture
        self._described = Described(self, self._on_described)
        self.create_subscription(SwarmPoses, "true_poses", within(self, "true_poses", self._on_poses), NEWEST)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._sender = self.create_timer(period, self._send, clock=steady, autostart=False)
        self.create_timer(period, self._expose, clock=steady)
        self.add_on_set_parameters_callback(self._may_set)
        self.get_logger().info("up: pictures on image_raw, once a driver describes a swarm")

    def _settings(self, changes: list[Parameter]) -> tuple[Optics, np.ndarray]:
        """Raises StressbotError."""
        new = {parameter.name: parameter.value for parameter in changes}
        values = {entry.name: new.get(entry.name, value_of(self, entry.name)) for entry in OPTICS}
        strangers = list(new.get("strangers", value_of(self, "strangers")) or [])
        if any(isinstance(value, bool | str) or not math.isfinite(value) for value in strangers):
            raise StressbotError(ErrorCode.WRONG_TYPE, "strangers", "holds what is no finite number: give x, y and heading of each")
        if len(strangers) % 3 or len(strangers) > 3 * MOST_STRANGERS:
            raise StressbotError(
                ErrorCode.WRONG_COUNT, "strangers", f"has {len(strangers)} entries: give 3 each, of at most {MOST_STRANGERS}"
            )
        return Optics(**values), np.array(strangers, dtype=float).reshape(-1, 3)

    def _may_set(self, parameters: list[Parameter]) -> SetParametersResult:
        problem = first_problem(PARAMETERS, parameters)
        if problem is None:
            try:
                self._optics, self._strangers = self._settings(parameters)
                self._on_described()
            except StressbotError as error:
                problem = str(error)
        return SetParametersResult(successful=not problem, reason=problem or "")

    def _on_described(self) -> None:
        """Set the microscope up for what is described, or with new settings."""
        self._microscope = None
        message = self._described.description
        if message is None or not passes(self, check_description, message):
            return
        camera, outlines = cameras.seen(self._loaded, message)
        if message.swarm_id != self._swarm_id:
            self._swarm_id, self._seen_at = message.swarm_id, 0
            self._rows = {robot: row for row, robot in enumerate(message.ids)}
            self._poses = np.reshape(message.start, (-1, 3)).copy()
            self.get_logger().info(f"looks at {len(outlines)} robots of {message.name!r}: {camera}")
        stranger = outlines[0] if outlines else Outline()
        outlines += [stranger] * len(self._strangers)
        self._microscope = Microscope(camera, outlines, self._optics, value_of(self, "seed"))

    def _on_poses(self, message: SwarmPoses) -> None:
        if message.swarm_id != self._swarm_id or not passes(self, check_poses, message):
            return
        poses = np.column_stack([message.x, message.y, message.heading])
        for robot, pose in zip(message.ids, poses, strict=True):
            if robot in self._rows and np.all(np.isfinite(pose)):
                self._poses[self._rows[robot]] = pose
        self._seen_at = nanoseconds(message.header.stamp)

    def _expose(self) -> None:
        """Take a picture, and let it wait until it shall be sent."""
        if self._microscope is None or not self._pictures.are_wanted:
            return
        now = self.get_clock().now().nanoseconds
        taken = self._seen_at if now - self._period < self._seen_at <= now else now
        if taken <= self._last or self._random.random() < number_of(self, "lost"):
            return
        self._first, self._last = self._first or taken, taken
        if self._picture is None or not value_of(self, "frozen"):
            poses = np.vstack([self._poses, self._strangers])
            self._picture = self._microscope.picture(poses, 1e-9 * (taken - self._first))
        delay = number_of(self, "latency") + self._random.exponential(number_of(self, "late"))
        stamp = taken + int(1e9 * number_of(self, "stamp_late"))
        due = max(taken + int(1e9 * delay), stamp)
        self._waiting.append((max(due, self._waiting[-1][0] if self._waiting else due), stamp, self._picture))
        if len(self._waiting) == 1:
            self._send()

    def _send(self) -> None:
        """Send what is due; come again when the next picture is."""
        self._sender.cancel()
        while self._waiting:
            due, stamp, picture = self._waiting[0]
            left = due - self.get_clock().now().nanoseconds
            if left > 0:
                self._sender.timer_period_ns = left
                self._sender.reset()
                return
            self._waiting.popleft()
            self._pictures.publish(picture, stamp_of(stamp))


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver simulated_camera`."""
    sys.exit(run("simulated_camera", SimulatedCameraNode, args))
