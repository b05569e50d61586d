"""Motions made piece by piece, and ways of one disc: what crowded swarms are moved by."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, clearance
from stressbot_planner.collision.shortest_paths import DiscPaths
from stressbot_planner.formats import scenario
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.kinematics import path_length, replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.motion import Motion, World
from stressbot_planner.primitives.expansion import Subgroup, expand
from stressbot_planner.primitives.subgroups import subgroups
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances


def spread(n: int, rng: np.random.Generator, spacing=50.0) -> Problem:
    """Robots so far apart that none can reach another."""
    starts = np.column_stack([spacing * np.arange(n), np.zeros(n), rng.uniform(-np.pi, np.pi, n)])
    return Problem(Swarm(1.0, 1.3, 0.3, binary(n)), Environment(), starts, starts[:, :2])


def assert_is_what_it_says(motion: Motion, start: np.ndarray) -> None:
    swarm, environment = motion.world.problem.swarm, motion.world.problem.environment
    groups, lengths = expand(swarm, motion.primitives)
    poses = replay(swarm, start, groups, lengths)[-1]
    np.testing.assert_allclose(motion.poses[:, :2], poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * motion.poses[:, 2]), np.exp(1j * poses[:, 2]), atol=1e-9)
    assert motion.path == pytest.approx(path_length(swarm, groups, lengths))
    assert motion.activations == len(groups)
    assert clearance(swarm, environment, start, groups, lengths).gap >= 0


@given(st.sampled_from([6, 14, 30]), st.integers(0, 2**32 - 1))
def test_halving_moves_a_subgroup_of_any_order_and_nobody_else(n, seed):
    rng = np.random.default_rng(seed)
    problem = spread(n, rng)
    order = int(rng.integers(1, problem.swarm.m))
    choice = subgroups(problem.swarm, order)
    subgroup = choice[int(rng.integers(len(choice)))]
    distance = float(rng.uniform(0.1, 3.0))
    for motion in Motion(World(problem), problem.starts).move(subgroup, distance, rng):
        heading = problem.starts[:, 2]
        moved = np.isin(np.arange(1, n + 1), subgroup.robots)[:, None]
        wanted = distance * np.column_stack([np.cos(heading), np.sin(heading)]) * moved
        np.testing.assert_allclose(motion.poses[:, :2] - problem.starts[:, :2], wanted, atol=1e-9)
        assert_is_what_it_says(motion, problem.starts)


def test_a_gray_code_takes_one_half_turn_a_pulse():
    problem = spread(30, np.random.default_rng(0))
    factors = [(2, True), (3, False), (4, True), (5, True)]
    motion = Motion(World(problem), problem.starts)
    assert motion.halve(1, factors, 1.0)
    nested = Subgroup(1, 1.0, inside=(2, 4, 5), outside=(3,))
    turns = [primitive for primitive in motion.primitives if type(primitive).__name__ == "Turn"]
    assert len(turns) == 2 ** len(factors)
    assert motion.path < 0.6 * path_length(problem.swarm, *expand(problem.swarm, [nested]))


def test_swings_are_aimed_past_what_is_in_the_way():
    """Robot 1 looks at a disc; it can swing out another way, or in parts if there are discs all around."""
    swarm = Swarm(1.0, 1.0, 0.3, ("10", "01"))
    starts = np.array([[0.0, 0, 0], [50, 0, 0]])
    for discs, parts in (((0.0,), 1), (np.arange(0, 6, 0.4), 2)):
        circles = tuple(Circle((1.5 * np.cos(angle), 1.5 * np.sin(angle)), 0.3) for angle in discs)
        problem = Problem(swarm, Environment(None, circles), starts, starts[:, :2])
        motion = Motion(World(problem), starts)
        assert motion.turn(1, np.pi)
        assert_is_what_it_says(motion, starts)
        assert np.cos(motion.poses[1, 2]) == pytest.approx(-1)
        turn = next(primitive for primitive in motion.primitives if type(primitive).__name__ == "Turn")
        assert np.ceil(np.pi / 2 / turn.excursion - 1e-9) == (parts if parts > 1 else 0)


def test_a_robot_that_is_locked_in_cannot_swing():
    swarm = Swarm(1.0, 1.0, 0.3, ("10", "01"))
    starts = np.array([[0.0, 0, 0], [50, 0, 0]])
    ring = tuple(Circle((np.cos(angle), np.sin(angle)), 0.69) for angle in np.arange(0, 6, 0.4))
    assert not Motion(World(Problem(swarm, Environment(None, ring), starts, starts[:, :2])), starts).turn(1, np.pi)


OBSTACLES = Environment(Workspace(0, 20, 0, 20), (Circle((8, 6), 1.5), Polygon([(11, 8), (13, 8), (13, 19), (11, 19)])))


@given(st.integers(0, 2**32 - 1))
def test_ways_keep_their_margin_and_are_as_long_as_they_say(seed):
    rng = np.random.default_rng(seed)
    swarm = Swarm(1.0, 1.0, 0.3, ("1",))
    places = rng.uniform(0.5, 19.5, (2, 2))
    shapes = Shapes.of(OBSTACLES)
    paths = DiscPaths(places[1], 0.3, 0.15, 1e-9, *shapes.kernel_arguments)
    distance, _ = paths.ahead(places[0])
    way = paths.way(places[0])

    def gap(points):
        step = np.diff(points, axis=0)
        gaps = []
        for a, (dx, dy) in zip(points[:-1], step, strict=True):
            start = np.array([[*a, np.arctan2(dy, dx)]])
            gaps.append(clearance(swarm, OBSTACLES, start, np.array([1]), np.array([np.hypot(dx, dy)])).gap)
        return min(gaps)

    ends = min(gap(np.array([place, place])) for place in places)
    if way is None:
        assert ends <= 0.15 or distance == np.inf
        return
    assert gap(way) >= min(0.15, 0.99 * ends) - 1e-9
    assert np.hypot(*np.diff(way, axis=0).T).sum() == pytest.approx(distance)
    assert distance >= np.hypot(*(places[1] - places[0])) - 1e-9


def crowd(n: int, seed: int) -> Problem:
    """A random swarm among discs, walls, and the squares that some of the discs are replaced by."""
    loaded = scenario.parse(instances.random(n, True, seed), 1.5)
    environment = loaded.problem.environment
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    obstacles = tuple(Polygon(o.center + square) if k % 2 else o for k, o in enumerate(environment.obstacles))
    return Problem(loaded.swarm, Environment(environment.workspace, obstacles), loaded.problem.starts, loaded.problem.goals, 1.5)


@pytest.mark.parametrize(("planner", "n"), [("pure_control", 30), ("sequential", 14), ("parallel", 14)])
def test_large_swarms_among_discs_and_polygons(planner, n):
    result = solve(crowd(n, 0), planner, Settings(max_tries=2000))
    assert result.success, result.reason
    assert result.plan.clearance.gap > 0.01  # no closer than it need be


def test_robots_make_way():
    """Two robots that stand on each other's goals in a corridor with one recess."""
    recess = [Polygon([(-2, 1), (6, 1), (6, 2), (-2, 2)]), Polygon([(8, 1), (16, 1), (16, 2), (8, 2)])]
    environment = Environment(Workspace(-1, 15, -1, 4), tuple(recess))
    problem = Problem(
        Swarm(1.0, 0.5, 0.3, ("10", "01")), environment, [[2, 0, 0], [11, 0, 0]], [[11, 0], [2, 0]], tolerance=0.1
    )
    result = solve(problem, "pure_control", Settings(max_tries=200))
    assert result.success, result.reason
    assert result.details["moved_aside"] > 0


@pytest.mark.parametrize("seed", range(20))
def test_motions_of_mixed_swarms_move_a_subgroup_and_nobody_else(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    radii, paces = rng.choice([0.7, 1.0, 1.6], n), rng.choice([0.5, 1.0], n)
    paces[0] = 1.0
    swarm = Swarm(1.0, radii, 0.3, binary(n), paces)
    starts = np.column_stack([50.0 * np.arange(n), np.zeros(n), rng.uniform(-np.pi, np.pi, n)])
    world = World(Problem(swarm, Environment(), starts, starts[:, :2]))
    choice = [subgroup for order in range(1, swarm.m) for subgroup in subgroups(swarm, order)]
    for subgroup in (choice[k] for k in rng.choice(len(choice), 5)):
        members = np.array(subgroup.robots) - 1
        motion = Motion(world, starts, members[0])
        assert motion.orient(subgroup.robots[:1], (float(rng.uniform(0, 6)),))
        headings = motion.poses[members, 2]
        (found,) = motion.move(subgroup, 1.5, rng)
        assert_is_what_it_says(found, starts)
        expected = starts[:, :2].copy()
        expected[members] += 1.5 * paces[members, None] * np.column_stack([np.cos(headings), np.sin(headings)])
        np.testing.assert_allclose(found.poses[:, :2], expected, atol=1e-9)


@pytest.mark.parametrize("angle", [0.5, 3.0, 6.0])
def test_turns_of_mixed_swarms_turn_the_set_as_h_does_and_displace_nobody(angle):
    swarm = Swarm(1.0, [1.0, 0.7, 1.0, 0.7, 1.3], 0.3, ("01", "01", "10", "11", "11"))
    starts = np.column_stack([50.0 * np.arange(5), np.zeros(5), np.linspace(0, 2, 5)])
    for robot, group in [(0, 1), (0, 2), (1, 1), (3, 2), (4, 1)]:
        motion = Motion(World(Problem(swarm, Environment(), starts, starts[:, :2])), starts, robot)
        assert motion.turn(group, angle)
        assert_is_what_it_says(motion, starts)
        np.testing.assert_allclose(motion.poses[:, :2], starts[:, :2], atol=1e-9)
        same = swarm.turning_length == swarm.turning_length[robot]
        wanted = starts[:, 2] + angle * ~swarm.membership[group - 1]
        np.testing.assert_allclose(np.exp(1j * motion.poses[same, 2]), np.exp(1j * wanted[same]), atol=1e-9)
