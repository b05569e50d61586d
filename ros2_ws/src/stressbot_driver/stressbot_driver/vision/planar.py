"""Turns and angles in the plane."""

from typing import Any

import numpy as np


def turned(places: np.ndarray, angle: float) -> np.ndarray:
    """Return places (k, 2), turned counter-clockwise about the origin by an angle [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return places @ np.array([[cos, sin], [-sin, cos]])


def wrapped(angle: Any) -> Any:
    """Return an angle or an array of them, rad, in (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)
