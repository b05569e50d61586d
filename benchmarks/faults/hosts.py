"""The network between two hosts is cut, or loses, doubles, delays and reorders packets."""

import time

from stressbot_msgs.msg import DriverStatus, ErrorCode
from stressbot_msgs.srv import PlanMotion

from faults.settings import lossy_hosts, two_hosts
from faults.stage import Outcome, Stage

PLANS = 5
LATEST = 120.0
"""s. DDS notices a lost packet with its next heartbeat, every 3 s, which may be lost as well."""

SPOILT = {"packets lost one by one": {"loss": 0.2}, "packets late, doubled, out of order": {"doubled": 0.2, "delay": 0.03}}


def link_cut(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.link.cut(), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    assert "sequencer_status" in status.missing
    time.sleep(stage.rng.uniform(0.0, 3.0))
    stage.link.heal()
    stage.until(lambda: not stage.status.missing, "the sequencer's return")
    assert stage.status.state == DriverStatus.FAULT
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"still FAULT when healed; {stage.recover()}")


def spoilt(packets: str):
    """Return a fault: plans are asked for over a bad link; each that is answered must come to the driver, once, and run."""

    def fault(stage: Stage) -> Outcome:
        stage.link.spoil(**SPOILT[packets])
        slowest = 0.0
        try:
            for _ in range(PLANS):
                slowest = max(slowest, _plan_and_run(stage))
        finally:
            stage.link.spoil()
        seen = f"nothing but time: {PLANS} of {PLANS} plans that were answered were loaded and ran, {slowest:.1f} s at most for one"
        return Outcome(seen, None, "DONE", stage.recover())

    return fault


def _plan_and_run(stage: Stage) -> float:
    """Return how long it took from the request to the sequence, s."""
    while True:
        before, asked = len(stage.heard), time.monotonic()
        answer = stage.system.client.call("plan_motion", PlanMotion.Request(first=True), LATEST)
        assert answer.success, answer.error_msg
        mine = answer.plan.plan_id
        # After a reset, poses from before may still be on their way to the planner.
        if answer.plan.primitives and _came(stage, mine):
            break
    took = time.monotonic() - asked
    assert stage.call("start").success
    stage.until(lambda: stage.status.state != DriverStatus.RUNNING, "its end", LATEST)
    assert (stage.status.plan_id, stage.status.state) == (mine, DriverStatus.DONE), stage.status.error_msg
    refused = [status.refused_plan_id for _, status in stage.heard[before:] if status.refused_plan_id]
    assert not refused, refused
    assert stage.call("reset").success
    return took


def _came(stage: Stage, plan_id: str) -> bool:
    """Wait for the sequence of a plan; return False if it was outdated before it came."""
    stage.until(lambda: plan_id in (stage.status.plan_id, stage.status.refused_plan_id), "a sequence that was answered", LATEST)
    if stage.status.plan_id == plan_id:
        assert stage.status.state == DriverStatus.LOADED
        return True
    assert stage.status.error_code == ErrorCode.OUTDATED, stage.status.error_msg
    return False


FAULTS = {
    "two hosts: link cut and healed": (two_hosts, link_cut),
    **{f"two hosts: {packets}": (lossy_hosts, spoilt(packets)) for packets in SPOILT},
}
"""Need root."""
