"""The sequencer node: motion plans in, voltage sequences out. It owns no physics and knows no pose."""

import os
import sys
import traceback
from contextlib import suppress

import numpy as np
from stressbot_msgs.bounds import LONGEST_NAME
from stressbot_msgs.described import Described
from stressbot_msgs.health import OK, WARN, Health, tell_health
from stressbot_msgs.msg import MotionPlan, SequencerStatus, VoltageSequence
from stressbot_msgs.process import ProcessNode, run
from stressbot_msgs.wording import quoted

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.conversion import (
    FRAME,
    Scene,
    check_size,
    poses_from_plan,
    primitive_from_message,
    scene_of,
    sequence_to_message,
)
from stressbot_planner.ros.orders import publish_order
from stressbot_planner.ros.parameters import declare
from stressbot_planner.ros.qos import LATCHED, LIVING, ORDERS
from stressbot_planner.sequencing import VoltageProgram, expand_bounded, volts_of

LIVELINESS = 4
"""Priority of the threads that show life to the driver, whose own is 5."""


class SequencerNode(ProcessNode):
    """Expands the primitives of each plan, encodes the activations and publishes the volts.

    Whether it is ready, and what became of the last plan, stands on the latched topic `sequencer_status`. The last plan whose volts
    were heard stands on `accepted_plan`, which is latched, too: for those who look on, nobody drives by it.
    """

    def __init__(self) -> None:
        _schedule(LIVELINESS)  # for the threads of DDS, which start here, not for the node's own work
        super().__init__("sequencer")
        try:
            declare(self)
        except BaseException:
            self.destroy_node()
            raise
        self._scene: Scene | None = None
        self._refusal: StressbotError | None = None  # of the description
        self._told = SequencerStatus()
        self._sequence_publisher = self.create_publisher(VoltageSequence, "voltage_sequence", ORDERS)
        self._status_publisher = self.create_publisher(SequencerStatus, "sequencer_status", LIVING)
        self._copy_publisher = self.create_publisher(MotionPlan, "accepted_plan", LATCHED)
        self._described = Described(self, self._on_described)
        self.create_subscription(MotionPlan, "motion_plan", self._on_plan, ORDERS)
        tell_health(self, self._health)
        _schedule(0)
        self.get_logger().info("ready: waits for the driver's description")

    def _on_described(self) -> None:
        self._scene, self._refusal = None, None
        try:
            self._scene = scene_of(self._described)
            self.get_logger().info(f"swarm {self._scene.swarm_id} of {self._scene.name!r}: {self._scene.swarm.n} robots")
        except StressbotError as error:
            self._refusal = error
            self.get_logger().warning(f"plans are refused: {error}")
            self._report(code=error.code, text=str(error))
            return
        self._report()

    def _on_plan(self, message: MotionPlan) -> None:
        try:
            check_size(message)
            if self._refusal is not None:
                raise self._refusal
            program = program_of_plan(message, self._scene)
            if program.epoch_count:
                self._publish(program, message)
        except StressbotError as error:
            self.get_logger().warning(f"plan {quoted(message.plan_id)} refused: {error}")
            self._report(message.plan_id, error.code, str(error))
            return
        except Exception as error:
            self.get_logger().error(f"plan {quoted(message.plan_id)}: {traceback.format_exc()}")
            self._report(message.plan_id, ErrorCode.INTERNAL, f"sequencer: a defect ({error!r}): please report it")
            return
        self.get_logger().info(f"plan {message.plan_id}: {program.epoch_count} epochs, {program.duration:.3f} s")
        self._report(message.plan_id, epoch_count=program.epoch_count, duration=program.duration)

    def _publish(self, program: VoltageProgram, plan: MotionPlan) -> None:
        sequence = sequence_to_message(program, plan.plan_id, plan.swarm_id)
        sequence.header.stamp = plan.header.stamp
        if not publish_order(self, self._sequence_publisher, sequence):
            raise StressbotError(
                ErrorCode.NOT_HEARD, "voltage_sequence", "is heard by nobody: start the driver, then plan again"
            )
        self._copy_publisher.publish(plan)

    def _report(
        self, plan_id: str = "", code: ErrorCode = ErrorCode.NONE, text: str = "", epoch_count: int = 0, duration: float = 0.0
    ) -> None:
        status = SequencerStatus(
            swarm_id=self._scene.swarm_id if self._scene else "",
            plan_id=plan_id[:LONGEST_NAME],
            error_code=int(code),
            error_msg=text,
            epoch_count=epoch_count,
            duration=duration,
        )
        status.header.stamp = self.get_clock().now().to_msg()
        status.header.frame_id = FRAME
        self._told = status
        self._status_publisher.publish(status)

    def _health(self) -> Health:
        told = self._told
        figures = {"swarm_id": told.swarm_id, "plan_id": told.plan_id, "epochs": told.epoch_count, "duration": told.duration}
        if told.error_code:
            return WARN, told.error_msg, figures
        if not told.swarm_id:
            return WARN, "waits for the driver's description", figures
        return OK, "takes plans", figures


def program_of_plan(message: MotionPlan, scene: Scene | None) -> VoltageProgram:
    """Return the volts that realise a `motion_plan` for the swarm that is described.

    Raises:
        StressbotError: the plan is for another swarm, or one of its primitives is refused, naming it.
    """
    if not message.plan_id:
        raise StressbotError(ErrorCode.INVALID_PLAN, "plan_id", "is empty: give the plan a name")
    if scene is None:
        raise StressbotError(ErrorCode.NO_SWARM, "swarm_description", "has not arrived: start the driver, then plan again")
    if message.swarm_id != scene.swarm_id:
        raise StressbotError(
            ErrorCode.WRONG_SWARM,
            "swarm_id",
            f"is {quoted(message.swarm_id)}, on the bench lies '{scene.swarm_id}': plan again for this swarm",
        )
    scene = scene.pulsed_at(message.frequency)
    primitives = []
    for index, item in enumerate(message.primitives):
        try:
            primitives.append(primitive_from_message(item, scene))
        except StressbotError as error:
            raise StressbotError(error.code, f"primitives[{index}].{error.field}", error.message) from error
    return volts_of(scene.swarm, scene.electrical, _starts(message, scene), *expand_bounded(scene.swarm, primitives))


def _starts(message: MotionPlan, scene: Scene) -> np.ndarray:
    """Return the poses (n, 3) that a plan starts from, units and rad: whole pulses depend on them, though little.

    Those that the driver describes, if the plan does not say.
    """
    if not message.start:
        return scene.starts
    if len(message.start) != 3 * scene.swarm.n:
        raise StressbotError(
            ErrorCode.WRONG_COUNT, "start", f"has {len(message.start)} entries: {scene.swarm.n} robots need {3 * scene.swarm.n}"
        )
    starts = poses_from_plan(message, scene)[0]
    if not np.isfinite(starts).all():
        raise StressbotError(ErrorCode.NOT_FINITE, "start", "holds numbers that are not finite: give the poses of the plan")
    return starts


def _schedule(priority: int) -> None:
    """Let this thread, and those that it will start, run in real time if they may; 0: as others do."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO if priority else os.SCHED_OTHER, os.sched_param(priority))


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_planner sequencer`."""
    sys.exit(run("sequencer", SequencerNode, args=args))
