"""Pictures of a substrate with robots, as a microscope camera would take them."""

from collections.abc import Sequence

import cv2
import numpy as np

from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.planar import turned

BLACK = 4.0
"""Grey levels of a camera that sees no light: a dark picture is noisy, too."""

_HAND_LEVEL, _HAND_EDGE = 0.3, 0.05
"""How bright a hand is, relative to the lamp, and how wide its blurred edge, in widths of the picture."""

_STILL = 0.02
"""Pixels that the stage may move before stripes and dust are drawn anew. Robots always are where they should be."""

_FINER, _FINEST, _STRIPS = 4, 1024, 2
"""A robot is drawn so many times finer than the picture, in at most so many of these finer pixels a side."""

_DUST_RADII = (0.5, 3.0)
"""Pixels, and of how much of the light a speck takes: 0.2 to 0.8."""

_SPARE = 64
"""Pixels by which the stock of noise is larger than a picture each way: each picture takes another part of it."""


class Microscope:
    """Takes pictures of robots, electrodes and dust on a stage that drifts.

    Args:
        camera: where places of the substrate are in the picture at time 0.
        outlines: one a robot.
        settings: what departs from a perfect picture.
        seed: of dust, noise and the stage's random walk; the same calls then give the same pictures.
    """

    def __init__(self, camera: Camera, outlines: Sequence[Outline], settings: Optics, seed: int = 0) -> None:
        self.camera, self.settings = camera, settings
        self._outlines = list(outlines)
        dust, walk, self._noise = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(3))
        self._stage = Stage(settings, walk)
        self._light = _light(camera, settings)
        self._specks = _specks(camera, settings, dust)
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        places = camera.to_substrate(np.column_stack([columns.ravel(), rows.ravel()])) - camera.center
        self._x, self._y = (np.ascontiguousarray(part.reshape(columns.shape), dtype=np.float32) for part in places.T)
        shape = (camera.height + _SPARE, camera.width + _SPARE)
        self._stock = self._noise.standard_normal(shape, dtype=np.float32) if settings.noise else None
        self._drawn_at: np.ndarray | None = None
        self._background = self._light

    def picture(self, poses: np.ndarray, time: float) -> np.ndarray:
        """Return the picture of robots at poses, shape (n, 3) in m, m and rad, at a time [s] since the first picture.

        Shape (height, width), uint8. Later robots lie upon earlier ones.
        """
        offset = self.stage(time)
        signal = self._seen_background(offset).copy()
        for outline, pose in zip(self._outlines, np.asarray(poses, dtype=float), strict=True):
            self._draw(signal, self.camera.to_pixels(self._moved(outline.at(pose), offset)))
        return self._exposed(self._hidden(signal) if self.settings.hand else signal)

    def _hidden(self, signal: np.ndarray) -> np.ndarray:
        """Something even and out of focus lies before the left part of the picture."""
        width = self.camera.width
        soft = _HAND_EDGE * width
        hidden = np.clip((self.settings.hand * (width + soft) - np.arange(width)) / soft, 0.0, 1.0).astype(np.float32)
        return signal * (1.0 - hidden) + np.float32(_HAND_LEVEL * self.settings.lamp) * hidden

    def stage(self, time: float) -> np.ndarray:
        """Return by how much the stage has moved since time 0: x, y [m], and turned about the picture's middle [rad]."""
        return self._stage.at(time)

    def _moved(self, places: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Where the camera at time 0 would have seen what is at these places now; shape (k, 2), m."""
        return turned(places - self.camera.center, offset[2]) + self.camera.center + offset[:2]

    def _seen_background(self, offset: np.ndarray) -> np.ndarray:
        reach = (1.0, 1.0, 0.5 * np.hypot(self.camera.width, self.camera.height) * self.camera.pixel)
        moved = np.inf if self._drawn_at is None else np.abs((offset - self._drawn_at) * reach).max() / self.camera.pixel
        if moved > _STILL:
            self._drawn_at, self._background = offset, self._drawn_background(offset)
        return self._background

    def _drawn_background(self, offset: np.ndarray) -> np.ndarray:
        settings, background = self.settings, self._light
        if settings.stripes and settings.pitch:
            background = background * self._electrodes(offset)
        if len(self._specks):
            background = background * self._dust(offset)
        if settings.blur and background is not self._light:
            background = cv2.GaussianBlur(background, (0, 0), settings.blur)
        return background

    def _electrodes(self, offset: np.ndarray) -> np.ndarray:
        """Bands along y, as wide as the gaps between them; an edge at x = 0, smooth over a pixel."""
        pitch, (x, y, turn) = self.settings.pitch, offset
        (center_x, _) = self.camera.center
        cos, sin = np.cos(turn), np.sin(turn)
        start = (center_x - cos * x - sin * y) / pitch
        phase = np.float32(cos / pitch) * self._x + np.float32(sin / pitch) * self._y + np.float32(start % 1.0)
        phase -= np.floor(phase)
        edge = 0.25 - np.abs(phase - 0.5, out=phase)  # periods, positive within an electrode
        share = np.clip(edge * np.float32(pitch / self.camera.pixel) + 0.5, 0.0, 1.0, out=edge)
        return 1.0 - np.float32(self.settings.stripes) * share

    def _dust(self, offset: np.ndarray) -> np.ndarray:
        passed = np.ones_like(self._light)
        for (u, v), radius, taken in zip(
            self.camera.to_pixels(self._moved(self._specks[:, :2], offset)), self._specks[:, 2], self._specks[:, 3], strict=True
        ):
            reach = int(3 * radius) + 2
            rows, columns = _part(v, reach, passed.shape[0]), _part(u, reach, passed.shape[1])
            if rows is None or columns is None:
                continue
            across = (np.arange(rows.start, rows.stop)[:, None] - v) ** 2 + (np.arange(columns.start, columns.stop) - u) ** 2
            passed[rows, columns] *= 1.0 - taken * np.exp(-across / (2 * radius**2))
        return passed

    def _draw(self, signal: np.ndarray, corners: np.ndarray) -> None:
        """Lay a robot with these corners [pixels], shape (k, 2), upon the picture."""
        reach, limits = 3.0 * self.settings.blur + 1.0, np.array(signal.shape[::-1])
        low, high = np.floor(corners.min(axis=0) - reach), np.ceil(corners.max(axis=0) + reach) + 1.0
        first, last = np.maximum(low, -reach).astype(int), np.minimum(high, limits + reach).astype(int)
        (left, top), (right, bottom) = np.maximum(first, 0), np.minimum(last, limits)
        if left >= right or top >= bottom:
            return
        cover = _cover(corners - first, last - first, self.settings.blur)
        cover = cover[top - first[1] : bottom - first[1], left - first[0] : right - first[0]]
        below = signal[top:bottom, left:right]
        below += cover * ((1.0 + self.settings.contrast) * self._light[top:bottom, left:right] - below)

    def _exposed(self, signal: np.ndarray) -> np.ndarray:
        """Add noise; return grey levels, rounded and limited."""
        signal += BLACK
        if self._stock is None:
            return cv2.add(signal, np.zeros_like(signal), dtype=cv2.CV_8U)
        top, left = self._noise.integers(0, _SPARE, 2)
        noise = self._stock[top : top + signal.shape[0], left : left + signal.shape[1]]
        strength = cv2.sqrt(signal)
        noise = cv2.multiply(noise, strength, scale=self.settings.noise / np.sqrt(128.0))
        return cv2.add(signal, noise, dtype=cv2.CV_8U)


class Stage:
    """A stage that drifts steadily and walks at random; the walk is straight between whole seconds."""

    def __init__(self, settings: Optics, random: np.random.Generator) -> None:
        self._speed = np.array([settings.drift_x, settings.drift_y, settings.drift_turn])
        self._wander, self._random = settings.wander, random
        self._walk = np.zeros((1, 2))

    def at(self, time: float) -> np.ndarray:
        """Return x, y [m] and angle [rad] since time 0, at a time [s]."""
        moved = self._speed * time
        if self._wander:
            whole = int(time)
            if (more := whole + 2 - len(self._walk)) > 0:
                steps = self._random.normal(0.0, self._wander, (more, 2))
                self._walk = np.vstack([self._walk, self._walk[-1] + np.cumsum(steps, axis=0)])
            before, after = self._walk[whole : whole + 2]
            moved[:2] += before + (time - whole) * (after - before)
        return moved


def _light(camera: Camera, settings: Optics) -> np.ndarray:
    """Grey levels of the empty substrate: the brightest place is to the upper left of the middle."""
    across = np.linspace(-1.0, 1.0, camera.width) + 0.3
    down = np.linspace(-1.0, 1.0, camera.height)[:, None] + 0.2
    falling = across**2 + down**2
    light = 1.0 - settings.uneven * falling / falling.max()
    return (settings.lamp * light / light[camera.height // 2, camera.width // 2]).astype(np.float32)


def _specks(camera: Camera, settings: Optics, random: np.random.Generator) -> np.ndarray:
    """Dust: x, y [m], radius [pixels], part of the light that it takes; shape (k, 4)."""
    places = camera.to_substrate(random.uniform((0, 0), (camera.width - 1, camera.height - 1), (settings.dust, 2)))
    return np.column_stack([places, random.uniform(*_DUST_RADII, settings.dust), random.uniform(0.2, 0.8, settings.dust)])


def _part(middle: float, reach: int, size: int) -> slice | None:
    """Pixels within reach of a coordinate, of so many."""
    first, last = max(int(middle) - reach, 0), min(int(middle) + reach + 1, size)
    return slice(first, last) if first < last else None


def _cover(corners: np.ndarray, size: np.ndarray, blur: float) -> np.ndarray:
    """How much of each pixel of a picture of a size (width, height) a convex polygon covers, shape (height, width).

    It is blurred first and cut into pixels then, as by a lens and a sensor.
    """
    finer = int(np.clip(_FINEST // size.max(), 1, _FINER))
    cover = _stretches((corners + 0.5) * finer - 0.5, *map(int, size * finer))
    if blur:
        cover = cv2.GaussianBlur(cover, (0, 0), blur * finer)
    return cv2.resize(cover, (int(size[0]), int(size[1])), interpolation=cv2.INTER_AREA)


def _stretches(corners: np.ndarray, width: int, height: int) -> np.ndarray:
    """The same without blur: each of `_STRIPS` strips a pixel is as the line in the middle of what it has of the polygon."""
    (x1, y1), (x2, y2) = corners.T, np.roll(corners, -1, axis=0).T
    edges = np.clip(np.arange(height * _STRIPS + 1)[:, None] / _STRIPS - 0.5, y1.min(), y1.max())
    y, share = (edges[1:] + edges[:-1]) / 2, np.float32(_STRIPS) * np.diff(edges, axis=0).astype(np.float32)
    is_crossed = (y1 <= y) != (y2 <= y)
    x = x1 + (y - y1) * np.divide(x2 - x1, y2 - y1, out=np.zeros_like(x1), where=y1 != y2)
    first = np.where(is_crossed, x, np.inf).min(axis=1, keepdims=True).astype(np.float32)
    last = np.where(is_crossed, x, -np.inf).max(axis=1, keepdims=True).astype(np.float32)
    left = np.arange(width, dtype=np.float32) - np.float32(0.5)
    stretch = np.maximum(np.clip(last - left, 0.0, 1.0) - np.clip(first - left, 0.0, 1.0), 0.0)
    return (share * stretch).reshape(height, _STRIPS, width).mean(axis=1)
