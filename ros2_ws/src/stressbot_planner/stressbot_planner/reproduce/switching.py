"""How fast activations approach the embedded system (paper, section 3): the paper's six robots, weights that change all along."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stressbot_planner.formats import scenario
from stressbot_planner.model.kinematics import replay
from stressbot_planner.primitives.embedded import Weights, integrate, switch
from stressbot_planner.reproduce import instances

LENGTH = 10.0
"""Of the whole way, units."""

EPOCHS = (10, 20, 40, 80, 160, 320, 640)


@dataclass(frozen=True)
class Switching:
    """One approximation.

    Attributes:
        symmetric: which cycle, see `embedded.switch`.
        epochs, activations: how many.
        epoch_length: units.
        error: largest distance of a robot from where the embedded system leads it, units.
    """

    symmetric: bool
    epochs: int
    activations: int
    epoch_length: float
    error: float


def measure() -> list[Switching]:
    """Return the approximations of both cycles."""
    problem = scenario.parse(instances.paper(discs=False)).problem
    weights = Weights.sampled(_weights, np.linspace(0.0, LENGTH, 101))
    end = integrate(problem.swarm, problem.starts, weights)
    rows = []
    for symmetric in (False, True):
        for epochs in EPOCHS:
            groups, lengths = switch(weights, epochs, symmetric)
            missed = (replay(problem.swarm, problem.starts, groups, lengths)[-1] - end)[:, :2]
            rows.append(Switching(symmetric, epochs, len(groups), LENGTH / epochs, float(np.hypot(*missed.T).max())))
    return rows


def order_of(rows: Sequence[Switching]) -> float:
    """Return the slope of the error over the length of an epoch, in logarithms, of the shorter half of the epochs."""
    shorter = rows[len(rows) // 2 :]
    slope, _ = np.polyfit(np.log([row.epoch_length for row in shorter]), np.log([row.error for row in shorter]), 1)
    return float(slope)


def _weights(way: float) -> np.ndarray:
    """Return weights of four groups that sum to 1."""
    raw = 1.2 + np.sin(np.arange(1, 5) * (0.7 * way + 0.3))
    return raw / raw.sum()
