"""Messages and memory between driver and gate: what was put in comes out, and nothing else is taken for a message."""

import math
import os
import socket

import numpy as np
import pytest
from driver_support import bench, encode
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_driver.backends.base import Progress
from stressbot_driver.errors import ErrorCode
from stressbot_driver.gate import memory, protocol
from stressbot_driver.gate.protocol import BadMessageError, Beat, Kind, Outcome, PosesReport, Request, Word
from stressbot_driver.sequence import Limits, VoltageSequence
from stressbot_driver.simulation.substrate import Poses

QUICK = settings(deadline=None, max_examples=50)
number = st.integers(0, 2**64 - 1)
real = st.floats(allow_nan=False)
words = st.builds(
    Word,
    number=number,
    serial=number,
    run=number,
    outcome=st.sampled_from(Outcome),
    code=st.sampled_from(ErrorCode),
    field=st.text(max_size=30),
    text=st.text(max_size=400),
    progress=st.builds(Progress, real, number, real),
    limits=st.builds(Limits, real, real, real, real, st.integers(0, 2**62), real, real),
    dropped=number,
    failures=number,
    seen=st.booleans(),
)


@QUICK
@given(words)
def test_a_word_comes_out_as_it_went_in(word):
    if not (word.field + word.text).isprintable():
        return
    message = protocol.pack_word(word)
    assert protocol.unpack_word(message) == protocol.unpack_report(message) == word


@QUICK
@given(number, real, st.sampled_from(sorted(protocol.MEMORIES)), real)
def test_other_messages_too(n, x, kind, y):
    assert protocol.unpack_beat(protocol.pack_beat(Beat(n, x))) == Beat(n, x)
    assert protocol.unpack_stop(protocol.pack_stop(n)) == n
    assert protocol.unpack_request(protocol.pack_request(Request(kind, n, x, y))) == Request(kind, n, x, y)
    assert protocol.unpack_report(protocol.pack_poses(PosesReport(n))) == PosesReport(n)
    with pytest.raises(BadMessageError):  # nothing is answered by poses
        protocol.unpack_word(protocol.pack_poses(PosesReport(n)))


@QUICK
@given(words, st.binary(max_size=3000) | st.integers(0, 3000).map(bytes))
def test_what_is_no_message_is_refused_and_nothing_breaks(word, noise):
    good = [
        protocol.pack_beat(Beat(1, 1.0)),
        protocol.pack_stop(1),
        protocol.pack_request(Request(Kind.START, 1)),
        protocol.pack_word(word),
    ]
    readers = [protocol.unpack_beat, protocol.unpack_stop, protocol.unpack_request, protocol.unpack_report]
    for position, reader in enumerate(readers):
        for message in [noise, good[position][:-1], good[position] + b"\0", *(m for m in good if m is not good[position])]:
            try:
                reader(message)
            except BadMessageError:
                continue
            assert len(message) == len(good[position]) or position == 3  # noise of the right size and kind is a message


def test_long_texts_are_cut_at_a_letter():
    word = protocol.unpack_word(protocol.pack_word(Word(field="ä" * 500, text="€" * 5000)))
    assert word.text.endswith("…") and set(word.text[:-1]) == {"€"}
    assert len(word.text.encode()) <= protocol.TEXT and len(word.field.encode()) <= protocol.FIELD
    for length, kept in ((protocol.TEXT, protocol.TEXT), (protocol.TEXT + 1, protocol.TEXT - 3)):
        text = protocol.unpack_word(protocol.pack_word(Word(text="a" * length))).text
        assert text == "a" * kept + "…" * (kept < length)


@pytest.mark.parametrize("unknown", [{"outcome": 77}, {"code": 100_000}])
def test_a_word_of_what_nobody_knows_is_bad(unknown):
    with pytest.raises(BadMessageError):
        protocol.unpack_word(protocol.pack_word(Word(**unknown)))


def test_the_other_side_is_gone_whether_it_has_read_everything_or_not():
    for unread in (b"", b"x"):
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ours:
            if unread:
                ours.send(unread)
            theirs.close()
            assert protocol.receive(ours) == b""


names = st.text(max_size=20)
stamps = st.integers(0, 2**63 - 1)
numbers = st.lists(st.floats(), max_size=20)


@QUICK
@given(names, names, numbers, numbers, st.lists(st.integers(-(2**63), 2**63 - 1), max_size=20), st.floats(), stamps)
def test_a_sequence_comes_out_as_it_went_in(plan, swarm, levels, dwells, ends, duration, stamp):
    if len(levels) != len(dwells):
        dwells = levels
    given_ = VoltageSequence(plan, swarm, np.array(levels), np.array(dwells), np.array(ends, dtype=np.int64), duration, stamp)
    if not _encodable(plan + swarm):
        return
    descriptor = memory.sealed_sequence(given_)
    taken = memory.read_sequence(descriptor)
    os.close(descriptor)
    assert (taken.plan_id, taken.swarm_id, taken.stamp) == (plan, swarm, stamp)
    assert taken.duration == duration or math.isnan(duration)
    for name in ("levels", "dwells", "epoch_ends"):
        assert np.array_equal(getattr(taken, name), getattr(given_, name), equal_nan=name != "epoch_ends")
        assert not getattr(taken, name).flags.writeable


def _encodable(text):
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


@QUICK
@given(st.binary(min_size=1, max_size=200), st.integers(0, 400))
def test_memory_that_holds_no_sequence_is_refused(noise, cut):
    good = memory.sealed_sequence(encode(bench(2), [(1, 1.0)]))
    whole = bytes(memory.read(good))
    os.close(good)
    for data in (noise, whole[: cut % len(whole)] or b"\0", whole + b"\0", noise + whole[len(noise) :]):
        descriptor = memory.sealed("test", [data])
        try:
            memory.read_sequence(descriptor)
        except BadMessageError:
            pass
        else:
            assert len(data) == len(whole)
        finally:
            os.close(descriptor)


def test_memory_that_can_still_change_is_refused(tmp_path):
    open_memory = os.memfd_create("open", os.MFD_ALLOW_SEALING)
    os.write(open_memory, b"something")
    with open(tmp_path / "file", "wb+") as file:
        for descriptor in (open_memory, file.fileno()):
            with pytest.raises(BadMessageError):
                memory.read(descriptor)
    os.close(open_memory)
    closed = memory.sealed("closed", [b"something"])
    with pytest.raises(PermissionError):
        os.write(closed, b"else")
    os.close(closed)


def poses(count, first):
    values = first + np.arange(count, dtype=float)
    return Poses(np.arange(1, count + 1, dtype=np.uint32), values, values + 0.25, values + 0.5)


@pytest.mark.parametrize("robots", [1, 7, 1022])
def test_the_ring_keeps_order_and_drops_what_finds_no_room(robots):
    one = memory.Ring(robots)
    other = memory.Ring(robots, os.dup(one.descriptor))
    put = taken = 0
    rng = np.random.default_rng(robots)
    for _ in range(500):
        count = int(rng.integers(0, robots + 1))
        if rng.random() < 0.6:
            room = put - taken < 64
            assert one.put(float(put), poses(robots, put)) == room
            put += room
        elif put > taken:
            time, oldest = other.take()
            assert time == taken and np.array_equal(oldest.heading, poses(robots, taken).heading)
            taken += 1
        else:
            assert other.take() is None
        one.put_aside(poses(count, -1.0))
        aside = other.taken_aside()
        assert np.array_equal(aside.ids, poses(count, 0).ids) and np.array_equal(aside.x, poses(count, -1.0).x)
    with pytest.raises(ValueError):
        one.put_aside(poses(robots + 1, 0))
    with pytest.raises(BadMessageError):
        memory.Ring(robots + 1, other.descriptor)
