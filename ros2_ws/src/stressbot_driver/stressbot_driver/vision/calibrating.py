"""Which camera has taken a picture: from its electrodes, whose pitch is known, and from robots that stand where they are known to.

Electrodes tell scale, rotation (but for half a turn) and distortion, with thousands of places; not where the substrate lies. Robots
at their start poses tell all of it, but the distortion only if there are some, in the corners too. Phases of the electrodes
are found by demodulation with what is known so far, from the middle of the picture outwards (Fourier-transform profilometry: Takeda
and others, J. Opt. Soc. Am. 72, 1982); everything is fitted by robust least squares.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from scipy.optimize import least_squares

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.vision.camera import MOST_DISTORTION, Camera
from stressbot_driver.vision.detection import Detector
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.planar import turned, wrapped

FIELD = "source"
SHORTEST_PERIOD, FEWEST_PERIODS = 3.0, 16
"""Pixels of a period of electrodes, and periods across the picture."""

CLEAR = 8.0
"""Of the strongest wave relative to the median one: noise alone reaches 5."""

RADII = (0.35, 0.5, 0.7, 0.85, 1.0, 1.0)
"""Of half a diagonal: as far as electrodes are looked at, one time after another."""

SMOOTH = 1.5
"""Periods: sigma of what phases are averaged over."""

MOST_SCATTER = 0.1
"""Periods rms, between electrodes and what they are fitted by: where there are none it is 0.3."""

FEWEST_PLACES, MOST_PLACES = 40, 2000
ALIKE = 0.35
"""rad between a robot's heading and its start's."""

ENOUGH_FOR_DISTORTION = 6
"""Robots."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A camera, and by how much it misses what it was fitted to.

    Attributes:
        camera: fitted.
        errors: m; of electrodes across them, of robots the distance from their start.
    """

    camera: Camera
    errors: np.ndarray

    @property
    def rms(self) -> float:
        """m."""
        return float(np.sqrt(np.mean(self.errors**2)))


def fit_electrodes(picture: np.ndarray, pitch: float, rotation: float = 0.0) -> Fit:
    """Return scale, rotation and distortion; the middle of the picture is at 0, 0.

    Args:
        picture: shape (height, width), uint8.
        pitch: of the electrodes, m.
        rotation: rad, about; the picture is the same after half a turn.

    Raises:
        StressbotError: INFEASIBLE, no electrodes are seen.
    """
    height, width = picture.shape
    levels = picture.astype(np.float32)
    levels -= cv2.GaussianBlur(levels, (0, 0), max(picture.shape) / FEWEST_PERIODS)
    wave = _wave(levels)
    if np.cos(np.arctan2(wave[1], wave[0]) - rotation) < 0:
        wave = -wave
    start, period = 0.0, 1.0 / float(np.hypot(*wave))
    camera = Camera(width, height, pitch / period, rotation=float(np.arctan2(wave[1], wave[0])))
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    from_middle = np.hypot(*(pixels - (width / 2 - 0.5, height / 2 - 0.5)).T)
    grid = _grid(width, height, period)
    errors = np.empty(0)
    for radius in RADII:
        at = grid[from_middle[grid] <= radius * np.hypot(width, height) / 2]
        phases = camera.to_substrate(pixels)[:, 0] / pitch + start
        answer = _demodulated(levels, phases, SMOOTH * period).ravel()[at]
        measured = phases[at] + np.angle(answer) / (2 * np.pi)
        weight = np.minimum(np.abs(answer) / np.median(np.abs(answer)), 1.0)
        camera, start = _fitted(pixels[at], measured * pitch, weight, camera, start * pitch, bends=radius > RADII[0])
        missed = camera.to_substrate(pixels[at])[:, 0] + start - measured * pitch
        start, errors = start / pitch, missed[weight > 0.5]
    fit = Fit(camera, errors)
    if len(errors) < FEWEST_PLACES or fit.rms > MOST_SCATTER * pitch:
        raise _nothing()
    return fit


def _nothing() -> StressbotError:
    return StressbotError(
        ErrorCode.INFEASIBLE, FIELD, "shows no electrodes: give a sharper picture, or leave the pitch out and give the pixel"
    )


def _demodulated(levels: np.ndarray, phases: np.ndarray, smooth: float) -> np.ndarray:
    """Return the complex amplitude of a wave of these phases [periods], averaged with a sigma in pixels."""
    turned = np.exp(-2j * np.pi * phases).astype(np.complex64).reshape(levels.shape)
    real, imaginary = (cv2.GaussianBlur(levels * part, (0, 0), smooth) for part in (turned.real, turned.imag))
    return real + 1j * imaginary


def _fitted(
    pixels: np.ndarray, x: np.ndarray, weight: np.ndarray, camera: Camera, start: float, bends: bool
) -> tuple[Camera, float]:
    """Return the camera that sees places at x, shape (k,), m, but for a start, and that start."""

    def model(values: np.ndarray) -> Camera:
        pixel, rotation, distortion, _ = values
        return replace(camera, pixel=float(np.exp(pixel)), rotation=float(rotation), distortion=float(distortion) * bends)

    def misses(values: np.ndarray) -> np.ndarray:
        return weight * (model(values).to_substrate(pixels)[:, 0] + values[3] * camera.pixel - x) / camera.pixel

    first = [np.log(camera.pixel), camera.rotation, camera.distortion, start / camera.pixel]
    limits = np.array([np.inf, np.inf, MOST_DISTORTION, np.inf])
    found = least_squares(misses, first, bounds=(-limits, limits), loss="soft_l1", f_scale=0.3, x_scale=[0.01, 0.01, 0.01, 1.0])
    return model(found.x), float(found.x[3]) * camera.pixel


def _wave(levels: np.ndarray) -> np.ndarray:
    """Return the strongest wave in the middle of a picture, periods per pixel to the right and down. Raises StressbotError."""
    height, width = levels.shape
    middle = levels[height // 4 : height - height // 4, width // 4 : width - width // 4]
    rows, columns = middle.shape
    window = np.hanning(rows)[:, None] * np.hanning(columns)
    power = np.abs(np.fft.rfft2(middle * window))
    down, right = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)
    frequency = np.hypot(down, right)
    allowed = (frequency > FEWEST_PERIODS / max(levels.shape)) & (frequency < 1.0 / SHORTEST_PERIOD)
    power = np.where(allowed, power, 0.0)
    i, j = np.unravel_index(int(power.argmax()), power.shape)
    if not allowed.any() or power[i, j] < CLEAR * np.median(power[allowed]):
        raise _nothing()

    def peak(before: float, at: float, after: float) -> float:
        """Where a parabola through the logarithms of three values is highest."""
        a, b, c = np.log([max(value, 1e-9 * at) for value in (before, at, after)])
        return float(np.clip(0.5 * (a - c) / (a - 2 * b + c), -0.5, 0.5)) if a + c < 2 * b else 0.0

    across = peak(power[i, max(j - 1, 0)], power[i, j], power[i, min(j + 1, power.shape[1] - 1)])
    along = peak(power[i - 1, j], power[i, j], power[(i + 1) % rows, j])
    return np.array([right[j] + across / columns, down[i, 0] + along / rows])


def _grid(width: int, height: int, period: float) -> np.ndarray:
    """Indices of the pixels at which phases are read, none near the edge."""
    rim = min(2 * SMOOTH * period, min(width, height) / 4)
    step = max(SMOOTH * period, np.sqrt(width * height / MOST_PLACES))
    columns, rows = (np.arange(rim, size - rim, step).astype(int) for size in (width, height))
    return (rows[:, None] * width + columns).ravel()


class Unknown(IntEnum):
    """What of a camera robots shall tell; the value is how many numbers that are."""

    PLACE = 2
    PLACE_AND_TURN = 3
    ALL = 5


def fit_places(pixels: np.ndarray, places: np.ndarray, camera: Camera, unknown: Unknown = Unknown.ALL) -> Fit:
    """Return the camera that sees places, shape (k, 2), m, at pixels, shape (k, 2); one in some may be wrong.

    Args:
        pixels: where they are seen.
        places: where they are.
        camera: what it is about.
        unknown: of it; the distortion stays where there are too few places.
    """
    count = int(unknown) - (unknown is Unknown.ALL and len(places) < ENOUGH_FOR_DISTORTION)
    first = np.array([0.0, 0.0, 0.0, 0.0, camera.distortion])

    def model(values: np.ndarray) -> Camera:
        x, y, turn, scale, distortion = np.concatenate([values, first[count:]])
        return replace(
            camera,
            pixel=camera.pixel * float(np.exp(scale)),
            center=(float(camera.center[0] + x * camera.pixel), float(camera.center[1] + y * camera.pixel)),
            rotation=camera.rotation + float(turn),
            distortion=float(distortion),
        )

    def misses(values: np.ndarray) -> np.ndarray:
        return (model(values).to_pixels(places) - pixels).ravel()

    high = np.array([np.inf, np.inf, np.inf, 2.0, MOST_DISTORTION])[:count]
    scale = np.array([1.0, 1.0, 0.01, 0.01, 0.01])[:count]
    values = first[:count]
    for loss in ("soft_l1", "cauchy"):  # which leads there from far, and lets go of what is wrong
        values = least_squares(misses, values, bounds=(-high, high), loss=loss, f_scale=0.3, x_scale=scale).x
    fitted = model(values)
    return Fit(fitted, np.hypot(*(fitted.to_substrate(pixels) - places).T))


def matched(seen: np.ndarray, starts: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return which of what is seen stands where which robot starts, after the best turn and shift; and that turn, rad.

    Args:
        seen: poses, shape (k, 3), in a frame of its own of the same scale.
        starts: shape (n, 3), m, m, rad.
        within: m, of one place.

    Raises:
        StressbotError: INFEASIBLE, fewer than two, or than half of the robots, stand where they should.
    """
    best: tuple[int, float] = (0, 0.0)
    at, of, best_turn = np.empty(0, dtype=int), np.empty(0, dtype=int), 0.0
    for i, j in np.ndindex(len(seen), len(starts)):
        turn = starts[j, 2] - seen[i, 2]
        moved = turned(seen[:, :2] - seen[i, :2], turn) + starts[j, :2]
        far = np.hypot(*(moved[:, None] - starts[None, :, :2]).transpose(2, 0, 1))
        alike = np.cos(seen[:, None, 2] + turn - starts[:, 2]) > np.cos(ALIKE)
        far = np.where(alike, far, np.inf)
        nearest = far.argmin(axis=1)
        mutual = (far.argmin(axis=0)[nearest] == np.arange(len(seen))) & (far.min(axis=1) < within)
        score = int(mutual.sum()), -float(far.min(axis=1)[mutual].sum())
        if score > best:
            best, best_turn, at, of = score, turn, np.flatnonzero(mutual), nearest[mutual]
    if best[0] < max(2, len(starts) / 2):
        raise StressbotError(
            ErrorCode.INFEASIBLE,
            FIELD,
            f"shows {best[0]} of {len(starts)} robots where they start: call reset before the picture, or correct the outline",
        )
    return at, of, float(best_turn)


def calibrate(picture: np.ndarray, starts: np.ndarray, outline: Outline, camera: Camera, unknown: Unknown) -> Fit:
    """Return the camera that has taken a picture of robots at their starts.

    Args:
        picture: shape (height, width), uint8.
        starts: shape (n, 3), m, m, rad.
        outline: of every robot.
        camera: about, but for where it looks and how it is turned.
        unknown: what of it shall be fitted; if that is the place alone, the rotation is right, but for half a turn.

    Raises:
        StressbotError: INFEASIBLE, the robots are not found there.
    """
    fit = Fit(camera, np.empty(0))
    for _ in range(2):  # what is found again with a better camera fits better
        seen = Detector(camera, [outline]).find(picture).poses
        at, of, turn = matched(seen, starts, 0.7 * outline.length)
        pixels = camera.to_pixels(seen[at, :2])
        rotation = camera.rotation + turn
        if unknown is Unknown.PLACE:  # electrodes know better, but for half a turn
            rotation = camera.rotation + (np.pi if np.cos(turn) < 0 else 0.0)
        away = turned(seen[at, :2] - camera.center, rotation - camera.rotation)
        x, y = np.median(starts[of, :2] - away, axis=0)
        guess = replace(camera, rotation=wrapped(rotation), center=(float(x), float(y)))
        fit = fit_places(pixels, starts[of, :2], guess, unknown)
        camera = fit.camera
    return fit


def moved(fit: Fit, camera: Camera) -> np.ndarray:
    """Return by how much a picture says that the stage has moved since its camera was calibrated: x, y [m] and angle [rad]."""
    turn = wrapped(camera.rotation - fit.camera.rotation)
    return np.array([*np.subtract(camera.center, fit.camera.center), turn])
