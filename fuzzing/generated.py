"""hypothesis throws inputs at an interface, in this process."""

import itertools
import time
from collections import Counter
from dataclasses import dataclass, field

from hypothesis import HealthCheck, Phase, given, seed, settings

from fuzzing.interface import Final, Interface

ROUND = 1000
LONGEST = 3000
"""Letters of a report."""


@dataclass
class Tally:
    """What came of the inputs to one interface.

    Attributes:
        name: of the interface.
        how: the inputs were made, or brought there.
        outcomes: how many inputs were accepted, or refused by which code.
        violations: what must never happen, with the smallest input that was found to do it.
        seconds: of processor time.
    """

    name: str
    how: str
    outcomes: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def inputs(self) -> int:
        """How many there were."""
        return self.outcomes.total()


def campaign(interface: Interface, count: int, number: int, how: str = "hypothesis") -> Tally:
    """Try at least `count` inputs that follow from the seed `number`; hypothesis shrinks one that fails."""
    tally = Tally(interface.name, how)
    begin = time.process_time()
    # in rounds, since hypothesis slows down with what it remembers of a long one
    for round_number in itertools.count(number * 1000):
        if tally.inputs >= count or tally.violations:
            break
        try:
            _round(interface, min(ROUND, count - tally.inputs), round_number, tally)
        except Exception as error:
            tally.violations.append("\n".join([repr(error), *getattr(error, "__notes__", ())])[:LONGEST])
    tally.seconds = time.process_time() - begin
    return tally


def _round(interface: Interface, count: int, number: int, tally: Tally) -> None:
    @seed(number)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(interface.inputs)
    def attempt(value: object) -> None:
        if tally.violations:
            return
        try:
            tally.outcomes[interface(value)] += 1
        except Final as error:
            tally.violations.append(f"{error} at {value!r}"[:LONGEST])

    attempt()
