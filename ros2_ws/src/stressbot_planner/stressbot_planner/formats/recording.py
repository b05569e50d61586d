"""Recordings: MCAP files with ROS 2's profile, which rosbag2, Foxglove and others read. Messages are kept as they were sent.

Written in chunks that are whole on the disk, so that whatever ends the recorder leaves a file that can be read up to there.
"""

import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from stressbot_planner.errors import ErrorCode, StressbotError

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

PROFILE, ENCODING = "ros2", "cdr"
CHUNK = 64 * 1024
"""Bytes of messages after which a chunk is written; a smaller one is by `flush`."""
END = struct.pack("<BQI", 0x0F, 4, 0) + struct.pack("<BQQQI", 0x02, 20, 0, 0, 0) + b"\x89MCAP0\r\n"
"""The end of a file without a summary: records DataEnd and Footer, and the magic number."""

FIELD, OUTPUT = "recording", "output"
LARGEST = 1 << 30
"""Bytes of a record that a reader takes in; a longer one is no record of ours."""


@dataclass(frozen=True)
class Topic:
    """What a file says of a topic.

    Attributes:
        name: full.
        type: of its messages, `package/msg/Name`.
        definition: of that type and of all in it, in ROS 2's message language.
        type_hash: `RIHS01_…`, or empty.
        qualities: of service that its publishers offer, as rosbag2 writes them in YAML.
    """

    name: str
    type: str
    definition: str
    type_hash: str = ""
    qualities: str = ""


class Recorded(NamedTuple):
    """A message: its topic, when it was heard and when it was sent (ns of Unix time), and itself, serialized."""

    topic: Topic
    heard: int
    sent: int
    data: bytes


class Writer:
    """Writes a new file.

    Attributes:
        messages: how many are on the disk.
    """

    def __init__(self, path: Path, distribution: str = ""):
        """Raises StressbotError: UNREADABLE_FILE if there is such a file already, or it cannot be made; UNSUPPORTED as `read`."""
        _check_library()
        from mcap.writer import CompressionType
        from mcap.writer import Writer as Chunks

        self.messages = 0
        self._file = _File(path)
        output: Any = self._file  # mcap asks for more than it uses
        self._chunks = Chunks(output, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._channels: dict[Topic, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._added = 0
        self._chunks.start(PROFILE, "stressbot")
        if distribution:
            self._chunks.add_metadata("rosbag2", {"ROS_DISTRO": distribution})

    def add(self, message: Recorded) -> None:
        """Add a message; it is on the disk after the next `flush` at the latest. Raises OSError if that is full."""
        topic = message.topic
        if topic not in self._channels:
            schema = topic.type, topic.definition
            if schema not in self._schemas:
                self._schemas[schema] = self._chunks.register_schema(topic.type, "ros2msg", topic.definition.encode())
            metadata = {"offered_qos_profiles": topic.qualities, "topic_type_hash": topic.type_hash}
            self._channels[topic] = self._chunks.register_channel(topic.name, ENCODING, self._schemas[schema], metadata)
        self._added += 1
        self._chunks.add_message(self._channels[topic], message.heard, message.data, message.sent)
        self._file.write_out()

    def flush(self) -> None:
        """Write what has been added. Raises OSError if that cannot be: the file then ends with the last flush."""
        self._chunks.flush()
        self._file.write_out()
        self.messages = self._added

    def close(self) -> None:
        """Write what is left and the summary. Raises OSError if that cannot be."""
        try:
            self.flush()
            self._chunks.finish()
            self._file.write_out(is_last=True)
        finally:
            self._file.close()

    def give_up(self) -> None:
        """Close the file as it is."""
        self._file.close()


class _File:
    """Whole pieces of a file, and an end behind them that the next one takes the place of: it can be read at any time.

    A piece that does not fit on the disk leaves nothing behind.
    """

    def __init__(self, path: Path):
        try:
            self._number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            raise _refusal(OUTPUT, f"{path} exists: give another name, or take it away") from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise _refusal(OUTPUT, f"cannot write {path} ({reason}): give another name") from error
        self._waiting = bytearray()
        self._written = 0

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def flush(self) -> None:
        """Pieces are whole when `write_out` is called."""

    def tell(self) -> int:
        return self._written + len(self._waiting)

    def write_out(self, is_last: bool = False) -> None:
        waiting = bytes(self._waiting)
        self._waiting.clear()
        if not waiting:
            return
        try:
            self._put(waiting + (b"" if is_last else END))
        except OSError:
            os.ftruncate(self._number, self._written)
            with suppress(OSError):
                self._put(END)
            raise
        self._written += len(waiting)

    def _put(self, data: bytes) -> None:
        done = 0
        while done < len(data):
            done += os.pwrite(self._number, data[done:], self._written + done)

    def close(self) -> None:
        os.close(self._number)


def read(path: Path) -> Iterator[Recorded]:
    """Yield the messages of a file, in the order in which they were heard; of one that ends early, those that are whole.

    Raises:
        StressbotError: UNREADABLE_FILE or MALFORMED_FILE: it cannot be read, is no recording of ROS 2, or is damaged.
            UNSUPPORTED: the library that reads it is not installed.
    """
    _check_library()
    try:
        with open(path, "rb") as stream:
            yield from _messages(path, _Stream(stream))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _refusal(FIELD, f"{path} cannot be read ({reason}): name a recording") from error


class _Stream:
    """A file that knows whether more was asked of it than it has."""

    def __init__(self, stream: BinaryIO):
        self._stream = stream
        self.has_ended = False

    def read(self, size: int = -1) -> bytes:
        data = self._stream.read(size)
        self.has_ended |= len(data) < size
        return data


def _messages(path: Path, stream: _Stream) -> Iterator[Recorded]:
    from mcap.exceptions import InvalidMagic
    from mcap.records import Channel, Header, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Schema] = {}
    channels: dict[int, Topic] = {}
    is_ours = False
    try:
        given: Any = stream
        for record in StreamReader(given, validate_crcs=True, record_size_limit=LARGEST).records:
            if isinstance(record, Header):
                is_ours = record.profile == PROFILE
                if not is_ours:
                    raise _damaged(f"{path} has the profile '{record.profile}': give a recording of ROS 2")
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = _topic(path, record, schemas.get(record.schema_id))
            elif isinstance(record, Message):
                if record.channel_id not in channels:
                    raise _damaged(f"{path} has a message of no topic: it is damaged")
                yield Recorded(channels[record.channel_id], record.log_time, record.publish_time, record.data)
    except StressbotError:
        raise
    except InvalidMagic:
        is_ours = is_ours and stream.has_ended
    except Exception as error:  # what unpacking, checking and decompressing raise has no class in common
        if not stream.has_ended:
            raise _damaged(f"{path} is damaged ({error}): what follows cannot be read") from error
    if not is_ours:
        raise _damaged(f"{path} is no MCAP file: give a recording of ROS 2")


def _topic(path: Path, channel: "Channel", schema: "Schema | None") -> Topic:
    if channel.message_encoding != ENCODING or schema is None:
        raise _damaged(f"{path}: topic '{channel.topic}' is encoded as '{channel.message_encoding}': give a recording of ROS 2")
    metadata = channel.metadata
    definition = schema.data.decode("utf-8", errors="replace")
    return Topic(
        channel.topic, schema.name, definition, metadata.get("topic_type_hash", ""), metadata.get("offered_qos_profiles", "")
    )


def _check_library() -> None:
    try:
        import mcap  # noqa: F401
        import zstandard  # noqa: F401
    except ImportError as error:
        message = f"needs the Python library {error.name}, which is not installed here: pip install mcap"
        raise StressbotError(ErrorCode.UNSUPPORTED, FIELD, message) from None


def _damaged(message: str) -> StressbotError:
    return StressbotError(ErrorCode.MALFORMED_FILE, FIELD, message)


def _refusal(field: str, message: str) -> StressbotError:
    return StressbotError(ErrorCode.UNREADABLE_FILE, field, message)
