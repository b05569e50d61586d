"""Robots in a picture: found by templates in all of it, measured by least squares where they are expected.

A robot is an outline of an even grey upon a background that is not. Its cover of a pixel at p is modelled as

    A(p) = Π_i s((h_i - n_i · R(θ)ᵀ (p - c)) / σ),

the outline's edges i with outer normals n_i at distances h_i from the pivot c, each blurred by σ (s: a logistic function with the
slope of a normal distribution's). The picture around it is b_0 + b_x x + b_y y + (1 - A) B + a A, where B is what is known to be
behind (dust, electrodes). All but c, θ and σ enter linearly, so that one linear least-squares problem a step finds these, and
another one, by the derivatives (a - B) ∂A, the step of the others (Gauss-Newton).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import expit

from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.planar import wrapped

SLOPE = 1.702
"""Of the logistic function that is closest to a normal distribution's."""

STEPS = 3
"""Of Gauss-Newton, where a robot is expected."""

SEARCHING_STEPS = 8
"""The same, where one was found by templates."""

MOST_SAMPLES = 27
"""Pixels along a side of what is looked at of a robot; of larger ones every second, third, … pixel is."""

AROUND = 2.5
"""Pixels, and of the blur, that are looked at around an outline."""

BLUR, LEAST_BLUR, MOST_BLUR = 0.9, 0.35, 8.0
"""Pixels: of a picture before anything is known of it, and limits."""

FOUND, WORSE, FAINT = 0.4, 0.6, 0.5
"""Least quality, quality relative to the best, and contrast relative to that of most, of what is called a robot when all of a
picture is searched."""

LEARNING = 0.6
"""Quality of fits from which the blur is learnt."""

RIDGE = 1e-3
"""Of the mean of the normal matrix's diagonal: keeps steps small where a picture tells little."""

TRUST = (0.2, 0.4)
"""Largest step: of the length, and rad."""

BAD_FIT = 3.0
"""Residuals beyond so many deviations of the rest count less (dust)."""

FLOOR = (0.04, 0.004)
"""Pixels, and of the length: what outlines, grey levels and electrodes leave uncertain, at either end."""

TEMPLATE_LENGTH = 9.0
"""Pixels of a robot, at which a whole picture is searched."""

TURNS = 16
"""Headings of templates."""

STRONGEST, MOST_CANDIDATES = 20, 200
"""Answers by which the polarity is told, and places that are looked at closely."""

SURE = 0.35
"""Of the strongest answer of a picture to a template: weaker ones are no robots."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Robots as one picture shows them, each as if the stage had not moved.

    Attributes:
        poses: shape (k, 3), m, m, rad in (-pi, pi].
        covariance: shape (k, 3, 3).
        quality: part of what differs from an even background that the outline explains; 1: all of it. Shape (k,).
        contrast: grey levels from the background to the robot, shape (k,).
    """

    poses: np.ndarray
    covariance: np.ndarray
    quality: np.ndarray
    contrast: np.ndarray

    def of(self, rows: np.ndarray) -> "Measured":
        """Return some of them."""
        return Measured(self.poses[rows], self.covariance[rows], self.quality[rows], self.contrast[rows])


class Detector:
    """Measures robots of one outline in pictures of one camera.

    Attributes:
        blur: of the pictures' edges, pixels; learnt.
        middle: of each outline, from its pivot along and across the heading, m, shape (n, 2).
    """

    def __init__(self, camera: Camera, outlines: Sequence[Outline]) -> None:
        """`outlines`: one a robot."""
        self.camera = camera
        self.blur = BLUR
        corners = np.array([outline.corners() for outline in outlines]) / camera.pixel
        edges = np.roll(corners, -1, axis=1) - corners
        normals = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)
        self._normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)  # (n, 5, 2)
        self._offsets = np.sum(self._normals * corners, axis=-1)  # (n, 5), pixels
        self._reach = np.hypot(corners[..., 0], corners[..., 1]).max(axis=1)  # (n,), pixels
        self.middle = 0.5 * (corners.max(axis=1) + corners.min(axis=1)) * camera.pixel  # (n, 2), m
        self.length = np.array([outline.length for outline in outlines])  # (n,), m
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        places = camera.to_substrate(np.column_stack([columns.ravel(), rows.ravel()]))
        # in pixels, but along the axes of the substrate
        self._places = ((places - camera.center) / camera.pixel).reshape(camera.height, camera.width, 2).astype(np.float32)

    # Where robots are expected

    def measure(
        self,
        picture: np.ndarray,
        poses: np.ndarray,
        kinds: np.ndarray,
        steps: int = STEPS,
        firm: np.ndarray | None = None,
        background: np.ndarray | None = None,
    ) -> Measured:
        """Measure robots near poses.

        Args:
            picture: shape (h, w), uint8.
            poses: where they are expected, shape (k, 3), m, m, rad.
            kinds: of which outline each is, shape (k,).
            steps: of Gauss-Newton.
            firm: which of them surely are robots, shape (k,): each is measured where no such other one is, and the others
                where none at all is; None: they may be one and the same, and nothing is left out.
            background: what is behind robots, shape (h, w), float32, NaN where that is not known; None: nowhere.
        """
        count = len(poses)
        if not count:
            return Measured(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0), np.empty(0))
        pose = self._inner(poses)
        where, inside, grey, behind = self._patches(picture, pose, kinds, background)
        weight = inside if firm is None else inside * self._apart(pose, kinds, where, firm)
        edges, blur = (self._normals[kinds], self._offsets[kinds]), self.blur
        reach = 0.5 * (self.length[kinds] / self.camera.pixel)
        fit = _fit(edges, blur, reach, where, grey, behind, weight, pose, weight)
        for _ in range(steps):
            pose = pose + _trusted(fit.move, reach)
            fit = _fit(edges, blur, reach, where, grey, behind, weight, pose, fit.robust)
        covariance = fit.covariance + _floor(reach)
        even = fit.columns[..., :3]
        empty = grey - behind
        flat, _ = _least_squares(even, empty, weight, 3, 0.0)
        before = np.sum(weight * (empty - np.einsum("kpc,kc->kp", even, flat)) ** 2, axis=1)
        quality = 1.0 - np.sum(fit.robust * fit.residual**2, axis=1) / np.maximum(before, 1e-9)
        if steps == STEPS:
            self._learn_blur(fit.widening, quality, reach)
        unit = np.array([self.camera.pixel, self.camera.pixel, 1.0])
        return Measured(self._outer(pose), covariance * unit[:, None] * unit, quality, fit.contrast)

    def _inner(self, poses: np.ndarray) -> np.ndarray:
        """Poses in pixels about the middle of the picture."""
        return np.column_stack([(poses[:, :2] - self.camera.center) / self.camera.pixel, poses[:, 2]])

    def _outer(self, poses: np.ndarray) -> np.ndarray:
        return np.column_stack([poses[:, :2] * self.camera.pixel + self.camera.center, wrapped(poses[:, 2])])

    def _patches(
        self, picture: np.ndarray, pose: np.ndarray, kinds: np.ndarray, background: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Places (k, p, 2), whether they are in the picture (k, p), grey levels (k, p), and those behind, less their mean."""
        half = float(self._reach[kinds].max()) * 1.1 + AROUND * (1.0 + self.blur)
        stride = max(1, int(np.ceil((2 * half + 1) / MOST_SAMPLES)))
        steps = stride * np.arange(-int(np.ceil(half / stride)), int(np.ceil(half / stride)) + 1)
        middle = np.rint(self.camera.to_pixels(pose[:, :2] * self.camera.pixel + self.camera.center)).astype(int)
        columns = middle[:, None, None, 0] + steps[None, None, :]
        rows = middle[:, None, None, 1] + steps[None, :, None]
        height, width = picture.shape
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        columns, rows = np.clip(columns, 0, width - 1), np.clip(rows, 0, height - 1)
        count = len(pose)
        where = self._places[rows, columns].reshape(count, -1, 2).astype(float)
        inside = np.broadcast_to(inside, (count, len(steps), len(steps))).reshape(count, -1)
        grey = picture[rows, columns].reshape(count, -1).astype(float)
        behind = np.zeros(grey.shape)
        if background is not None:
            found = background[rows, columns].reshape(count, -1).astype(float)
            known = np.isfinite(found)
            middle = np.sum(found, axis=1, where=known, keepdims=True) / np.maximum(known.sum(axis=1, keepdims=True), 1)
            behind = np.where(known, found - middle, 0.0)
        return where, inside.astype(float), grey, behind

    def _apart(self, pose: np.ndarray, kinds: np.ndarray, where: np.ndarray, firm: np.ndarray) -> np.ndarray:
        """Weights (k, p): none where another robot is expected."""
        weight = np.ones(where.shape[:2])
        reach = self._reach[kinds] + AROUND * (1.0 + self.blur)
        gaps = np.hypot(*(pose[:, None, :2] - pose[None, :, :2]).transpose(2, 0, 1)) - reach[:, None] - reach
        for k, other in np.argwhere((gaps < 0) & (firm | ~firm[:, None]) & ~np.eye(len(pose), dtype=bool)):
            row = slice(other, other + 1)
            offsets = self._offsets[kinds[row]] + 1.0 + self.blur
            cover, _, _ = _cover(self._normals[kinds[row]], offsets, pose[row], where[k : k + 1], 0.5)
            weight[k] *= 1.0 - cover[0]
        return weight

    def _learn_blur(self, change: np.ndarray, quality: np.ndarray, reach: np.ndarray) -> None:
        """`change` is of the logarithm, shape (k,). Small robots show no edges to learn from."""
        good = (quality > LEARNING) & (reach > 4.0) & np.isfinite(change)
        if good.any():
            step = float(np.clip(0.1 * np.median(change[good]), -0.1, 0.1))
            self.blur = float(np.clip(self.blur * np.exp(step), LEAST_BLUR, MOST_BLUR))

    # In the whole picture

    def find(self, picture: np.ndarray, kind: int = 0, most: int = MOST_CANDIDATES) -> Measured:
        """Find robots of one outline anywhere: all brighter than the substrate, or all darker.

        Args:
            picture: shape (h, w), uint8.
            kind: which outline.
            most: how many are looked at closely.
        """
        places, headings = self._candidates(picture, kind, most)
        found = self._both_ways(picture, np.column_stack([places, headings]), kind, None)
        found = found.of(self._distinct(found, kind))
        found = self._both_ways(picture, found.poses, kind, np.ones(len(found.poses), dtype=bool))
        return found.of(self._distinct(found, kind))

    def _both_ways(self, picture: np.ndarray, poses: np.ndarray, kind: int, firm: np.ndarray | None) -> Measured:
        """Measure robots from poses (k, 3), and from there with head and tail exchanged; each as it fits better."""
        kinds, turned = np.full(len(poses), kind), poses + (0.0, 0.0, np.pi)
        turned[:, :2] += self.middles(poses, kinds) - self.middles(turned, kinds)
        one, other = (self.measure(picture, guess, kinds, SEARCHING_STEPS, firm) for guess in (poses, turned))
        better = one.quality >= other.quality
        return Measured(*(
            np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b)
            for a, b in zip(vars(one).values(), vars(other).values(), strict=True)
        ))

    def around(self, kinds: np.ndarray) -> float:
        """Return pixels from pivots within which all is that robots change."""
        return float(self._reach[kinds].max()) + AROUND * (1.0 + self.blur)

    def middles(self, poses: np.ndarray, kinds: np.ndarray) -> np.ndarray:
        """Return where the middles of the outlines of robots at poses (k, 3) are, shape (k, 2), m."""
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = self.middle[kinds].T
        return poses[:, :2] + np.column_stack([cos * x - sin * y, sin * x + cos * y])

    def _candidates(self, picture: np.ndarray, kind: int, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (k, 2), m, and headings (k,) that templates answer to."""
        shrink = max(1.0, self.length[kind] / self.camera.pixel / TEMPLATE_LENGTH)
        size = np.maximum(np.round(np.array(picture.shape[::-1]) / shrink).astype(int), 1)
        small = cv2.resize(picture, size.tolist(), interpolation=cv2.INTER_AREA).astype(np.float32)
        around = int(2 * np.ceil(1.5 * self.length[kind] / self.camera.pixel / shrink)) + 1
        small -= cv2.blur(small, (around, around))
        best = np.zeros(small.shape, dtype=np.float32)
        turn = np.zeros(small.shape, dtype=np.int16)
        answers = []
        for k in range(TURNS):
            answers.append(cv2.filter2D(small, cv2.CV_32F, self._template(kind, shrink, 2 * np.pi * k / TURNS)))
        levels = [sum(float(np.sort(sign * answer, axis=None)[-STRONGEST:].mean()) for answer in answers[::4]) for sign in (1, -1)]
        polarity = 1.0 if levels[0] > levels[1] else -1.0
        for k, answer in enumerate(answers):
            better = polarity * answer > best
            best[better], turn[better] = (polarity * answer)[better], k
        wide = max(3, 2 * int(0.2 * self.length[kind] / self.camera.pixel / shrink) + 1)
        peak = (best == cv2.dilate(best, np.ones((wide, wide)))) & (best > SURE * float(best.max()))
        rows, columns = np.nonzero(peak)
        order = np.argsort(-best[rows, columns])[:most]
        rows, columns = rows[order], columns[order]
        real = np.array(picture.shape[::-1]) / size
        pixels = (np.column_stack([columns, rows]) + 0.5) * real - 0.5
        # in the picture, v points down
        return self.camera.to_substrate(pixels), 2 * np.pi * turn[rows, columns] / TURNS

    def _template(self, kind: int, shrink: float, heading: float) -> np.ndarray:
        """Cover of a robot whose pivot is in the middle, less its mean, of a picture that is smaller; odd square, float32."""
        half = int(np.ceil((self._reach[kind] + 1.0) / shrink))
        steps = np.arange(-half, half + 1) * shrink
        pictured = np.stack(np.meshgrid(steps, -steps), axis=-1).reshape(1, -1, 2)
        pose = np.array([[0.0, 0.0, heading - self.camera.rotation]])
        cover, _, _ = _cover(self._normals[[kind]], self._offsets[[kind]], pose, pictured, 0.4 * shrink + 0.3)
        cover = cover.reshape(2 * half + 1, 2 * half + 1)
        return (cover / cover.sum() - 1.0 / cover.size).astype(np.float32)

    def _distinct(self, found: Measured, kind: int) -> np.ndarray:
        """Rows of what fits, the best of those that are at one place."""
        near = 0.3 * self.length[kind]
        kept: list[int] = []
        fits = found.quality > max(FOUND, WORSE * float(found.quality.max(initial=0.0)))
        if not fits.any():
            return np.empty(0, dtype=int)
        usual = float(np.median(found.contrast[fits]))
        middles = self.middles(found.poses, np.full(len(found.poses), kind))
        for row in np.argsort(-found.quality):
            if not fits[row] or found.contrast[row] / usual < FAINT:
                continue
            if all(np.hypot(*(middles[row] - middles[k])) > near for k in kept):
                kept.append(int(row))
        return np.array(kept, dtype=int)


def _cover(
    normals: np.ndarray, offsets: np.ndarray, pose: np.ndarray, where: np.ndarray, blur: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A (k, p), its derivatives by x, y, heading (k, p, 3), and by the logarithm of the blur (k, p)."""
    cos, sin = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
    dx, dy = where[..., 0] - pose[:, :1], where[..., 1] - pose[:, 1:2]
    qx, qy = cos * dx + sin * dy, cos * dy - sin * dx
    cover = np.ones_like(qx)
    gx, gy, spread = np.zeros_like(qx), np.zeros_like(qx), np.zeros_like(qx)
    for i in range(normals.shape[1]):
        nx, ny = normals[:, i, :1], normals[:, i, 1:]
        z = (offsets[:, i : i + 1] - nx * qx - ny * qy) * (1.0 / blur)
        part = expit(SLOPE * z)
        cover *= part
        slope = SLOPE * (1.0 - part)
        gx += slope * nx
        gy += slope * ny
        spread -= slope * z
    gx *= cover / blur
    gy *= cover / blur
    gradient = np.stack([cos * gx - sin * gy, sin * gx + cos * gy, gy * qx - gx * qy], axis=-1)
    return cover, gradient, cover * spread


class _Fit(NamedTuple):
    """Of pictures around k robots, p pixels each: what fits best, and the step that would fit better."""

    columns: np.ndarray  # (k, p, 4) what enters linearly
    residual: np.ndarray  # (k, p) grey levels
    robust: np.ndarray  # (k, p) weights
    contrast: np.ndarray  # (k,)
    move: np.ndarray  # (k, 3) pixels, pixels, rad
    widening: np.ndarray  # (k,) of the logarithm of the blur
    covariance: np.ndarray  # (k, 3, 3) of the pose


def _fit(
    edges: tuple[np.ndarray, np.ndarray],
    blur: float,
    reach: np.ndarray,
    where: np.ndarray,
    grey: np.ndarray,
    behind: np.ndarray,
    weight: np.ndarray,
    pose: np.ndarray,
    robust: np.ndarray,
) -> _Fit:
    """Solve for what enters linearly and for a step, at poses (k, 3), with weights that tell what counts and what is trusted."""
    cover, gradient, along = _cover(*edges, pose, where, blur)
    columns = _columns(where - pose[:, None, :2], reach, cover)
    above = grey - (1.0 - cover) * behind
    even, _ = _least_squares(columns, above, robust, 4, 0.0)
    safe = _safe(even[:, 3])[:, None]
    share = ((even[:, 3:] - behind) / safe)[..., None]  # of the contrast, by which grey levels change where an edge moves
    full = np.concatenate([columns, share * gradient, share * along[..., None]], axis=-1)
    solution, normal = _least_squares(full, above, robust, 4, RIDGE)
    contrast = solution[:, 3]
    residual = above - np.einsum("kpc,kc->kp", columns, solution[:, :4])
    scale = _deviation(residual, weight)
    steps = solution[:, 4:] / safe
    covariance = np.linalg.inv(normal)[:, 4:7, 4:7] * (scale**2 / np.maximum(contrast**2, 1.0))[:, None, None]
    return _Fit(columns, residual, weight * _robust(residual, scale), contrast, steps[:, :3], steps[:, 3], covariance)


def _columns(away: np.ndarray, reach: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """What enters linearly: an even background that may slope, and the robot; shape (k, p, 4)."""
    return np.stack([np.ones(cover.shape), away[..., 0] / reach[:, None], away[..., 1] / reach[:, None], cover], axis=-1)


def _least_squares(
    columns: np.ndarray, grey: np.ndarray, weight: np.ndarray, plain: int, ridge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return solutions (k, c) and normal matrices (k, c, c); `ridge` holds back columns behind the first `plain`."""
    weighted = columns * weight[..., None]
    normal = np.einsum("kpc,kpd->kcd", weighted, columns, optimize=True)
    extra = np.full(columns.shape[-1], 1e-9)
    extra[plain:] += ridge * np.trace(normal, axis1=1, axis2=2).mean() / columns.shape[-1]
    normal = normal + np.diag(extra)
    right = np.einsum("kpc,kp->kc", weighted, grey)
    return np.linalg.solve(normal, right[..., None])[..., 0], normal


def _safe(contrast: np.ndarray) -> np.ndarray:
    """To divide by: nothing follows from a robot that cannot be seen."""
    return np.where(np.abs(contrast) < 1.0, np.inf, contrast)


def _deviation(residual: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Standard deviations (k,), of what counts."""
    return np.sqrt(np.sum(weight * residual**2, axis=1) / np.maximum(np.sum(weight, axis=1) - 8.0, 1.0)) + 1e-6


def _robust(residual: np.ndarray, scale: np.ndarray) -> np.ndarray:
    size = np.abs(residual) / (BAD_FIT * scale[:, None])
    return 1.0 / np.maximum(size, 1.0)


def _trusted(move: np.ndarray, reach: np.ndarray) -> np.ndarray:
    far, turn = TRUST
    limit = np.column_stack([2 * far * reach, 2 * far * reach, np.full(len(move), turn)])
    return np.clip(move, -limit, limit)


def _floor(reach: np.ndarray) -> np.ndarray:
    pixels, share = FLOOR
    place = pixels + share * 2.0 * reach
    floor = np.zeros((len(reach), 3, 3))
    floor[:, 0, 0] = floor[:, 1, 1] = place**2
    floor[:, 2, 2] = (place / reach) ** 2
    return floor
