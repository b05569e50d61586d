"""From a request to the task of a planner, in the units of the library."""

from dataclasses import replace

from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.srv import PlanMotion

from stressbot_planner.planners import Settings
from stressbot_planner.ros.conversion import Scene, starts_from_poses
from stressbot_planner.ros.goals import goals_of_request
from stressbot_planner.swarm import check_positive
from stressbot_planner.worker import Task


def task_of_request(request: PlanMotion.Request, scene: Scene, poses: SwarmPoses, planner: str) -> Task:
    """Return what `plan_motion` asks for, from measured poses; `planner` is that of requests that name none.

    Raises:
        StressbotError: naming the field of the request or of the poses. Whether starts and goals are possible is for `Problem`.
    """
    check_positive("tolerance", request.tolerance)
    settings = Settings(
        objective=request.objective,
        time_limit=request.time_limit,
        max_tries=request.max_tries or None,
        first=request.first,
        min_clearance=request.min_clearance,
        max_epochs=request.max_epochs or None,
        selection_time=scene.electrical.selection_time,
        order=request.order or None,
        seed=request.seed,
    )
    starts = starts_from_poses(poses, scene)
    goals, exchangeable = goals_of_request(request, scene, starts)
    return Task(
        swarm=scene.swarm,
        environment=scene.environment,
        starts=starts,
        goals=goals,
        tolerance=request.tolerance / scene.unit,
        planner=request.planner or planner,
        settings=replace(settings, min_clearance=request.min_clearance / scene.unit),
        exchangeable=exchangeable,
    )
