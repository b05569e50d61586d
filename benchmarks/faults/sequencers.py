"""The sequencer is killed, frozen or ended."""

import signal

from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults.settings import simulated
from faults.stage import Outcome, Stage


def sequencer_killed(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.kill("sequencer"), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    refused = stage.call("start")
    assert not refused.success
    stage.start("sequencer")
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"sequencer restarted, {stage.recover()}")


def sequencer_frozen(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.signal("sequencer", signal.SIGSTOP), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    assert "sequencer_status" in status.missing
    stage.signal("sequencer", signal.SIGCONT)
    stage.until(lambda: not stage.status.missing, "the sequencer's return")
    assert stage.status.state == DriverStatus.FAULT
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"still FAULT when it goes on; {stage.recover()}")


def sequencer_ended(stage: Stage) -> Outcome:
    stage.running()
    zero, status = stage.at_rest(stage.signal("sequencer", signal.SIGTERM), DriverStatus.FAULT, ErrorCode.PEER_LOST)
    stage.system.processes.stop("sequencer")
    stage.start("sequencer")
    return Outcome(status.error_msg, zero, "FAULT PEER_LOST", f"sequencer restarted, {stage.recover()}")


def sequencer_killed_before_start(stage: Stage) -> Outcome:
    stage.loaded(stage.plan([1.0]))
    stage.kill("sequencer")
    stage.until(lambda: stage.status.missing, "its loss")
    answer = stage.call("start")
    assert not answer.success and stage.until(lambda: stage.status.error_code == ErrorCode.PEER_LOST, "the refusal")
    assert (stage.status.state, stage.status.output_level) == (DriverStatus.LOADED, 0.0)
    stage.start("sequencer")
    return Outcome(answer.message, None, "LOADED PEER_LOST", f"sequencer restarted, {stage.recover()}")


FAULTS = {
    "sequencer: kill -9": (simulated, sequencer_killed),
    "sequencer: frozen, goes on": (simulated, sequencer_frozen),
    "sequencer: SIGTERM": (simulated, sequencer_ended),
    "sequencer: kill -9 before start": (simulated, sequencer_killed_before_start),
}
