"""One run of the whole system, seen from outside: plan, load, start, watch to the end."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from stressbot_msgs.msg import DriverStatus
from stressbot_msgs.srv import PlanMotion
from stressbot_msgs.stamps import nanoseconds

from stressbot_planner import planners
from stressbot_planner.formats.scenario import Scenario
from stressbot_planner.problem.plan import Plan, Solved
from stressbot_planner.reporting.demo_report import Executed
from stressbot_planner.ros import conversion
from stressbot_planner.ros.child_processes import ChildProcesses
from stressbot_planner.ros.client import SwarmClient

READY_WITHIN = 300.0
"""Nodes must be up within this time, s, or end by themselves, which is noticed at once; on a slow or busy machine that compiles the
planner's loops it takes minutes."""

ANSWER_WITHIN = 60.0
STALLED_AFTER = 60.0
"""Without any progress for this long, s, the execution is given up."""


class Failure(Exception):
    """Something in the system did not work; the message says what."""


class NoPlan(Exception):
    """The planner's reason why there is no plan."""


@dataclass(frozen=True)
class Job:
    """What to plan for: the scenario's goals, by which planner; tolerance in units, order of the brackets, limits: s, tries."""

    planner: str
    objective: str
    tolerance: float
    seed: int
    order: int | None
    time_limit: float
    max_tries: int | None


class ProgressDisplay(ABC):
    """Hears how a run comes along."""

    @abstractmethod
    def step(self, text: str) -> None:
        """Say what happens now."""

    @abstractmethod
    def progress(self, done: int, total: int) -> None:
        """Say how much of it is done."""


def perform(client: SwarmClient, processes: ChildProcesses, scenario: Scenario, order: Job, show: ProgressDisplay) -> Executed:
    """Plan, load, start, watch; return what was planned and what happened.

    Raises:
        NoPlan, Failure, TimeoutError: with the reason.
    """

    def alive() -> None:
        for name in processes.ended():
            raise Failure(f"the {name} node ended by itself, see {processes.log(name)}")
        if client.drivers > 1:
            raise Failure("another driver runs in this ROS domain: stop it, or set ROS_DOMAIN_ID to a free domain")

    client.wait_for(client.is_system_ready, READY_WITHIN, "answer from all nodes", alive)
    scene = conversion.scene_from_description(client.swarm)

    most = f"{order.max_tries} tries" if order.max_tries else f"{order.time_limit:g} s"
    show.step(f"planning with '{order.planner}', seed {order.seed}, at most {most}")
    request = PlanMotion.Request(
        planner=order.planner, objective=order.objective, seed=order.seed, order=order.order or 0, time_limit=order.time_limit,
        max_tries=order.max_tries or 0, tolerance=order.tolerance * scene.unit,
    )
    begin = time.monotonic()
    answer = client.call("plan_motion", request, order.time_limit + ANSWER_WITHIN, alive)
    call_time = time.monotonic() - begin
    if not answer.success:
        raise NoPlan(answer.error_msg)
    message = answer.plan
    primitives = tuple(conversion.primitive_from_message(item, scene) for item in message.primitives)
    planned = conversion.problem_of_plan(message, scenario.problem, scene)
    plan = Plan(planners.with_leeway(planned, scene.electrical.pulse_length(scene.swarm.speed)), primitives)
    result = Solved(planner=message.planner, seed=message.seed, plan=plan, planning_time=answer.planning_time)

    show.step(f"{len(primitives)} primitives, path {plan.path_length:.2f}, made in {answer.planning_time:.3f} s; encoding")

    def encoded() -> bool:
        status, driver = client.sequencer_status, client.driver
        if status and status.plan_id == message.plan_id and status.error_code:
            raise Failure(f"the sequencer refuses the plan: {status.error_msg}")
        if driver.refused_plan_id == message.plan_id:
            raise Failure(f"the driver refuses the sequence: {driver.error_msg}")
        if not status or status.plan_id != message.plan_id:
            return False
        loaded_now = driver.plan_id == message.plan_id and driver.state == DriverStatus.LOADED
        return status.epoch_count == 0 or (loaded_now and client.sequence is not None)

    client.wait_for(encoded, ANSWER_WITHIN, "sequence loaded by the driver", alive)
    client.forget_poses()
    begin = time.monotonic()
    if client.sequencer.epoch_count:
        show.step(f"driving: {client.driver.epoch_count} epochs, {client.driver.duration:.2f} s of volts")
        answer_of_start = client.trigger("start", ANSWER_WITHIN, alive)
        if not answer_of_start.success:
            raise Failure(f"the driver does not start: {answer_of_start.message}")
        _watch(client, message.plan_id, alive, show)
    execution_wall_time = time.monotonic() - begin
    end = nanoseconds(client.driver.header.stamp)
    client.wait_for(
        lambda: client.poses and nanoseconds(client.poses[-1].header.stamp) >= end,
        ANSWER_WITHIN,
        "poses after the end",
        alive,
    )
    return Executed(
        scenario=scenario,
        result=result,
        ids=scene.ids,
        predicted=conversion.poses_from_plan(message, scene)[1],
        recorded=np.array([conversion.starts_from_poses(item, scene) for item in client.poses]),
        program=None if client.sequence is None else conversion.program_from_message(client.sequence),
        sequence_time=client.driver.sequence_time,
        call_time=call_time,
        execution_wall_time=execution_wall_time,
    )


def _watch(client: SwarmClient, plan_id: str, alive: Callable[[], None], show: ProgressDisplay) -> None:
    """Wait until the driver has put the whole sequence on the substrate."""
    latest = (time.monotonic(), -1.0)

    def done() -> bool:
        nonlocal latest
        status = client.driver
        if status.sequence_time != latest[1]:
            latest = (time.monotonic(), status.sequence_time)
        show.progress(status.epoch, status.epoch_count)
        if status.plan_id != plan_id or status.state in (DriverStatus.STOPPED, DriverStatus.FAULT, DriverStatus.IDLE):
            raise Failure(f"the driver stopped in state {status.state}: {status.error_msg or 'somebody asked it to'}")
        return status.state == DriverStatus.DONE

    def moving() -> None:
        alive()
        if time.monotonic() - latest[0] > STALLED_AFTER:
            raise Failure(f"the driver has made no progress for {STALLED_AFTER:g} s")

    client.wait_for(done, float("inf"), "end of the sequence", moving)
