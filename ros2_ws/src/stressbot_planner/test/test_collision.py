"""The collision checker: against dense sampling, against brute force, and at its edges.

The sampled distances below are written from the definitions of disc, polygon and wall; they share nothing with the checker.
"""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, clearance, clearance_of, environment_clearances, is_clear, slide_is_clear
from stressbot_planner.model.allocation import SCHEMES, binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm, fastest

SQUARE = Polygon([(2, -1), (4, -1), (4, 1), (2, 1)])
HORSESHOE = Polygon([(-4, 2), (4, 2), (4, 6), (2, 6), (2, 3.5), (-2, 3.5), (-2, 6), (-4, 6)])
STAR = Polygon([(r * np.cos(k * np.pi / 5) - 4, r * np.sin(k * np.pi / 5) - 4) for k, r in enumerate([2.5, 1] * 5)])
OBSTACLES = (Circle((0, 0), 1.0), Circle((-6, 3), 0.5), SQUARE, HORSESHOE, STAR)
WALLS = Workspace(-11, 12, -10, 13)
SAMPLES = 400


def distance_to_polygon(points, vertices):
    """Return the signed distance of points (k, 2) from a filled polygon, negative inside."""
    nearest = np.full(len(points), np.inf)
    winding = np.zeros(len(points))
    for a, b in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        nearest = np.minimum(nearest, np.hypot(*(points - a - share[:, None] * (b - a)).T))
        u, v = a - points, b - points
        winding += np.arctan2(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], (u * v).sum(axis=1))
    return np.where(np.abs(winding) > np.pi, -nearest, nearest)


def gaps_at(swarm, environment, positions):
    """Return every gap by name at positions (k, n, 2), each of shape (k,)."""
    body = swarm.body_radius
    gaps = {}
    for i, j in itertools.combinations(range(swarm.n), 2):
        gaps[f"robot {i + 1}", f"robot {j + 1}"] = np.hypot(*(positions[:, i] - positions[:, j]).T) - body[i] - body[j]
    for i in range(swarm.n):
        place = positions[:, i]
        for index, obstacle in enumerate(environment.obstacles):
            if isinstance(obstacle, Circle):
                gap = np.hypot(*(place - obstacle.center).T) - obstacle.radius
            else:
                gap = distance_to_polygon(place, obstacle.vertices)
            gaps[f"robot {i + 1}", f"obstacles[{index}]"] = gap - body[i]
        walls = environment.workspace
        if walls is not None:
            for name, gap in (
                ("x_min", place[:, 0] - walls.x_min), ("x_max", walls.x_max - place[:, 0]),
                ("y_min", place[:, 1] - walls.y_min), ("y_max", walls.y_max - place[:, 1]),
            ):
                gaps[f"robot {i + 1}", f"wall {name}"] = gap - body[i]
    return gaps


def sampled(swarm, environment, start, groups, lengths):
    """Return (smallest sampled gap, by how much a gap may fall between two samples)."""
    poses = replay(swarm, start, groups, lengths)
    share = np.linspace(0, 1, SAMPLES)[:, None, None]
    places = [poses[:1, :, :2]] + [a[None, :, :2] + share * (b - a)[None, :, :2] for a, b in itertools.pairwise(poses)]
    smallest = min((gap.min() for gap in gaps_at(swarm, environment, np.concatenate(places)).values()), default=np.inf)
    return smallest, (lengths.max() if len(lengths) else 0.0) / (SAMPLES - 1)


@st.composite
def motions(draw, obstacles=OBSTACLES, most=6, robots=5):
    """Return (swarm, environment, start, groups, lengths), anywhere: bodies may overlap from the start."""
    n = draw(st.integers(1, robots))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    words = SCHEMES[draw(st.sampled_from(sorted(SCHEMES)))](n)
    u, pace = fastest(rng.uniform(0.2, 1.5, n) if draw(st.booleans()) else np.ones(n))
    body = rng.uniform(0.05, 0.4, n)
    if draw(st.booleans()):
        body[rng.integers(n)] = 0.0
    swarm = Swarm(u, rng.uniform(0.5, 2.0, n), body, words, pace)
    chosen = draw(st.lists(st.sampled_from(obstacles), unique=True)) if obstacles else []
    environment = Environment(WALLS if draw(st.booleans()) else None, tuple(chosen))
    count = draw(st.integers(0, most))
    start = np.column_stack([rng.uniform(-8, 8, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
    lengths = rng.uniform(0, 5, count) * (rng.random(count) > 0.1)
    return swarm, environment, start, rng.integers(1, swarm.m + 1, count), lengths


def assert_agrees_with_samples(motion):
    found = clearance(*motion).gap
    smallest, step = sampled(*motion)
    if smallest == np.inf:
        assert found == np.inf
    elif smallest < 0:  # how deep bodies overlap is not defined beyond the sign
        assert found <= (-1e-9 if smallest < -1e-3 else 1e-12)
    else:
        # never above a sampled gap, and below it by no more than two bodies can approach between samples
        assert found <= smallest + 1e-12
        assert found >= smallest - 2 * step - 1e-12


@given(motions())
def test_gap_equals_the_sampled_minimum_within_the_sampling_error(motion):
    assert_agrees_with_samples(motion)


@given(motions(obstacles=(Circle((0, 0), 1.0), Circle((-6, 3), 0.5))))
def test_gap_to_discs_and_walls(motion):
    assert_agrees_with_samples(motion)


@given(motions(obstacles=(SQUARE, HORSESHOE, STAR), robots=2))
def test_gap_to_convex_and_concave_polygons(motion):
    assert_agrees_with_samples(motion)


@given(motions())
def test_the_place_of_the_smallest_gap_is_right(motion):
    swarm, environment, start, groups, lengths = motion
    found = clearance(*motion)
    if not np.isfinite(found.gap) or found.gap <= 0:
        return
    poses = replay(swarm, start, groups, lengths)
    if found.activation < 0:
        place = poses[0, :, :2]
    else:
        assert 0 <= found.length <= lengths[found.activation]
        share = found.length / lengths[found.activation]
        place = poses[found.activation, :, :2] * (1 - share) + poses[found.activation + 1, :, :2] * share
    gaps = gaps_at(swarm, environment, place[None])
    names = [pair for pair in gaps if set(pair) == {f"robot {found.robot}", found.other}]
    assert len(names) == 1
    assert gaps[names[0]][0] == pytest.approx(found.gap, abs=1e-9)


def brute_force(swarm, start, groups, lengths):
    """Return the smallest robot-robot gap: every pair, every activation, the vertex of a parabola."""
    poses = replay(swarm, start, groups, lengths)
    smallest = np.inf
    for i, j in itertools.combinations(range(swarm.n), 2):
        offset = poses[:, i, :2] - poses[:, j, :2]
        change = np.diff(offset, axis=0)
        square = (change**2).sum(axis=1)
        share = np.clip(-(offset[:-1] * change).sum(axis=1) / np.where(square > 0, square, 1), 0, 1)
        nearest = np.hypot(*(offset[:-1] + share[:, None] * change).T)
        body = swarm.body_radius[i] + swarm.body_radius[j]
        smallest = min(smallest, np.hypot(*offset[0]) - body, *(nearest - body))
    return smallest


@pytest.mark.parametrize("n", [2, 5, 14, 40])
@pytest.mark.parametrize("seed", range(4))
def test_pairs_that_are_left_alone_change_nothing(n, seed):
    rng = np.random.default_rng(seed)
    swarm = Swarm(1.0, rng.choice([0.001, 1.0]), rng.uniform(0.01, 0.2, n), binary(n))
    start = np.column_stack([rng.uniform(-20, 20, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
    groups, lengths = rng.integers(1, swarm.m + 1, 60), rng.exponential(0.5, 60)
    assert clearance(swarm, Environment(), start, groups, lengths).gap == pytest.approx(
        brute_force(swarm, start, groups, lengths), abs=1e-9
    )


@pytest.mark.parametrize(("first", "away"), [(5.2, 1.5), (9.4, 1.5), (9.4, 0.0)])
def test_a_pair_that_meets_head_on_between_two_looks_is_seen(first, away):
    # robots 1 and 2 go apart, come close at twice the speed of one, and part again; 3 and 4 keep a gap of 5
    swarm = Swarm(1.0, 0.01, 0.3, ("110", "101", "010", "011"))
    start = np.array([[0, 0, np.pi], [first + 0.6, 0, 0], [0, 100, 0], [5.6, 100, 0]])
    back = away + (first - 4.8) / 2
    slides = [*[0.1] * round(away / 0.1), None, *[0.1] * round(back / 0.1), None, *[0.1] * 30]
    groups = [1 if length else swarm.m for length in slides]
    lengths = np.array([length or np.pi * 0.01 for length in slides])
    assert clearance(swarm, Environment(), start, groups, lengths).gap == pytest.approx(4.8)


@given(motions(), st.floats(-0.5, 3))
def test_is_clear_says_whether_the_gap_is_at_least_that(motion, wanted):
    swarm, environment, start, groups, lengths = motion
    gap = clearance(*motion).gap
    if abs(gap - wanted) < 1e-9:
        return
    shapes = Shapes.of(environment)
    assert is_clear(swarm, shapes, replay(swarm, start, groups, lengths), groups, lengths, wanted) == (gap >= wanted)


@given(motions(most=1), st.floats(0, 3))
def test_a_single_slide_is_clear_if_its_motion_is(motion, wanted):
    swarm, environment, start, groups, lengths = motion
    at_start = clearance(swarm, environment, start, groups[:0], lengths[:0]).gap
    for group, length in zip(groups, lengths, strict=True):
        slides = swarm.slides[group - 1]
        arguments = (start, slides, length, swarm.body_radius, *Shapes.of(environment).kernel_arguments)
        gap = clearance(swarm, environment, start, groups, lengths).gap
        if at_start >= wanted:
            assert abs(gap - wanted) < 1e-12 or slide_is_clear(*arguments, wanted, 1e-12) == (gap >= wanted)
        elif gap >= at_start:  # nobody comes closer than the closest ones are
            assert slide_is_clear(*arguments, at_start, 1e-12)


def test_bodies_that_are_close_may_slide_apart_but_not_together():
    swarm = Swarm(1.0, 1.0, 0.3, ("10", "01"))
    shapes = Shapes.of(Environment())
    for heading, clear in ((np.pi, True), (np.pi / 2, True), (0.0, False)):
        poses = np.array([[0, 0, heading], [0.61, 0, 0]])
        assert slide_is_clear(poses, swarm.membership[0], 1.0, swarm.body_radius, *shapes.kernel_arguments, 0.1, 1e-6) == clear


@given(motions(), st.integers(0, 6))
def test_the_smallest_gap_of_a_motion_is_the_smaller_one_of_its_parts(motion, cut):
    swarm, environment, start, groups, lengths = motion
    cut = min(cut, len(groups))
    middle = replay(swarm, start, groups[:cut], lengths[:cut])[-1]
    parts = [
        clearance(swarm, environment, start, groups[:cut], lengths[:cut]).gap,
        clearance(swarm, environment, middle, groups[cut:], lengths[cut:]).gap,
    ]
    whole = clearance(*motion).gap
    if whole > 0 or not environment.obstacles:
        assert whole == pytest.approx(min(parts), abs=1e-9)
    else:
        assert min(parts) <= 1e-9


@pytest.mark.parametrize("gap", [1e-9, 0.0, -1e-9])
def test_a_pass_at_a_hair_is_told_from_a_touch(gap):
    swarm = Swarm(1.0, 1.0, 0.3, ("1",))
    environment = Environment(None, (Circle((5, 0.3 + 1.0 + gap), 1.0),))
    found = clearance(swarm, environment, np.zeros((1, 3)), [1], [10.0])
    assert found.gap == pytest.approx(gap, abs=1e-15)
    assert (found.activation, found.length, found.robot, found.other) == (0, 5.0, 1, "obstacles[0]")


def test_a_thin_obstacle_between_two_clear_ends_is_seen():
    swarm = Swarm(1.0, 1.0, 0.01, ("1",))
    sliver = Polygon([(5, -1), (5 + 1e-9, -1), (5, 1)])
    assert clearance(swarm, Environment(None, (sliver,)), np.zeros((1, 3)), [1], [10.0]).gap < 0


def test_a_body_inside_a_polygon_overlaps_it():
    swarm = Swarm(1.0, 1.0, 0.1, ("1",))
    big = Polygon([(-50, -50), (50, -50), (50, 50), (-50, 50)])
    assert clearance(swarm, Environment(None, (big,)), np.zeros((1, 3)), [1], [1.0]).gap < 0


def test_sliding_along_the_edge_of_a_polygon():
    swarm = Swarm(1.0, 1.0, 0.25, ("1",))
    start = np.array([[0.0, 1.5, 0.0]])
    assert clearance(swarm, Environment(None, (SQUARE,)), start, [1], [8.0]).gap == pytest.approx(0.25)


def test_the_way_round_of_a_polygon_does_not_matter():
    swarm = Swarm(1.0, 1.0, 0.1, ("1",))
    start = np.array([[-9.0, 5.0, -0.1]])
    there = clearance(swarm, Environment(None, (HORSESHOE,)), start, [1], [6.0]).gap
    back = clearance(swarm, Environment(None, (Polygon(HORSESHOE.vertices[::-1]),)), start, [1], [6.0]).gap
    assert there == pytest.approx(back, abs=1e-12)


def test_nothing_to_hit():
    swarm = Swarm(1.0, 1.0, 0.3, ("1",))
    found = clearance(swarm, Environment(), np.zeros((1, 3)), [1], [1.0])
    assert found.gap == np.inf
    assert str(found) == "nothing to hit"
    assert environment_clearances(swarm, Environment(), np.zeros((1, 2)))[0].gap == np.inf


def test_clearance_at_the_start_names_both_bodies():
    swarm = Swarm(1.0, 1.0, 0.3, ("01", "10"))
    found = clearance(swarm, Environment(), np.array([[0, 0, 0], [1, 0, 0]]), [], [])
    assert (found.gap, found.activation, found.robot, found.other) == (pytest.approx(0.4), -1, 2, "robot 1")
    assert str(found) == "0.4 units between robot 2 and robot 1 at the start"


def test_large_swarms_take_seconds():
    n = 1022
    rng = np.random.default_rng(1)
    swarm = Swarm(1.0, 1.0, 0.05, binary(n))
    x, y = np.meshgrid(np.arange(32.0), np.arange(32.0))
    start = np.column_stack([x.ravel()[:n] * 3, y.ravel()[:n] * 3, rng.uniform(-np.pi, np.pi, n)])
    groups, lengths = rng.integers(1, swarm.m + 1, 100), rng.exponential(0.2, 100)
    poses = replay(swarm, start, groups, lengths)
    found = clearance_of(swarm, Shapes.of(Environment()), poses, groups, lengths)
    nearest = min(np.hypot(*(start[:, :2] - start[k, :2]).T)[np.arange(n) != k].min() for k in range(0, n, 50))
    assert found.gap <= nearest - 0.1
