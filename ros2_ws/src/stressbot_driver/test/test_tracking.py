"""Robots followed through pictures, and told apart by how they move. No ROS, no substrate: plain kinematics."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_driver.vision.activations import Activations
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.filters import wrapped
from stressbot_driver.vision.identities import Identities, reversed_poses
from stressbot_driver.vision.latency import LatencyMeter
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.stage import StageFilter
from stressbot_driver.vision.tracking import Robots, Seen, SwarmTracker

PIXEL = 2e-6
LENGTH = 12.0
"""Pixels."""
SPEED, RATE = 1e-4, 2.0
"""m/s, rad/s."""
RADIUS = 0.5 * np.hypot(1.0, 0.5) * LENGTH * PIXEL
PERIOD = 1.0 / 15.0
SELECTION = 0.1
MIDDLE = np.zeros((12, 2))
DRIFT = {"drift_x": 5e-7, "drift_y": -3e-7, "drift_turn": 1e-4, "wander": 3e-7}


class Bench:
    """Robots that slide and turn, in front of a microscope and a tracker."""

    def __init__(self, seed: int, count: int = 6, side: int = 200, known: bool = True, dust: int = 2, **optics) -> None:
        self.random = np.random.default_rng(seed)
        self.camera = Camera(side, side, PIXEL)
        places = np.empty((0, 2))
        while len(places) < count:
            point = self.random.uniform(-0.32, 0.32, 2) * side * PIXEL
            if not len(places) or np.hypot(*(places - point).T).min() > 3.0 * LENGTH * PIXEL:
                places = np.vstack([places, point])
        self.poses = np.column_stack([places, self.random.uniform(-np.pi, np.pi, count)])
        bits = int(np.ceil(np.log2(count + 2)))
        self.membership = np.array([[bool(k >> bit & 1) for bit in range(bits)] for k in range(1, count + 1)])
        self.ids = np.arange(11, 11 + count)
        self.outlines = [Outline(LENGTH * PIXEL, 0.5 * LENGTH * PIXEL, (1e-6, 0.0))] * count
        self.microscope = Microscope(self.camera, self.outlines, Optics(dust=dust, **optics), seed)
        self.follow(known)
        self.time = self.ended = 0.0
        self.notes: list[str] = []
        self.covered = False
        self.late: deque[np.ndarray] = deque(maxlen=1)  # what pictures show: the oldest
        self.meter = LatencyMeter()
        self.still = np.empty(0, dtype=int)
        self.lost = 0.0
        self.seen: Seen | None = None
        self.shown: list[tuple[np.ndarray, np.ndarray]] = []  # ids, and their errors

    def follow(self, known: bool = True) -> None:
        """Begin with a new tracker, which takes the poses of now for starts if they are known."""
        count, start = len(self.poses), self.poses.copy() if known else None
        robots = Robots(self.ids, np.full(count, SPEED), np.full(count, RATE), self.membership, start)
        self.tracker = SwarmTracker(robots, self.camera, self.outlines)

    def look(self, at: float) -> None:
        """A picture after one more period."""
        self.time += PERIOD
        self.late.append(self.poses.copy())
        picture = self.microscope.picture(self.late[0], self.time)
        if self.random.random() < self.lost:
            return
        if self.covered:
            picture = np.full_like(picture, 30)
        seen = self.tracker.look(picture, self.time, at)
        self.meter.look(self.time, seen.moved)
        rows = seen.ids - self.ids[0]
        off = seen.poses - self.late[0][rows]
        self.shown.append((seen.ids, np.column_stack([off[:, :2] / RADIUS, wrapped(off[:, 2])])))
        self.notes += seen.notes
        self.seen = seen

    def rest(self, pictures: int) -> None:
        for _ in range(pictures):
            self.look(self.ended)

    def activate(self, group: int, seconds: float) -> None:
        """Select a group, counted from 1, and drive, with small errors; then rest for some pictures."""
        self.tracker.play(Activations(np.array([group]), np.array([SELECTION]), np.array([SELECTION + seconds])))
        slides = self.membership[:, group - 1] if group <= self.membership.shape[1] else np.zeros(len(self.poses), dtype=bool)
        self.meter.drive(self.time + np.array([SELECTION]), self.time + np.array([SELECTION + seconds]))
        moves = ~np.isin(np.arange(len(self.poses)), self.still)
        self.poses[:, 2] += moves * self.random.normal(0.0, np.radians(2.0), len(self.poses))
        at = 0.0
        while at < SELECTION + seconds:
            before, at = at, at + PERIOD
            driven = max(0.0, min(at, SELECTION + seconds) - max(before, SELECTION))
            along = np.where(slides & moves, 1.03 * SPEED * driven, 0.0)
            self.poses[:, 0] += along * np.cos(self.poses[:, 2])
            self.poses[:, 1] += along * np.sin(self.poses[:, 2])
            self.poses[:, 2] += np.where(slides | ~moves, 0.0, 0.97 * RATE * driven)
            self.look(at)
        self.ended = SELECTION + seconds
        self.rest(2)

    def roam(self, groups: list[int], seconds: float = 0.4) -> None:
        """Groups slide and come back, so that nobody leaves the picture."""
        for group in groups:
            for _ in range(2):
                self.activate(group, seconds)
                self.activate(self.membership.shape[1] + 1, np.pi / RATE)

    def exchange(self, robots: list[int], turned: bool = False, beside: float = 0.0) -> None:
        """Set robots down in each other's places, one further each; with the headings that they find there, unless turned."""
        places = self.poses[np.roll(robots, -1)]
        self.poses[robots, :2] = places[:, :2] + self.random.normal(0.0, 1.0, (len(robots), 2)) * beside * LENGTH * PIXEL
        self.poses[robots, 2] = places[:, 2] + turned * self.random.uniform(0.6, 2.4, len(robots))

    def gap(self, kind: str) -> None:
        """Let the camera see nothing for a while."""
        if kind == "lost":
            self.time += 1.5
        if kind == "covered":
            self.covered = True
            self.rest(17)
            self.covered = False

    def swapped_since(self, first: int) -> int:
        """Poses under a wrong id since some picture: beside where that robot was by more than a body's radius."""
        return sum(int(np.sum(np.hypot(*off[:, :2].T) > 1.0)) for _, off in self.shown[first:])

    @property
    def swapped(self) -> int:
        return self.swapped_since(0)


@pytest.mark.parametrize("seed", range(5))
def test_robots_are_followed_while_they_slide_and_turn_and_pictures_are_lost(seed):
    bench = Bench(seed)
    bench.lost = 0.05
    bench.rest(3)
    bench.roam([1, 2, 3])
    assert bench.swapped == 0
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    off = np.concatenate([off for _, off in bench.shown])
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 0.06
    assert np.degrees(np.sqrt(np.mean(off[:, 2] ** 2))) < 2.5


@pytest.mark.parametrize("seed", range(5))
def test_stamps_that_are_a_little_late_cost_no_name(seed):
    bench = Bench(seed)
    bench.late = deque(maxlen=2)
    bench.rest(5)
    bench.roam([1, 2, 3])
    bench.rest(15)
    assert bench.swapped == 0
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    _, off = bench.shown[-1]
    assert np.hypot(*off[:, :2].T).max() < 0.15


@pytest.mark.parametrize(("seed", "pictures"), [(0, 0), (1, 1), (2, 2), (3, 2)])
def test_how_late_stamps_are_is_measured_even_if_it_costs_names(seed, pictures):
    bench = Bench(seed)
    bench.late = deque(maxlen=pictures + 1)
    bench.rest(5)
    bench.roam([1, 2, 3])
    found = bench.meter.latency()
    assert abs(found.seconds - pictures * PERIOD) < 0.01
    assert (len(bench.seen.ids) < 6) == (pictures == 2)


@pytest.mark.parametrize("seed", range(5))
def test_robots_that_may_be_anywhere_are_known_by_how_they_move(seed):
    bench = Bench(seed, known=False)
    bench.rest(3)
    assert len(bench.seen.ids) == 0
    assert len(bench.seen.nameless) >= 6
    begin = bench.time
    bench.roam([1, 2, 3], 0.3)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    assert bench.swapped == 0
    assert bench.time - begin < 60.0


@pytest.mark.parametrize("seed", range(3))
def test_a_stage_that_drifts_and_turns_is_followed(seed):
    bench = Bench(seed, **DRIFT)
    bench.rest(10)
    bench.roam([1, 2, 3])
    assert bench.swapped == 0
    off = np.concatenate([off for _, off in bench.shown[-10:]])
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 0.08
    assert np.hypot(*bench.microscope.stage(bench.time)[:2]) > 0.1 * RADIUS  # it was no small matter


def test_robots_that_were_covered_come_back_as_themselves():
    bench = Bench(0)
    bench.rest(3)
    bench.covered = True
    bench.rest(20)
    assert len(bench.seen.ids) == 0
    assert bench.tracker.missing == bench.ids.tolist()
    bench.covered = False
    bench.rest(20)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    assert bench.swapped == 0


def test_after_a_drive_that_nobody_saw_robots_are_found_again_and_nobody_is_swapped():
    bench = Bench(1)
    bench.rest(3)
    bench.covered = True
    bench.activate(1, 0.8)
    bench.activate(2, 0.8)
    bench.covered = False
    bench.rest(40)
    bench.roam([1, 2, 3], 0.2)
    bench.rest(20)
    assert bench.swapped == 0
    assert len(bench.seen.ids) >= 4


def test_a_thing_that_looks_like_a_robot_gets_no_id():
    bench = Bench(3, count=7)
    robots = Robots(bench.ids[:6], np.full(6, SPEED), np.full(6, RATE), bench.membership[:6], None)
    bench.tracker = SwarmTracker(robots, bench.camera, bench.outlines[:6])
    bench.rest(3)
    bench.still = np.array([6])
    bench.roam([1, 2, 3], 0.3)
    bench.rest(20)
    assert bench.seen.ids.tolist() == bench.ids[:6].tolist()
    assert bench.swapped == 0


@pytest.mark.parametrize("kind", ["none", "lost", "covered"])
@pytest.mark.parametrize(("seed", "robots"), [(0, [0, 1]), (1, [5, 2]), (2, [3, 1, 4]), (3, [2, 5, 0])])
def test_a_perfect_exchange_is_known_after_the_first_activation_that_tells_robots_apart(seed, robots, kind):
    bench = Bench(seed, **(DRIFT if seed % 2 else {}))
    bench.rest(3)
    bench.exchange(robots)
    bench.gap(kind)
    bench.rest(3)
    known_since = None
    for group in (1, 2, 3):
        bench.activate(group, 0.35)
        if known_since is None and len(set(bench.membership[robots, group - 1].tolist())) > 1:
            known_since = len(bench.shown) - 2
    assert known_since is not None and bench.swapped_since(known_since) == 0


@pytest.mark.parametrize("kind", ["none", "lost", "covered"])
@pytest.mark.parametrize(("seed", "robots"), [(4, [0, 1]), (5, [5, 2]), (6, [3, 1, 4]), (7, [0, 1, 2, 3, 4, 5])])
def test_robots_that_lie_otherwise_in_each_others_places_have_no_names(seed, robots, kind):
    bench = Bench(seed, **(DRIFT if seed % 2 else {}))
    bench.rest(3)
    bench.exchange(robots, turned=True)
    bench.gap(kind)
    bench.rest(12)
    assert not set(bench.seen.ids.tolist()) & set(bench.ids[robots].tolist())
    told = len(bench.shown) - 1
    assert bench.swapped_since(told - 4) == 0  # half a second after it
    for group in (1, 2, 3):
        bench.activate(group, 0.35)
    assert bench.swapped_since(told) == 0


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_that_touch_are_not_taken_for_each_other_after_an_exchange(seed):
    bench = Bench(seed)
    beside = bench.poses[0, 2] + 0.5 * np.pi
    bench.poses[1, :2] = bench.poses[0, :2] + 1.13 * LENGTH * PIXEL * np.array([np.cos(beside), np.sin(beside)])
    bench.poses[1, 2] = bench.poses[0, 2] + 0.3
    bench.follow()
    bench.rest(3)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    bench.exchange([0, 1])
    bench.rest(3)
    bench.activate(1, 0.35)  # robot 11 slides, 12 turns
    told = len(bench.shown) - 2
    bench.activate(2, 0.35)
    assert bench.swapped_since(told) == 0


def test_names_that_an_exchange_took_away_are_earned_again():
    bench = Bench(2)
    bench.rest(3)
    bench.exchange([1, 3, 4])
    bench.roam([1, 2, 3], 0.3)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    assert bench.swapped_since(len(bench.shown) - 10) == 0


def test_robots_exchanged_under_a_hand_at_their_starts_are_not_taken_for_those_that_start_there():
    bench = Bench(0)
    bench.rest(3)
    bench.exchange([0, 1, 2, 3], beside=0.25)
    bench.gap("covered")
    bench.rest(15)
    assert bench.swapped == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_stage_that_moved_before_is_noticed(seed):
    bench = Bench(seed)
    bench.poses[:, :2] += 0.2 * LENGTH * PIXEL * np.array([np.cos(seed), np.sin(seed)])
    bench.rest(2)
    assert bench.tracker.displaced == pytest.approx(0.2 * LENGTH * PIXEL, rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_robots_that_a_hand_sets_down_beside_their_starts_are_no_stage_that_moved(seed):
    bench = Bench(seed)
    bench.poses[:, :2] += bench.random.normal(0.0, 0.12 * LENGTH * PIXEL, (6, 2))
    bench.rest(2)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    assert bench.tracker.displaced == 0.0


def test_a_reset_is_noticed():
    bench = Bench(4)
    start = bench.poses.copy()
    bench.rest(3)
    bench.roam([2])
    bench.activate(2, 1.0)
    bench.poses = start
    bench.tracker.reset()
    bench.rest(40)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    assert np.hypot(*bench.shown[-1][1][:, :2].T).max() < 0.3


@pytest.mark.parametrize("turns", [0.9, 1.0, 1.1])
@pytest.mark.parametrize("seed", range(3))
def test_a_reset_is_noticed_however_few_it_moves(seed, turns):
    bench = Bench(seed, count=5, side=300)
    start = bench.poses.copy()
    bench.rest(3)
    bench.activate(3, turns * 2 * np.pi / RATE)  # two slide, the others turn back to where they were
    bench.poses = start
    bench.tracker.reset()
    bench.rest(40)
    assert bench.seen.ids.tolist() == bench.ids.tolist()
    assert np.hypot(*bench.shown[-1][1][:, :2].T).max() < 0.3


def test_activations_are_read_from_levels_and_trains():
    levels = np.array([90.0, 0.0, 40.0, 0.0, 60.0, 0.0, 140.0, 0.0, 90.0, 0.0, 60.0, 0.0, 60.0, 0.0, -140.0, 0.0])
    dwells = np.array([0.01, 0.005] * 3 + [0.5, 0.005] + [0.01, 0.005] * 3 + [0.25, 0.005])
    trains = np.zeros(16, dtype=bool)
    trains[14] = True
    codes = np.array([[0, 0], [0, 1], [1, 0]])
    read = Activations.of(levels, dwells, np.array([8, 16]), trains, np.array([40.0, 60.0]), 140.0, codes)
    assert read.groups.tolist() == [2, 0]  # the second code is that of nobody
    np.testing.assert_allclose(read.ends - read.begins, [0.5, 0.25])
    assert read.between(0.0, 0.1) == [(2, pytest.approx(0.055), True)]
    assert read.between(0.1, 10.0) == [(2, pytest.approx(0.445), False), (0, pytest.approx(0.25), True)]
    assert read.driving(0.1) and not read.driving(0.0)
    assert [read.done(time) for time in (0.0, 0.55, 10.0)] == [0, 1, 2]


def test_activations_are_read_where_levels_select_groups():
    levels = np.array([0.0, 140.0, 140.0, 0.0, 0.0, 154.0, 140.0, 0.0])
    trains = np.array([False, False, True, False] * 2)
    control, codes = np.array([140.0, 154.0, 170.0]), np.array([[0], [1], [2]])
    read = Activations.of(levels, np.full(8, 0.01), np.array([4, 8]), trains, control, 140.0, codes)
    assert read.groups.tolist() == [1, 2]
    np.testing.assert_allclose(read.begins, [0.02, 0.06])


@pytest.mark.parametrize("seed", range(5))
def test_the_stage_is_known_from_robots_that_stand(seed):
    random = np.random.default_rng(seed)
    stage = StageFilter((1e-3, 2e-3), 1e-6, 5e-4)
    places = np.array([1e-3, 2e-3]) + random.uniform(-4e-4, 4e-4, (8, 2))
    speed = random.normal(0.0, (5e-7, 5e-7, 2e-4))
    for step in range(1, 200):
        x, y, turn = speed * step / 30.0
        cos, sin = np.cos(turn), np.sin(turn)
        seen = (places - (1e-3, 2e-3)) @ np.array([[cos, sin], [-sin, cos]]) + (1e-3 + x, 2e-3 + y)
        stage.predict(1.0 / 30.0)
        stage.update(places, seen + random.normal(0.0, 1e-7, seen.shape), np.tile(1e-14 * np.eye(2), (8, 1, 1)))
    assert np.hypot(stage.offset[0] - x, stage.offset[1] - y) < 1e-7
    assert abs(stage.offset[2] - turn) < 4e-4
    poses = random.uniform(-1e-3, 1e-3, (5, 3))
    np.testing.assert_allclose(stage.to_substrate(stage.to_picture(poses)), poses, atol=1e-12)


def test_nobody_is_known_by_a_motion_that_two_share():
    identities = Identities(np.array([[True, False], [True, True]]), np.full(2, SPEED), np.full(2, RATE))
    identities.add(2)
    before = np.zeros((2, 3))
    after = np.array([[3e-5, 0.0, 0.0], [3e-5, 0.0, 0.0]])
    for _ in range(5):
        identities.learn(np.arange(2), before, after, MIDDLE[:2], 1, 0.3, 1e-6)
    assert identities.known(np.arange(2), np.full(2, -1)).tolist() == [-1, -1]
    after[0] = (0.0, 0.0, 0.6)
    for _ in range(2):
        identities.learn(np.arange(2), before, after, MIDDLE[:2], 2, 0.3, 1e-6)
    assert identities.known(np.arange(2), np.full(2, -1)).tolist() == [0, 1]


def test_a_robot_whose_arm_is_stuck_keeps_its_id():
    membership = np.array([[True, False], [False, True], [True, True]])
    identities = Identities(membership, np.full(3, SPEED), np.full(3, RATE))
    identities.add(3)
    for robot in range(3):
        identities.start(robot, robot)
    before, known = np.zeros((3, 3)), np.arange(3)
    for _ in range(20):
        for group in (1, 2):
            after = np.array([(3e-5, 0.0, 0.0) if slides else (0.0, 0.0, 0.6) for slides in membership[:, group - 1]])
            after[2] = (0.0, 0.0, 0.6)  # turns whatever is asked for
            identities.learn(np.arange(3), before, after, MIDDLE[:3], group, 0.3, 1e-6)
            known = identities.known(np.arange(3), known)
    assert known.tolist() == [0, 1, 2]


def moved(membership: np.ndarray, group: int, before: np.ndarray) -> np.ndarray:
    """Poses after robots with these codewords have done what they should for 0.3 s."""
    slides = membership[:, group - 1] * SPEED * 0.3
    turns = ~membership[:, group - 1] * RATE * 0.3
    return before + np.column_stack([slides * np.cos(before[:, 2]), slides * np.sin(before[:, 2]), turns])


@given(st.integers(2, 12), st.integers(0, 2**32 - 1), st.data())
def test_any_exchange_that_an_activation_shows_is_doubted_and_nothing_else(count, seed, data):
    random = np.random.default_rng(seed)
    membership = random.random((count, 4)) < 0.5
    identities = Identities(membership, np.full(count, SPEED), np.full(count, RATE))
    before = np.column_stack([random.uniform(-1e-3, 1e-3, (count, 2)), random.uniform(-np.pi, np.pi, count)])
    bodies, group = np.array(data.draw(st.permutations(range(count)))), data.draw(st.integers(1, 4))
    # two standard deviations at most: a body that turns and is seen four away from its place is nobody's
    after = moved(membership[bodies], group, before) + random.uniform(-1.0, 1.0, (count, 3)) * (1e-6, 1e-6, 0.06)
    failed, exchanged = identities.compare(np.arange(count), before, after, MIDDLE[:count], group, 0.3, 1e-6, 0.0)
    wrong = membership[bodies, group - 1] != membership[:, group - 1]
    assert failed.tolist() == wrong.tolist()
    assert exchanged.tolist() == [bool(wrong.any())] * count


@given(st.integers(3, 12), st.integers(0, 2**32 - 1), st.booleans())
def test_one_that_fails_is_doubted_only_if_another_one_is_not_seen(count, seed, covered):
    random = np.random.default_rng(seed)
    membership = random.random((count, 1)) < 0.5
    membership[:2, 0] = True, False
    identities = Identities(membership, np.full(count, SPEED), np.full(count, RATE))
    before = np.column_stack([random.uniform(-1e-3, 1e-3, (count, 2)), random.uniform(-np.pi, np.pi, count)])
    stuck = membership.copy()
    stuck[0] = False
    seen = np.delete(np.arange(count), 1) if covered else np.arange(count)
    after = moved(stuck, 1, before)
    failed, exchanged = identities.compare(seen, before[seen], after[seen], MIDDLE[seen], 1, 0.3, 1e-6, 0.0)
    assert np.flatnonzero(failed).tolist() == [0]
    assert np.flatnonzero(exchanged).tolist() == ([0] if covered else [])


@pytest.mark.parametrize("group", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_who_slides_or_turns_tells_head_from_tail(seed, group):
    random = np.random.default_rng(seed)
    membership, middle = np.array([[True], [False]]), np.tile([-3e-6, 0.0], (2, 1))
    identities = Identities(membership, np.full(2, SPEED), np.full(2, RATE))
    identities.add(2)
    before = np.column_stack([random.uniform(-1e-3, 1e-3, (2, 2)), random.uniform(-np.pi, np.pi, 2)])
    after = moved(np.column_stack([membership, [False, False]]), group, before)
    told = identities.learn(np.arange(2), before, after, middle, group, 0.3, 5e-7)
    assert told.tolist() == [False, False] and (identities.score.max(axis=1) > 2.0).all()
    reversed_ = [reversed_poses(poses, middle) for poses in (before, after)]
    assert identities.learn(np.arange(2), *reversed_, middle, group, 0.3, 5e-7).tolist() == [True, True]
    assert (identities.score.max(axis=1) > 4.0).all()
    back = reversed_poses(reversed_[0], middle) - before
    np.testing.assert_allclose(back, np.tile([0.0, 0.0, 2 * np.pi], (2, 1)), atol=1e-12)
