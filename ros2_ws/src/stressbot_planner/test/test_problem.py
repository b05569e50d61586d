"""A problem that no plan could solve is refused, and named as in the scenario file."""

import tracemalloc

import numpy as np
import pytest

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.problem.definition import EXACT, Problem

NAN, INF = float("nan"), float("inf")
SCENE = Environment(Workspace(0, 20, 0, 20), (Circle((8, 6), 1.5), Polygon([(12, 12), (14, 12), (13, 14)])))


def problem(starts=((2, 2, 0), (2, 4, 0)), goals=((5, 15), (8, 15)), environment=SCENE, **swarm) -> Problem:
    values = {"speed": 1.0, "turning_radius": 1.0, "body_radius": 0.3, "codewords": binary(len(starts))} | swarm
    return Problem(Swarm(**values), environment, starts, goals)


def test_a_good_problem_is_immutable_and_exact_by_default():
    good = problem()
    assert good.tolerance == EXACT == 1e-6
    with pytest.raises(ValueError, match="read-only"):
        good.starts[0, 0] = 1
    assert good.goal_error(good.goals + [[3, 4], [0, 0]]) == 5


@pytest.mark.parametrize(
    ("changes", "code", "field"),
    [
        ({"goals": ((25, 15), (8, 15))}, ErrorCode.OUTSIDE_WORKSPACE, "robots[0].goal"),
        ({"goals": ((5, 15), (0.2, 15))}, ErrorCode.OUTSIDE_WORKSPACE, "robots[1].goal"),
        ({"starts": ((-1, 2, 0), (2, 4, 0))}, ErrorCode.OUTSIDE_WORKSPACE, "robots[0].start"),
        ({"goals": ((8, 7), (8, 15))}, ErrorCode.INSIDE_OBSTACLE, "robots[0].goal"),
        ({"goals": ((13, 12.5), (8, 15))}, ErrorCode.INSIDE_OBSTACLE, "robots[0].goal"),
        ({"goals": ((13, 11.8), (8, 15))}, ErrorCode.INSIDE_OBSTACLE, "robots[0].goal"),
        ({"starts": ((2, 2, 0), (8, 4.3, 0))}, ErrorCode.INSIDE_OBSTACLE, "robots[1].start"),
        ({"starts": ((2, 2, 0), (2, 2.5, 0))}, ErrorCode.STARTS_OVERLAP, "robots[1].start"),
        ({"starts": ((2, 2, 0), (2, 2, 0))}, ErrorCode.STARTS_OVERLAP, "robots[1].start"),
        ({"goals": ((5, 15), (5.5, 15))}, ErrorCode.GOALS_TOO_CLOSE, "robots[1].goal"),
        ({"goals": ((5, 15),)}, ErrorCode.WRONG_COUNT, "goal"),
        ({"starts": ((2, 2), (2, 4))}, ErrorCode.WRONG_COUNT, "start"),
        ({"goals": ((5, NAN), (8, 15))}, ErrorCode.NOT_FINITE, "robots[0].goal"),
        ({"starts": ((2, 2, 0), (2, 4, INF))}, ErrorCode.NOT_FINITE, "robots[1].start"),
        ({"starts": ((2, 2, 0), (2, 1e200, 0)), "environment": Environment()}, ErrorCode.OUT_OF_RANGE, "robots[1].start"),
        ({"goals": ((1e10, 2), (2, 4)), "environment": Environment()}, ErrorCode.OUT_OF_RANGE, "robots[0].goal"),
        ({"codewords": ()}, ErrorCode.NO_ROBOTS, "robots"),
        ({"codewords": ("01", "01")}, ErrorCode.DUPLICATE_CODEWORD, "swarm.groups[1]"),
        ({"codewords": ("01", "01"), "turning_radius": [0.5, 0.5]}, ErrorCode.DUPLICATE_CODEWORD, "swarm.groups[1]"),
        ({"codewords": ("01", "00")}, ErrorCode.EMPTY_CODEWORD, "swarm.groups[1]"),
        ({"codewords": ("01", "")}, ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        ({"codewords": ("01", "2x")}, ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        ({"codewords": ("01", "101")}, ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        ({"speed": 0.0}, ErrorCode.OUT_OF_RANGE, "swarm.speed"),
        ({"speed": NAN}, ErrorCode.NOT_FINITE, "swarm.speed"),
        ({"speed": 1e-300}, ErrorCode.OUT_OF_RANGE, "swarm.speed"),
        ({"turning_radius": -1.0}, ErrorCode.OUT_OF_RANGE, "swarm.turning_radius"),
        ({"turning_radius": [1.0, INF]}, ErrorCode.NOT_FINITE, "swarm.turning_radius"),
        ({"turning_radius": [1.0, 2.0, 3.0]}, ErrorCode.WRONG_COUNT, "swarm.turning_radius"),
        ({"body_radius": 1e-300}, ErrorCode.OUT_OF_RANGE, "swarm.body_radius"),
        ({"body_radius": [0.3, -0.3]}, ErrorCode.OUT_OF_RANGE, "swarm.body_radius"),
    ],
)
def test_refused_problems_name_the_field(changes, code, field):
    with pytest.raises(StressbotError) as caught:
        problem(**changes)
    assert (caught.value.code, caught.value.field) == (code, field)


@pytest.mark.parametrize(
    ("tolerance", "code"), [(0.0, ErrorCode.OUT_OF_RANGE), (-1.0, ErrorCode.OUT_OF_RANGE), (NAN, ErrorCode.NOT_FINITE)]
)
def test_refused_tolerances(tolerance, code):
    good = problem()
    with pytest.raises(StressbotError) as caught:
        Problem(good.swarm, good.environment, good.starts, good.goals, tolerance)
    assert (caught.value.code, caught.value.field) == (code, "tolerance")


def test_different_bodies_need_their_own_distance():
    problem(starts=((2, 2, 0), (2, 3.2, 0)), body_radius=[1.0, 0.15])
    with pytest.raises(StressbotError, match="need 1.25") as caught:
        problem(starts=((2, 2, 0), (2, 3.2, 0)), body_radius=[1.0, 0.25])
    assert caught.value.code == ErrorCode.STARTS_OVERLAP


def test_touching_bodies_and_walls_are_allowed():
    problem(starts=((0.5, 2, 0), (0.5, 3, 0)), body_radius=0.5)


def test_thousands_of_robots_on_one_spot_are_refused_without_eating_the_memory():
    n = 5000
    swarm = Swarm(1.0, 1.0, 0.3, binary(n))
    tracemalloc.start()
    with pytest.raises(StressbotError) as caught:
        Problem(swarm, Environment(), np.zeros((n, 3)), np.zeros((n, 2)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert caught.value.code == ErrorCode.STARTS_OVERLAP
    assert peak < 20e6


def test_robots_with_one_codeword_are_told_apart_by_their_turning_radii():
    assert problem(codewords=("1", "1"), turning_radius=[1.0, 0.5]).swarm.m == 2
    sentence = r"'1' for robots 1 and 2, whose turning radius ÷ speed is 0.1 \(0.3 ÷ 3\) and 0.1 \(0.7 ÷ 7\): equal"
    with pytest.raises(StressbotError, match=sentence):
        problem(codewords=("1", "1"), speed=7.0, pace=[3 / 7, 1.0], turning_radius=[0.3, 0.7])
