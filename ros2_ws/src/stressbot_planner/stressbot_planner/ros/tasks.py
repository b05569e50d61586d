"""From a request to the task of a planner, in the units of the library."""

from dataclasses import replace
from math import inf

from stressbot_msgs.action import PlanMotion as PlanMotionAction
from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.srv import PlanMotion

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.execution.worker import Task
from stressbot_planner.model.whole_pulses import contact_depth
from stressbot_planner.planners import LONGEST_REQUEST, Settings
from stressbot_planner.ros.conversion import Scene, starts_from_poses
from stressbot_planner.ros.goals import check_measured, goals_of_request


def task_of_request(
    request: PlanMotion.Request | PlanMotionAction.Goal, scene: Scene, poses: SwarmPoses, planner: str
) -> Task:
    """Return what `plan_motion` asks for, from measured poses; `planner` is that of requests that name none.

    Raises:
        StressbotError: naming the field of the request or of the poses. Whether starts and goals are possible is for `Problem`.
    """
    if request.planner:
        planners.check_known(request.planner)
    if LONGEST_REQUEST < request.time_limit < inf:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE,
            "time_limit",
            f"is {request.time_limit:g} s: give at most {LONGEST_REQUEST:g} s (`stressbot plan` takes longer ones)",
        )
    settings = Settings(
        objective=request.objective,
        time_limit=request.time_limit,
        first=request.first,
        min_clearance=request.min_clearance,
        max_epochs=request.max_epochs or None,
        max_tries=request.max_tries or None,
        selection_time=scene.electrical.selection_time,
        pulse_length=scene.electrical.pulse_length(scene.swarm.speed),
        order=request.order or None,
        seed=request.seed,
    )
    starts = starts_from_poses(poses, scene)
    check_measured(scene, starts)
    goals = goals_of_request(request, scene, starts)
    return Task(
        swarm=scene.swarm,
        environment=scene.environment,
        starts=starts,
        goals=goals.places,
        tolerance=request.tolerance / scene.unit,
        planner=request.planner or planner,
        settings=replace(settings, min_clearance=request.min_clearance / scene.unit),
        exchangeable=goals.exchangeable,
        goal_headings=goals.headings,
        parked=goals.parked,
        waypoints=goals.waypoints,
        contacts=scene.contacts,
        contact_depth=contact_depth(settings.pulse_length),
    )
