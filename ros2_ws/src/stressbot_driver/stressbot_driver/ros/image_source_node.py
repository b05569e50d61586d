"""The image source node: pictures of a folder, a video, a recording or a camera, on the topics of a camera."""

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
from rclpy.clock import Clock, ClockType
from stressbot_msgs.process import ProcessNode, run

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.parameters import Declaration, declare_all
from stressbot_driver.ros.pictures import FORMAT, Pictures
from stressbot_driver.ros.recorded_pictures import RecordedPicture, recorded_pictures
from stressbot_driver.vision.sources import FIELD, open_source

PARAMETERS = (
    Declaration(
        FIELD, "", "A folder of pictures, a video, a recording (.mcap), or the number of a camera. Required.", read_only=True
    ),
    Declaration(
        "rate", 0.0, "[Hz] Pictures per second; 0: as the source has it.", low=0.0, high=240.0, least=0.1, read_only=True
    ),
    Declaration("repeat", False, "Begin again after the last picture."),
    FORMAT,
)
LONGEST_GAP = 2_000_000_000
"""ns between two pictures of a recording; a longer one is cut to that."""


class ImageSourceNode(ProcessNode):
    """Publishes `image_raw` and `image_raw/compressed`, from when somebody listens. A stamp is when the picture is shown.

    Raises StressbotError if the parameters or the source are refused.
    """

    def __init__(self) -> None:
        super().__init__("image_source")
        cv2.setNumThreads(1)
        try:
            declare_all(self, PARAMETERS)
            self._name = self.get_parameter(FIELD).value
            if not self._name:
                message = "is not set: name a folder of pictures, a video, a recording (.mcap) or the number of a camera"
                raise StressbotError(ErrorCode.MISSING_FIELD, FIELD, message)
            self._pictures = Pictures(self, self.get_parameter(FORMAT.name).value)
            self._recording: Iterator[RecordedPicture] | None = None
            self._coming: RecordedPicture | None = None
            if Path(self._name).suffix.lower() == ".mcap":
                self._rewind_recording()
                self._source, rate = None, 0.0
            else:
                self._source = open_source(self._name)
                rate = self._source.rate
        except BaseException:
            self.destroy_node()
            raise
        self._count = 0
        self._rate = float(self.get_parameter("rate").value) or rate
        self._timer = self.create_timer(1.0 / (self._rate or 30.0), self._show, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"up: pictures of {self._name} on image_raw, once somebody listens")

    def _rewind_recording(self) -> None:
        self._recording = recorded_pictures(Path(self._name))
        self._coming = next(self._recording)

    def _show(self) -> None:
        if not self._pictures.are_wanted:
            return
        try:
            shown = self._show_next() if self._source else self._show_recorded()
        except StressbotError as error:
            self.get_logger().warning(str(error))
            return
        if shown:
            self._count += 1
        elif self._count and self.get_parameter("repeat").value:
            self._source.rewind() if self._source else self._rewind_recording()
        else:
            self._timer.cancel()
            self.get_logger().info(f"the end of {self._name}: {self._count} pictures")

    def _show_next(self) -> bool:
        picture = self._source.next()
        if picture is not None:
            self._pictures.publish(picture, self.get_clock().now().to_msg())
        return picture is not None

    def _show_recorded(self) -> bool:
        """Show what comes; come again after as long as it was in the recording."""
        shown = self._coming
        if shown is None:
            return False
        shown.message.header.stamp = self.get_clock().now().to_msg()
        self._pictures.pass_on(shown.message)
        self._coming = next(self._recording, None)
        if self._coming is not None and not self._rate:
            self._timer.timer_period_ns = min(max(self._coming.time - shown.time, 1), LONGEST_GAP)
            self._timer.reset()
        return True


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver image_source`."""
    sys.exit(run("image_source", ImageSourceNode, args))
