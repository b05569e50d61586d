"""Recordings as files: what is written is read, by us and by others, whatever happened to the writer or the file."""

import errno
import os
import random
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import recording
from stressbot_planner.formats.recording import Recorded, Topic, Writer

QUALITIES = """
- {history: keep_last, depth: 1, reliability: reliable, durability: volatile, liveliness: automatic,
   deadline: {sec: 1, nsec: 0}, lifespan: {sec: 1, nsec: 0}, liveliness_lease_duration: {sec: 1, nsec: 0},
   avoid_ros_namespace_conventions: false}
"""
TEXT = Topic("/said", "std_msgs/msg/String", "string data\n", "RIHS01_ab", QUALITIES)
NUMBER = Topic("/counted", "std_msgs/msg/UInt8", "uint8 data\n")


def text(content: str) -> bytes:
    encoded = content.encode() + b"\0"
    return b"\0\1\0\0" + len(encoded).to_bytes(4, "little") + encoded


def some(count: int, size: int = 20) -> list[Recorded]:
    source = random.Random(count)
    return [
        Recorded(TEXT, 10**18 + k, 10**18 + k - 5, text(source.randbytes(size).hex()))
        if k % 3
        else Recorded(NUMBER, 10**18 + k, 0, b"\0\1\0\0" + bytes([k % 256]))
        for k in range(count)
    ]


def write(path, messages, close=True):
    writer = Writer(path, "jazzy")
    for message in messages:
        writer.add(message)
    if close:
        writer.close()
    return writer


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([TEXT, NUMBER]), st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary())))
def test_what_is_written_is_read(tmp_path_factory, messages):
    path = tmp_path_factory.mktemp("recording") / "x.mcap"
    messages = [Recorded(*message) for message in messages]
    assert write(path, messages).messages == len(messages)
    assert list(recording.read(path)) == messages


def read_by_others(path) -> int:
    with AnyReader([path]) as reader:
        return sum(1 for _ in reader.messages())


def test_an_independent_reader_finds_types_times_and_messages(tmp_path):
    messages = some(300)
    write(tmp_path / "x.mcap", messages)
    with AnyReader([tmp_path / "x.mcap"]) as reader:
        assert {(c.topic, c.msgtype) for c in reader.connections} == {
            ("/said", "std_msgs/msg/String"), ("/counted", "std_msgs/msg/UInt8"),
        }
        found = [(connection.topic, time, data) for connection, time, data in reader.messages()]
        assert found == [(message.topic.name, message.heard, message.data) for message in messages]
        (said,) = (c for c in reader.connections if c.topic == "/said")
        assert reader.deserialize(messages[1].data, said.msgtype).data == messages[1].data[8:-1].decode()


def test_a_writer_that_is_killed_loses_what_came_after_its_last_flush(tmp_path):
    messages = some(5000)  # some chunks of 64 kB, and a rest
    writer = write(tmp_path / "x.mcap", messages[:4000], close=False)
    writer.flush()
    for message in messages[4000:4010]:
        writer.add(message)
    assert writer.messages == 4000
    assert list(recording.read(tmp_path / "x.mcap")) == messages[:4000]
    assert read_by_others(tmp_path / "x.mcap") == 4000
    writer.give_up()


@pytest.mark.parametrize("part", range(0, 100, 7))
def test_a_file_that_ends_early_is_read_up_to_there(tmp_path, part):
    messages = some(4000, 40)
    write(tmp_path / "x.mcap", messages)
    whole = (tmp_path / "x.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: 200 + (len(whole) - 200) * part // 100])
    found = list(recording.read(tmp_path / "cut.mcap"))
    assert found == messages[: len(found)] and (part < 60 or len(found) > 1000)


def test_a_full_disk_leaves_what_fitted(tmp_path, monkeypatch):
    messages, room, real = some(6000, 40), 150_000, os.pwrite

    def limited(number, data, place):
        if place >= room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(number, data[: room - place], place)

    writer = Writer(tmp_path / "x.mcap")
    monkeypatch.setattr(os, "pwrite", limited)
    with pytest.raises(OSError, match="No space left"):
        for message in messages:
            writer.add(message)
        writer.flush()
    writer.give_up()
    monkeypatch.undo()
    found = list(recording.read(tmp_path / "x.mcap"))
    assert found == messages[: len(found)] and len(found) == read_by_others(tmp_path / "x.mcap") > 1000
    assert (tmp_path / "x.mcap").stat().st_size <= room


def test_an_existing_file_is_not_written_over(tmp_path):
    (tmp_path / "x.mcap").write_text("precious")
    with pytest.raises(StressbotError, match="x.mcap exists: give another name") as caught:
        Writer(tmp_path / "x.mcap")
    assert caught.value.code == ErrorCode.UNREADABLE_FILE and (tmp_path / "x.mcap").read_text() == "precious"
    with pytest.raises(StressbotError, match="No such file or directory"):
        Writer(tmp_path / "no" / "x.mcap")


@pytest.mark.parametrize(
    ("content", "code", "reason"),
    [
        (None, ErrorCode.UNREADABLE_FILE, "No such file or directory"),
        (b"", ErrorCode.MALFORMED_FILE, "is no MCAP file"),
        (b"SQLite format 3\0" * 9, ErrorCode.MALFORMED_FILE, "is no MCAP file"),
        (b"\x89MCAP0\r\n" + b"\xff" * 40, ErrorCode.MALFORMED_FILE, "is damaged"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, code, reason):
    if content is not None:
        (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(StressbotError, match=reason) as caught:
        list(recording.read(tmp_path / "x.mcap"))
    assert caught.value.code == code and "\n" not in str(caught.value)


def test_a_recording_of_something_else_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "PROFILE", "ros1")
    write(tmp_path / "x.mcap", some(3))
    monkeypatch.undo()
    with pytest.raises(StressbotError, match="profile 'ros1'"):
        list(recording.read(tmp_path / "x.mcap"))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damage_is_named_in_one_line_and_never_a_defect(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("recording") / "x.mcap"
    messages = some(50)
    write(path, messages)
    content = bytearray(path.read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
        content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        for _ in recording.read(path):
            pass
    except StressbotError as error:
        assert error.code == ErrorCode.MALFORMED_FILE and "\n" not in str(error)


def test_without_the_library_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap", None)
    for use in (lambda: Writer(tmp_path / "x.mcap"), lambda: list(recording.read(tmp_path / "x.mcap"))):
        with pytest.raises(StressbotError, match="needs the Python library mcap.*: pip install mcap") as caught:
            use()
        assert caught.value.code == ErrorCode.UNSUPPORTED
