"""Angles."""

from typing import Any

import numpy as np


def wrapped(angles: Any) -> Any:
    """Return an angle or an array of them, rad, less the nearest whole turns."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))
