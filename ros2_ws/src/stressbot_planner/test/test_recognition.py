"""Recognition: slides that are clear whoever does them, and what is said where it cannot be."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, clearance
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.recognition import MOST_ROUNDS, Bodies, least_gap, longest, recognise, room
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Workspace
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm

BOX = Environment(Workspace(-5, 5, -5, 5), (Circle((0, 0), 0.5),))


@given(st.integers(2, 4), st.integers(0, 2**32 - 1), st.floats(0.1, 2.0))
@settings(max_examples=50)
def test_the_least_gap_is_that_of_the_worst_group(n, seed, slide):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(-4, 4, (n, 2)), rng.uniform(-4, 4, n)])
    gaps = []
    for members in itertools.product("01", repeat=n):
        swarm = Swarm(1.0, np.arange(1.0, n + 1.0), 0.2, tuple(f"{bit}1" for bit in members))
        gaps.append(clearance(swarm, BOX, poses, np.array([1]), np.array([slide])).gap)
    assert least_gap(Shapes.of(BOX), poses, slide, 0.2) == pytest.approx(min(gaps), abs=1e-9)


class Bench:
    """Robots at places that nobody has named, and a tracker that knows each after it has slid three times."""

    def __init__(self, seed, n, shown=None):
        self.swarm = Swarm(1.0, 0.5, 0.2, binary(n))
        rng = np.random.default_rng(seed)
        places = np.array([(x, y) for x in (-4, -2, 2, 4) for y in (-4, -2, 2, 4)])[:n]
        self.poses = np.column_stack([places + rng.uniform(-0.3, 0.3, (n, 2)), rng.uniform(-4, 4, n)])
        self.slid, self.gap, self.shown = np.zeros(n, dtype=int), np.inf, n if shown is None else shown
        self.false = np.empty((0, 3)) if shown is not None else np.vstack([self.poses[:1] + (0.1, 0.0, 1.0), [0.1, 0.2, 0.3]])

    def look(self):
        unknown = self.slid < 3
        nameless = self.poses[np.argsort(self.poses[:, 0])]
        nameless = nameless[unknown[np.argsort(self.poses[:, 0])]][: self.shown]
        return Bodies(np.where(unknown[:, None], np.nan, self.poses), np.vstack([nameless, self.false]))

    def drive(self, group, length):
        motion = np.array([group]), np.array([length])
        self.gap = min(self.gap, clearance(self.swarm, BOX, self.poses, *motion).gap)
        self.poses = replay(self.swarm, self.poses, *motion)[-1]
        self.slid += self.swarm.membership[group - 1]


@pytest.mark.parametrize("seed", range(10))
def test_everybody_is_known_and_nobody_touches(seed):
    bench = Bench(seed, 14)
    activations = recognise(bench.swarm, BOX, bench.look, bench.drive)
    assert (bench.slid >= 3).all()
    assert bench.gap > 0.05
    assert activations <= 1 + 2 * 4 * (bench.swarm.m - 1)  # a slide and a turn, four times each group at most
    assert recognise(bench.swarm, BOX, bench.look, bench.drive) == 0


def test_robots_that_are_not_seen_are_not_driven():
    bench = Bench(0, 6, shown=5)
    with pytest.raises(StressbotError) as refusal:
        recognise(bench.swarm, BOX, bench.look, bench.drive)
    assert refusal.value.code is ErrorCode.NO_SWARM and "5 of 6 robots" in str(refusal.value)
    assert not bench.slid.any()


def test_robots_that_never_slide_are_named():
    bench = Bench(0, 6)

    def look():
        never = np.isin(np.arange(6), [2, 5])
        return Bodies(np.where(never[:, None], np.nan, bench.poses), bench.poses[never])

    with pytest.raises(StressbotError) as refusal:
        recognise(bench.swarm, BOX, look, bench.drive)
    assert refusal.value.code is ErrorCode.NO_SWARM and f"robots 3, 6 after {2 * MOST_ROUNDS} slides" in str(refusal.value)


def test_where_there_is_no_room_nothing_moves():
    swarm = Swarm(1.0, 0.5, 0.2, binary(3))
    shapes = Shapes.of(Environment(None, ()))
    poses = np.array([[0.0, 0.0, 0.0], [0.45, 0.0, 1.0], [0.2, 0.45, 2.0]])
    assert longest(swarm, shapes, poses) == 0.0
    with pytest.raises(StressbotError) as refusal:
        room(swarm, shapes, poses)
    assert refusal.value.code is ErrorCode.INFEASIBLE
