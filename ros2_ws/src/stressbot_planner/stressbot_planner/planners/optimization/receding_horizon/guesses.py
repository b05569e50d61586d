"""First guesses of windows and ends: random group orders, and the one of several that is clear for longest."""

from collections.abc import Iterable

import numpy as np

from stressbot_planner.planners.optimization.receding_horizon.prefixes import Ground, Prefix

Guess = tuple[np.ndarray, np.ndarray]
"""Groups (K,) from 1, and lengths (K,)."""

SPREAD = (0.5, 1.5)
"""Of random lengths, relative."""

RAMP, RAMP_CYCLES = (0.1, 1.0), 4
"""A guess begins with short activations, which leave freedom where bodies are close already: these shares, in so many cycles."""

FIRST_TURN = 0.05
"""Least turn of all that a guess begins with, turning lengths."""


def random_guess(ground: Ground, rng: np.random.Generator, count: int, wanted: np.ndarray, mean: float) -> Guess:
    """Return so many activations in cycles of one random order of the groups, with lengths in proportion to wanted (m,)."""
    groups = np.resize(rng.permutation(ground.used), count)
    return groups + 1, wanted[groups] / float(wanted[ground.used].mean()) * mean * rng.uniform(*SPREAD, count)


def careful(ground: Ground, rng: np.random.Generator, guess: Guess, most_turn: float) -> Guess:
    """Return a guess that begins with a random turn of all, up to this share of a whole one, and with short activations."""
    groups, t = guess
    ramp = np.linspace(*RAMP, RAMP_CYCLES * len(ground.used))[: len(t)]
    t[: len(ramp)] *= ramp
    groups[0] = ground.crowd.m
    t[0] = most_turn * rng.uniform(FIRST_TURN, 2 * np.pi * float(ground.crowd.turning_length.mean()))
    return groups, t


def clearest(ground: Ground, node: Prefix, guesses: Iterable[Guess], count: int) -> Guess:
    """Return the guess of which most of the first activations, so many, are clear."""
    return max(guesses, key=lambda guess: ground.clear_until(node, guess[0][:count], guess[1][:count]))
