"""Pictures of a camera as messages, on the topics of image_transport."""

from array import array

import cv2
import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.parameters import Declaration
from stressbot_driver.ros.qos import PICTURES

TOPIC, COMPRESSED = "image_raw", "image_raw/compressed"
FRAME = "camera"
FORMATS = {"jpeg": (".jpg", [cv2.IMWRITE_JPEG_QUALITY, 90]), "png": (".png", [cv2.IMWRITE_PNG_COMPRESSION, 1])}

FORMAT = Declaration("format", "jpeg", f"Of compressed pictures: {' or '.join(FORMATS)}.", read_only=True)


class Pictures:
    """Publishes `image_raw` and `image_raw/compressed`, each only while somebody subscribes to it.

    Raises StressbotError OUT_OF_RANGE for a format that is not known.
    """

    def __init__(self, node: Node, kind: str) -> None:
        if kind not in FORMATS:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, FORMAT.name, f"is {kind!r}: give {' or '.join(FORMATS)}")
        self._kind = kind
        self._raw = node.create_publisher(Image, TOPIC, PICTURES)
        self._compressed = node.create_publisher(CompressedImage, COMPRESSED, PICTURES)

    @property
    def are_wanted(self) -> bool:
        """Whether anybody listens."""
        return bool(self._raw.get_subscription_count() or self._compressed.get_subscription_count())

    def publish(self, picture: np.ndarray, stamp: Time) -> None:
        """Publish grey levels, shape (height, width), uint8, at the middle of their exposure."""
        if self._raw.get_subscription_count():
            self._raw.publish(image_message(picture, stamp))
        if self._compressed.get_subscription_count():
            suffix, settings = FORMATS[self._kind]
            _, data = cv2.imencode(suffix, picture, settings)
            message = CompressedImage(format=self._kind, data=array("B", data.tobytes()))
            message.header.stamp, message.header.frame_id = stamp, FRAME
            self._compressed.publish(message)

    def pass_on(self, message: Image | CompressedImage) -> None:
        """Publish a picture as it was once sent."""
        (self._raw if isinstance(message, Image) else self._compressed).publish(message)


def image_message(picture: np.ndarray, stamp: Time) -> Image:
    """Return grey levels, shape (height, width), uint8, as a message. The data are one copy: a list would take a second."""
    height, width = picture.shape
    message = Image(height=height, width=width, encoding="mono8", step=width, data=array("B", picture.tobytes()))
    message.header.stamp, message.header.frame_id = stamp, FRAME
    return message
