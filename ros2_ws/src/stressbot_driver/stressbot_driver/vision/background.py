"""What is behind the robots: electrodes, dust and light, learnt where no robot is."""

import cv2
import numpy as np

EVERY = 0.2
"""s between two pictures that are learnt from."""

NEW = 0.2
"""Share of what is learnt that the newest picture has."""


class Background:
    """The mean of pictures, without robots.

    Attributes:
        mean: grey levels, shape (h, w), float32; NaN where there has always been a robot.
    """

    def __init__(self, height: int, width: int) -> None:
        self.mean = np.full((height, width), np.nan, dtype=np.float32)
        self._learnt = -np.inf

    def is_due(self, stamp: float) -> bool:
        """Return whether a picture of that time [s] is to be learnt from."""
        return stamp >= self._learnt + EVERY

    def learn(self, picture: np.ndarray, stamp: float, middles: np.ndarray, reach: float) -> None:
        """Take in a picture (h, w), uint8, but for discs around pixels (k, 2) as large as a reach in pixels."""
        self._learnt = stamp
        free = np.ones(picture.shape, dtype=np.uint8)
        for u, v in np.rint(middles).astype(int).tolist():
            cv2.circle(free, (u, v), int(np.ceil(reach)), 0, -1)
        new = np.isnan(self.mean)
        np.copyto(self.mean, picture, where=new & (free > 0), casting="unsafe")
        cv2.accumulateWeighted(picture, self.mean, NEW, free)
