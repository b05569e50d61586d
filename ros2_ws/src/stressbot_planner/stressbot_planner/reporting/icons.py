"""Icons of robots along their paths, as in the paper's figures: the more icons, the less efficient a plan."""

from typing import NamedTuple

import numpy as np

LENGTH = 120e-6
"""Of a MicroStressBot, m (paper, section 2). It is half as wide."""

_CORNERS = np.array([[-0.5, -0.25], [0.22, -0.25], [0.5, 0.0], [0.22, 0.25], [-0.5, 0.25]])
"""Of an icon one unit long that looks along x: half as wide as long, with a nose."""

_SMALLEST, LARGEST = 1 / 80, 1 / 12
"""Length of an icon relative to the longer side of a picture, in which it can be seen and hides nothing."""

_PLAUSIBLE = 4.0
"""Ratio of body sizes: one larger or smaller than a MicroStressBot by more is another kind of robot."""

_SAME_PLACE, _SAME_HEADING = 0.4, np.pi / 4
"""Two icons nearer than that, relative to their length, and alike within that many radians, look like one."""


class Size(NamedTuple):
    """How large icons are.

    Attributes:
        lengths: one a robot, shape (n,), units.
        text: what they are, for a legend.
    """

    lengths: np.ndarray
    text: str


def size(body_radius: np.ndarray, length_unit: float, span: float) -> Size:
    """Return how large the icons of robots are.

    They have the outline of a MicroStressBot, to scale. Where bodies are those of other robots, it fills the body's disc, and
    where it could not be seen or would hide everything, it is as small or as large as can be looked at.

    Args:
        body_radius: shape (n,), units.
        length_unit: m per unit.
        span: longer side of the picture, units.
    """
    true = LENGTH / length_unit
    radius = np.asarray(body_radius, dtype=float)
    own = (radius == 0) | ((radius <= _PLAUSIBLE * true / 2) & (radius >= true / 2 / _PLAUSIBLE))
    wanted = np.where(own, true, 2 * radius / np.hypot(1.0, 0.5))
    lengths = np.clip(wanted, _SMALLEST * span, LARGEST * span)
    if np.any(lengths != wanted):
        return Size(lengths, "robot (not to scale)")
    return Size(lengths, "robot, 120 × 60 µm" if own.all() else "robot")


def polygons(poses: np.ndarray, length: float) -> np.ndarray:
    """Return the icons at poses, shape (K, 3), that do not look alike; corners as an array of shape (k, 5, 2), units."""
    x, y, heading = poses[distinct(poses, length)].T
    along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    corners = length * _CORNERS
    return np.stack([x, y], axis=-1)[:, None] + corners[:, :1] * along[:, None] + corners[:, 1:] * across[:, None]


def distinct(poses: np.ndarray, length: float) -> np.ndarray:
    """Return the indices of poses, shape (K, 3), whose icons do not look like one before."""
    cells = np.floor(poses / [_SAME_PLACE * length, _SAME_PLACE * length, _SAME_HEADING] + 0.5)
    cells[:, 2] %= round(2 * np.pi / _SAME_HEADING)
    _, numbers = zip(*(np.unique(column, return_inverse=True) for column in cells.T), strict=True)
    key = np.ravel_multi_index(numbers, [int(number.max()) + 1 for number in numbers])
    return np.sort(np.unique(key, return_index=True)[1])


def outline() -> np.ndarray:
    """Return the corners of an icon of length 1 that looks along x, closed, shape (6, 2)."""
    return np.vstack([_CORNERS, _CORNERS[:1]])
