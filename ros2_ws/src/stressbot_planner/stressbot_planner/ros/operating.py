"""What an operator asks of nodes that run, in plain values: lengths in m, angles in rad, times in s."""

import signal
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.action import ActionClient
from std_srvs.srv import Trigger
from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus, SwarmPoses

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros.client import SwarmClient
from stressbot_planner.system.interrupts import handled

STATES = {getattr(DriverStatus, name): name for name in ("IDLE", "LOADED", "RUNNING", "DONE", "STOPPED", "FAULT")}

ASK_AGAIN = 1.0
"""s; a driver that does not know this client yet loses its answer, and to stop twice does no harm."""

SEEN_WITHIN = 1.0
"""s, for poses, and to find a sequencer."""

LATE = 600.0
"""s that the mover may take beyond its time limit: it ends at rest, after the motion that is under way."""


def status(client: SwarmClient, timeout: float) -> dict[str, Any]:
    """Return what driver and sequencer say of themselves, and where the robots are, if anybody sees them.

    Raises:
        TimeoutError: there is no driver, or a sequencer that says nothing.
    """
    client.wait_for(lambda: client.driver_status and client.description, timeout, "word of a driver")
    until = time.monotonic() + SEEN_WITHIN

    def is_all() -> object:
        if client.poses and client.sequencer_status:
            return True
        awaited = client.sequencer_status is None and client.node.count_publishers("sequencer_status")
        return time.monotonic() > until and not awaited

    client.wait_for(is_all, timeout, "word of the sequencer")
    driver, swarm, sequencer = client.driver, client.swarm, client.sequencer_status
    poses = client.poses[-1] if client.poses else SwarmPoses()
    is_running = driver.state == DriverStatus.RUNNING
    return {
        "state": STATES.get(driver.state, str(driver.state)),
        "backend": driver.backend,
        "swarm": swarm.name,
        "swarm_id": swarm.swarm_id,
        "robot_count": len(swarm.ids),
        "plan_id": driver.plan_id,
        "epoch": driver.epoch,
        "epoch_count": driver.epoch_count,
        "sequence_time": driver.sequence_time,
        "duration": driver.duration,
        "time_left": max(0.0, driver.duration - driver.sequence_time) if is_running else 0.0,
        "output_level": driver.output_level,
        "missing": list(driver.missing),
        "error": _code(driver.error_code),
        "message": driver.error_msg,
        "sequencer": None if sequencer is None else sequencer.error_msg or "ready",
        "robots": [
            {"id": robot, "x": x, "y": y, "heading": heading}
            for robot, x, y, heading in zip(poses.ids, poses.x, poses.y, poses.heading, strict=False)
        ],
    }


def trigger(client: SwarmClient, word: str, timeout: float) -> tuple[bool, str]:
    """Call `start`, `stop` or `reset`; return whether it was done, and what the driver says.

    Raises:
        TimeoutError: nobody answers.
    """
    client.wait_for(lambda: client.is_ready(word), timeout, f"answer of {word}")
    if word == "stop":
        answer = _stop(client, timeout)
    else:
        client.wait_for(lambda: client.has_met("driver"), timeout, f"answer of {word}")
        answer = client.trigger(word, timeout)
    return answer.success, answer.message


def _stop(client: SwarmClient, timeout: float) -> Trigger.Response:
    while True:
        try:
            return client.trigger("stop", min(ASK_AGAIN, timeout))
        except TimeoutError:
            timeout -= ASK_AGAIN
            if timeout <= 0:
                raise


def move(
    client: SwarmClient,
    goals: Sequence[tuple[int, float, float]],
    assign: bool,
    tolerance: float,
    time_limit: float,
    timeout: float,
    tell: Callable[[MoveSwarm.Feedback], None],
) -> dict[str, Any]:
    """Bring robots to goals in closed loop, and return how it ended. The first signal ends the motion in good order.

    Args:
        client: of the nodes.
        goals: ids and places, m; none: those of the scenario.
        assign: whether robots may take each other's.
        tolerance: m, that counts as there.
        time_limit: s, for all of it.
        timeout: s, for an answer of the mover.
        tell: hears how it comes along.

    Raises:
        StressbotError: BUSY if the mover moves already.
        TimeoutError: nobody answers.
    """
    goal = MoveSwarm.Goal(
        robots=[robot for robot, _, _ in goals],
        goal_x=[x for _, x, _ in goals],
        goal_y=[y for _, _, y in goals],
        assign=assign,
        tolerance=tolerance,
        time_limit=time_limit,
    )
    mover = ActionClient(client.node, MoveSwarm, "move_swarm")
    client.wait_for(mover.server_is_ready, timeout, "answer of move_swarm (start a mover, too)")
    client.wait_for(lambda: client.has_met("mover"), timeout, "answer of the mover")
    accepted = client.asked(lambda: mover.send_goal_async(goal, feedback_callback=lambda message: tell(message.feedback)))
    client.wait_for(accepted.done, timeout, "answer of move_swarm")
    handle: Any = accepted.result()
    if not handle.accepted:
        raise StressbotError(ErrorCode.BUSY, "move_swarm", "is moving the swarm already: wait for its end, or cancel that")
    ended = client.asked(handle.get_result_async)
    signals: list[int] = []
    executor: Any = client.node.executor

    def cancel(number: int, _frame: Any) -> None:
        signals.append(number)
        signal.signal(number, signal.default_int_handler)
        executor.create_task(handle.cancel_goal_async)
        executor.wake()

    with handled((signal.SIGINT, signal.SIGTERM), cancel):
        client.wait_for(ended.done, time_limit + LATE, "end of the motion")
    outcome: Any = ended.result()
    result = outcome.result
    return {
        "success": result.success,
        "interrupted": bool(signals),
        "robots": list(result.robots),
        "errors": list(result.errors),
        "stuck": list(result.stuck),
        "activations": result.activations,
        "plans": result.plans,
        "corrections": result.corrections,
        "error": _code(result.error_code),
        "message": result.error_msg,
    }


def _code(number: int) -> str | None:
    return ErrorCode(number).name if number else None
