"""Orders: what planner, sequencer, mover, viewer and paths do with requests, plans, descriptions and poses."""

from functools import partial
from math import pi

import numpy as np
from driver_support import bench
from hypothesis import strategies as st
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import ElectricalDescription, MotionPlan, Obstacle, Primitive, SwarmDescription, SwarmPoses
from stressbot_msgs.srv import PlanMotion

from fuzzing.files import FOLDER
from fuzzing.interface import Interface, Violation, outcome
from fuzzing.strategies import NAMES, NUMBERS, fields_of, messages
from stressbot_driver.backends.simulated import SimulatedBackend
from stressbot_driver.bench import load_bench
from stressbot_driver.ros.checks import check_description, check_poses
from stressbot_driver.ros.conversions import description_message, poses_message, sequence_from_message
from stressbot_driver.ros.markers import fixed_markers, robot_markers
from stressbot_driver.sequence import check_sequence
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.errors import StressbotError
from stressbot_planner.execution.worker import perform
from stressbot_planner.planners import names
from stressbot_planner.problem.definition import Problem
from stressbot_planner.ros.conversion import Scene, measured_poses, scene_from_description, sequence_to_message
from stressbot_planner.ros.goals import goals_of_request, in_words, named_for_request
from stressbot_planner.ros.sequencer_node import program_of_plan
from stressbot_planner.ros.standard_messages import anew, lines, path_message
from stressbot_planner.ros.tasks import task_of_request
from stressbot_planner.ros.unfolding import activations_of_plan, ends_of_plan
from stressbot_planner.view.plan_paths import LONGEST, plan_paths

BENCH = load_bench(FOLDER / "paper-six-two-discs.yaml")
DESCRIPTION = description_message(BENCH)
SCENE = scene_from_description(DESCRIPTION)
MANY = scene_from_description(
    description_message(
        bench(30, **{"swarm.groups": [f"{1 << k:030b}" for k in range(30)], "electrical.symbol_levels": [40.0, 60.0]})
    )
)
"""A swarm in which every robot has a group of its own."""
POSES = poses_message(BENCH.swarm_id, 0.0, Substrate(BENCH).poses())
UNIT = BENCH.length_unit

# What arrives


def descriptions() -> st.SearchStrategy[SwarmDescription]:
    """Of a swarm, most of them nearly right."""
    obstacles = st.lists(
        st.one_of(
            messages(Obstacle, kind=Obstacle.CIRCLE, x=[30 * UNIT], y=[30 * UNIT], radius=UNIT),
            messages(Obstacle, kind=Obstacle.POLYGON, x=[-4e-3, -3.8e-3, -3.9e-3], y=[-4e-3, -4e-3, -3.8e-3]),
        ),
        max_size=3,
    )
    electrical = messages(ElectricalDescription, **_plain(DESCRIPTION.electrical))
    full = messages(SwarmDescription, **{**_plain(DESCRIPTION), "obstacles": obstacles, "electrical": electrical})
    return st.one_of(full, full, full, messages(SwarmDescription, length_unit=UNIT, electrical=electrical))


def poses() -> st.SearchStrategy[SwarmPoses]:
    """Of the six robots, some twice, some unknown, some missing."""
    rows = st.lists(st.integers(0, 7), max_size=9) | st.permutations(range(6))
    some = rows.flatmap(
        lambda chosen: messages(
            SwarmPoses,
            swarm_id=BENCH.swarm_id,
            ids=[row + 1 for row in chosen],
            x=[float((*POSES.x, 0.0, 1.0)[row]) for row in chosen],
            y=[float((*POSES.y, 0.0, 1.0)[row]) for row in chosen],
            heading=[0.0 for _ in chosen],
        )
    )
    return st.one_of(messages(SwarmPoses, 1, **_plain(POSES)), some)


def _plain(message: object) -> dict:
    """Fields, but for the header, which nobody reads."""
    return {
        name: list(value) if hasattr(value, "typecode") else value for name, value in fields_of(message).items() if name != "header"
    }


_ROBOTS = st.lists(st.integers(1, 6), max_size=4, unique=True) | st.lists(st.integers(0, 8), max_size=8)
_PLACES = st.one_of(st.floats(-1e-3, 4e-3), NUMBERS)


def _goals(kind: type, **fields: object) -> st.SearchStrategy:
    def of(robots: list[int]) -> st.SearchStrategy:
        def in_stages(stages: int) -> st.SearchStrategy:
            places = st.lists(_PLACES, min_size=stages * len(robots), max_size=stages * len(robots))
            return messages(kind, robots=robots, goal_x=places, goal_y=places, assign=st.booleans(), **fields)

        return st.sampled_from([1, 1, 1, 2, 3]).flatmap(in_stages)

    return _ROBOTS.flatmap(of)


def requests(longest: float, kind: type = PlanMotion.Request) -> st.SearchStrategy:
    """For a plan, of the service or of the action."""
    return _goals(
        kind,
        planner=st.sampled_from(["", *names()]),
        objective=st.sampled_from(["path", "time", "0.5"]),
        tolerance=st.sampled_from([1e-10, 1e-5, 5e-5, 1e-3]),
        order=st.integers(0, 5),
        time_limit=st.floats(1e-3, longest),
        first=st.booleans(),
        min_clearance=st.sampled_from([0.0, 0.0, 1e-6, 1.0]),
        max_epochs=st.sampled_from([0, 0, 1, 30]),
        max_tries=st.sampled_from([0, 0, 1, 30]),
        parked=st.just([]) | _ROBOTS,
    )


def move_goals() -> st.SearchStrategy[MoveSwarm.Goal]:
    """For the mover."""
    return _goals(MoveSwarm.Goal, tolerance=st.sampled_from([3e-5, 1e-3]), time_limit=st.just(1.0) | NUMBERS)


def primitives(robots: int, groups: int) -> st.SearchStrategy[Primitive]:
    """Of a motion plan."""
    few = st.lists(st.integers(1, robots), max_size=4) | st.lists(st.integers(1, robots), max_size=30)
    some = st.lists(st.integers(1, groups), max_size=2) | st.lists(st.integers(1, groups), max_size=30)
    return messages(
        Primitive,
        2,
        kind=st.integers(1, 7),
        group=st.integers(1, groups),
        distance=st.one_of(st.floats(0, 1e-3), NUMBERS),
        angle=st.one_of(st.floats(-2 * pi, 2 * pi), NUMBERS),
        excursion=st.sampled_from([0.0, 0.0, 1e-4, 1e-5, 1e-8]),
        robots=few,
        angles=few.map(lambda robots: [0.1 * robot for robot in robots]),
        inside=some,
        outside=some,
    )


def plans(scene: Scene) -> st.SearchStrategy[MotionPlan]:
    """For the sequencer."""
    one = primitives(scene.swarm.n, scene.swarm.m)
    return messages(
        MotionPlan,
        1,
        plan_id=st.uuids().map(str) | NAMES.filter(lambda text: text.isprintable()),
        swarm_id=scene.swarm_id,
        primitives=st.lists(one, max_size=5) | st.builds(lambda primitive, n: [primitive] * n, one, st.sampled_from([50, 2000])),
    )


def standing_plans() -> st.SearchStrategy[MotionPlan]:
    """For those who look on: of plans that begin where the robots are described to stand, but for damage."""

    def stand(plan: MotionPlan) -> MotionPlan:
        plan.start = plan.start or DESCRIPTION.start
        return plan

    return plans(SCENE).map(stand)


# What happens then


def described(message: SwarmDescription) -> str:
    """As planner, sequencer and mover take a description."""
    return outcome(lambda: scene_from_description(message))


def viewed(message: SwarmDescription) -> str:
    """As the viewer takes a description, and the robots on it."""

    def draw() -> None:
        check_description(message)
        fixed_markers(message, 1000.0)
        robot_markers(message, POSES, 1000.0)

    return outcome(draw)


def looked_at(message: SwarmPoses) -> str:
    """As viewer, mover and planner take poses."""

    def look() -> None:
        check_poses(message)
        robot_markers(DESCRIPTION, message, 1000.0)
        seen = measured_poses(message, SCENE)
        if seen.shape != (6, 3):
            raise Violation(f"poses of shape {seen.shape}")
        task_of_request(PlanMotion.Request(), SCENE, message, "optimize")

    return outcome(look)


def asked(request: PlanMotion.Request) -> str:
    """As the planner node takes a request, up to the planner."""

    def ask() -> None:
        task = task_of_request(request, SCENE, POSES, "optimize")
        _problem(request, task.starts, task.goals, task.tolerance, task.exchangeable, parked=task.parked, waypoints=task.waypoints)

    return outcome(ask)


def planned(request: PlanMotion.Request) -> str:
    """As the planning process answers a request."""

    def plan() -> None:
        task = task_of_request(request, SCENE, POSES, "optimize")
        try:
            report = perform(task)
        except StressbotError as error:
            raise named_for_request(error, SCENE, request, task.exchangeable) from error
        if not report.success:
            raise StressbotError(report.code, task.planner, in_words(report.reason, SCENE, task.exchangeable))
        if not (report.gap >= task.settings.min_clearance and report.goal_error <= task.tolerance):
            raise Violation(f"a plan that misses what was asked for: {report}")

    return outcome(plan)


def told_to_move(goal: MoveSwarm.Goal) -> str:
    """As the mover takes a goal."""

    def move() -> None:
        starts = measured_poses(POSES, SCENE)
        asked = goals_of_request(goal, SCENE, starts)
        _problem(goal, starts, asked.places, goal.tolerance / UNIT, asked.exchangeable, waypoints=asked.waypoints)

    return outcome(move)


def _problem(
    request: PlanMotion.Request | MoveSwarm.Goal, starts: np.ndarray, goals: np.ndarray, tolerance: float, exchangeable: tuple,
    **more: object,
) -> None:
    try:
        Problem(SCENE.swarm, SCENE.environment, starts, goals, tolerance, exchangeable, **more)
    except StressbotError as error:
        raise named_for_request(error, SCENE, request, exchangeable) from error


_limits = SimulatedBackend(BENCH, None, None).limits


def sequenced(scene: Scene, plan: MotionPlan) -> str:
    """As the sequencer takes a plan; what comes out passes the driver's check, or is refused there for its duration."""

    def expand() -> None:
        program = program_of_plan(plan, scene)
        if program.epoch_count:
            message = sequence_to_message(program, plan.plan_id, plan.swarm_id)
            check_sequence(sequence_from_message(message), scene.swarm_id, _limits)

    return outcome(expand)


def shown(plan: MotionPlan) -> str:
    """As paths takes a plan."""

    def show() -> None:
        starts, _ = ends_of_plan(plan, SCENE)
        rows = list(range(SCENE.swarm.n))
        paths = plan_paths(SCENE.swarm, starts, *activations_of_plan(plan, SCENE), rows)
        if any(not 0 < len(path) <= LONGEST for path in paths):
            raise Violation(f"paths of {[len(path) for path in paths]} poses")
        path_message(paths[0], plan.header.stamp)
        anew(lines("planned", dict(zip(rows, paths, strict=True)), 1000.0, 1e-5, 1.0))

    return outcome(show)


INTERFACES = (
    Interface("swarm_description, planner and sequencer", descriptions(), described, 3),
    Interface("swarm_description, viewer", descriptions(), viewed),
    Interface("swarm_poses", poses(), looked_at, 2),
    Interface("plan_motion request", requests(10.0), asked, 3),
    Interface("plan_motion request, planned", requests(0.05), planned, 0.4),
    Interface("move_swarm goal", move_goals(), told_to_move, 2),
    Interface("motion_plan, sequencer", plans(SCENE), partial(sequenced, SCENE), 4),
    Interface("accepted_plan, paths", standing_plans(), shown, 2),
    Interface("motion_plan, sequencer, many groups", plans(MANY), partial(sequenced, MANY), 2),
)
