"""`make orders`: every event in every state while something is broken, and any two requests or events at once in every order."""

import itertools

import pytest
from exploring import AT_ONCE, BROKEN, at_once, explored
from scheduling import orders
from whole_world import FILES, worlds

PAIRS = [(("load",), ("start", other)) for other in AT_ONCE]
PAIRS += [(("load", "start"), pair) for pair in itertools.combinations_with_replacement(AT_ONCE, 2)]


@pytest.fixture(autouse=True)
def modules():
    with worlds():
        yield


@pytest.mark.parametrize("broken", [None, *BROKEN])
def test_every_event_in_every_state(broken):
    assert explored(broken)


@pytest.mark.parametrize(("first", "actors"), PAIRS, ids=lambda value: "-".join(value))
@pytest.mark.parametrize(("changes", "files"), [(2, ()), (1, FILES)], ids=["held up twice", "held up at any line"])
def test_any_two_at_once(first, actors, changes, files):
    assert sum(1 for _ in orders(at_once(first, actors, files), changes)) > 1
