"""What is too large for a message: memory that nobody can change any more, and a ring of poses that both sides have mapped."""

import fcntl
import mmap
import os
import pickle
import struct
from collections.abc import Iterable
from typing import Any

import numpy as np

from stressbot_driver.gate.protocol import BadMessageError
from stressbot_driver.sequence import VoltageSequence
from stressbot_driver.simulation.substrate import Poses

SEALS = fcntl.F_SEAL_SEAL | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE
_HEAD = struct.Struct("<5QdqdQ")  # bytes of plan_id and swarm_id; segments, epochs, trains; duration, stamp, duty, alternating
NAMES = 65536  # [bytes] at most, of plan_id and swarm_id
LARGEST = 1 << 33  # [bytes]


def sealed(name: str, pieces: Iterable[bytes | memoryview]) -> int:
    """The file descriptor of new memory that holds the pieces and can never change again."""
    descriptor = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        for piece in pieces:
            left = memoryview(piece).cast("B")
            while left:
                left = left[os.write(descriptor, left[: 1 << 30]) :]
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, SEALS)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def read(descriptor: int) -> mmap.mmap:
    """What sealed memory holds. Raises BadMessageError if it could still change, or is empty or too large."""
    try:
        seals = fcntl.fcntl(descriptor, fcntl.F_GET_SEALS)
    except OSError as error:
        raise BadMessageError(f"no memory that can be sealed ({error})") from error
    size = os.fstat(descriptor).st_size
    if seals & SEALS != SEALS or not 0 < size <= LARGEST:
        raise BadMessageError(f"memory of {size} bytes with seals {seals}")
    return mmap.mmap(descriptor, size, prot=mmap.PROT_READ)


def sealed_object(name: str, value: Any) -> int:
    """As `sealed`, of any value. For what the driver itself has made."""
    return sealed(name, [pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)])


def read_object(descriptor: int) -> Any:
    """The value in the memory of `sealed_object`."""
    return pickle.loads(read(descriptor))


def sealed_sequence(sequence: VoltageSequence) -> int:
    """A sequence as memory that `read_sequence` maps without a copy."""
    names = [sequence.plan_id.encode(), sequence.swarm_id.encode()]
    counts = map(len, (*names, sequence.levels, sequence.epoch_ends, sequence.pulses))
    head = _HEAD.pack(*counts, sequence.duration, sequence.stamp, sequence.duty, sequence.alternating)
    text = b"".join(names)
    arrays = [(sequence.levels, "<f8"), (sequence.dwells, "<f8"), (sequence.epoch_ends, "<i8")]
    arrays += [(sequence.pulses, "<u8"), (sequence.low_levels, "<f8")]
    numbers = [np.ascontiguousarray(values, dtype).data for values, dtype in arrays]
    return sealed("sequence", [head, text, bytes(-len(text) % 8), *(piece for piece in numbers if piece.nbytes)])


def read_sequence(descriptor: int) -> VoltageSequence:
    """The sequence in memory of `sealed_sequence`, unchecked. Raises BadMessageError if the memory holds something else."""
    data = read(descriptor)
    if len(data) < _HEAD.size:
        raise BadMessageError(f"a sequence of {len(data)} bytes")
    plan, swarm, segments, epochs, trains, duration, stamp, duty, alternating = _HEAD.unpack_from(data)
    begin = _HEAD.size + plan + swarm
    numbers = begin + -(plan + swarm) % 8
    begins = np.cumsum([numbers, 8 * segments, 8 * segments, 8 * epochs, 8 * trains, 8 * trains], dtype=object).tolist()
    if plan + swarm > NAMES or len(data) != begins[-1]:
        raise BadMessageError(f"a sequence of {len(data)} bytes for {segments} segments, {epochs} epochs and {trains} trains")

    def array(dtype: str, count: int, offset: int) -> np.ndarray:
        return np.frombuffer(data, dtype, count, offset)

    try:
        return VoltageSequence(
            plan_id=data[_HEAD.size : _HEAD.size + plan].decode(),
            swarm_id=data[_HEAD.size + plan : begin].decode(),
            levels=array("<f8", segments, begins[0]),
            dwells=array("<f8", segments, begins[1]),
            epoch_ends=array("<i8", epochs, begins[2]),
            pulses=array("<u8", trains, begins[3]),
            low_levels=array("<f8", trains, begins[4]),
            duration=duration,
            stamp=stamp,
            duty=duty,
            alternating=bool(alternating),
        )
    except UnicodeDecodeError as error:
        raise BadMessageError(f"a name that is no text ({error})") from error


class Ring:
    """Poses on their way from the gate to the driver, the oldest first, and one place besides for the answer to LOOK.

    One side puts, the other takes. What finds no room is dropped.
    """

    _SLOTS = 64  # more than a second of poses at the default rate
    _HEAD = 128  # [bytes]: how many were put, and how many were taken, each on a cache line of its own

    def __init__(self, robots: int, descriptor: int | None = None) -> None:
        """For at most `robots` robots: new memory, or that of the other side. The file descriptor is not needed afterwards.

        Raises BadMessageError if the size differs.
        """
        self._robots = robots
        self._slot = 16 + -(-28 * robots // 8) * 8
        size = self._HEAD + (self._SLOTS + 1) * self._slot
        if descriptor is None:
            descriptor = os.memfd_create("poses", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            os.ftruncate(descriptor, size)
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
        if os.fstat(descriptor).st_size != size:
            raise BadMessageError(f"{os.fstat(descriptor).st_size} bytes for the poses of {robots} robots")
        self.descriptor = descriptor
        self._map = mmap.mmap(descriptor, size)
        self._counts = np.frombuffer(self._map, np.uint64, self._HEAD // 8)

    @property
    def put_so_far(self) -> int:
        return int(self._counts[0])

    def put(self, time: float, poses: Poses) -> bool:
        """Append poses at sequence time `time` [s]; False if there is no room."""
        number = int(self._counts[0])
        if number - int(self._counts[8]) >= self._SLOTS:
            return False
        self._write(number % self._SLOTS, time, poses)
        self._counts[0] = number + 1
        return True

    def take(self) -> tuple[float, Poses] | None:
        """The oldest poses that were not taken yet, and their time."""
        number = int(self._counts[8])
        if number >= int(self._counts[0]):
            return None
        taken = self._read(number % self._SLOTS)
        self._counts[8] = number + 1
        return taken

    def put_aside(self, poses: Poses) -> None:
        """Poses for `taken_aside`; the next ones replace them."""
        self._write(self._SLOTS, 0.0, poses)

    def taken_aside(self) -> Poses:
        """A copy of what was put aside last."""
        return self._read(self._SLOTS)[1]

    def _write(self, slot: int, time: float, poses: Poses) -> None:
        count = len(poses.ids)
        if count > self._robots:
            raise ValueError(f"poses of {count} robots, on the bench lie {self._robots}")
        offset = self._HEAD + slot * self._slot
        struct.pack_into("<Qd", self._map, offset, count, time)
        numbers = np.frombuffer(self._map, np.float64, 3 * count, offset + 16).reshape(3, count)
        numbers[0], numbers[1], numbers[2] = poses.x, poses.y, poses.heading
        np.frombuffer(self._map, np.uint32, count, offset + 16 + 24 * count)[:] = poses.ids

    def _read(self, slot: int) -> tuple[float, Poses]:
        offset = self._HEAD + slot * self._slot
        count, time = struct.unpack_from("<Qd", self._map, offset)
        x, y, heading = np.frombuffer(self._map, np.float64, 3 * count, offset + 16).reshape(3, count).copy()
        ids = np.frombuffer(self._map, np.uint32, count, offset + 16 + 24 * count).copy()
        return time, Poses(ids=ids, x=x, y=y, heading=heading)
