"""Whether a picture is one: of now, of this camera, and not of nothing."""

import numpy as np

DARK = 12.0
"""Grey level, in the mean: a camera that sees no light."""

EVEN = 2.0
"""Grey levels between blocks of a picture: something is close to the lens."""

_BLOCKS = 8


class Plausibility:
    """What is wrong with pictures, one after the other."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None
        self._stamp: int | None = None

    def problem(self, picture: np.ndarray, stamp: int) -> str:
        """Return why a picture is not to be used, "" if it is.

        Args:
            picture: shape (h, w), uint8.
            stamp: ns.
        """
        last, before = self._last, self._stamp
        if before is not None and stamp <= before:
            if before - stamp > 1_000_000_000:
                self._stamp = stamp  # the clock was set back: what follows is compared with this
            late = 1e-9 * (before - stamp)
            return f"is stamped {late:.3f} s before the last one: are there two cameras, or was a clock set back?"
        self._last, self._stamp = picture, stamp
        if last is not None and np.array_equal(last, picture):
            return "is the last one again, noise and all: the camera is frozen, restart it"
        return ""


def darkness(picture: np.ndarray) -> str:
    """Return why a picture may show no robots, "" if nothing is known."""
    if float(picture[::4, ::4].mean()) < DARK:
        return "the picture is dark: is the light on?"
    rows, columns = (np.array_split(np.arange(size), _BLOCKS) for size in picture.shape)
    means = [picture[row[0] : row[-1] + 1 : 2, column[0] : column[-1] + 1 : 2].mean() for row in rows for column in columns]
    if float(np.std(means)) < EVEN:
        return "the picture is an even grey: is something in front of the lens?"
    return ""
