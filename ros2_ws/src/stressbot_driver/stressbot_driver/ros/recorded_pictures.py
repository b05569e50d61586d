"""Pictures out of a recording (MCAP), as they were sent."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, Image
from stressbot_msgs.stamps import nanoseconds

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.sources import FIELD

_KINDS = {"sensor_msgs/msg/Image": Image, "sensor_msgs/msg/CompressedImage": CompressedImage}


class RecordedPicture(NamedTuple):
    """A picture and when it was taken, ns."""

    message: Image | CompressedImage
    time: int


class Recording:
    """The pictures of a recording, one after the other.

    Attributes:
        coming: the next one, or None after the last.

    Raises StressbotError as `recorded_pictures` does.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rewind()

    def rewind(self) -> None:
        """Begin again."""
        self._pictures = recorded_pictures(self._path)
        self.coming: RecordedPicture | None = next(self._pictures)

    def next(self) -> RecordedPicture | None:
        """The one that comes, which has then come."""
        picture, self.coming = self.coming, next(self._pictures, None)
        return picture


def recorded_pictures(path: Path) -> Iterator[RecordedPicture]:
    """Yield the pictures of a recording, those of one topic if there are several; of one that ends early, those that are whole.

    Raises StressbotError UNREADABLE_FILE, MALFORMED_FILE, UNSUPPORTED.
    """
    try:
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader
    except ImportError as error:
        message = f"needs the Python library {error.name}, which is not installed here: pip install mcap"
        raise StressbotError(ErrorCode.UNSUPPORTED, FIELD, message) from None
    schemas: dict[int, str] = {}
    kinds: dict[int, type] = {}
    chosen: int | None = None
    try:
        with open(path, "rb") as stream:
            for record in StreamReader(stream).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel) and schemas.get(record.schema_id) in _KINDS:
                    kinds[record.id] = _KINDS[schemas[record.schema_id]]
                elif isinstance(record, Message) and record.channel_id in kinds and chosen in (None, record.channel_id):
                    chosen = record.channel_id
                    picture = deserialize_message(record.data, kinds[chosen])
                    yield RecordedPicture(picture, nanoseconds(picture.header.stamp))
    except OSError as error:
        raise StressbotError(ErrorCode.UNREADABLE_FILE, FIELD, f"{path} cannot be read ({error.strerror})") from error
    except Exception as error:  # what reading raises has no class in common
        if chosen is None:
            message = f"{path} cannot be read as a recording ({error}): name an MCAP file with pictures"
            raise StressbotError(ErrorCode.MALFORMED_FILE, FIELD, message) from error
        return  # it ends early
    if chosen is None:
        raise StressbotError(ErrorCode.MALFORMED_FILE, FIELD, f"{path} has no topic of pictures: record image_raw/compressed too")
