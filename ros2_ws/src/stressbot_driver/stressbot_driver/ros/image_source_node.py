"""The image source node: pictures of a folder, a video, a recording or a camera, on the topics of a camera."""

import sys
from pathlib import Path

import cv2
from rclpy.clock import Clock, ClockType
from stressbot_msgs.process import ProcessNode, run

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.parameters import Declaration, declare_all, number_of, value_of
from stressbot_driver.ros.pictures import FORMAT, Pictures
from stressbot_driver.ros.recorded_pictures import Recording
from stressbot_driver.vision.sources import FIELD, Source, open_source

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
            self._name: str = value_of(self, FIELD)
            if not self._name:
                message = "is not set: name a folder of pictures, a video, a recording (.mcap) or the number of a camera"
                raise StressbotError(ErrorCode.MISSING_FIELD, FIELD, message)
            self._pictures = Pictures(self, value_of(self, FORMAT.name))
            path = Path(self._name)
            self._source = Recording(path) if path.suffix.lower() == ".mcap" else open_source(self._name)
        except BaseException:
            self.destroy_node()
            raise
        self._count = 0
        own = self._source.rate if isinstance(self._source, Source) else 0.0
        self._rate = number_of(self, "rate") or own  # [Hz]; 0: as it was recorded
        self._timer = self.create_timer(1.0 / (self._rate or 30.0), self._show, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"up: pictures of {self._name} on image_raw, once somebody listens")

    def _show(self) -> None:
        if not self._pictures.are_wanted:
            return
        try:
            source = self._source
            shown = self._show_next(source) if isinstance(source, Source) else self._show_recorded(source)
        except StressbotError as error:
            self.get_logger().warning(str(error))
            return
        if shown:
            self._count += 1
        elif self._count and value_of(self, "repeat"):
            self._source.rewind()
        else:
            self._timer.cancel()
            self.get_logger().info(f"the end of {self._name}: {self._count} pictures")

    def _show_next(self, source: Source) -> bool:
        picture = source.next()
        if picture is not None:
            self._pictures.publish(picture, self.get_clock().now().to_msg())
        return picture is not None

    def _show_recorded(self, recording: Recording) -> bool:
        """Show what comes; come again after as long as it was in the recording."""
        shown, coming = recording.next(), recording.coming
        if shown is None:
            return False
        shown.message.header.stamp = self.get_clock().now().to_msg()
        self._pictures.pass_on(shown.message)
        if coming is not None and not self._rate:
            self._timer.timer_period_ns = min(max(coming.time - shown.time, 1), LONGEST_GAP)
            self._timer.reset()
        return True


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver image_source`."""
    sys.exit(run("image_source", ImageSourceNode, args))
