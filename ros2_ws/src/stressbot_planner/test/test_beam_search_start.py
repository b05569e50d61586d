"""Steering as the beginning of a plan: safe, each sequence the beginning of the next one, and nearer to the goals."""

from dataclasses import replace

import numpy as np
import pytest

from stressbot_planner.beam_search.look_ahead import _beam as look_ahead_loop
from stressbot_planner.collision.clearance import Shapes, clearance
from stressbot_planner.formats import scenario
from stressbot_planner.model.environment import Environment, Workspace
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import prepare
from stressbot_planner.planners.optimization.beam_search_start import FIRST_COST_TO_GO, STALL_LOOKS, approaches
from stressbot_planner.problem.definition import Problem
from stressbot_planner.reproduce import instances

FOURTEEN = scenario.parse(instances.random(14, True, 5)).problem


def found(problem, least_gap=0.0, count=None, out_of_time=lambda: False):
    sequences = []
    for sequence in approaches(problem, Shapes.of(problem.environment), least_gap, np.random.default_rng(0), out_of_time):
        sequences.append(sequence)
        if len(sequences) == count:
            break
    return sequences


@pytest.mark.parametrize("least_gap", [0.0, 0.1])
def test_robots_come_nearer_and_touch_nothing(least_gap):
    sequences = found(FOURTEEN, least_gap, count=5)
    before = FIRST_COST_TO_GO * FOURTEEN.swarm.turning_radius.mean()
    for groups, lengths in sequences:
        poses = replay(FOURTEEN.swarm, FOURTEEN.starts, groups, lengths)
        errors = np.hypot(*(poses[-1, :, :2] - FOURTEEN.goals).T)
        assert errors.max() <= before
        assert clearance(FOURTEEN.swarm, FOURTEEN.environment, FOURTEEN.starts, groups, lengths).gap > least_gap - 1e-9
        before = 0.7 * before
    for (first, _), (second, _) in zip(sequences, sequences[1:], strict=False):
        assert len(first) <= len(second) and np.array_equal(first, second[: len(first)])


def test_speeds_and_radii_of_each_robot_are_known():
    problem = scenario.parse(instances.random(6, True, 1)).problem
    swarm = replace(problem.swarm, turning_radius=np.linspace(0.8, 1.3, 6), pace=np.linspace(0.7, 1.0, 6))
    problem = replace(problem, swarm=swarm)
    groups, lengths = found(problem, count=4)[-1]
    assert clearance(swarm, problem.environment, problem.starts, groups, lengths).gap > 0.0


def test_its_loops_are_loaded_before_the_time_of_optimize_begins():
    prepare("optimize")
    before = len(look_ahead_loop.signatures)
    assert before
    found(FOURTEEN, count=1)
    assert len(look_ahead_loop.signatures) == before


def test_it_ends_with_the_time():
    assert found(FOURTEEN, out_of_time=lambda: True) == []


def test_it_ends_where_nobody_can_pass():
    swarm = Swarm(1.0, 0.5, 0.2, ("01", "10"))
    starts = np.array([[0.3, 0.205, 0.0], [2.6, 0.205, np.pi]])
    problem = Problem(swarm, Environment(Workspace(0, 3.0, 0, 0.41)), starts, starts[::-1, :2].copy(), 1e-6)
    asked = []
    sequences = found(problem, out_of_time=lambda: asked.append(0) or len(asked) > 50 * STALL_LOOKS)
    assert len(asked) <= 50 * STALL_LOOKS
    assert len(sequences) < 3
