"""Messages from and to the driver's own values. Large arrays go through `array.array`, which rclpy copies whole."""

from array import array

import numpy as np
from stressbot_msgs.msg import (
    DriverStatus,
    ElectricalDescription,
    Obstacle,
    SwarmDescription,
    SwarmPoses,
)
from stressbot_msgs.msg import (
    VoltageSequence as VoltageSequenceMsg,
)
from stressbot_msgs.stamps import nanoseconds

from stressbot_driver.bench import Bench, Circle, Electrical, Polygon
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import VoltageSequence
from stressbot_driver.session import Status
from stressbot_driver.simulation.substrate import Poses

FRAME = "substrate"


def doubles(values: np.ndarray) -> array:
    """`float64[]` of an array, flattened row by row."""
    flat = array("d")
    flat.frombytes(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return flat


def _unsigned(values: np.ndarray) -> array:
    """`uint32[]` of an array; array's "I" has four bytes on every platform of ROS 2."""
    flat = array("I")
    flat.frombytes(np.ascontiguousarray(values, dtype=np.uint32).tobytes())
    return flat


def description_message(bench: Bench) -> SwarmDescription:
    """`swarm_description` of a bench, without a stamp."""
    message = SwarmDescription(
        name=bench.name,
        swarm_id=bench.swarm_id,
        length_unit=bench.length_unit,
        ids=_unsigned(bench.ids),
        speed=doubles(bench.speed),
        turning_radius=doubles(bench.turning_radius),
        body_radius=doubles(bench.body_radius),
        group_count=bench.group_count,
        codewords=list(bench.codewords),
        start=doubles(bench.start),
        goal=doubles(bench.goal),
        goal_heading=doubles(bench.goal_heading if np.isfinite(bench.goal_heading).any() else np.empty(0)),
        assign=_unsigned(bench.assign),
        waypoint=doubles(bench.waypoint),
        contact=_unsigned(bench.contact),
        parked=_unsigned(bench.parked),
        workspace=doubles(bench.workspace) if bench.workspace is not None else array("d"),
        obstacles=[_obstacle_message(obstacle) for obstacle in bench.obstacles],
        electrical=_electrical_message(bench.electrical),
        **{name: doubles(values) for name, values in vars(bench.calibration).items()} if bench.calibration else {},
    )
    message.header.frame_id = FRAME
    return message


def _obstacle_message(obstacle: Circle | Polygon) -> Obstacle:
    if isinstance(obstacle, Circle):
        x, y = obstacle.center
        return Obstacle(kind=Obstacle.CIRCLE, x=array("d", [x]), y=array("d", [y]), radius=obstacle.radius)
    return Obstacle(kind=Obstacle.POLYGON, x=doubles(obstacle.corners[:, 0]), y=doubles(obstacle.corners[:, 1]))


def _electrical_message(electrical: Electrical) -> ElectricalDescription:
    values = dict(vars(electrical))
    codes, drive = values.pop("codes"), values.pop("drive")
    if drive is not None:
        values |= vars(drive)
    values["symbol_levels"] = doubles(electrical.symbol_levels)
    values["thresholds"] = doubles(electrical.thresholds)
    values["pull_downs"] = doubles(electrical.pull_downs)
    return ElectricalDescription(code_length=codes.shape[1], codes=array("B", codes.tobytes()), **values)


def poses_message(swarm_id: str, time: float, poses: Poses) -> SwarmPoses:
    """`swarm_poses` at sequence time `time` [s], without a stamp."""
    message = SwarmPoses(
        swarm_id=swarm_id,
        sequence_time=time,
        ids=_unsigned(poses.ids),
        x=doubles(poses.x),
        y=doubles(poses.y),
        heading=doubles(poses.heading),
    )
    message.header.frame_id = FRAME
    return message


def sequence_from_message(message: VoltageSequenceMsg) -> VoltageSequence:
    """The driver's value of a `voltage_sequence`; unchecked. Raises StressbotError OUT_OF_RANGE for a stamp that is no time."""
    stamp = message.header.stamp
    if stamp.sec < 0 or stamp.nanosec >= 1_000_000_000:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "header.stamp", f"is {stamp.sec} s and {stamp.nanosec} ns: send the time of the poses, or 0"
        )
    return VoltageSequence(
        plan_id=message.plan_id,
        swarm_id=message.swarm_id,
        levels=_read_only(message.levels, np.float64),
        dwells=_read_only(message.dwells, np.float64),
        epoch_ends=_read_only(message.epoch_ends, np.int64),
        duration=message.duration,
        stamp=nanoseconds(stamp),
        pulses=_read_only(message.pulses, np.uint64),
        low_levels=_read_only(message.low_levels, np.float64),
        duty=message.duty,
        alternating=message.alternating,
    )


def _read_only(values: array, dtype: type) -> np.ndarray:
    copy = np.array(values, dtype=dtype)
    copy.setflags(write=False)
    return copy


def status_message(backend: str, status: Status) -> DriverStatus:
    """`driver_status`, without a stamp."""
    message = DriverStatus(
        state=int(status.state),
        backend=backend,
        plan_id=status.plan_id,
        epoch=status.epoch,
        epoch_count=status.epoch_count,
        sequence_time=status.sequence_time,
        duration=status.duration,
        output_level=status.output_level,
        error_code=int(status.error_code),
        error_msg=status.error_msg,
        missing=list(status.missing),
        refused_plan_id=status.refused_plan_id,
    )
    message.header.frame_id = FRAME
    return message
