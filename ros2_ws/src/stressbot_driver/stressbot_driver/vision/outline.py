"""The outline of a robot, as a camera above sees it: a pentagon twice as long as wide, with a nose."""

from dataclasses import dataclass

import numpy as np

from stressbot_driver.vision.planar import turned

LENGTH = 120e-6
"""Of a MicroStressBot, m (paper, section 2). It is half as wide."""

_CORNERS = np.array([[-0.5, -0.5], [0.22, -0.5], [0.5, 0.0], [0.22, 0.5], [-0.5, 0.5]])
"""Of an outline one unit long and wide that looks along x."""


@dataclass(frozen=True)
class Outline:
    """A pentagon that looks along its length.

    Attributes:
        length: m.
        width: m.
        pivot: m, along and across: the point about which the robot turns and which poses give, from the middle of the bounding box.
    """

    length: float = LENGTH
    width: float = LENGTH / 2
    pivot: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, body_radius: float) -> "Outline":
        """Return the largest outline within the disc of a body of that radius [m]; of a point, that of a MicroStressBot."""
        length = 2 * body_radius / np.hypot(1.0, 0.5) if body_radius > 0 else LENGTH
        return cls(float(length), float(length / 2))

    def corners(self) -> np.ndarray:
        """Return the corners in order, relative to the pivot, of a robot that looks along x; shape (5, 2), m."""
        return _CORNERS * (self.length, self.width) - self.pivot

    def at(self, pose: np.ndarray) -> np.ndarray:
        """Return the corners of a robot at a pose [m, m, rad]; shape (5, 2), m."""
        return turned(self.corners(), pose[2]) + pose[:2]
