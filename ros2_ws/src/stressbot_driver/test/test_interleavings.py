"""A part of what `make orders` goes through: events in every state, and two at once in every order."""

import re
from pathlib import Path

import pytest
from exploring import AT_ONCE, at_once, explored
from scheduling import orders
from whole_world import FILES, worlds

from stressbot_driver.session import State


@pytest.fixture(autouse=True)
def modules():
    with worlds():
        yield


def test_every_event_in_every_state_that_there_is():
    known = explored()
    assert {state[0] for state in known} == set(State) and len(known) < 500


@pytest.mark.parametrize("other", AT_ONCE)
def test_a_start_and_anything_else_at_once(other):
    """All orders in which one thread is held up once, at a lock, a message, an event or a thread's start."""
    assert sum(1 for _ in orders(at_once(("load",), ("start", other)), changes=1)) > 1


@pytest.mark.parametrize("actors", [("stop", "close"), ("stop", "death"), ("loss", "silence"), ("end", "reset")], ids="-".join)
def test_two_ends_of_a_run_at_once(actors):
    assert sum(1 for _ in orders(at_once(("load", "start"), actors), changes=1)) > 1


def test_a_start_that_is_held_up_at_any_line_cannot_keep_volts_on_after_a_stop():
    assert sum(1 for _ in orders(at_once(("load",), ("start", "stop"), FILES), changes=1)) > 100


def test_a_gate_that_finds_silence_while_it_starts_rests_again():
    """Found by two changes: the latch told the output to rest before it began, and the start looked before that was said."""
    assert sum(1 for _ in orders(at_once(("load",), ("start", "silence")), changes=2)) > 100


def test_every_invariant_of_the_page_has_a_test():
    page = (Path(__file__).parents[4] / "docs/safety.md").read_text(encoding="utf-8")
    table = page[page.index("## Invariants") : page.index("## Watches")]
    rows = re.findall(r"^\| (\d+) \| (.+?) \| (.+?) \|$", table, re.MULTILINE)
    assert [int(number) for number, _, _ in rows] == list(range(1, len(rows) + 1)) and len(rows) >= 12
    defined = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("test_*.py"))
    for number, sentence, tests in rows:
        for name in re.findall(r"`(\w+)`", tests) or [f"none for {number}: {sentence}"]:
            assert f"def {name}(" in defined, name
