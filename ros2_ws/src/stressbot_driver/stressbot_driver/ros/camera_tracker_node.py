"""The camera tracker node: pictures of a microscope in, `swarm_poses` out."""

import sys
import time
from collections.abc import Callable

import cv2
import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseArray
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from stressbot_msgs.bounds import within
from stressbot_msgs.described import AMBIGUOUS, TOPIC, Described
from stressbot_msgs.health import ERROR, OK, WARN, Health, tell_health
from stressbot_msgs.msg import DriverStatus, SwarmDescription, SwarmPoses, VoltageSequence
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.stamps import nanoseconds, stamp_of

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros import camera_info, cameras
from stressbot_driver.ros.checks import check_description
from stressbot_driver.ros.conversions import FRAME, poses_message, sequence_from_message
from stressbot_driver.ros.grey_pictures import grey_of_compressed, grey_of_image
from stressbot_driver.ros.parameters import Declaration, declare_all, value_of
from stressbot_driver.ros.qos import LATCHED, MARKERS, PICTURES, POSES, SEQUENCES
from stressbot_driver.simulation.substrate import Poses
from stressbot_driver.vision.activations import NOTHING, Activations
from stressbot_driver.vision.latency import LATE, Latency, LatencyMeter, remark
from stressbot_driver.vision.plausibility import Plausibility, darkness
from stressbot_driver.vision.sequence_clock import DriverWord, SequenceClock
from stressbot_driver.vision.tracking import Robots, Seen, SwarmTracker

SMALLEST, LARGEST = 2.5, 200.0
"""Pixels of a robot's length that can be tracked."""

MOVED = 0.25
"""Pixels by which a stage must have moved for its camera to be told again."""

GONE_AFTER = 1.0
"""s without a picture."""

_LOOK = 0.25
"""s"""

PARAMETERS = (
    cameras.CAMERA,
    Declaration(
        "start",
        "known",
        "known: robots may be taken for those that start where they are seen; unknown: only for what they move like.",
        read_only=True,
    ),
    Declaration("compressed", False, "Read image_raw/compressed in place of image_raw.", read_only=True),
)


class CameraTrackerNode(ProcessNode):
    """Publishes the robots that pictures show and that are known, and nothing where there is doubt.

    Raises StressbotError if the parameters or the camera file are refused.
    """

    def __init__(self) -> None:
        super().__init__("camera_tracker")
        cv2.setNumThreads(1)
        try:
            declare_all(self, PARAMETERS)
            start = value_of(self, "start")
            if start not in ("known", "unknown"):
                raise StressbotError(ErrorCode.OUT_OF_RANGE, "start", f"is {start!r}: give known or unknown")
            self._loaded = cameras.load(value_of(self, "camera"))
        except BaseException:
            self.destroy_node()
            raise
        self._starts_known = start == "known"
        self._tracker: SwarmTracker | None = None
        self._description: SwarmDescription | None = None
        self._times, self._plausibility = SequenceClock(), Plausibility()
        self._sequence: VoltageSequence | None = None
        self._playing = ""  # plan whose activations the tracker has
        self._heard = time.monotonic()  # when the last picture came
        self._problem, self._told = "", ""
        self._pictures = self._shown = 0
        self._delay = self._spent = 0.0  # s, of the last picture: from its exposure to its poses, and of that to look at it
        self._meter = LatencyMeter()
        self._latency: Latency | None = None  # as it was measured last
        self._late, self._told_latency = "", 0.0  # what is wrong with that of the camera file, and what that says it is
        self._running = ""  # plan that the driver runs
        self._publisher = self.create_publisher(SwarmPoses, "swarm_poses", POSES)
        self._nameless = self.create_publisher(PoseArray, "nameless_poses", MARKERS)
        self._camera_told = self.create_publisher(CameraInfo, camera_info.TOPIC, LATCHED)
        self._projection: np.ndarray | None = None  # as it was told last
        self._described = Described(self, self._on_described)
        self.create_subscription(DriverStatus, "driver_status", within(self, "driver_status", self._on_status), LATCHED)
        sequences = within(self, "voltage_sequence", self._on_sequence)
        self.create_subscription(VoltageSequence, "voltage_sequence", sequences, SEQUENCES)
        if value_of(self, "compressed"):
            self.create_subscription(CompressedImage, "image_raw/compressed", self._reader(grey_of_compressed), PICTURES)
        else:
            self.create_subscription(Image, "image_raw", self._reader(grey_of_image), PICTURES)
        self.create_timer(_LOOK, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))
        tell_health(self, self._health)
        self.get_logger().info("up: poses on swarm_poses as soon as there are pictures and a driver describes a swarm")

    # What is on the bench

    def _on_described(self) -> None:
        self._tracker = self._description = self._latency = None
        self._meter, self._late = LatencyMeter(), ""
        message = self._described.description
        if message is None:
            reason = f"{TOPIC} {AMBIGUOUS}" if self._described.is_ambiguous else "the driver is gone"
            self._tell(f"no poses are told: {reason}")
            return
        try:
            check_description(message)
            self._camera, outlines = cameras.seen(self._loaded, message)
            for outline in outlines:
                _check_scale(outline.length / self._camera.pixel)
        except StressbotError as error:
            self._tell(f"no poses are told: {error}")
            return
        speed = np.array(message.speed)
        codewords = np.array([[letter == "1" for letter in word] for word in message.codewords], dtype=bool)
        robots = Robots(
            np.array(message.ids, dtype=int),
            speed,
            speed / np.array(message.turning_radius),
            codewords.reshape(len(message.ids), -1),
            np.reshape(message.start, (-1, 3)) if self._starts_known else None,
        )
        self._tracker, self._description, self._playing = SwarmTracker(robots, self._camera, outlines), message, ""
        self._plausibility, self._projection = Plausibility(), None
        self._tell_camera(self._tracker, self.get_clock().now().to_msg())
        self.get_logger().info(f"looks for {len(outlines)} robots of {message.name!r} (swarm {message.swarm_id})")

    def _on_sequence(self, message: VoltageSequence) -> None:
        self._sequence = message

    def _on_status(self, message: DriverStatus) -> None:
        word = DriverWord(
            1e-9 * nanoseconds(message.header.stamp),
            message.plan_id,
            message.sequence_time,
            message.state == DriverStatus.RUNNING,
            message.duration,
        )
        self._times.hear(word)
        if self._running and self._running == word.plan and not word.running:
            self._measure_latency(word.plan, word.time)
        self._running = word.plan if word.running else ""

    def _at(self, stamp: float) -> tuple[float, float | None]:
        """Sequence time at a moment, and the same for the tracker: None where what is driven is not known."""
        found = self._times.at(stamp)
        if found is None or self._tracker is None or self._description is None:
            return 0.0, None
        plan, at = found
        if plan != self._playing:
            if not plan:
                self._tracker.play(NOTHING)
                self._tracker.reset()  # the driver forgets a plan only then
                self._playing = ""
                return at, 0.0
            activations = self._activations_of(plan)
            if activations is None:
                return at, None
            self._tracker.play(activations)
            self._playing = plan
        return at, at

    def _activations_of(self, plan: str) -> Activations | None:
        """Those of a plan's sequence; None if it is not known."""
        sequence, description = self._sequence, self._description
        if sequence is None or description is None or (sequence.plan_id, sequence.swarm_id) != (plan, description.swarm_id):
            return None
        try:
            return _activations(sequence, description)
        except (StressbotError, ValueError):
            return None

    def _measure_latency(self, plan: str, end: float) -> None:
        """A run is over, at a sequence time: compare its drives with what pictures have shown."""
        activations = self._activations_of(plan)
        if activations is None:
            return
        begun = activations.begins < end
        ends = np.minimum(activations.ends[begun], end)
        self._meter.drive(self._times.stamps(plan, activations.begins[begun]), self._times.stamps(plan, ends))
        self._latency = found = self._meter.latency()
        if found is None:
            return
        late = remark(found, self._camera.latency)
        if not late or not self._late or abs(found.seconds - self._told_latency) > 0.5 * LATE:
            self._late, self._told_latency = late, found.seconds
            if late:
                self.get_logger().warning(late)

    # Pictures

    def _reader(self, grey: Callable) -> Callable:
        def read(message: Image | CompressedImage) -> None:
            self._heard = time.monotonic()
            self._pictures += 1
            if self._tracker is None:
                return
            try:
                picture = grey(message, self._camera.width, self._camera.height)
            except StressbotError as error:
                self._tell(f"pictures are refused: {error}")
                return
            taken = nanoseconds(message.header.stamp) - round(1e9 * self._camera.latency)
            problem = self._plausibility.problem(picture, taken)
            if problem:
                self._tell(f"no poses are told: the picture {problem}")
                return
            self._look(self._tracker, picture, taken)

        return read

    def _look(self, tracker: SwarmTracker, picture: np.ndarray, taken: int) -> None:
        """`taken`: ns."""
        begin = time.monotonic()
        sequence_time, at = self._at(1e-9 * taken)
        seen = tracker.look(picture, 1e-9 * taken, at)
        stamp = stamp_of(taken)
        self._publish(seen, sequence_time, stamp)
        self._tell_camera(tracker, stamp)
        self._meter.look(1e-9 * taken + self._camera.latency, seen.moved)
        for note in seen.notes:
            self.get_logger().info(note)
        self._spent = time.monotonic() - begin
        self._delay = 1e-9 * (self.get_clock().now().nanoseconds - taken)
        missing, beside = tracker.missing, ""
        if tracker.displaced:
            beside = (
                f"robots lay {1e6 * tracker.displaced:.3g} µm beside their starts, all alike: the stage has moved since the camera "
                "file was made, or before; run camera_check"
            )
        if len(seen.ids):
            self._shown += 1
            self._tell(f"robots {', '.join(map(str, missing[:20]))} are not seen, or not known for sure" if missing else beside)
        elif len(seen.nameless):
            self._tell(f"{len(seen.nameless)} robots are seen and none is known: let each group slide a little, one by one")
        else:
            self._tell(f"no robot is seen: {darkness(picture) or 'are they in the picture, and is it sharp?'}")

    def _publish(self, seen: Seen, sequence_time: float, stamp: Time) -> None:
        if len(seen.ids) and self._description is not None:
            poses = Poses(seen.ids, *seen.poses.T)
            told = poses_message(self._description.swarm_id, sequence_time, poses)
            told.header.stamp = stamp
            self._publisher.publish(told)
        if self._nameless.get_subscription_count():
            array = PoseArray()
            array.header.stamp, array.header.frame_id = stamp, FRAME
            array.poses = [_pose(pose) for pose in seen.nameless.tolist()]
            self._nameless.publish(array)

    def _tell_camera(self, tracker: SwarmTracker, stamp: Time) -> None:
        """Tell where the camera looks, if that is news: the stage has moved by more than MOVED in a corner."""
        projection = camera_info.projection_of(self._camera, tracker.stage.to_picture)
        if self._projection is None or camera_info.farthest(projection, self._projection, self._camera) > MOVED:
            self._projection = projection
            self._camera_told.publish(camera_info.camera_info(self._camera, projection, stamp))

    # What is wrong

    def _watch(self) -> None:
        if time.monotonic() - self._heard > GONE_AFTER:
            self._tell(f"no poses are told: no picture has come for {GONE_AFTER:g} s; is the camera running?")

    def _tell(self, problem: str) -> None:
        """Keep what is wrong for the diagnostics; the log says it once."""
        self._problem = problem
        if problem and problem != self._told:
            self.get_logger().warning(problem)
        if not problem and self._told:
            self.get_logger().info("all robots are seen and known")
        self._told = problem

    def _health(self) -> Health:
        figures: dict[str, object] = {"pictures": self._pictures, "with poses": self._shown}
        figures |= {"delay_s": f"{self._delay:.4f}", "look_s": f"{self._spent:.4f}"}
        if self._tracker is not None:
            figures |= {"latency_s": self._camera.latency, "latency_measured_s": _measured(self._latency)}
            x, y, turn = self._tracker.stage.offset
            figures |= {"stage_x_m": f"{x:.3e}", "stage_y_m": f"{y:.3e}", "stage_turn_rad": f"{turn:.3e}"}
        if not self._problem:
            return (WARN, self._late, figures) if self._late else (OK, "all robots are seen and known", figures)
        said = f"{self._problem}; {self._late}" if self._late else self._problem
        return (WARN if self._problem.startswith("robots") else ERROR), said, figures


def _activations(sequence: VoltageSequence, description: SwarmDescription) -> Activations:
    value, electrical = sequence_from_message(sequence), description.electrical
    codes = np.frombuffer(bytes(electrical.codes), dtype=np.uint8).reshape(-1, electrical.code_length)
    levels = np.array(electrical.symbol_levels)
    return Activations.of(
        value.levels, value.dwells, value.epoch_ends, value.trains, levels, electrical.drive_level, codes
    )


def _measured(latency: Latency | None) -> str:
    if latency is None:
        return "not yet"
    return f"{latency.seconds:.4f} (standard error {latency.error:.4f}, {latency.edges} begins and ends of drives)"


def _check_scale(pixels: float) -> None:
    if not SMALLEST <= pixels <= LARGEST:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE,
            "camera",
            f"shows robots {pixels:.3g} pixels long, which must be {SMALLEST:g} to {LARGEST:g}: check `pixel` of the camera file",
        )


def _pose(values: list[float]) -> Pose:
    x, y, heading = values
    pose = Pose()
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = float(np.sin(0.5 * heading)), float(np.cos(0.5 * heading))
    return pose


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver camera_tracker`."""
    sys.exit(run("camera_tracker", CameraTrackerNode, args))
