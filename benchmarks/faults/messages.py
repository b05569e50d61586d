"""Messages come twice, late, in the wrong order, or are hostile."""

import time
import uuid

from stressbot_msgs.msg import DriverStatus, ErrorCode, MotionPlan, VoltageSequence

from faults.settings import simulated
from faults.stage import Outcome, Stage


def doubled_plan(stage: Stage) -> Outcome:
    plan = stage.plan([0.1, 0.1])
    stage.loaded(plan)
    stage.loaded(plan)
    assert stage.call("start").success
    stage.until(lambda: stage.status.state == DriverStatus.DONE, "the end")
    status = refused(stage, plan, ErrorCode.OUTDATED)
    assert (status.state, status.output_level) == (DriverStatus.DONE, 0.0)
    return Outcome(status.error_msg, None, "DONE OUTDATED", stage.recover())


def refused(stage: Stage, plan: MotionPlan, code: int) -> DriverStatus:
    """Publish a plan, and return the status that refuses its sequence with a code."""
    since = time.monotonic()
    stage.plans.publish(plan)
    return stage.first(lambda s: (s.refused_plan_id, s.error_code) == (plan.plan_id, code), since, "the refusal")[1]


def reordered_plans(stage: Stage) -> Outcome:
    early, late = stage.plan([0.1]), stage.plan([0.2])
    stage.loaded(late)
    assert stage.call("start").success
    stage.until(lambda: stage.status.state == DriverStatus.DONE, "the end")
    status = refused(stage, early, ErrorCode.OUTDATED)
    assert (status.state, status.output_level) == (DriverStatus.DONE, 0.0)
    assert not stage.call("start").success
    return Outcome(status.error_msg, None, "DONE OUTDATED", stage.recover())


def doubled_plan_while_running(stage: Stage) -> Outcome:
    plan = stage.running()
    status = refused(stage, plan, ErrorCode.BUSY)
    assert status.state == DriverStatus.RUNNING
    since = time.monotonic()
    assert stage.call("stop").success
    stage.at_rest(since, DriverStatus.STOPPED)
    assert refused(stage, plan, ErrorCode.OUTDATED).state == DriverStatus.STOPPED
    return Outcome(status.error_msg.replace(plan.plan_id, "…"), None, "RUNNING BUSY", stage.recover())


def hostile_sequences(stage: Stage) -> Outcome:
    """For another swarm, beyond the volts, with lists that do not match: sent past the sequencer, waiting and running."""
    stage.loaded(stage.plan([5.0]))
    swarm = stage.system.client.description.swarm_id
    cases = {
        ErrorCode.WRONG_SWARM: {"swarm_id": "another"},
        ErrorCode.LIMIT_EXCEEDED: {"levels": [0.0, 1e4]},
        ErrorCode.NOT_FINITE: {"levels": [0.0, float("nan")]},
        ErrorCode.WRONG_COUNT: {"dwells": [1.0]},
        ErrorCode.INVALID_SEQUENCE: {"epoch_ends": [7]},
    }
    good = {"levels": [0.0, 1.0], "dwells": [1.0, 1.0], "epoch_ends": [2], "duration": 2.0, "swarm_id": swarm}
    for running in (False, True):
        loaded = stage.status.plan_id
        for code, fields in cases.items():
            sequence = VoltageSequence(plan_id=uuid.uuid4().hex, **{**good, **fields})
            stage.sequences.publish(sequence)
            _, status = stage.first(lambda s, name=sequence.plan_id: s.refused_plan_id == name, 0.0, "the refusal")
            expected = (DriverStatus.RUNNING, ErrorCode.BUSY) if running else (DriverStatus.LOADED, code)
            assert (status.state, status.error_code) == expected, status.error_msg
            assert status.plan_id == loaded
        if not running:
            assert stage.call("start").success
    since = time.monotonic()
    assert stage.call("stop").success
    stage.at_rest(since, DriverStatus.STOPPED)
    return Outcome("a refusal with its own code each; what is loaded or runs stays", None, "LOADED, RUNNING", stage.recover())


FAULTS = {
    "plan doubled, and again after its end": (simulated, doubled_plan),
    "plan doubled while it runs": (simulated, doubled_plan_while_running),
    "plans reordered: an older one after a newer one ran": (simulated, reordered_plans),
    "hostile sequences past the sequencer": (simulated, hostile_sequences),
}
