"""Large neighbourhood search: a random stretch of the best plan gets other groups and lengths, and the whole is solved again."""

import numpy as np

from stressbot_planner.planners.optimization.central_path import Order
from stressbot_planner.planners.optimization.search import Search

STRETCH = (0.05, 0.6)
"""Length of the stretch, relative to the plan."""

LEAST = 4
"""Activations in it."""


def search_neighbour(search: Search, groups: np.ndarray, lengths: np.ndarray) -> None:
    """Try one neighbour of a sequence of groups (K,) and lengths (K,), units."""
    search.count()
    search.solve(*_neighbour(search, groups.copy(), lengths.copy()), search.ends(groups, lengths))


def _neighbour(search: Search, groups: np.ndarray, lengths: np.ndarray) -> tuple[Order, np.ndarray]:
    rng = search.rng
    count = len(groups)
    size = min(max(int(rng.uniform(*STRETCH) * count), LEAST), count)
    first = rng.integers(0, count - size + 1)
    used = rng.permutation(np.unique(groups))
    stretch = slice(first, first + size)
    lengths[stretch] = lengths[stretch].mean() * rng.uniform(0.3, 1.7, size)
    groups[stretch] = np.resize(used, size)
    return search.order(groups), lengths
