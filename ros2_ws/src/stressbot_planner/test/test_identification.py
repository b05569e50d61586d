"""The identification motion: clear of everything with a margin, on and off the robots' places, refused where there is no room."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_robots import Robots

from stressbot_planner.collision.clearance import clearance
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.calibration import Fault
from stressbot_planner.estimation.identification import MARGIN, SLIDES, design_stage, identify, turn_on_the_spot
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Workspace
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm

OPEN = Environment(None, ())


@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.integers(1, 3))
@settings(max_examples=50)
def test_a_stage_keeps_its_distance_and_brings_members_back(n, seed, group):
    rng = np.random.default_rng(seed)
    radius = float(rng.uniform(0.5, 2.0))
    swarm = Swarm(1.0, radius, 0.2, binary(n))
    environment = Environment(Workspace(-10, 10, -10, 10), (Circle((0, 0), 1.0),))
    poses = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-4, 4, n)])
    group = min(group, swarm.m - 1)
    motion = design_stage(swarm, environment, poses, group, MARGIN)
    if motion is None:
        return
    groups, lengths = motion
    slide = float(lengths[groups == group][0])
    assert min(abs(slide / radius - candidate) for candidate in SLIDES) < 1e-9
    assert clearance(swarm, environment, poses, groups, lengths).gap >= MARGIN * slide
    end = replay(swarm, poses, groups, lengths)[-1]
    np.testing.assert_allclose(end[:, :2], poses[:, :2], atol=1e-9)
    assert set(groups.tolist()) == {group, swarm.m}


def test_turns_on_the_spot_move_nobody():
    swarm = Swarm(1.0, [0.5, 1.5], 0.2, ("01", "10"))
    groups, lengths = turn_on_the_spot(swarm, 1.2, 3)
    poses = replay(swarm, np.zeros((2, 3)), groups, lengths)[-1]
    np.testing.assert_allclose(poses, [[0, 0, 7.2], [0, 0, 2.4]])


def spread(n, always=None, **changes):
    """Robots 6 apart that `identify` can drive, and what is at fault with them."""
    swarm = Swarm(1.0, 1.0, 0.3, binary(n))
    values = {"speed": np.full(n, 1.03), "radius": np.full(n, 0.95), "bias": np.full(n, 0.1), **changes}
    robots = Robots(swarm, **values, always=always, position=0.01, orientation=0.01)
    robots.poses[:, :2] = np.column_stack([6.0 * np.arange(n), np.zeros(n)])
    return robots


def run(robots, environment=OPEN, precision=0.01, gone=()):
    def measure():
        poses = robots.poses.copy()
        poses[robots.hidden] = np.nan
        return poses

    def drive(motion):
        records = [robots.drive(int(group), float(length)) for group, length in zip(*motion, strict=True)]
        robots.hidden[list(gone)] = True
        return records

    return identify(robots.swarm, environment, measure, drive, precision)


def test_rounds_go_on_until_the_intervals_are_narrow():
    few, many = (run(spread(3), precision=precision) for precision in (0.02, 0.001))
    assert len(many[1]) > len(few[1])
    for estimates, precision in ((few[0], 0.02), (many[0], 0.001)):
        for found in estimates:
            assert found.speed.half_width <= precision * found.speed.value
            assert found.speed.value == pytest.approx(1.03, abs=3 * found.speed.half_width)
            assert found.turning_radius.value == pytest.approx(0.95, abs=3 * found.turning_radius.half_width)


def test_a_robot_that_always_slides_is_refused_before_it_gets_far():
    robots = spread(3, always={1: 1})
    before = robots.poses.copy()
    with pytest.raises(StressbotError) as caught:
        run(robots)
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "robot 2")
    assert np.hypot(*(robots.poses - before)[1, :2]) < 2.0


def test_a_robot_that_always_turns_becomes_an_obstacle_for_the_others():
    estimates, _ = run(spread(3, always={1: -1}))
    assert [found.fault for found in estimates] == [Fault.NONE, Fault.ALWAYS_TURNS, Fault.NONE]
    assert estimates[0].speed.value == pytest.approx(1.03, rel=0.01)


def test_robots_that_are_never_seen_are_left_out_and_lost_ones_refused():
    robots = spread(3)
    robots.hidden[0] = True
    estimates, _ = run(robots)
    assert [found.fault for found in estimates] == [Fault.NOT_SEEN, Fault.NONE, Fault.NONE]
    with pytest.raises(StressbotError) as caught:
        run(spread(3), gone=[2])
    assert caught.value.code == ErrorCode.NO_SWARM and "robot 3" in str(caught.value)


def test_without_room_it_is_refused():
    robots = spread(3)
    robots.poses[:, 0] *= 0.105
    with pytest.raises(StressbotError) as caught:
        run(robots)
    assert (caught.value.code, caught.value.field) == (ErrorCode.INFEASIBLE, "swarm_poses")
