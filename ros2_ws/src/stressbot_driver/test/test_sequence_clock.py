"""Sequence times of pictures, and pictures that are none."""

import numpy as np
import pytest

from stressbot_driver.vision.plausibility import Plausibility, darkness
from stressbot_driver.vision.sequence_clock import KEPT, DriverWord, SequenceClock


def clock(speed=1.0, lag=0.0):
    """A driver that starts at 10 s, runs for 5 s of sequence time, and says so every 0.1 s."""
    told = SequenceClock()
    told.hear(DriverWord(9.0, "a", 0.0, False, 5.0))
    for step in range(int(50 / speed)):
        told.hear(DriverWord(10.0 + 0.1 * step, "a", max(0.0, 0.1 * speed * step - lag * (step % 3)), True, 5.0))
    return told


def test_before_anything_is_said_nothing_is_known():
    assert SequenceClock().at(1.0) is None


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_between_words_and_beyond_the_last_time_goes_on(speed):
    told = clock(speed)
    assert told.at(9.5) == ("a", 0.0)
    for stamp in (10.04, 11.23, 12.0, 12.399):
        assert told.at(stamp) == ("a", pytest.approx(speed * (stamp - 10.0), abs=1e-6))


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_how_fast_time_runs_is_known_from_the_run_before(speed):
    told = SequenceClock()
    for word in (("a", 0.0, True), ("a", 0.4 * speed, False), ("b", 0.0, False)):
        told.hear(DriverWord(10.0 + word[1] / speed, word[0], word[1], word[2], 5.0))
    told.hear(DriverWord(11.0, "b", 0.0, True, 5.0))
    for stamp in (11.0, 11.1, 11.3):
        assert told.at(stamp) == ("b", pytest.approx(speed * (stamp - 11.0), abs=1e-6))


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0])
def test_stamps_are_the_inverse_of_times(speed):
    told = clock(speed)
    assert told.stamps("b", np.array([1.0])).size == 0
    for stamp, time in zip((10.04, 11.23, 12.0), told.stamps("a", speed * (np.array([10.04, 11.23, 12.0]) - 10.0)), strict=True):
        assert time == pytest.approx(stamp, abs=1e-6)


def test_the_first_word_of_a_long_run_is_kept_which_is_of_that_very_moment():
    told = SequenceClock()
    told.hear(DriverWord(10.0, "a", 0.0, True, 500.0))
    for step in range(1, 2 * KEPT):
        told.hear(DriverWord(10.0 + 0.1 * step, "a", 0.1 * step - 0.03, True, 500.0))
    assert told.at(10.0 + 0.2 * KEPT)[1] == pytest.approx(0.2 * KEPT, abs=1e-6)
    told.hear(DriverWord(10.0 + 0.2 * KEPT, "b", 0.0, True, 5.0))
    assert told.at(11.0 + 0.2 * KEPT) == ("b", pytest.approx(1.0, abs=1e-6))


def test_a_word_may_be_of_a_moment_before():
    told = clock(lag=0.02)
    for stamp in (11.23, 12.04, 14.95):
        assert told.at(stamp)[1] == pytest.approx(stamp - 10.0, abs=1e-6)


def test_the_end_is_the_drivers_own_number():
    told = clock()
    assert told.at(17.0)[1] <= 5.0
    told.hear(DriverWord(15.0, "a", 4.9999999, False, 5.0))
    assert told.at(16.0) == ("a", 4.9999999)
    told.hear(DriverWord(16.5, "b", 0.0, False, 3.0))
    assert told.at(17.0) == ("b", 0.0)
    assert told.at(14.5)[1] == pytest.approx(4.5)  # a picture that comes late


def test_a_picture_that_is_the_last_one_again_is_refused():
    random = np.random.default_rng(0)
    one, other = random.integers(0, 255, (2, 60, 80), dtype=np.uint8)
    pictures = Plausibility()
    assert pictures.problem(one, 1) == ""
    assert "frozen" in pictures.problem(one.copy(), 2)
    assert pictures.problem(other, 3) == ""
    assert "before the last one" in pictures.problem(one, 3)
    assert "before the last one" in pictures.problem(one, 2)
    assert pictures.problem(one, 4) == ""


def test_a_clock_that_was_set_back_is_said_once():
    random = np.random.default_rng(0)
    pictures = Plausibility()
    told = [
        pictures.problem(random.integers(0, 255, (20, 20), dtype=np.uint8), stamp)
        for stamp in (10_000_000_000, 5_000_000_000, 5_100_000_000, 5_200_000_000)
    ]
    assert [bool(problem) for problem in told] == [False, True, False, False]


def test_why_a_picture_shows_nobody():
    random = np.random.default_rng(0)
    noise = random.normal(0.0, 3.0, (100, 120))
    assert "dark" in darkness(np.clip(4.0 + noise, 0, 255).astype(np.uint8))
    assert "in front of the lens" in darkness((60.0 + noise).astype(np.uint8))
    assert darkness((100.0 + noise + np.linspace(0.0, 40.0, 120)).astype(np.uint8)) == ""
