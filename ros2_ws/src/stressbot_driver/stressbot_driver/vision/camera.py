"""Where a place on the substrate is in the picture, and back."""

import math
from dataclasses import dataclass

import numpy as np

MOST_DISTORTION = 0.1
"""Of a lens, either way. Beyond 4/27 a place in a corner of the picture would have no place on the substrate."""

_STEPS = 30
"""Of Newton's method at most; far from the largest distortion it takes 5."""


@dataclass(frozen=True)
class Camera:
    """A camera that looks straight down: scale, rotation, offset, and radial distortion.

    A place at distance r from the middle of the picture is seen at r (1 + distortion (r/R)^2), R half a diagonal of the picture.
    In pictures u points to the right and v down, and the centres of pixels are whole numbers; on the substrate y points up.

    Attributes:
        width: pixels.
        height: pixels.
        pixel: m per pixel.
        center: x, y [m] of the place on the substrate in the middle of the picture.
        rotation: rad, counter-clockwise from the substrate's x axis to the picture's.
        distortion: k1, within ±MOST_DISTORTION.
        latency: s by which pictures are stamped after they were taken.
    """

    width: int
    height: int
    pixel: float
    center: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    distortion: float = 0.0
    latency: float = 0.0

    @classmethod
    def over(cls, places: np.ndarray, margin: float, side: int = 1000) -> "Camera":
        """Return a square camera that sees all places, shape (k, 2), and a margin around them; m."""
        low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
        x, y = (low + high) / 2
        return cls(side, side, float((high - low).max() / side), (float(x), float(y)))

    def to_pixels(self, places: np.ndarray) -> np.ndarray:
        """Return u, v of places on the substrate, shape (k, 2), m. What lies far outside the picture stays outside."""
        seen = (np.asarray(places, dtype=float) - self.center) @ self._axes / self.pixel
        if self.distortion:
            r2 = np.minimum(np.sum(seen**2, axis=1, keepdims=True) / self._half_diagonal**2, self._turning**2)
            seen = seen * (1.0 + self.distortion * r2)
        return seen * (1.0, -1.0) + self._middle

    def to_substrate(self, pixels: np.ndarray) -> np.ndarray:
        """Return x, y [m] on the substrate of u, v, shape (k, 2)."""
        seen = (np.asarray(pixels, dtype=float) - self._middle) * (1.0, -1.0)
        if self.distortion:
            seen = seen * self._shrinking(np.sqrt(np.sum(seen**2, axis=1, keepdims=True)))
        return seen * self.pixel @ self._axes.T + self.center

    def _shrinking(self, seen: np.ndarray) -> np.ndarray:
        """r of distances [pixels] in the picture, relative to these: Newton's method on r + k r^3 = seen, in units of R."""
        k = self.distortion
        wanted = seen / self._half_diagonal
        r = wanted.copy()
        for _ in range(_STEPS):
            step = (r + k * r**3 - wanted) / np.maximum(1.0 + 3.0 * k * r**2, 1e-3)
            r = np.minimum(r - step, self._turning)
            if np.all(np.abs(step) < 1e-15):
                break
        return np.divide(r, wanted, out=np.ones_like(r), where=wanted > 0)

    @property
    def _turning(self) -> float:
        """Distance, in units of R, beyond which the formula would lead back to the middle; of hardly any distortion, far away."""
        return 1.0 / math.sqrt(max(-3.0 * self.distortion, 1e-100))

    @property
    def _half_diagonal(self) -> float:
        return 0.5 * float(np.hypot(self.width, self.height))

    @property
    def _middle(self) -> np.ndarray:
        return np.array([self.width - 1, self.height - 1]) / 2

    @property
    def _axes(self) -> np.ndarray:
        """Columns: the picture's x axis and its upward one, on the substrate."""
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        return np.array([[cos, -sin], [sin, cos]])
