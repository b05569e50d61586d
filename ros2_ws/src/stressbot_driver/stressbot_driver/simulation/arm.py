"""Steering arms: held up by a PFSM, pulled down by a high voltage, released by a low one."""

import numpy as np


class Arms:
    """The arms of n robots. An arm that nothing holds comes down at v >= pull_down, rises at v <= release, else keeps."""

    def __init__(self, count: int, pull_down: np.ndarray | float, release: np.ndarray | float) -> None:
        """`pull_down` and `release` [V], a number or (n,)."""
        self._pull_down = pull_down
        self._release = release
        self.stuck_up: np.ndarray | None = None  # (n,) bool
        self.stuck_down: np.ndarray | None = None
        self.up = np.ones(count, dtype=bool)

    def update(self, voltage: float | np.ndarray, holding: np.ndarray) -> None:
        """React to `voltage` [V], a number or (n,), and to `holding` (n,), whether a PFSM holds the arm up."""
        self.up = holding | (voltage <= self._release) | (self.up & (voltage < self._pull_down))
        if self.stuck_up is not None:
            self.up |= self.stuck_up
        if self.stuck_down is not None:
            self.up &= ~self.stuck_down
