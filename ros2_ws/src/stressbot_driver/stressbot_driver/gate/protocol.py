"""What driver and gate say to each other: messages of one size and kind each, over four pairs of SOCK_SEQPACKET sockets.

    beats     driver → gate: that all is well, every PERIOD; answered by a word
    stops     driver → gate: rest now; answered by a word when the output is at rest
    requests  driver → gate: one at a time, with memory for what is large; each answered by a word
    reports   gate → driver: words when a run has ended, and that poses lie in the shared ring; dropped if nobody reads

Messages of one socket are numbered from 1 without a gap. All numbers are little-endian.
"""

import socket
import struct
from dataclasses import dataclass, replace
from enum import IntEnum

from stressbot_driver.backends.base import Progress
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.sequence import Limits

PERIOD = 0.02
"""[s] between beats."""

ROOM = 65536  # [bytes] more than any message: what is longer than it should be is seen to be so
FIELD, TEXT = 128, 2000  # [bytes] of UTF-8

_LIMITS = (
    "min_level", "max_level", "min_dwell", "max_duration", "max_slew_rate", "max_duty", "max_frequency", "max_charge",
    "capacitance", "max_power",
)
_BEAT = struct.Struct("<4xIQd")
_STOP = struct.Struct("<4xIQ")
_REQUEST = struct.Struct("<4xIQ2d")
_POSES = struct.Struct("<4xIQ")
_WORD = struct.Struct(f"<2I5Q i4x dQd {len(_LIMITS)}dq Q {FIELD}s{TEXT}s")


class Kind(IntEnum):
    """What a message is."""

    BEAT = 1
    STOP = 2
    OPEN = 3  # with memory: the configuration, the ring of poses
    UPLOAD = 4  # with memory: the sequence
    START = 5
    RESET = 6
    IMPAIR = 7  # with memory: the imperfections
    LOOK = 8
    WORD = 9
    POSES = 10


MEMORIES = {Kind.OPEN: 2, Kind.UPLOAD: 1, Kind.START: 0, Kind.RESET: 0, Kind.IMPAIR: 1, Kind.LOOK: 0}
"""The requests, and how many file descriptors come with each."""


class Outcome(IntEnum):
    """What has become of a run."""

    NONE = 0
    PLAYING = 1
    FINISHED = 2
    FAILED = 3
    RESTED = 4  # by `stop`


class BadMessageError(Exception):
    """What came is no message of this protocol."""


@dataclass(frozen=True)
class Beat:
    number: int
    time: float  # [s] when it was sent, by CLOCK_MONOTONIC, which both processes share


@dataclass(frozen=True)
class Request:
    kind: Kind
    number: int
    real_time_factor: float = 0.0
    pose_rate: float = 0.0


@dataclass(frozen=True)
class PosesReport:
    """`number` poses have been put into the ring so far."""

    number: int


@dataclass(frozen=True)
class Word:
    """All that the gate knows at one moment. It answers message `number`.

    `error` is that of the request or the stop that is answered; in reports and answers to beats that of the run.
    """

    number: int = 0
    serial: int = 0  # a word with a higher one is newer
    run: int = 0  # number of the request that started it
    outcome: Outcome = Outcome.NONE
    code: ErrorCode = ErrorCode.NONE
    field: str = ""
    text: str = ""
    progress: Progress = Progress()
    limits: Limits = Limits(0.0, 0.0)
    dropped: int = 0  # reports that nobody had room for
    failures: int = 0  # of runs, and of an output that should have been at rest; `error` is the last one
    seen: bool = False  # the answer to LOOK lies in the ring

    @property
    def error(self) -> StressbotError | None:
        return StressbotError(self.code, self.field, self.text) if self.code else None

    def answering(self, error: StressbotError | None) -> "Word":
        """The same with this error instead of any other."""
        if error is None:
            return replace(self, code=ErrorCode.NONE, field="", text="")
        return replace(self, code=error.code, field=error.field, text=error.message)


def pack_beat(beat: Beat) -> bytes:
    return _BEAT.pack(Kind.BEAT, beat.number, beat.time)


def unpack_beat(message: bytes) -> Beat:
    kind, number, time = _fields(_BEAT, message)
    _expect(kind == Kind.BEAT, "kind", kind)
    return Beat(number, time)


def pack_stop(number: int) -> bytes:
    return _STOP.pack(Kind.STOP, number)


def unpack_stop(message: bytes) -> int:
    kind, number = _fields(_STOP, message)
    _expect(kind == Kind.STOP, "kind", kind)
    return number


def pack_request(request: Request) -> bytes:
    return _REQUEST.pack(request.kind, request.number, request.real_time_factor, request.pose_rate)


def unpack_request(message: bytes) -> Request:
    kind, number, factor, rate = _fields(_REQUEST, message)
    _expect(kind in MEMORIES, "kind", kind)
    return Request(Kind(kind), number, factor, rate)


def pack_poses(report: PosesReport) -> bytes:
    return _POSES.pack(Kind.POSES, report.number)


def pack_word(word: Word) -> bytes:
    progress, limits = word.progress, word.limits
    return _WORD.pack(
        Kind.WORD,
        word.outcome,
        word.number,
        word.serial,
        word.run,
        word.dropped,
        word.failures,
        word.code,
        progress.time,
        progress.epoch,
        progress.level,
        *(getattr(limits, name) for name in _LIMITS),
        limits.max_segments,
        word.seen,
        _clipped(word.field, FIELD),
        _clipped(word.text, TEXT),
    )


def unpack_report(message: bytes) -> Word | PosesReport:
    """A message of `reports`."""
    if len(message) == _POSES.size:
        kind, number = _POSES.unpack(message)
        _expect(kind == Kind.POSES, "kind", kind)
        return PosesReport(number)
    return unpack_word(message)


def unpack_word(message: bytes) -> Word:
    """The answer to a message."""
    kind, outcome, number, serial, run, dropped, failures, code, time, epoch, level, *rest = _fields(_WORD, message)
    _expect(kind == Kind.WORD, "kind", kind)
    *limits, segments, seen, field, text = rest
    try:
        return Word(
            number=number,
            serial=serial,
            run=run,
            outcome=Outcome(outcome),
            code=ErrorCode(code),
            field=_text(field),
            text=_text(text),
            progress=Progress(time, epoch, level),
            limits=Limits(**dict(zip(_LIMITS, limits, strict=True)), max_segments=segments),
            dropped=dropped,
            failures=failures,
            seen=bool(seen),
        )
    except ValueError as error:
        raise BadMessageError(str(error)) from error


def receive(connection: socket.socket, flags: int = 0) -> bytes:
    """The next message; empty if the other side is gone. Raises BlockingIOError."""
    try:
        return connection.recv(ROOM, flags)
    except ConnectionError:
        return b""


def _fields(form: struct.Struct, message: bytes) -> tuple:
    _expect(len(message) == form.size, "size", len(message))
    return form.unpack(message)


def _expect(right: bool, what: str, value: int) -> None:
    if not right:
        raise BadMessageError(f"a message of {what} {value}")


def _clipped(text: str, size: int) -> bytes:
    data = text.encode("utf-8", "replace")
    return data if len(data) <= size else data[: size - 3].decode("utf-8", "ignore").encode() + "…".encode()


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode("utf-8", "replace")
