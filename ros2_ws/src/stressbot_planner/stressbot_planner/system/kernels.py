"""Compiled loops."""

from collections.abc import Callable
from typing import Any

from numba import njit


def kernel(**options: Any) -> Callable[[Callable], Callable]:
    """Return a decorator that compiles a function at its first call, and keeps what was compiled where there is a place for it.

    Without one, as for a user without a home in an installation that is read-only, each process compiles anew. Options are
    those of numba.
    """

    def compiled(function: Callable) -> Callable:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:  # "cannot cache function: no locator available"
            return njit(**options)(function)

    return compiled
