"""Local search over codewords, with the planner in the loop: many get one short run, the promising ones more (racing)."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from stressbot_planner.codesign.measuring import Candidate, Ended, Measuring, tries_of
from stressbot_planner.codesign.objective import Objective
from stressbot_planner.codesign.words import Words

BATCH = 4
"""Candidates that get a run before the next are chosen, at any number of processes: so these change nothing but the time."""

FIRST = 12
"""Candidates to begin with, at random where there are no better ones."""

RUNS = (1, 2, 4, 8, 16)
"""Of the stages of the race."""

SURVIVORS, QUICK_SURVIVORS = 0.3, 0.1
"""Share of those that have reached a stage that go on to the next, and where a run there takes far less time than the next one."""

PARENTS = 6
"""Best candidates that are changed to find better ones."""

RANDOM = 0.1
"""Share of new candidates that are nobody's change."""

LOOKS = 400
"""Changes that are looked at for one that is new and not proved to be no better; where there is none, one at random is."""


@dataclass(frozen=True)
class SearchProgress:
    """How far a search has got.

    Attributes:
        tries: runs of the planner so far, one for each task.
        tried, screened: codewords that had some, and those that had none since their bound is above what was found.
        best: value; infinite as long as there is no plan.
    """

    tries: int
    tried: int
    screened: int
    best: float


class Race:
    """A search for the best codewords.

    Attributes:
        given: the allocation to compare with, which has no fewer runs than the best one; it need not be of these words.
        tries: runs of the planner so far, those for the given allocation included.
    """

    def __init__(
        self,
        objective: Objective,
        words: Words,
        given: Candidate,
        measuring: Measuring,
        rng: np.random.Generator,
        max_tries: int | None = None,
        on_progress: Callable[[SearchProgress], None] = lambda _: None,
    ):
        self.objective, self.words, self.given, self.measuring, self.rng = objective, words, given, measuring, rng
        self.max_tries, self.on_progress = max_tries, on_progress
        self.tries = 0
        self.screened: set[tuple[str, ...]] = set()
        self.found: dict[tuple[str, ...], Candidate] = {}

    def run(self, first: Iterable[Sequence[str]]) -> Candidate | None:
        """Return the best candidate, which may be equal to the given one; None if no run ended in time.

        Args:
            first: codewords to begin with.
        """
        waiting = [self.words.in_order(codewords) for codewords in first]
        waiting = list(dict.fromkeys(waiting))
        if self.given.objective is self.objective and self.words.fits(self.given.codewords):
            waiting = [codewords for codewords in waiting if codewords != self.words.in_order(self.given.codewords)]
            self.found[self.words.in_order(self.given.codewords)] = self.given
        for _ in range(FIRST - len(waiting) - len(self.found)):
            waiting.append(self.words.random(self.rng))
        try:
            self._run([self.given])
            while batch := self._batch(waiting):
                self._run(batch)
        except Ended:
            pass
        return self.best()

    def best(self) -> Candidate | None:
        """Return the best candidate that has had a run."""
        return min((one for one in self.found.values() if one.runs), key=lambda one: one.value, default=None)

    def progress(self) -> SearchProgress:
        """Return how far it has got."""
        best = self.best()
        tried = sum(bool(one.runs) for one in self.found.values())
        return SearchProgress(self.tries, tried, len(self.screened), np.inf if best is None else best.value)

    def _batch(self, waiting: list[tuple[str, ...]]) -> list[Candidate]:
        """Return who gets the next runs: the given one if it is behind, who survived a stage, then new ones."""
        room = BATCH if self.max_tries is None else min(BATCH, self.max_tries - self.tries)
        if room <= 0:
            return []
        best = self.best()
        if best is not None and len(self.given.runs) < len(best.runs):
            return [self.given]
        batch = [] if waiting else self._survivors()[:room]
        while len(batch) < room and (new := self._new(waiting)) is not None:
            batch.append(new)
        return batch or self._survivors(1)[:room]

    def _survivors(self, least: int = 0) -> list[Candidate]:
        """Return those that are to have more runs, of the latest stage first, from each stage at least so many."""
        going = []
        for stage, runs in reversed(list(enumerate(RUNS[:-1]))):
            reached = sorted((one for one in self.found.values() if len(one.runs) >= runs), key=lambda one: one.after(runs))
            is_quick = tries_of(self.words.n, runs - 1) < tries_of(self.words.n, runs)
            most = max(least, int((QUICK_SURVIVORS if is_quick else SURVIVORS) * len(reached)))
            going += [one for one in reached[:most] if len(one.runs) < RUNS[stage + 1] and np.isfinite(one.after(runs))]
        return list({id(one): one for one in going}.values())

    def _new(self, waiting: list[tuple[str, ...]]) -> Candidate | None:
        while waiting:
            codewords = waiting.pop(0)
            if codewords not in self.found:
                return self._add(Candidate.of(codewords, self.objective))
        best = self.best()
        if best is None:
            return None
        ranked = sorted((one for one in self.found.values() if np.isfinite(one.value)), key=lambda one: one.value)[:PARENTS]
        for _ in range(LOOKS):
            if not ranked or self.rng.random() < RANDOM:
                codewords = self.words.random(self.rng)
            else:
                parent = ranked[min(self.rng.integers(len(ranked), size=2))].codewords
                codewords = next(self.words.neighbours(parent, self.rng))
            if codewords in self.found or codewords in self.screened:
                continue
            new = Candidate.of(codewords, self.objective)
            if new.bound < best.value:
                return self._add(new)
            self.screened.add(codewords)
        return None

    def _add(self, candidate: Candidate) -> Candidate:
        self.found[candidate.codewords] = candidate
        return candidate

    def _run(self, batch: list[Candidate]) -> None:
        try:
            self.measuring.run(batch)
        finally:
            self.tries += len(batch)
            self.on_progress(self.progress())
