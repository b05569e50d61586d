"""Warm start: mend a plan that nearly fits, such as what remains of one, by other durations, then by further activations."""

import numpy as np

from stressbot_planner.planners.optimization.central_path import Order
from stressbot_planner.planners.optimization.search import Search

INSERTIONS, INSERTED_LENGTH = 2, 0.3
"""Tries with further activations inserted, and their largest length relative to the mean."""

SHORTEST = 1e-3
"""Of the mean length: shorter activations are taken as that long."""


def mend_warm_start(search: Search, used: np.ndarray) -> None:
    """Look for a plan from `Settings.warm_start`, with activations of the groups `used`, from 0."""
    if search.settings.warm_start is None:
        return
    groups, lengths = map(np.asarray, search.settings.warm_start)
    groups = groups.astype(np.int64)
    if not np.any(lengths):
        return
    lengths = np.maximum(lengths, SHORTEST * lengths.mean())
    order, ends = search.order(groups), search.ends(groups, lengths)
    if len(groups) > search.problem.conditions:
        restored = search.path(order, ends).restore(lengths, patient=True)
        if restored is not None and search.keep(order, restored) or search.repair(order, lengths, ends):
            return
    for _ in range(INSERTIONS):
        if search.done() or search.repair(*_with_insertions(search, used, groups, lengths), ends):
            return


def _with_insertions(search: Search, used: np.ndarray, groups: np.ndarray, lengths: np.ndarray) -> tuple[Order, np.ndarray]:
    """Return a sequence with as many short activations inserted at random, or as many as goals need."""
    count = max(len(groups), search.problem.conditions)
    at = search.rng.integers(0, len(groups) + 1, count)
    more = search.rng.permutation(np.resize(used + 1, count))
    short = lengths.mean() * search.rng.uniform(0.0, INSERTED_LENGTH, count)
    return search.order(np.insert(groups, at, more)), np.insert(lengths, at, short)
