"""`camera_calibrate`, `camera_check`: which camera has taken pictures of robots at their starts, and whether it still does."""

import argparse
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from sensor_msgs.msg import Image
from stressbot_msgs.wording import sentence

from stressbot_driver.bench import Bench, load_bench
from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.grey_pictures import decoded, grey_of_image
from stressbot_driver.ros.recorded_pictures import recorded_pictures
from stressbot_driver.vision.calibrating import Fit, Unknown, calibrate, fit_electrodes, moved
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import load_camera, write_camera
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.sources import FIELD, open_source

GOOD, BAD_INPUT, BEYOND = 0, 2, 3
AVERAGED = 10
"""Pictures at most, of robots that stand still."""

_PICTURES = "a folder of pictures, a video, a recording (.mcap) or the number of a camera; the robots at their starts, at rest"


def calibrate_main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver camera_calibrate`."""
    parser = _parser("camera_calibrate", "Find out which camera has taken pictures of robots at their starts.")
    about = parser.add_mutually_exclusive_group(required=True)
    about.add_argument("--pitch", type=float, metavar="M", help="of the electrodes that are seen, from one to the next")
    about.add_argument("--pixel", type=float, metavar="M", help="m per pixel, about, where no electrodes are seen")
    outline = ("LENGTH", "WIDTH", "PIVOT")
    parser.add_argument("--outline", type=float, nargs=3, metavar=outline, help="m, of a robot; pivot along it, from its middle")
    parser.add_argument("--output", type=Path, default=Path("camera.yaml"), metavar="FILE", help="default: %(default)s")
    sys.exit(_run("camera_calibrate", lambda: _calibrate(parser.parse_args(args))))


def check_main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run stressbot_driver camera_check`."""
    parser = _parser("camera_check", "Tell how far a stage has moved since its camera was calibrated.")
    parser.add_argument("--camera", type=Path, default=Path("camera.yaml"), metavar="FILE", help="default: %(default)s")
    parser.add_argument("--most", type=float, default=5e-6, metavar="M", help="that is accepted (default: %(default)s)")
    sys.exit(_run("camera_check", lambda: _check(parser.parse_args(args))))


def _parser(name: str, text: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=name, description=text)
    parser.add_argument("--scenario", type=Path, required=True, metavar="FILE", help="that says where the robots start")
    parser.add_argument("--source", required=True, help=_PICTURES)
    return parser


def _run(name: str, work) -> int:
    cv2.setNumThreads(1)
    try:
        return work()
    except StressbotError as error:
        sys.stderr.write(f"{name}: {error}\n")
        return BEYOND if error.code == ErrorCode.INFEASIBLE else BAD_INPUT


def _calibrate(args: argparse.Namespace) -> int:
    for name, value in (("pitch", args.pitch), ("pixel", args.pixel)):
        if value is not None and not 1e-9 <= value <= 1e-2:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, name, f"is {value:g}: give m, from 1e-09 to 0.01")
    bench = load_bench(args.scenario)
    given = None
    if args.outline:
        length, width, pivot = args.outline
        if not (0 < width <= length <= 1 and abs(pivot) <= length):
            raise StressbotError(ErrorCode.OUT_OF_RANGE, "outline", "needs a length, a smaller width and a pivot within: give m")
        given = Outline(length, width, (pivot, 0.0))
    picture = _mean(args.source)
    if args.pitch is None:
        camera = Camera(picture.shape[1], picture.shape[0], args.pixel)
    else:
        electrodes = fit_electrodes(picture, args.pitch)
        camera = electrodes.camera
        _say(f"electrodes: {1e6 * camera.pixel:.4f} um per pixel, fitted to {1e6 * electrodes.rms:.2f} um rms")
    unknown = Unknown.ALL if args.pitch is None else Unknown.PLACE
    fit = calibrate(picture, bench.start, given or _outline(bench), camera, unknown)
    write_camera(args.output, fit.camera, given)
    _tell(fit, bench)
    _say(
        f"{args.output}: {1e6 * fit.camera.pixel:.4f} um per pixel, turned {np.degrees(fit.camera.rotation):.2f} degrees, "
        f"distortion {fit.camera.distortion:.4f}"
    )
    return GOOD


def _check(args: argparse.Namespace) -> int:
    camera, outline = load_camera(args.camera)
    bench = load_bench(args.scenario)
    picture = _mean(args.source)
    if picture.shape != (camera.height, camera.width):
        height, width = picture.shape
        problem = f"shows {width} x {height} pixels, {args.camera} is of {camera.width} x {camera.height}: calibrate this camera"
        raise StressbotError(ErrorCode.WRONG_COUNT, FIELD, problem)
    fit = calibrate(picture, bench.start, outline or _outline(bench), camera, Unknown.PLACE_AND_TURN)
    x, y, turn = moved(fit, camera)
    far = float(np.hypot(x, y) + abs(turn) * np.hypot(camera.width, camera.height) * camera.pixel / 2)
    _tell(fit, bench)
    _say(
        f"the stage has moved by {1e6 * x:.2f}, {1e6 * y:.2f} um and turned by {np.degrees(turn):.3f} degrees: "
        f"in a corner {1e6 * far:.2f} um, accepted are {1e6 * args.most:.2f} um"
    )
    if far > args.most:
        sys.stderr.write(f"camera_check: the stage has moved by more than {1e6 * args.most:.2f} um: calibrate again\n")
        return BEYOND
    return GOOD


def _outline(bench: Bench) -> Outline:
    return Outline.of(float(np.median(bench.body_radius)))


def _mean(name: str) -> np.ndarray:
    """Return the mean of the first pictures, shape (height, width), uint8."""
    pictures = list(islice(_recorded(Path(name)) if name.lower().endswith(".mcap") else _shown(name), AVERAGED))
    if not pictures:
        raise StressbotError(ErrorCode.UNREADABLE_FILE, FIELD, f"{name} shows nothing: give at least one picture")
    if any(picture.shape != pictures[0].shape for picture in pictures):
        raise StressbotError(ErrorCode.WRONG_COUNT, FIELD, f"{name} has pictures of several sizes: let all have one")
    return np.round(np.mean(pictures, axis=0)).astype(np.uint8)


def _shown(name: str) -> Iterator[np.ndarray]:
    source = open_source(name)
    while (picture := source.next()) is not None:
        yield picture


def _recorded(path: Path) -> Iterator[np.ndarray]:
    for message, _ in recorded_pictures(path):
        if isinstance(message, Image):
            yield grey_of_image(message, message.width, message.height)
        elif (picture := decoded(message)) is not None:
            yield picture


def _tell(fit: Fit, bench: Bench) -> None:
    _say(
        f"{len(fit.errors)} of {len(bench.start)} robots at their starts: {1e6 * fit.rms:.2f} um rms, "
        f"{1e6 * fit.errors.max():.2f} um at most"
    )


def _say(text: str) -> None:
    sys.stdout.write(sentence(text) + "\n")
