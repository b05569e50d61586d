"""The substrate as a client of sequencer and driver sees it: drive activations, look at the robots."""

import time
import uuid
from collections.abc import Callable

import numpy as np
from stressbot_msgs.described import AMBIGUOUS, TOPIC
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses
from stressbot_msgs.stamps import nanoseconds

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.calibration import LEAST_FRAMES, Record, cut, rest_poses
from stressbot_planner.estimation.identification import Motion
from stressbot_planner.model.kinematics import replay
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.ros import conversion
from stressbot_planner.ros.client import SwarmClient
from stressbot_planner.ros.orders import publish_order
from stressbot_planner.ros.qos import ORDERS
from stressbot_planner.sequencing import decode

_INSTANT = 1e-9
"""s; times this close are the same."""

READY_WITHIN = 20.0
ALONE_WITHIN = 3.0
ANSWER_WITHIN = 20.0
STALLED_AFTER = 60.0
"""s; the second for a driver that was killed and started again, the last without any progress of the driver."""

REST_FRAMES = 25
"""Number of measurements that poses at rest are the mean of, unless told otherwise."""

SEEN_WITHIN = 10.0
"""s; a robot that the tracker loses is waited for so long, unless told otherwise."""


def stop(client: SwarmClient) -> None:
    """Leave nothing running, nor about to."""
    status = client.driver_status
    if status is not None and status.state in (DriverStatus.LOADED, DriverStatus.RUNNING):
        client.trigger("stop", ANSWER_WITHIN)


class RemoteBench:
    """The substrate, as a client of sequencer and driver."""

    def __init__(
        self,
        client: SwarmClient,
        name: str,
        rest_frames: int = REST_FRAMES,
        seen_within: float = SEEN_WITHIN,
        meanwhile: Callable[[], None] = lambda: None,
        seen: bool = True,
    ):
        """Wait for driver and sequencer.

        Args:
            client: the topics and services.
            name: who makes the plans, as it stands in them.
            rest_frames: how many poses make a measurement at rest.
            seen_within: s, how long a robot that the tracker loses is waited for.
            meanwhile: called a few times a second while something is waited for; may raise to give up.
            seen: whether a tracker has to know robots already.

        Raises:
            TimeoutError: one of them is missing.
            StressbotError: BUSY if a sequence is running; AMBIGUOUS_SWARM if more than one driver is alive; what a description may
                be refused for.
        """
        self._client, self._name, self._meanwhile = client, name, meanwhile
        self._rest_frames, self._seen_within = rest_frames, seen_within
        self._plans = client.node.create_publisher(MotionPlan, "motion_plan", ORDERS)
        begin = time.monotonic()

        def alone() -> None:
            meanwhile()
            if client.drivers > 1 and time.monotonic() > begin + ALONE_WITHIN:
                raise StressbotError(ErrorCode.AMBIGUOUS_SWARM, TOPIC, AMBIGUOUS)

        what = "driver, sequencer and poses" if seen else "driver, which runs without poses, and sequencer"
        client.wait_for(lambda: client.is_bench_ready(seen), READY_WITHIN, what, alone)
        if client.driver.state == DriverStatus.RUNNING:
            raise StressbotError(ErrorCode.BUSY, "driver_status", "a sequence is running: wait for its end, or call stop")
        self._described = self.scene = conversion.scene_from_description(client.swarm)
        self._frequency = 0.0
        self._seen = np.zeros(self.scene.swarm.n, dtype=bool)
        self._last = np.full((self.scene.swarm.n, 3), np.nan)

    def pulse_at(self, frequency: float) -> None:
        """Drive with pulses of that frequency from now on, Hz; 0: as described. `scene` has the speeds that follow.

        Raises:
            StressbotError: as `Scene.pulsed_at`.
        """
        self.scene, self._frequency = self._described.pulsed_at(frequency), frequency

    def measure(self) -> np.ndarray:
        """Return the poses at rest, shape (n, 3), units and rad; NaN for a robot that the tracker does not show."""
        client = self._client
        client.forget_poses()
        deadline = time.monotonic() + self._seen_within
        since = nanoseconds(client.driver.header.stamp)  # what still queues up may be older

        def frames() -> list[np.ndarray]:
            at_rest = client.driver.sequence_time
            return [
                conversion.measured_poses(message, self.scene)
                for message in client.poses
                if message.sequence_time >= at_rest and nanoseconds(message.header.stamp) >= since
            ]

        def enough() -> tuple[np.ndarray] | None:
            found = frames()
            if len(found) < self._rest_frames:
                return None
            poses = rest_poses(found)
            is_missed = (self._seen & np.isnan(poses[:, 0])).any()
            return None if is_missed and time.monotonic() <= deadline else (poses,)

        (poses,) = client.wait_for(enough, 2 * SEEN_WITHIN, "poses", self._meanwhile)
        self._seen |= np.isfinite(poses[:, 0])
        self._last = poses
        return poses

    def drive(self, motion: Motion) -> list[Record]:
        """Put activations on the substrate, wait for their end and return what was seen of each.

        Raises:
            TimeoutError: no answer, or no progress.
            StressbotError: a refusal of sequencer or driver; OUT_OF_RANGE if poses come too rarely.
        """
        return self._records(self.play(motion))

    def drive_and_look(self, motion: Motion) -> list[tuple[int, float, np.ndarray]]:
        """Put activations on the substrate, wait for their end and return what each epoch did: group, length, poses (n, 3) after.

        NaN for robots that were not seen between the end of an epoch and the beginning of the next. Raises as `drive`.
        """
        begin = self.play(motion)
        groups, lengths, first, last = self._epochs()
        poses = np.full((len(last), self.scene.swarm.n, 3), np.nan)
        for message in list(self._client.poses):
            if nanoseconds(message.header.stamp) < begin:
                continue
            k = int(np.searchsorted(last, message.sequence_time + _INSTANT, "right")) - 1
            # behind the end of a drive, and not yet in the next
            if k >= 0 and (k + 1 == len(last) or message.sequence_time <= first[k + 1]):
                seen = conversion.measured_poses(message, self.scene)
                poses[k] = np.where(np.isfinite(seen), seen, poses[k])
        poses[-1] = self.measure()
        return list(zip(groups.tolist(), lengths.tolist(), poses, strict=True))

    def play(self, motion: Motion) -> int:
        """Put activations on the substrate, wait for their end, and return the time since which poses belong to them.

        Raises TimeoutError and StressbotError as `drive`.
        """
        client = self._client
        plan = self._plan(motion)
        client.forget_poses()
        if not publish_order(client.node, self._plans, plan):
            raise StressbotError(ErrorCode.NOT_HEARD, "motion_plan", "is heard by nobody: start the sequencer")

        def loaded() -> bool:
            sequencer, driver = client.sequencer, client.driver
            if sequencer.plan_id == plan.plan_id and sequencer.error_code:
                raise StressbotError(ErrorCode(sequencer.error_code), "sequencer", sequencer.error_msg)
            if driver.refused_plan_id == plan.plan_id:
                raise StressbotError(ErrorCode(driver.error_code), "driver", driver.error_msg)
            known = client.sequence is not None and client.sequence.plan_id == plan.plan_id
            return known and driver.plan_id == plan.plan_id

        client.wait_for(loaded, ANSWER_WITHIN, "sequence loaded by the driver", self._meanwhile)
        # What was measured before belongs to another sequence, and has its times.
        begin = nanoseconds(client.driver.header.stamp)
        if client.driver.state == DriverStatus.LOADED:  # otherwise it starts by itself
            answer = client.trigger("start", ANSWER_WITHIN, self._meanwhile)
            if not answer.success:
                code = ErrorCode(client.driver.error_code) or ErrorCode.NOTHING_LOADED
                raise StressbotError(code, "driver", answer.message)
        self._watch(plan.plan_id)
        return begin

    def _plan(self, motion: Motion) -> MotionPlan:
        scene, (groups, lengths) = self.scene, motion
        start = np.where(np.isnan(self._last), scene.starts, self._last)
        unit = (scene.unit, scene.unit, 1.0)
        return MotionPlan(
            plan_id=uuid.uuid4().hex,
            swarm_id=scene.swarm_id,
            planner=self._name,
            frequency=self._frequency,
            primitives=[conversion.primitive_to_message(primitive, scene) for primitive in as_primitives(groups, lengths)],
            start=(start * unit).ravel().tolist(),
            predicted=(replay(scene.swarm, start, groups, lengths)[-1] * unit).ravel().tolist(),
            execution_time=float(lengths.sum()) / scene.swarm.speed,
            selection_time=scene.electrical.selection_time * len(groups),
        )

    def _watch(self, plan_id: str) -> None:
        client, latest = self._client, (time.monotonic(), -1.0)

        def done() -> bool:
            nonlocal latest
            status = client.driver
            if status.sequence_time != latest[1]:
                latest = (time.monotonic(), status.sequence_time)
            if status.plan_id != plan_id or status.state not in (DriverStatus.LOADED, DriverStatus.RUNNING, DriverStatus.DONE):
                code = ErrorCode(status.error_code) if status.state == DriverStatus.FAULT else ErrorCode.BACKEND_FAILURE
                raise StressbotError(code, "driver", status.error_msg or "was stopped by somebody else")
            return status.state == DriverStatus.DONE

        def moving() -> None:
            self._meanwhile()
            if not client.drivers:
                raise StressbotError(ErrorCode.NO_SWARM, "driver", "has died: start it again")
            if time.monotonic() - latest[0] > STALLED_AFTER:
                raise TimeoutError(f"no progress of the driver for {STALLED_AFTER:g} s")

        client.wait_for(done, float("inf"), "end of the sequence", moving)

    def _records(self, begin: int) -> list[Record]:
        groups, _, begins, ends = self._epochs()

        def measured() -> list[SwarmPoses]:
            found = [message for message in list(self._client.poses) if nanoseconds(message.header.stamp) >= begin]
            return found if found and found[-1].sequence_time >= ends[-1] else []

        # The driver's word of the end overtakes poses that still queue up here.
        messages = self._client.wait_for(measured, self._seen_within, "poses up to the end", self._meanwhile)
        records = cut(
            groups,
            begins,
            ends,
            np.array([message.sequence_time for message in messages]),
            np.array([conversion.measured_poses(message, self.scene) for message in messages]).reshape(-1, self.scene.swarm.n, 3),
        )
        if min(len(record.times) for record in records) < LEAST_FRAMES:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                "swarm_poses",
                f"came less than {LEAST_FRAMES} times within an activation: lower the driver's real_time_factor or raise its "
                "pose_rate",
            )
        return records

    def _epochs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return group, length (units), begin and end of the drive (s since the start) of each epoch of the last sequence.

        They are those of the volts themselves, since an activation of no length has no epoch.
        """
        program = conversion.program_from_message(self._client.volts)
        groups, lengths = decode(self.scene.swarm, self.scene.electrical, program)
        drives = program.epoch_ends - 2
        ends = np.cumsum(program.dwells)[drives]
        return groups, lengths, ends - program.dwells[drives], ends
