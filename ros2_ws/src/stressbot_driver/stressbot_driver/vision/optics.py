"""How a microscope and its stage depart from a perfect picture: settings, and their limits."""

from dataclasses import dataclass, field, fields
from typing import Any

from stressbot_driver.errors import ErrorCode, StressbotError


def _number(default: float, low: float, high: float, description: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "description": description})


@dataclass(frozen=True)
class Optics:
    """The settings. Raises StressbotError WRONG_TYPE or OUT_OF_RANGE."""

    lamp: float = _number(150.0, 0.0, 255.0, "Grey level of the substrate in the middle of the picture; 0: the lamp is off.")
    contrast: float = _number(-0.5, -1.0, 1.0, "Brightness of robots relative to the substrate, less 1: negative ones are darker.")
    blur: float = _number(0.8, 0.0, 20.0, "[pixels] Sigma of what is out of focus.")
    noise: float = _number(3.0, 0.0, 50.0, "Sigma of shot noise at grey level 128; it grows with the root of the level.")
    uneven: float = _number(0.2, 0.0, 0.9, "Part of the light that is missing in the darkest corner.")
    dust: int = _number(20, 0, 1000, "Specks of dust on the substrate within the picture.")
    stripes: float = _number(0.1, 0.0, 0.9, "How much darker electrodes are than the gaps between them.")
    pitch: float = _number(40e-6, 0.0, 1.0, "[m] From one electrode to the next along x of the substrate; 0: none are seen.")
    hand: float = _number(0.0, 0.0, 1.0, "Part of the picture, from its left, that something close to the lens hides.")
    drift_x: float = _number(0.0, -1e-3, 1e-3, "[m/s] of the stage.")
    drift_y: float = _number(0.0, -1e-3, 1e-3, "[m/s] of the stage.")
    drift_turn: float = _number(0.0, -1.0, 1.0, "[rad/s] of the stage about the middle of the picture, counter-clockwise.")
    wander: float = _number(0.0, 0.0, 1e-3, "[m/s^0.5] Sigma of the random walk of the stage after a second, along x and along y.")

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, limits = getattr(self, entry.name), entry.metadata
            whole = isinstance(entry.default, int)
            if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
                raise StressbotError(ErrorCode.WRONG_TYPE, entry.name, f"is {value!r}: give a {'whole ' if whole else ''}number")
            if not limits["low"] <= value <= limits["high"]:  # NaN fails as well
                raise StressbotError(
                    ErrorCode.OUT_OF_RANGE, entry.name, f"is {value!r}: give {limits['low']:g} to {limits['high']:g}"
                )
