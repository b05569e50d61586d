"""The witness: volts in, poses out, against the closed form and against a robot described step by step."""

import ast
import math
import time
from pathlib import Path

import numpy as np
import pytest
from driver_support import bench, closed_form, encode, play
from hypothesis import given, settings
from hypothesis import strategies as st

import stressbot_driver
from stressbot_driver.simulation.substrate import Substrate


def poses(substrate):
    measured = substrate.poses()
    return np.column_stack([measured.x, measured.y, substrate.heading_unwrapped])


def activations(bench, count, seed, longest=3.0):
    rng = np.random.default_rng(seed)
    groups = rng.integers(1, bench.group_count + 1, count)
    return [(int(group), float(seconds)) for group, seconds in zip(groups, rng.uniform(0.01, longest, count), strict=True)]


def assert_same(bench, actual, expected, tolerance=1e-6):
    """Positions to `tolerance` length units, headings to `tolerance` radians."""
    assert np.abs(actual[:, :2] - expected[:, :2]).max() / bench.length_unit < tolerance
    assert np.abs(actual[:, 2] - expected[:, 2]).max() < tolerance


@pytest.mark.parametrize(
    ("count", "changes"),
    [
        (1, {}),
        (6, {}),
        (6, {"swarm.groups": "balanced"}),
        (7, {"swarm.groups": "tight"}),
        (5, {"swarm.groups": ["1000", "1100", "0110", "0011", "1111"], "swarm.turning_radius": [1.0, 2.0, 0.5, 0.7, 3.0]}),
        (14, {"electrical.symbol_levels": [20.0, 35.0, 50.0, 65.0], "electrical.release": 5.0}),
        (30, {"electrical.hysteresis": 0.0, "length_unit": 1.0}),
        (6, {"electrical.codes": [[1, 0, 1], [0, 1, 1], [1, 1, 1], [0, 0, 0]]}),
        (126, {"robots.3.start": [100.0, 100.0, -20.0]}),
    ],
)
def test_random_activations_by_volts_alone(count, changes):
    swarm = bench(count, **changes)
    substrate = Substrate(swarm)
    plan = activations(swarm, 200, seed=count)
    play(substrate, encode(swarm, plan))
    assert_same(swarm, poses(substrate), closed_form(swarm, plan), 1e-9)


def test_ten_thousand_activations_stay_exact():
    swarm = bench(6, **{"swarm.turning_radius": [1.0, 0.9, 1.1, 0.37, 2.3, 0.5]})
    substrate = Substrate(swarm)
    plan = activations(swarm, 10_000, seed=0, longest=12.0)
    play(substrate, encode(swarm, plan))
    measured = poses(substrate)
    assert np.abs(measured[:, 2]).max() > 1e4  # many turns, all counted
    # The closed form's own headings are sums of 1e4 rad, so it is good to some 1e-8 itself.
    assert_same(swarm, measured, closed_form(swarm, plan))


@given(st.data())
@settings(deadline=None)
def test_any_code_alphabet_selects_the_group_meant(data):
    levels = data.draw(st.integers(2, 6), "L")
    count = data.draw(st.integers(1, 20), "n")
    symbols = np.sort(data.draw(st.lists(st.integers(2, 16), min_size=levels, max_size=levels, unique=True), "levels")) * 5.0
    swarm = bench(
        count,
        **{"electrical.symbol_levels": symbols.tolist(), "electrical.release": 1.0, "swarm.groups": "tight"},
    )
    plan = data.draw(st.lists(st.tuples(st.integers(1, swarm.group_count), st.floats(1e-9, 30.0)), max_size=6), "plan")
    substrate = Substrate(swarm)
    if plan:
        play(substrate, encode(swarm, plan))
    assert_same(swarm, poses(substrate), closed_form(swarm, plan), 1e-9)


class OneRobot:
    """The electrical model in words, for one robot: the slow and obvious way."""

    def __init__(self, swarm, index):
        self.e = swarm.electrical
        self.codeword = swarm.codewords[index]
        self.speed, self.radius = swarm.speed[index], swarm.turning_radius[index]
        self.x, self.y, self.heading = swarm.start[index]
        self.above = [False] * len(self.e.thresholds)
        self.band, self.since, self.up = 0, 0.0, True
        self.words = {}
        self.let_go()

    def let_go(self):
        """Symbols taken since the reset, per module."""
        self.words = {i: [] for i, bit in enumerate(self.codeword) if bit == "1"}

    def held(self):
        return any(word == self.e.codes[i].tolist() for i, word in self.words.items())

    def hold(self, level, dwell):
        for k, threshold in enumerate(self.e.thresholds):
            if level >= threshold + self.e.hysteresis / 2:
                self.above[k] = True
            elif level <= threshold - self.e.hysteresis / 2:
                self.above[k] = False
        band, symbols = sum(self.above), len(self.e.symbol_levels)
        if band != self.band:
            if band == 0 and 1 <= self.band <= symbols and self.since >= self.e.min_dwell:
                for word in self.words.values():
                    word.append(self.band - 1)
            self.band, self.since = band, 0.0
        self.arm(level)
        if band == symbols + 2:
            if self.up:
                self.x += self.speed * dwell * math.cos(self.heading)
                self.y += self.speed * dwell * math.sin(self.heading)
            else:
                self.heading += self.speed * dwell / self.radius
        self.since += dwell
        if band == symbols + 1 and self.since >= self.e.min_dwell:
            self.let_go()
            self.arm(level)

    def arm(self, level):
        if self.held() or level <= self.e.release:
            self.up = True
        elif level >= self.e.pull_down:
            self.up = False


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_any_volts_at_all_move_the_robots_as_described(data):
    """Not only codes: random levels anywhere, dwells around min_dwell, levels within the hysteresis."""
    swarm = bench(3, **{"electrical.pull_down": data.draw(st.sampled_from([35.0, 80.0, 120.0, 140.0]), "pull_down")})
    substrate = Substrate(swarm)
    robots = [OneRobot(swarm, index) for index in range(3)]
    symbol = st.sampled_from([[(90.0, 0.01), (0.0, 0.005)], [(40.0, 0.01), (0.0, 0.005)], [(60.0, 0.01), (0.0, 0.005)]])
    level = st.sampled_from([0.0, 18.0, 21.0, 22.0, 40.0, 49.0, 60.0, 74.0, 90.0, 114.0, 118.0, 130.0, 140.0]) | st.floats(0, 200)
    dwell = st.sampled_from([0.001, 0.0019999, 0.002, 0.01, 1.0])
    anything = st.tuples(level, dwell).map(lambda step: [step])
    for steps in data.draw(st.lists(symbol | anything, max_size=30), "volts"):
        for volts, seconds in steps:
            substrate.apply(volts)
            substrate.advance(seconds)
            for robot in robots:
                robot.hold(volts, seconds)
            assert substrate.arm_up.tolist() == [robot.up for robot in robots]
    expected = np.array([(robot.x, robot.y, robot.heading) for robot in robots])
    assert_same(swarm, poses(substrate), expected, 1e-9)


def select(substrate, electrical, symbols, dwell=None):
    for level in [electrical.reset_level, *(electrical.symbol_levels[s] for s in symbols)]:
        substrate.apply(level)
        substrate.advance(electrical.symbol_dwell if dwell is None else dwell)
        substrate.apply(electrical.rest_level)
        substrate.advance(electrical.guard_dwell)


def sliders(substrate, electrical):
    """Ids of the robots whose arms stay up under the drive level."""
    substrate.apply(electrical.drive_level)
    return (np.flatnonzero(substrate.arm_up) + 1).tolist()


def test_short_symbols_surplus_symbols_and_wrong_codes_select_nobody():
    swarm = bench(6)
    electrical = swarm.electrical
    for symbols, dwell, expected in [
        ([0, 0], None, [4, 5, 6]),
        ([0, 1], None, [2, 3, 6]),
        ([1, 0], None, [1, 3, 5]),
        ([1, 1], None, []),
        ([0], None, []),
        ([0, 0, 0], None, []),
        ([], None, []),
        ([0, 0], electrical.min_dwell, [4, 5, 6]),
        ([0, 0], 0.999 * electrical.min_dwell, []),
    ]:
        substrate = Substrate(swarm)
        select(substrate, electrical, symbols, dwell)
        assert sliders(substrate, electrical) == expected, symbols


def test_one_wrong_symbol_of_a_checked_code_selects_nobody():
    swarm = bench(6, electrical={"codes": "checked"})
    electrical = swarm.electrical
    for group, code in enumerate(electrical.codes):
        for place in range(len(code)):
            symbols = code.tolist()
            symbols[place] = 1 - symbols[place]
            substrate = Substrate(swarm)
            select(substrate, electrical, symbols)
            assert sliders(substrate, electrical) == []
        substrate = Substrate(swarm)
        select(substrate, electrical, code)
        members = swarm.ids[swarm.membership[:, group]].tolist() if group < swarm.membership.shape[1] else []  # the last: all turn
        assert sliders(substrate, electrical) == members


def test_a_code_holds_until_the_next_reset():
    swarm = bench(6)
    electrical = swarm.electrical
    substrate = Substrate(swarm)
    select(substrate, electrical, [0, 0])
    for _ in range(3):
        assert sliders(substrate, electrical) == [4, 5, 6]
        substrate.apply(electrical.rest_level)
    select(substrate, electrical, [])
    assert sliders(substrate, electrical) == []


def test_too_short_a_reset_is_ignored():
    swarm = bench(6)
    electrical = swarm.electrical
    substrate = Substrate(swarm)
    select(substrate, electrical, [0, 0])
    substrate.apply(electrical.reset_level)
    substrate.advance(0.5 * electrical.min_dwell)
    substrate.apply(electrical.rest_level)
    assert sliders(substrate, electrical) == [4, 5, 6]


def test_looking_changes_nothing():
    swarm = bench(6)
    plan = activations(swarm, 50, seed=3)
    sequence = encode(swarm, plan)
    plain, watched = Substrate(swarm), Substrate(swarm)
    play(plain, sequence)
    for level, dwell in zip(sequence.levels, sequence.dwells, strict=True):
        watched.apply(level)
        for part in (0.1, 0.5, 0.9):
            watched.poses(part * dwell)
        ahead = watched.poses(dwell)
        watched.advance(dwell)
        assert np.array_equal(ahead.x, watched.poses().x)
    assert np.array_equal(poses(plain), poses(watched))


def test_headings_are_published_wrapped():
    swarm = bench(3, **{"robots.0.start": [0.0, 0.0, math.pi], "robots.1.start": [0.0, 2.0, -math.pi]})
    substrate = Substrate(swarm)
    assert substrate.poses().heading.tolist() == [math.pi, math.pi, 0.0]
    substrate.apply(swarm.electrical.drive_level)
    for dt in np.linspace(0.0, 50.0, 1001):
        heading = substrate.poses(dt).heading
        assert (heading > -math.pi).all() and (heading <= math.pi).all()
    substrate.advance(7.0)
    assert substrate.heading_unwrapped == pytest.approx([math.pi + 7, -math.pi + 7, 7])


def test_reset_brings_everybody_home():
    swarm = bench(6)
    substrate = Substrate(swarm)
    play(substrate, encode(swarm, activations(swarm, 20, seed=1)))
    substrate.apply(swarm.electrical.drive_level)
    substrate.reset()
    assert np.array_equal(poses(substrate), swarm.start)
    assert substrate.level == 0.0 and substrate.arm_up.all()
    assert sliders(substrate, swarm.electrical) == []  # no PFSM remembers its code


@pytest.mark.timing
@pytest.mark.parametrize("count", [6, 126, 1022])
def test_a_segment_costs_as_much_as_some_additions(count):
    """By far the least that a segment lasts is longer than that on any machine: see `make bench ARGS="speed"`."""
    swarm = bench(count)
    sequence = encode(swarm, activations(swarm, 200, seed=count, longest=1.0))
    numbers = np.ones(count)

    def played():
        play(Substrate(swarm), sequence)

    def added():
        for _ in range(len(sequence.levels)):
            numbers + numbers

    def processor_time(work):
        """The others on the machine disturb: the quickest of five."""
        times = []
        for _ in range(5):
            began = time.process_time()
            work()
            times.append(time.process_time() - began)
        return min(times)

    assert processor_time(played) < 200 * processor_time(added)


def test_the_witness_knows_nothing_of_the_planner():
    for path in Path(stressbot_driver.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.startswith("stressbot_planner") for name in names), path
