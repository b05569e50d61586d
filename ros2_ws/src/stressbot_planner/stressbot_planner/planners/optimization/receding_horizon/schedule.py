"""The numbers of one attempt, and their variation from one to the next."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Schedule:
    """See `docs/optimize.md` for where the numbers come from.

    Attributes:
        activations: of a window.
        length: mean of an activation, turning lengths.
        pace: length of the path that a window asks for is its total by this, in relation to what the groups must slide.
        turning: of all, in relation to the sliding.
        end_rest: an end is tried once the rest is below this share of the bound of the whole.
    """

    activations: int
    length: float = 0.28
    pace: float = 1.2
    turning: float = 0.25
    end_rest: float = 0.3

    @classmethod
    def of(cls, n: int) -> "Schedule":
        """Return what suits n robots."""
        return cls(activations=240 if n <= 45 else 300 if n <= 90 else 350, turning=0.25 if n <= 45 else 0.4)

    def varied(self, rng: np.random.Generator) -> "Schedule":
        """Return a schedule near this one: another start of the search."""
        return replace(
            self,
            pace=self.pace * rng.choice([0.85, 1.0, 1.2]),
            turning=self.turning * rng.choice([0.7, 1.0, 1.4]),
            end_rest=self.end_rest * rng.choice([0.7, 1.0, 1.4]),
        )
