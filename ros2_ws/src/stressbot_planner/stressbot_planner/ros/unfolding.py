"""What a `motion_plan` makes robots do: where it begins, where it leads, and the activations between."""

import numpy as np
from stressbot_msgs.msg import MotionPlan

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.conversion import Scene, primitive_from_message
from stressbot_planner.sequencing import expand_bounded


def ends_of_plan(plan: MotionPlan, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return starts (n, 3) and goals (n, 2), units and rad; the scene's own goals where the plan has none.

    Raises:
        StressbotError: WRONG_COUNT, NOT_FINITE.
    """
    n = scene.swarm.n
    if len(plan.start) != 3 * n or len(plan.goal) not in (0, 2 * n):
        raise StressbotError(ErrorCode.WRONG_COUNT, "motion_plan", f"is not one of {n} robots")
    starts = np.reshape(plan.start, (n, 3)) / (scene.unit, scene.unit, 1.0)
    goals = np.reshape(plan.goal, (n, 2)) / scene.unit if len(plan.goal) else scene.goals
    if not np.isfinite(starts).all() or not np.isfinite(goals).all():
        raise StressbotError(ErrorCode.NOT_FINITE, "motion_plan", "has starts or goals that are no numbers")
    return starts, goals


def activations_of_plan(plan: MotionPlan, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return groups (K,) and lengths (K,), units. Raises StressbotError as `expand_bounded` does, or for a primitive's message."""
    return expand_bounded(scene.swarm, [primitive_from_message(item, scene) for item in plan.primitives])
