"""`ros2 run stressbot_planner calibrate`: measures the robots of whatever driver is up, and writes a scenario file."""

import argparse
import signal
import sys
import time
import uuid
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rclpy.utilities import remove_ros_args
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses

from stressbot_planner import scenario, swarm_file
from stressbot_planner.calibration import CONFIDENCE, LEAST_FRAMES, Estimate, Record, cut, look_alikes, rest_poses
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.identification import Motion, identify
from stressbot_planner.kinematics import replay
from stressbot_planner.primitives import Activate
from stressbot_planner.problem import Problem
from stressbot_planner.ros import conversion
from stressbot_planner.ros.client import SwarmClient
from stressbot_planner.ros.orders import publish_order
from stressbot_planner.ros.qos import ORDERS
from stressbot_planner.swarm import check_positive

READY_WITHIN = 20.0
ANSWER_WITHIN = 20.0
STALLED_AFTER = 60.0
"""s; the last without any progress of the driver."""

REST_FRAMES = 25
"""Poses at rest are the mean of so many."""

SEEN_WITHIN = 10.0
"""s; a robot that the tracker loses is waited for so long."""

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130


class Bench:
    """The substrate, as a client of sequencer and driver."""

    def __init__(self, client: SwarmClient):
        """Wait for driver and sequencer.

        Raises:
            TimeoutError: one of them is missing.
            StressbotError: BUSY if a sequence is running; what a description may be refused for.
        """
        self._client = client
        self._plans = client.node.create_publisher(MotionPlan, "motion_plan", ORDERS)

        def ready() -> bool:
            known = client.description and client.driver_status and client.sequencer_status and client.poses
            described = bool(known) and client.sequencer_status.swarm_id == client.description.swarm_id
            return described and not client.driver_status.missing and client.is_ready("start")

        client.wait_for(ready, READY_WITHIN, "driver, sequencer and poses")
        if client.driver_status.state == DriverStatus.RUNNING:
            raise StressbotError(ErrorCode.BUSY, "driver_status", "a sequence is running: wait for its end, or call stop")
        self.scene = conversion.scene_from_description(client.description)
        self._seen = np.zeros(self.scene.swarm.n, dtype=bool)

    def measure(self) -> np.ndarray:
        """Return the poses at rest, shape (n, 3), units and rad; NaN for a robot that the tracker does not show."""
        client = self._client
        client.forget_poses()
        deadline = time.monotonic() + SEEN_WITHIN

        def frames() -> list[np.ndarray]:
            at_rest = client.driver_status.sequence_time
            return [self._poses(message) for message in client.poses if message.sequence_time >= at_rest]

        def enough() -> bool:
            found = frames()
            if len(found) < REST_FRAMES:
                return False
            return not (self._seen & np.isnan(rest_poses(found)[:, 0])).any() or time.monotonic() > deadline

        client.wait_for(enough, 2 * SEEN_WITHIN, "poses")
        poses = rest_poses(frames())
        self._seen |= np.isfinite(poses[:, 0])
        self._last = poses
        return poses

    def drive(self, motion: Motion) -> list[Record]:
        """Put activations on the substrate, wait for their end and return what was seen of each."""
        client = self._client
        plan = self._plan(motion)
        client.forget_poses()
        if not publish_order(client.node, self._plans, plan):
            raise StressbotError(ErrorCode.NO_SWARM, "motion_plan", "is heard by nobody: start the sequencer")

        def loaded() -> bool:
            sequencer, driver = client.sequencer_status, client.driver_status
            if sequencer.plan_id == plan.plan_id and sequencer.error_code:
                raise StressbotError(ErrorCode(sequencer.error_code), "sequencer", sequencer.error_msg)
            if driver.refused_plan_id == plan.plan_id:
                raise StressbotError(ErrorCode(driver.error_code), "driver", driver.error_msg)
            known = client.sequence is not None and client.sequence.plan_id == plan.plan_id
            return known and driver.plan_id == plan.plan_id

        client.wait_for(loaded, ANSWER_WITHIN, "sequence loaded by the driver")
        # What was measured before belongs to another sequence, and has its times.
        begin = _time(client.driver_status)
        if client.driver_status.state == DriverStatus.LOADED:  # otherwise it starts by itself
            answer = client.trigger("start", ANSWER_WITHIN)
            if not answer.success:
                raise StressbotError(ErrorCode.NOTHING_LOADED, "start", answer.message)
        self._watch(plan.plan_id)
        return self._records(motion, begin)

    def _plan(self, motion: Motion) -> MotionPlan:
        scene, (groups, lengths) = self.scene, motion
        start = np.where(np.isnan(self._last), scene.starts, self._last)
        unit = (scene.unit, scene.unit, 1.0)
        primitives = [Activate(int(group), float(length)) for group, length in zip(groups, lengths, strict=True)]
        return MotionPlan(
            plan_id=uuid.uuid4().hex,
            swarm_id=scene.swarm_id,
            planner="calibrate",
            primitives=[conversion.primitive_to_message(primitive, scene) for primitive in primitives],
            start=(start * unit).ravel().tolist(),
            predicted=(replay(scene.swarm, start, groups, lengths)[-1] * unit).ravel().tolist(),
            execution_time=float(lengths.sum()) / scene.swarm.speed,
            selection_time=scene.electrical.selection_time * len(groups),
        )

    def _watch(self, plan_id: str) -> None:
        client, latest = self._client, (time.monotonic(), -1.0)

        def done() -> bool:
            nonlocal latest
            status = client.driver_status
            if status.sequence_time != latest[1]:
                latest = (time.monotonic(), status.sequence_time)
            if status.plan_id != plan_id or status.state not in (DriverStatus.LOADED, DriverStatus.RUNNING, DriverStatus.DONE):
                raise StressbotError(ErrorCode.BACKEND_FAILURE, "driver", status.error_msg or "was stopped by somebody else")
            return status.state == DriverStatus.DONE

        def moving() -> None:
            if time.monotonic() - latest[0] > STALLED_AFTER:
                raise TimeoutError(f"no progress of the driver for {STALLED_AFTER:g} s")

        client.wait_for(done, float("inf"), "end of the sequence", moving)

    def _records(self, motion: Motion, begin: tuple[int, int]) -> list[Record]:
        program = conversion.program_from_message(self._client.sequence)
        drives = program.epoch_ends - 2
        ends = np.cumsum(program.dwells)[drives]

        def measured() -> list[SwarmPoses]:
            found = [message for message in list(self._client.poses) if _time(message) >= begin]
            return found if found and found[-1].sequence_time >= ends[-1] else []

        # The driver's word of the end overtakes poses that still queue up here.
        messages = self._client.wait_for(measured, SEEN_WITHIN, "poses up to the end")
        records = cut(
            motion[0],
            ends - program.dwells[drives],
            ends,
            np.array([message.sequence_time for message in messages]),
            np.array([self._poses(message) for message in messages]).reshape(-1, self.scene.swarm.n, 3),
        )
        if min(len(record.times) for record in records) < LEAST_FRAMES:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                "swarm_poses",
                f"came less than {LEAST_FRAMES} times within an activation: lower the driver's real_time_factor or raise its "
                "pose_rate",
            )
        return records

    def _poses(self, message: SwarmPoses) -> np.ndarray:
        poses = np.full((self.scene.swarm.n, 3), np.nan)
        rows = [self.scene.row(robot, "swarm_poses.ids") for robot in message.ids]
        unit = self.scene.unit
        poses[rows] = np.column_stack([np.asarray(message.x) / unit, np.asarray(message.y) / unit, message.heading])
        return poses


def _time(message: DriverStatus | SwarmPoses) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


def calibrate(client: SwarmClient, output: Path, precision: float) -> int:
    """Measure the robots, write the file, say what was found; return the exit code.

    Raises:
        StressbotError, TimeoutError: with the reason.
    """
    bench = Bench(client)
    scene = bench.scene
    print(f"{scene.name}: {scene.swarm.n} robots in {scene.swarm.m} groups; driving", flush=True)
    bench.measure()
    driven = 0.0

    def drive(motion: Motion) -> list[Record]:
        nonlocal driven
        records = bench.drive(motion)
        driven += client.driver_status.duration
        print(f"  {driven:.0f} s: groups {', '.join(map(str, motion[0]))}", flush=True)
        return records

    estimates, _ = identify(scene.swarm, scene.environment, bench.measure, drive, precision)
    places = bench.measure()[:, :2]
    described = scenario.Scenario(
        scene.name,
        scene.unit,
        Problem(scene.swarm, scene.environment, scene.starts, scene.goals, exchangeable=scene.exchangeable),
        scene.electrical,
    )
    swarm_file.write(output, swarm_file.calibrated(described, estimates, places, CONFIDENCE))
    print(*table(estimates), f"{output}: calibrated in {driven:.0f} s on the substrate", sep="\n")
    for one, two in look_alikes(estimates):
        print(f"calibrate: robots {one} and {two} answer to the same groups and turn alike: take one away", file=sys.stderr)
    try:
        scenario.load(output)
    except StressbotError as error:
        print(f"calibrate: {output} must be changed before it is used: {error}", file=sys.stderr)
        return FAILED
    return FAILED if look_alikes(estimates) else 0


def table(estimates: Sequence[Estimate]) -> list[str]:
    """Return lines for people, units of the scenario and degrees, 95 % intervals."""
    lines = [f"{'robot':>5}  {'speed':>18}  {'turning radius':>18}  {'heading bias (deg)':>18}  {'missed':>9}  fault"]
    for found in estimates:
        bias = found.heading_bias
        cells = [
            str(found.speed or "unknown"),
            str(found.turning_radius or "unknown"),
            f"{np.degrees(bias.value):.2f} ± {np.degrees(bias.half_width):.2f}" if bias else "unknown",
        ]
        missed = f"{found.missed}/{found.trials.sum()}"
        fault = str(found.fault) + (f": {found.codeword}" if found.fault and found.trials.any() else "")
        lines.append(f"{found.robot:>5}  " + "  ".join(f"{cell:>18}" for cell in cells) + f"  {missed:>9}  {fault}".rstrip())
    return lines


def main() -> None:
    """Entry point of `ros2 run stressbot_planner calibrate`."""
    parser = argparse.ArgumentParser(
        prog="calibrate",
        description="Measure speed, turning radius, heading bias and group faults of the robots of the driver that is up: "
        "drives them through a short sequence, on and off their places, and writes a scenario file. Driver and sequencer must "
        "be running.",
    )
    parser.add_argument("--output", type=Path, default=Path("swarm.yaml"), metavar="FILE", help="default: %(default)s")
    parser.add_argument(
        "--precision", type=float, default=0.005, metavar="P",
        help="half of the 95 %% interval of speeds and radii, relative, that is good enough (default: %(default)s)",
    )
    sys.exit(_run(parser.parse_args(remove_ros_args(sys.argv)[1:])))


def _run(args: argparse.Namespace) -> int:
    def interrupt(*_):
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    try:
        check_positive("--precision", args.precision)
        with SwarmClient("calibrate") as client:
            try:
                return calibrate(client, args.output, args.precision)
            except BaseException:
                _stop(client)
                raise
    except KeyboardInterrupt:
        print("calibrate: interrupted", file=sys.stderr)
        return INTERRUPTED
    except StressbotError as error:
        print(f"calibrate: {error}", file=sys.stderr)
        return BAD_INPUT
    except TimeoutError as error:
        print(f"calibrate: {error}", file=sys.stderr)
        return FAILED


def _stop(client: SwarmClient) -> None:
    """Leave nothing running that this command has started."""
    status = client.driver_status
    if status is not None and status.state in (DriverStatus.LOADED, DriverStatus.RUNNING):
        client.trigger("stop", ANSWER_WITHIN)
