"""The planner or its process is killed or frozen, or there are two."""

import signal
import time

from stressbot_msgs.msg import DriverStatus, ErrorCode
from stressbot_msgs.srv import PlanMotion
from system_rig import ENTRIES

from faults.settings import simulated
from faults.stage import UNIT, Outcome, Stage
from stressbot_planner.ros.bringup import command


def planner_killed(stage: Stage) -> Outcome:
    stage.running()
    stage.kill("planner")
    time.sleep(0.3)
    assert stage.status.state == DriverStatus.RUNNING
    stage.start("planner")
    since = time.monotonic()
    assert stage.call("stop").success
    stage.at_rest(since, DriverStatus.STOPPED)
    recovered = stage.recover()
    stage.planned()
    seen = "nothing: the sequence runs on, whole and checked"
    return Outcome(seen, None, "RUNNING", f"planner restarted, {recovered}, plans again")


def hopeless() -> PlanMotion.Request:
    """Return a request that keeps the planner busy."""
    return PlanMotion.Request(planner="rrt", tolerance=0.031 * UNIT, time_limit=60.0)


def planner_killed_while_planning(stage: Stage) -> Outcome:
    service = stage.system.client._services["plan_motion"]
    asked = service.call_async(hopeless())
    stage.until(lambda: stage.system.plan().error_code == ErrorCode.BUSY or asked.done(), "the plan to be in the making")
    stage.kill("planner")
    stage.start("planner")
    stage.planned()
    assert not asked.done()
    service.remove_pending_request(asked)
    assert stage.status.output_level == 0.0
    return Outcome("no answer: ask again", None, "as before", f"planner restarted, plans again, {stage.recover()}")


def planner_frozen(stage: Stage) -> Outcome:
    """It is asked while it is frozen: the answer comes when it goes on, and what was answered is loaded."""
    service = stage.system.client._services["plan_motion"]
    stage.running()
    stage.signal("planner", signal.SIGSTOP)
    time.sleep(0.3)
    assert stage.status.state == DriverStatus.RUNNING
    since = time.monotonic()
    assert stage.call("stop").success
    zero, _ = stage.at_rest(since, DriverStatus.STOPPED)
    asked = service.call_async(PlanMotion.Request(first=True))
    time.sleep(stage.rng.uniform(0.0, 1.0))
    assert not asked.done()
    stage.signal("planner", signal.SIGCONT)
    stage.until(asked.done, "the answer")
    answer = asked.result()
    assert answer.success, answer.error_msg
    stage.until(lambda: (stage.status.plan_id, stage.status.state) == (answer.plan.plan_id, DriverStatus.LOADED), "its sequence")
    seen = "nothing: the sequence runs on, stop works; who asks waits"
    return Outcome(seen, zero, "RUNNING, STOPPED", f"the answer comes when it goes on; {stage.recover()}")


def planning_process_killed(stage: Stage) -> Outcome:
    """The process that plans for the node, while it plans."""
    service = stage.system.client._services["plan_motion"]
    asked = service.call_async(hopeless())
    stage.until(lambda: stage.system.plan().error_code == ErrorCode.BUSY or asked.done(), "the plan to be in the making")
    stage.wait_for_work("planner")  # one that has no task yet would be replaced before it gets it
    stage.kill_children("planner")
    stage.until(asked.done, "the answer")
    answer = asked.result()
    assert not answer.success and answer.error_code == ErrorCode.INTERNAL, answer.error_msg
    stage.planned()
    return Outcome(answer.error_msg, None, "as before", f"plans again; {stage.recover()}")


def two_planners(stage: Stage) -> Outcome:
    """Both are asked at once, since both offer the service; the driver runs one plan and refuses the other."""
    stage.system.processes.start("second_planner", command(ENTRIES["planner"], {}, namespace=stage.system.namespace))
    try:
        stage.until(lambda: len(stage.node.get_service_names_and_types_by_node("planner", stage.system.namespace)) > 0, "it")
        stage.until(lambda: stage.node.count_publishers("motion_plan") == 3, "the second planner")
        answer = stage.system.plan()
        assert answer.success, answer.error_msg
        stage.until(lambda: stage.status.state == DriverStatus.LOADED, "a sequence")
        assert stage.call("start").success
        ran = stage.until(lambda: stage.status.state == DriverStatus.RUNNING and stage.status.plan_id, "the run")
        late = stage.plan([1.0])  # what the slower planner has made meanwhile
        stage.plans.publish(late)
        _, status = stage.first(lambda s: s.refused_plan_id == late.plan_id, 0.0, "the refusal")
        assert (status.state, status.plan_id, status.error_code) == (DriverStatus.RUNNING, ran, ErrorCode.BUSY)
        since = time.monotonic()
        assert stage.call("stop").success
        stage.at_rest(since, DriverStatus.STOPPED)
    finally:
        stage.system.processes.stop("second_planner")
    return Outcome(status.error_msg.replace(ran, "…"), None, "RUNNING BUSY", stage.recover())


FAULTS = {
    "planner: kill -9 while a sequence runs": (simulated, planner_killed),
    "planner: kill -9 while planning": (simulated, planner_killed_while_planning),
    "planner: frozen while a sequence runs": (simulated, planner_frozen),
    "planner: kill -9 of its planning process": (simulated, planning_process_killed),
    "two planners at once": (simulated, two_planners),
}
