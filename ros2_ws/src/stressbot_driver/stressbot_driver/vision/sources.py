"""Pictures that others have taken: a folder, a video, a camera at this computer. Grey, one after the other."""

import os
from abc import ABC, abstractmethod
from pathlib import Path

import cv2
import numpy as np

from stressbot_driver.errors import ErrorCode, StressbotError

FIELD = "source"
SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"}
DEFAULT_RATE = 30.0
"""Hz, where the source has none of its own."""


class Source(ABC):
    """Pictures in a row.

    Attributes:
        rate: Hz at which they were taken, or shall be shown.
    """

    rate: float

    @abstractmethod
    def next(self) -> np.ndarray | None:
        """Return the next picture, shape (height, width), uint8; None after the last one.

        Raises StressbotError MALFORMED_FILE if this one cannot be used; those after it may be.
        """

    @abstractmethod
    def rewind(self) -> None:
        """Begin again; a camera goes on."""


class Folder(Source):
    """The pictures of a folder, by name, all of one size. Raises StressbotError UNREADABLE_FILE."""

    def __init__(self, path: Path) -> None:
        self.rate = DEFAULT_RATE
        try:
            names = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in SUFFIXES)
        except OSError as error:
            raise _unreadable(f"{path} cannot be read ({error.strerror}): name a folder of pictures") from error
        if not names:
            raise _unreadable(f"{path} holds no picture: put {', '.join(sorted(SUFFIXES))} files there")
        self._names, self._at = names, 0
        self._shape: tuple[int, ...] = ()  # of the first picture

    def next(self) -> np.ndarray | None:
        if self._at == len(self._names):
            return None
        path = self._names[self._at]
        self._at += 1
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise StressbotError(ErrorCode.MALFORMED_FILE, FIELD, f"{path} is no picture: remove or replace it")
        if not self._shape:
            self._shape = picture.shape
        if picture.shape != self._shape:
            problem = f"{path} has another size ({_size(picture.shape)} and {_size(self._shape)}): let all have one"
            raise StressbotError(ErrorCode.MALFORMED_FILE, FIELD, problem)
        return picture.astype(np.uint8, copy=False)

    def rewind(self) -> None:
        self._at = 0


class Video(Source):
    """A video file, or the camera of that number. Not tried on a microscope. Raises StressbotError UNREADABLE_FILE."""

    def __init__(self, place: Path | int) -> None:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # what cannot be read is said by us
        silence = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel  # the first in OpenCV 4.6, of Ubuntu 24.04
        silence(0)
        self._place = place
        self._capture = self._opened()
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate = float(rate) if 0.1 <= rate <= 1000.0 else DEFAULT_RATE

    def _opened(self) -> cv2.VideoCapture:
        if isinstance(self._place, int):
            capture = cv2.VideoCapture(self._place)
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, not one from before
        else:
            capture = cv2.VideoCapture(str(self._place))
        if not capture.isOpened():
            kind = f"no camera {self._place}" if isinstance(self._place, int) else f"{self._place}"
            raise _unreadable(f"{kind} can be opened: name a folder, a video, a recording (.mcap) or the number of a camera")
        return capture

    def next(self) -> np.ndarray | None:
        found, picture = self._capture.read()
        if not found:
            return None
        return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)

    def rewind(self) -> None:
        if not isinstance(self._place, int):
            self._capture.release()
            self._capture = self._opened()


def open_source(name: str) -> Source:
    """Return the source of a name: a folder, a video file, or the number of a camera. Raises StressbotError."""
    if name.isdecimal() and len(name) < 4:
        return Video(int(name))
    path = Path(name)
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
    except (OSError, ValueError):  # ValueError: a null character
        is_folder = is_file = False
    if is_folder:
        return Folder(path)
    if not is_file:
        raise _unreadable(f"{name} is not there: name a folder, a video, a recording (.mcap) or the number of a camera")
    return Video(path)


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"


def _unreadable(message: str) -> StressbotError:
    return StressbotError(ErrorCode.UNREADABLE_FILE, FIELD, message)
