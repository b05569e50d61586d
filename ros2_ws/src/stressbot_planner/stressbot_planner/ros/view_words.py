"""What nodes say, as the page's plain data: of live nodes and of recordings alike."""

from typing import Any

import numpy as np
from stressbot_msgs.action import MoveSwarm, PlanMotion
from stressbot_msgs.msg import DriverStatus, MotionPlan, SwarmPoses, VoltageSequence

from stressbot_planner.errors import ErrorCode
from stressbot_planner.ros.conversion import Scene, measured_poses, program_from_message
from stressbot_planner.ros.unfolding import activations_of_plan, ends_of_plan
from stressbot_planner.sequencing import decode
from stressbot_planner.view import scene as model

SIMULATED = "simulated"
SIMULATION, INSTRUMENT = "SIMULATION", "INSTRUMENT"

STATES = {
    DriverStatus.IDLE: ("IDLE", "at rest: drag goals, then plan"),
    DriverStatus.LOADED: ("LOADED", "at rest: a checked plan waits for start"),
    DriverStatus.RUNNING: ("RUNNING", "volts are on: stop brings them to zero at once"),
    DriverStatus.DONE: ("DONE", "at rest, the plan ran to its end: plan again from here, or reset"),
    DriverStatus.STOPPED: ("STOPPED", "at rest before the end: plan again from where the robots lie"),
    DriverStatus.FAULT: ("FAULT", "at rest: see to what is said here, then reset"),
}
"""Name of each state of the driver, and what to do."""

NO_DRIVER = {
    "state": "NO DRIVER", "advice": "start one, or a whole simulated system: stressbot view SCENARIO.yaml",
    "backend": "", "place": "", "message": "", "code": "", "missing": [], "plan": "",
    "epoch": 0, "epochs": 0, "t": 0.0, "duration": 0.0, "level": 0.0,
}
AMBIGUOUS = NO_DRIVER | {
    "state": "SEVERAL DRIVERS", "advice": "stop all but one, or give each a namespace or a ROS_DOMAIN_ID of its own",
}

_TIME, _COST = 6, 2


def scene_of(scene: Scene) -> dict[str, Any]:
    """Return the scene that a driver describes."""
    bias = None if scene.calibration is None else scene.calibration.heading_bias
    calibrated = None if bias is None else np.isfinite(bias).tolist()
    return model.scene(
        scene.name, scene.unit, scene.swarm, scene.environment, scene.electrical, scene.starts, scene.goals, scene.goal_headings,
        scene.waypoints, scene.parked, scene.contacts, scene.ids.tolist(), calibrated,
    )


def status_of(message: DriverStatus) -> dict[str, Any]:
    """Return the driver's state, and what to do about it. Whatever is not surely a simulation is an instrument."""
    state, advice = STATES.get(message.state, (f"STATE {message.state}", "this driver is newer than this page"))
    if message.missing:
        advice = f"start is refused until these come: {', '.join(message.missing)}" if state != "FAULT" else advice
    code = message.error_code
    return {
        "state": state,
        "advice": advice,
        "backend": message.backend,
        "place": SIMULATION if message.backend == SIMULATED else INSTRUMENT,
        "message": message.error_msg,
        "code": "" if not code else ErrorCode(code).name if code in set(ErrorCode) else str(code),
        "missing": list(message.missing),
        "plan": message.plan_id,
        "epoch": message.epoch,
        "epochs": message.epoch_count,
        "t": round(_finite(message.sequence_time), _TIME),
        "duration": round(_finite(message.duration), _TIME),
        "level": _finite(message.output_level),
    }


def poses_of(message: SwarmPoses, scene: Scene) -> np.ndarray:
    """Return poses (n, 3), µm and rad, NaN for robots that were not seen. Raises StressbotError as `measured_poses`."""
    scale = scene.unit * model.MICRO
    return measured_poses(message, scene) * (scale, scale, 1.0)


def frame_of(poses: np.ndarray, time: float) -> dict[str, Any]:
    """Return poses (n, 3), µm and rad, in a row, null for robots that were not seen; time: s since the sequence started."""
    flat = np.round(poses, model.PLACE if len(poses) else 0)
    flat[:, 2] = np.round(poses[:, 2], model.ANGLE)
    values = flat.ravel().tolist()
    if not np.isfinite(flat).all():
        values = [value if np.isfinite(value) else None for value in values]
    return {"t": round(_finite(time), _TIME), "p": values}


def motion_of(plan: MotionPlan, sequence: VoltageSequence | None, scene: Scene) -> dict[str, Any]:
    """Return a plan, with the activations of its sequence once the newest one is that: these are what drives.

    Raises:
        StressbotError: plan or sequence are refused.
    """
    swarm, scale = scene.swarm, scene.unit * model.MICRO
    starts, goals = ends_of_plan(plan, scene)
    signs = None
    if sequence is None or sequence.plan_id != plan.plan_id:
        groups, lengths = activations_of_plan(plan, scene)
    else:
        program = program_from_message(sequence)
        groups, lengths = decode(swarm, scene.electrical, program)
        signs = model.signs_of(program)
    return model.motion(
        scale,
        starts,
        goals,
        groups,
        lengths,
        signs,
        plan=plan.plan_id,
        planner=plan.planner,
        solved=True,
        path=round(model.MICRO * _finite(plan.path_length), model.PLACE),
        clearance=round(model.MICRO * plan.min_clearance, model.PLACE) if np.isfinite(plan.min_clearance) else None,
    )


def planning_of(feedback: PlanMotion.Feedback) -> dict[str, Any]:
    """Return how far a search has got."""
    return {
        "elapsed": round(feedback.elapsed, 2),
        "tries": feedback.tries,
        "found": feedback.found,
        "path": round(model.MICRO * _finite(feedback.path_length), _COST),
        "driving": round(_finite(feedback.execution_time), _COST),
    }


def moving_of(message: MoveSwarm.Feedback | MoveSwarm.Result) -> dict[str, Any]:
    """Return how far a closed loop has got, or how it has ended."""
    return {
        "progress": round(_finite(getattr(message, "progress", 1.0)), 4),
        "errors": {
            str(robot): round(model.MICRO * _finite(error), model.PLACE)
            for robot, error in zip(message.robots, message.errors, strict=False)
        },
        "stuck": list(message.stuck),
        "activations": message.activations,
        "plans": message.plans,
        "corrections": message.corrections,
    }


def _finite(value: float) -> float:
    return float(value) if np.isfinite(value) else 0.0
