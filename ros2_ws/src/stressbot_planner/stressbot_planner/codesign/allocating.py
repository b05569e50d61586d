"""Codewords for tasks: the best bound over all of them, then the search that begins with its codewords and those that are known."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stressbot_planner.codesign.best_bound import BestBound, best_bound
from stressbot_planner.codesign.measuring import Candidate, Measuring
from stressbot_planner.codesign.objective import Objective
from stressbot_planner.codesign.search import Race, SearchProgress
from stressbot_planner.codesign.words import Words
from stressbot_planner.model.allocation import SCHEMES

BOUND_SHARE = 0.1
"""Of the time, for the best bound."""


@dataclass(frozen=True)
class Allocation:
    """What was proved and what was found.

    Attributes:
        bound: over all codewords of this kind.
        given: the allocation that it is compared with.
        found: the best; the given one if it is of this kind and nothing better was found. None: no plan was found for any.
        progress: at the end.
    """

    bound: BestBound
    given: Candidate
    found: Candidate | None
    progress: SearchProgress

    @property
    def saved(self) -> float:
        """Share of the given allocation's cost that the found one saves, after as many runs; below 0 if it costs more."""
        if self.found is None or self.found is self.given:
            return 0.0
        given = self.given.after(min(len(self.given.runs), len(self.found.runs)))
        return 1.0 - self.found.value / given if given > 0 else 0.0


def allocate(
    objective: Objective,
    words: Words,
    given: Candidate,
    measuring: Measuring,
    seed: int = 0,
    max_tries: int | None = None,
    known: Sequence[Sequence[str]] = (),
    on_progress: Callable[[SearchProgress], None] = lambda _: None,
) -> Allocation:
    """Look for the best codewords.

    Args:
        objective: that is minimised.
        words: to choose from.
        given: an allocation to compare with; it takes part if it is of these words and has this objective.
        measuring: ends the search when its time is over.
        seed: of the random generator.
        max_tries: runs of the planner, each for all tasks; None: any number.
        known: codewords to begin with, of as many bits or fewer.
        on_progress: told of all runs.
    """
    left = measuring.until - measuring.clock()
    bound = best_bound(objective, words, BOUND_SHARE * left if max_tries is None else np.inf)
    search = Race(objective, words, given, measuring, np.random.default_rng(seed), max_tries, on_progress)
    found = search.run(_first(words, [given.codewords, *known, *([bound.codewords] if bound.codewords else [])]))
    if found is not None and not np.isfinite(found.value):
        found = None
    return Allocation(bound, given, found, search.progress())


def _first(words: Words, known: Sequence[Sequence[str]]) -> Iterator[tuple[str, ...]]:
    """Yield those of known codewords and schemes that are of these words, groups without members added where they are short."""
    own_groups = tuple(f"{1 << row:0{words.n}b}" for row in range(words.n))
    for codewords in (*known, *(scheme(words.n) for scheme in SCHEMES.values()), own_groups):
        longer = tuple(word.ljust(words.bits, "0") for word in codewords)
        if words.fits(longer):
            yield longer
