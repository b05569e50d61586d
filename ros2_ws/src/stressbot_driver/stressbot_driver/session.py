"""The driver's state machine, between requests on one side and a backend on the other. No ROS.

    IDLE ──load──► LOADED ──start──► RUNNING ──end──► DONE          load: from IDLE, LOADED, DONE, STOPPED
      ▲              │ stop             │ stop        └ FAULT ◄── any failure of the backend, a loss while RUNNING
      └────reset─────┴──► STOPPED ◄─────┘             reset: from every state but RUNNING

A sequence is spent by its start: the robots are then no longer where it begins, so DONE and STOPPED need a new one.
FAULT is latched: nothing but `reset` leaves it. docs/safety.md has the whole table; the tests go through it cell by cell.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Generic, TypeVar

from stressbot_driver.backends.base import Backend, Listener, Pacing
from stressbot_driver.drive import check_drive
from stressbot_driver.errors import ErrorCode, StressbotError, as_failure
from stressbot_driver.sequence import LONGEST_ID, Limits, VoltageSequence, check_sequence
from stressbot_driver.simulation.substrate import Poses

AnyBackend = TypeVar("AnyBackend", bound=Backend)

AHEAD = 1_000_000_000
"""ns by which the clock of who measures the poses may be ahead of this one."""

FAILURES = (ErrorCode.BACKEND_FAILURE, ErrorCode.NO_HEARTBEAT, ErrorCode.INTERNAL)


class State(IntEnum):
    """As in `DriverStatus.msg`."""

    IDLE = 1
    LOADED = 2
    RUNNING = 3
    DONE = 4
    STOPPED = 5
    FAULT = 6


@dataclass(frozen=True)
class Status:
    """A snapshot for `driver_status`; units as there."""

    state: State = State.IDLE
    plan_id: str = ""
    epoch: int = 0
    epoch_count: int = 0
    sequence_time: float = 0.0
    duration: float = 0.0
    output_level: float = 0.0
    error_code: ErrorCode = ErrorCode.NONE
    error_msg: str = ""
    refused_plan_id: str = ""
    missing: tuple[str, ...] = ()


class Session(Listener, Generic[AnyBackend]):
    """One backend and what may be done with it when. Every method may be called from any thread.

    Attributes:
        backend: what the sequences are played on.

    `load`, `start` and `reset` raise StressbotError when they refuse; the refusal also stays in the status until the next
    request that succeeds. `stop` never refuses, but may fail.
    """

    def __init__(
        self,
        make: Callable[[Listener], AnyBackend],
        on_change: Callable[[], None],
        on_poses: Callable[[float, Poses], None],
        now: Callable[[], int] = time.time_ns,
        why_none: Callable[[], str] = str,
        **caps: float,
    ) -> None:
        """`make` makes the backend, which reports to this session. `caps` tighten its limits named max_…

        `on_change` is called after every change of the status, `on_poses` with measured poses and their time. `now` is the clock of
        the stamps of sequences [ns]; `why_none` says why no sequence has come, or nothing.
        """
        self._why_none = why_none
        self._refused: tuple[str, str] | None = None  # the last sequence, if it was: its plan, and why
        self._now = now
        self._moved = now()  # [ns] what was planned from poses before this is outdated
        self._on_change = on_change
        self._on_poses = on_poses
        self._caps = caps
        self._requests = threading.RLock()  # one request at a time
        self._lock = threading.Lock()  # guards the status; never held while calling out
        self._status = Status()
        self._missing: dict[str, StressbotError] = {}  # what `lost` told of and `found` has not, by field; guarded by the lock too
        self._fault: StressbotError | None = None  # in FAULT and only there; guarded by the lock too
        self.backend = make(self)

    @property
    def limits(self) -> Limits:
        """What a sequence is checked against: the tighter of what the backend can and the caps allow."""
        limits, electrical = self.backend.limits, self.backend.bench.electrical
        return replace(
            limits,
            rest_level=electrical.rest_level,
            drive_above=float(electrical.thresholds[-1]),
            **{name: min(getattr(limits, name), cap) for name, cap in self._caps.items()},
        )

    def status(self) -> Status:
        """The status, with the backend's progress at this moment."""
        progress = self.backend.progress()
        with self._lock:
            status = self._status
        return replace(status, epoch=progress.epoch, sequence_time=progress.time, output_level=progress.level)

    def poses(self) -> tuple[float, Poses] | None:
        """Sequence time and poses while nothing runs, None while a sequence runs or nobody sees the robots."""
        with self._requests:
            if self._status.state == State.RUNNING:
                return None
            poses = self.backend.poses()
            return None if poses is None else (self.backend.progress().time, poses)

    def load(self, sequence: VoltageSequence) -> None:
        """Check a sequence and make it the next to run. A refusal leaves everything else as it was."""
        with self._requests, self._refusal(sequence.plan_id[:LONGEST_ID]):
            state = self._status.state
            if state == State.RUNNING:
                raise StressbotError(
                    ErrorCode.BUSY,
                    "voltage_sequence",
                    f"plan {self._status.plan_id} is running: wait for its end or call stop, then send again",
                )
            self._refuse_in_fault()
            if 0 < sequence.stamp < self._moved:
                raise StressbotError(
                    ErrorCode.OUTDATED,
                    "header.stamp",
                    f"the sequence starts from poses of {1e-9 * (self._moved - sequence.stamp):.3f} s before the last start or "
                    "reset: plan again from the present poses (and compare the clocks of the machines)",
                )
            if sequence.stamp > self._now() + AHEAD:
                raise StressbotError(
                    ErrorCode.OUTDATED,
                    "header.stamp",
                    f"the sequence starts from poses of {1e-9 * (sequence.stamp - self._now()):.3f} s in the future, and nobody "
                    "can tell whether the robots have moved since: compare the clocks of the machines, then plan again",
                )
            check_sequence(sequence, self.backend.bench.swarm_id, self.limits)
            check_drive(sequence, self.backend.bench.electrical)
            with self._fault_on_failure(may_refuse=True):
                self.backend.upload(sequence)
            self._change(
                state=State.LOADED,
                plan_id=sequence.plan_id,
                epoch_count=len(sequence.epoch_ends),
                duration=float(sequence.dwells.sum()),
            )
            self._refused = None

    def start(self, pacing: Pacing) -> None:
        """Put the loaded sequence on the substrate."""
        with self._requests, self._refusal():
            state = self._status.state
            if state == State.RUNNING:
                raise StressbotError(ErrorCode.BUSY, "start", f"plan {self._status.plan_id} is already running")
            self._refuse_in_fault()
            if state != State.LOADED:
                raise StressbotError(ErrorCode.NOTHING_LOADED, "start", f"no voltage sequence is loaded: {self._cause()}")
            self._moved = self._now()
            # RUNNING before the first volt, because the end may be reported before `start` returns.
            self._change(unless_missing=True, state=State.RUNNING)
            with self._fault_on_failure():
                self.backend.start(pacing)

    def _cause(self) -> str:
        """Why nothing is loaded, and what to do."""
        status = self._status
        if self._refused:
            return "that of plan {} was refused ({}): mend that, then plan again".format(*self._refused)
        if status.state in (State.DONE, State.STOPPED):
            end = "has run to its end" if status.state == State.DONE else "was stopped"
            return f"that of plan {status.plan_id} {end}, and each serves once: plan again from the present poses"
        return self._why_none() or "plan from the present poses and send a new one"

    def stop(self) -> bool:
        """Rest level at once. True if a running or loaded sequence was given up.

        Raises StressbotError, in FAULT, if the backend cannot bring its output to rest.
        """
        self._rest()
        with self._requests:
            # Again, for a sequence that another request started in between.
            self._rest()
            stopped = self._status.state in (State.RUNNING, State.LOADED)
            if stopped:
                self._change(state=State.STOPPED)
            return stopped

    def reset(self) -> None:
        """Robots back at their starts, no sequence, no fault."""
        with self._requests, self._refusal():
            if self._status.state == State.RUNNING:
                raise StressbotError(ErrorCode.BUSY, "reset", f"plan {self._status.plan_id} is running: call stop first")
            with self._fault_on_failure():
                self.backend.reset()
            self._moved = self._now()
            self._change(state=State.IDLE, plan_id="", epoch_count=0, duration=0.0)
            self._refused = None

    def close(self) -> None:
        """Rest level for good. Raises StressbotError as `stop` does."""
        try:
            self.stop()
        finally:
            self.backend.close()

    def lost(self, error: StressbotError) -> bool:
        """What must be there while a sequence runs is gone: rest level and FAULT if one runs, and no start until `found`.

        `error.field` names what was lost. True if a sequence ran.
        """
        with self._lock:
            known = error.field in self._missing
            self._missing[error.field] = error
            running = self._note_missing().state == State.RUNNING
        if not running:
            if not known:
                self._on_change()
            return False
        with suppress(StressbotError):  # in FAULT already, and graver
            self._rest()
            with self._requests:
                self._rest()  # again, for a start that was under way
                if self._status.state == State.RUNNING:
                    self.failed(error)
        return True

    def found(self, field: str) -> None:
        """What `lost` called `field` is there. A fault that it has left stays."""
        with self._lock:
            if self._missing.pop(field, None) is None:
                return
            self._note_missing()
        self._on_change()

    def _note_missing(self) -> Status:
        self._status = replace(self._status, missing=tuple(self._missing))
        return self._status

    def _rest(self) -> None:
        try:
            self.backend.stop()
        except Exception as cause:
            error = as_failure(cause)
            self.failed(error)
            raise error from cause

    # What the backend reports, on its own thread.

    def poses_measured(self, time: float, poses: Poses) -> None:
        self._on_poses(time, poses)

    def finished(self) -> None:
        with self._lock:
            if self._status.state == State.RUNNING:
                self._status = replace(self._status, state=State.DONE)
        self._on_change()

    def failed(self, error: StressbotError) -> None:
        with self._lock:
            self._fault = error
            self._status = replace(self._status, state=State.FAULT, error_code=error.code, error_msg=str(error), refused_plan_id="")
        self._on_change()

    def refuse(self, error: StressbotError, plan_id: str = "") -> None:
        """Put a refusal into the status; the state stays."""
        if plan_id:
            self._refused = plan_id, str(error)
        with self._lock:
            self._status = replace(self._status, error_code=error.code, error_msg=str(error), refused_plan_id=plan_id)
        self._on_change()

    def _change(self, unless_missing: bool = False, **changes: object) -> None:
        """A request succeeded: new state, and the last error is history. Raises what is missing, if asked to."""
        with self._lock:
            if unless_missing and self._missing:
                missing = next(iter(self._missing.values()))
                raise StressbotError(missing.code, missing.field, missing.message)
            self._fault = None
            self._status = replace(self._status, error_code=ErrorCode.NONE, error_msg="", refused_plan_id="", **changes)
        self._on_change()

    def _refuse_in_fault(self) -> None:
        fault = self._fault
        if fault is not None:
            raise StressbotError(fault.code, "state", f"the driver is in FAULT ({fault}): mend the cause and call reset first")

    @contextmanager
    def _refusal(self, plan_id: str = "") -> Iterator[None]:
        """A StressbotError that leaves the block is a refusal, unless it is a fault already."""
        try:
            yield
        except StressbotError as error:
            if self._status.state != State.FAULT or self._status.error_msg != str(error):
                self.refuse(error, plan_id)
            raise

    @contextmanager
    def _fault_on_failure(self, may_refuse: bool = False) -> Iterator[None]:
        """Whatever goes wrong in the backend ends at rest level and in FAULT, unless it may refuse what is then no failure."""
        try:
            yield
        except Exception as cause:
            error = as_failure(cause)
            if may_refuse and error.code not in FAILURES:
                raise
            self._rest()  # its own failure is the graver one
            self.failed(error)
            raise error from cause
