"""Files of cameras: where a microscope looks, and the outline of the robots that it sees. Beside a scenario, as `camera.yaml`."""

import math
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from stressbot_msgs import scenario_text

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.camera import MOST_DISTORTION, Camera
from stressbot_driver.vision.outline import Outline

FIELD = "camera"
MAX_BYTES = 64_000

SIZE = (16, 10_000)
"""Pixels of a side."""

_LIMITS: dict[str, tuple[float, float]] = {
    "pixel": (1e-9, 1e-2),
    "center": (-10.0, 10.0),
    "rotation": (-2 * math.pi, 2 * math.pi),
    "distortion": (-MOST_DISTORTION, MOST_DISTORTION),
    "latency": (0.0, 1.0),
    "length": (1e-9, 1.0),
    "width": (1e-9, 1.0),
    "pivot": (-1.0, 1.0),
}
_HEADER = """\
# Where a microscope looks: pixels, m per pixel, x and y [m] in the middle of the picture, rad from the substrate's x axis to the
# picture's, radial distortion, s by which pictures are stamped after they were taken; and the outline of the robots that it sees,
# if it is not the one of their bodies.
"""


def load_camera(path: str | Path) -> tuple[Camera, Outline | None]:
    """Return the camera of a file, and the outline if it has one.

    Raises:
        StressbotError: UNREADABLE_FILE, MALFORMED_FILE, MISSING_FIELD, UNKNOWN_FIELD, WRONG_TYPE or OUT_OF_RANGE.
    """
    try:
        content = scenario_text.read_regular(path, MAX_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise StressbotError(ErrorCode.UNREADABLE_FILE, FIELD, f"{path} cannot be read ({reason}): name a camera file") from error
    if len(content) > MAX_BYTES:
        raise StressbotError(ErrorCode.MALFORMED_FILE, FIELD, f"{path} has more than {MAX_BYTES} bytes: is it a camera file?")
    try:
        return parse_camera(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise StressbotError(ErrorCode.UNREADABLE_FILE, FIELD, f"{path} is not UTF-8 text: save it as UTF-8") from error


def parse_camera(text: str) -> tuple[Camera, Outline | None]:
    """As `load_camera`, from text."""
    try:
        content = scenario_text.plain(text)
    except StressbotError as error:
        raise StressbotError(error.code, FIELD, error.message) from error
    _check_keys("", content, [entry.name for entry in fields(Camera)], optional=("distortion", "latency", "outline"))
    camera = Camera(
        width=_size("width", content["width"]),
        height=_size("height", content["height"]),
        pixel=_number("pixel", content["pixel"]),
        center=_pair("center", content["center"]),
        rotation=_number("rotation", content["rotation"]),
        distortion=_number("distortion", content.get("distortion", 0.0)),
        latency=_number("latency", content.get("latency", 0.0)),
    )
    if "outline" not in content:
        return camera, None
    given = content["outline"]
    _check_keys("outline", given, ["length", "width"], optional=("pivot",))
    length, width = (_number(name, given[name], "outline.") for name in ("length", "width"))
    return camera, Outline(length, width, _pair("pivot", given.get("pivot", (0.0, 0.0)), "outline."))


def write_camera(path: str | Path, camera: Camera, outline: Outline | None = None) -> None:
    """Write a camera's file, whole or not at all. Raises StressbotError UNREADABLE_FILE."""
    lines = [f"{entry.name}: {_written(getattr(camera, entry.name))}" for entry in fields(camera)]
    if outline is not None:
        lines += ["outline:", *(f"  {entry.name}: {_written(getattr(outline, entry.name))}" for entry in fields(outline))]
    new = Path(f"{path}.new")
    try:
        new.write_text(_HEADER + "\n".join(lines) + "\n", encoding="utf-8")
        os.replace(new, path)
    except OSError as error:
        message = f"{path} cannot be written ({error.strerror}): name a file in a folder that can"
        raise StressbotError(ErrorCode.UNREADABLE_FILE, "output", message) from error


def _written(value: Any) -> str:
    return f"[{', '.join(map(repr, value))}]" if isinstance(value, tuple) else repr(value)


def _check_keys(place: str, content: Any, names: list[str], optional: tuple[str, ...]) -> None:
    if not isinstance(content, dict):
        raise StressbotError(ErrorCode.WRONG_TYPE, place or FIELD, f"is no mapping: write {': …, '.join(names)}: …")
    prefix = f"{place}." if place else ""
    known = dict.fromkeys([*names, *optional])
    for name in content:
        if name not in known:
            raise StressbotError(ErrorCode.UNKNOWN_FIELD, prefix + name or FIELD, f"is unknown here: use one of {', '.join(known)}")
    for name in names:
        if name not in content and name not in optional:
            raise StressbotError(ErrorCode.MISSING_FIELD, prefix + name, "is missing: add it")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(name: str, value: Any, prefix: str = "") -> float:
    if not _is_number(value):
        raise StressbotError(ErrorCode.WRONG_TYPE, prefix + name, "is no number: give one")
    low, high = _LIMITS[name]
    if not low <= value <= high:  # NaN fails as well
        raise StressbotError(ErrorCode.OUT_OF_RANGE, prefix + name, f"is {value:g}: give {low:g} to {high:g}")
    return float(value)


def _size(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise StressbotError(ErrorCode.WRONG_TYPE, name, "is no whole number: give one, in pixels")
    if not SIZE[0] <= value <= SIZE[1]:
        raise StressbotError(ErrorCode.OUT_OF_RANGE, name, f"is {value}: give {SIZE[0]} to {SIZE[1]} pixels")
    return value


def _pair(name: str, value: Any, prefix: str = "") -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise StressbotError(ErrorCode.WRONG_TYPE, prefix + name, "is no pair: give [x, y] in m")
    first, second = (_number(name, part, prefix) for part in value)
    return first, second
