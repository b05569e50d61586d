"""The mover, or its planning process, is killed or frozen while it drives."""

import signal
import time

from stressbot_msgs.action import MoveSwarm
from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.settings import moving
from faults.stage import Outcome, Stage

AT_REST = 1.5
"""s without a motion, after which no order is under way any more."""

LONG = 240.0
"""s, for a whole motion."""


def mover_killed(stage: Stage) -> Outcome:
    driving(stage)
    since = stage.kill("mover")
    seen = _orders_end(stage, since)
    stage.start("mover")
    arrived = _arrives(stage, send(stage))
    return Outcome(f"no result; {seen}", None, "DONE", f"mover restarted, new goal reached after {arrived}; {stage.recover()}")


def mover_frozen(stage: Stage) -> Outcome:
    goal = driving(stage)
    since = stage.signal("mover", signal.SIGSTOP)
    seen = _orders_end(stage, since)
    stage.signal("mover", signal.SIGCONT)
    arrived = _arrives(stage, goal)
    return Outcome(f"feedback falls silent; {seen}", None, "DONE", f"goes on to its goal, {arrived}; {stage.recover()}")


def planning_process_killed(stage: Stage) -> Outcome:
    """It is hit while it plans or rests; the mover notices with the next plan that it asks for."""
    goal = driving(stage)
    stage.kill_children("mover")
    result = result_of(stage, goal)
    if not result.success:
        assert result.error_code == ErrorCode.INTERNAL and "planning process died" in result.error_msg, result.error_msg
    assert stage.status.state != DriverStatus.RUNNING and stage.status.output_level == 0.0
    arrived = _arrives(stage, send(stage))
    seen = result.error_msg or "nothing: the process is started again before the next plan"
    return Outcome(seen, None, "DONE", f"process restarted, new goal reached after {arrived}; {stage.recover()}")


def driving(stage: Stage):
    """Return the handle of a goal, at a random moment of the motion."""
    assert stage.call("reset").success
    goal = send(stage)
    for moment in (stage.rng.uniform(0.0, 1.0), 0.0):
        stage.until(lambda: stage.status.state == DriverStatus.RUNNING, "a motion", LONG)
        time.sleep(moment)
    return goal


def send(stage: Stage, heard: list | None = None):
    """Return the handle of an accepted goal; what is fed back goes to `heard`."""
    stage.until(stage.actions.server_is_ready, "the mover")
    stage.until(stage.system.is_known_to_mover(stage.actions), "an answer of the mover")
    tell = None if heard is None else lambda message: heard.append(message.feedback)
    goal = stage.system.asked(lambda: stage.actions.send_goal_async(MoveSwarm.Goal(), feedback_callback=tell))
    stage.until(goal.done, "acceptance")
    assert goal.result().accepted
    return goal.result()


def result_of(stage: Stage, handle) -> MoveSwarm.Result:
    answer = stage.system.asked(handle.get_result_async)
    stage.until(answer.done, "the result", LONG)
    return answer.result().result


def _orders_end(stage: Stage, since: float) -> str:
    """Wait until the substrate is at rest for good, by itself; return what is seen of it."""

    def changed() -> float:
        heard = [t for t, status in list(stage.heard) if t > since and status.state == DriverStatus.RUNNING]
        return heard[-1] if heard else since

    stage.until(lambda: time.monotonic() > max(changed(), stage.moved) + AT_REST, "rest", LONG)
    assert stage.status.state in (DriverStatus.DONE, DriverStatus.LOADED) and stage.status.output_level == 0.0
    return f"the driver goes on for {changed() - since:.1f} s, to the end of what was ordered"


def _arrives(stage: Stage, goal) -> str:
    result = result_of(stage, goal)
    assert result.success, result.error_msg
    return f"{result.activations} activations"


FAULTS = {
    "mover: kill -9 while it drives": (moving, mover_killed),
    "mover: frozen while it drives": (moving, mover_frozen),
    "mover: kill -9 of its planning process": (moving, planning_process_killed),
}
