"""How a robot reads the substrate voltage: a Schmitt quantiser into bands."""

import numpy as np


class Quantiser:
    """L+2 comparators with hysteresis, for R readers (one for all robots, or one per robot).

    Band b is the number of thresholds that the voltage is above: 0 rest, 1..L symbol b-1, L+1 reset, L+2 drive.
    A rising voltage crosses threshold T at T + h/2, a falling one at T - h/2; in between the band is kept.
    """

    def __init__(self, thresholds: np.ndarray, hysteresis: np.ndarray | float) -> None:
        """`thresholds` [V] (R, L+2), ascending along the second axis; `hysteresis` [V], full width."""
        half = 0.5 * np.asarray(hysteresis, dtype=float)
        self._rising = thresholds + half
        self._falling = thresholds - half
        self.band = np.zeros(len(thresholds), dtype=np.intp)  # (R,)

    def reset(self) -> None:
        """As after a long time at rest."""
        self.band = np.zeros_like(self.band)

    def read(self, voltage: float | np.ndarray) -> np.ndarray:
        """The new bands (R,) after a step to `voltage` [V], a number or (R, 1)."""
        at_least = (voltage >= self._rising).sum(axis=1)
        at_most = np.maximum((voltage > self._falling).sum(axis=1), at_least)
        self.band = np.minimum(np.maximum(self.band, at_least), at_most)
        return self.band
