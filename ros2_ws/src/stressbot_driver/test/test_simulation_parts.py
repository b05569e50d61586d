"""Quantiser, PFSMs and arms against scalar descriptions of the same thing, one robot and one module at a time."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.codewords import default_codes
from stressbot_driver.simulation.arm import Arms
from stressbot_driver.simulation.pfsm import PfsmBank
from stressbot_driver.simulation.quantiser import Quantiser

volts = st.floats(-50, 250, allow_nan=False)


@st.composite
def ladders(draw):
    """Ascending thresholds with room for the hysteresis between them."""
    steps = draw(st.lists(st.integers(5, 40), min_size=1, max_size=7))
    return np.cumsum(steps).astype(float), draw(st.sampled_from([0.0, 1.0, 4.0]))


@given(ladders(), st.lists(volts, max_size=40))
def test_quantiser_is_a_row_of_schmitt_triggers(ladder, voltages):
    thresholds, hysteresis = ladder
    quantiser = Quantiser(thresholds[None, :], hysteresis)
    triggers = [False] * len(thresholds)
    for voltage in voltages:
        for k, threshold in enumerate(thresholds):
            if voltage >= threshold + hysteresis / 2:
                triggers[k] = True
            elif voltage <= threshold - hysteresis / 2:
                triggers[k] = False
        assert quantiser.read(voltage).tolist() == [sum(triggers)]
        assert triggers == sorted(triggers, reverse=True)


def test_quantiser_rises_above_and_falls_below():
    quantiser = Quantiser(np.array([[20.0, 50.0]]), 4.0)
    assert [quantiser.read(v)[0] for v in (21.9, 22.0, 18.1, 18.0, 60.0, 48.1, 30.0, 0.0)] == [0, 1, 1, 0, 2, 2, 1, 0]


def test_quantiser_rows_are_independent():
    quantiser = Quantiser(np.array([[20.0, 50.0], [30.0, 60.0]]), 4.0)
    assert quantiser.read(25.0).tolist() == [1, 0]
    assert quantiser.read(55.0).tolist() == [2, 1]


@given(st.data())
def test_pfsms_accept_their_code_and_nothing_else(data):
    levels = data.draw(st.integers(2, 5), "L")
    groups = data.draw(st.integers(2, 10), "m")
    robots = data.draw(st.integers(1, 5), "n")
    bits = st.lists(st.booleans(), min_size=groups - 1, max_size=groups - 1)
    membership = np.array(data.draw(st.lists(bits, min_size=robots, max_size=robots)), dtype=bool)
    codes = np.array(default_codes(groups, levels))
    bank = PfsmBank(membership, codes, levels)
    taken = [[] for _ in range(robots)]
    for action in data.draw(st.lists(st.integers(-1, levels - 1) | st.sampled_from(codes.tolist()), max_size=15)):
        some = np.array(data.draw(st.lists(st.booleans(), min_size=robots, max_size=robots)), dtype=bool)
        chosen = slice(None) if data.draw(st.booleans()) else some
        if action == -1:
            bank.reset(chosen)
            for robot in np.arange(robots)[chosen]:
                taken[robot] = []
        else:
            for symbol in action if isinstance(action, list) else [action]:
                bank.step(chosen, np.array([symbol]))
                for robot in np.arange(robots)[chosen]:
                    taken[robot].append(symbol)
        for robot in range(robots):
            modules = [i for i in range(groups - 1) if membership[robot, i]]
            assert bank.holding[robot] == any(codes[i].tolist() == taken[robot] for i in modules)


@given(st.lists(st.tuples(volts, st.lists(st.booleans(), min_size=3, max_size=3)), max_size=30))
def test_arms_follow_their_holder_first_and_the_volts_second(steps):
    arms = Arms(3, pull_down=120.0, release=30.0)
    up = [True] * 3
    assert arms.up.tolist() == up
    for voltage, holding in steps:
        arms.update(voltage, np.array(holding))
        for j in range(3):
            if holding[j] or voltage <= 30.0:
                up[j] = True
            elif voltage >= 120.0:
                up[j] = False
        assert arms.up.tolist() == up
