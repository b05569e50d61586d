"""Closed loop through volts, in this process: imperfect robots at their goals, robots lost, stuck or running away."""

import numpy as np
import pytest
from closed_loop import TOLERANCE, closed, opened
from three_robots import SCENARIO

from stressbot_planner import closed_loop

NOISE = {"position_noise": 1e-6, "orientation_noise": np.radians(0.5)}


@pytest.mark.parametrize("seed", range(3))
def test_robots_reach_their_goals_without_a_touch(seed):
    run = closed(SCENARIO, seed, 0.3)
    assert run.error <= TOLERANCE and run.gap > 0.0 and not run.reason


def test_plans_are_driven_and_corrected_where_steering_does_not_help(monkeypatch):
    monkeypatch.setattr(closed_loop, "PATIENCE", 0)
    run = closed(SCENARIO, 0, 0.3)
    assert run.error <= TOLERANCE and run.gap > 0.0 and not run.reason
    assert run.plans > 0 and run.retimings > 0



def test_open_loop_misses():
    assert opened(SCENARIO, 0, 0.3).error > TOLERANCE


def test_robots_that_go_unseen_for_a_while_are_held_by_prediction():
    run = closed(SCENARIO, 1, 0.3, lost_probability=0.05, lost_frames=2, **NOISE)
    assert run.error <= TOLERANCE + 0.05 and run.gap > 0.0 and not run.reason


def test_a_robot_that_stays_out_of_sight_ends_it():
    run = closed(SCENARIO, 0, 0.3, lost_probability=0.02, lost_frames=10**6)
    assert "was not seen for" in run.reason


def test_a_stuck_robot_becomes_an_obstacle():
    run = closed(SCENARIO, 0, 0.3, always_turn=[2])
    assert run.error <= TOLERANCE and run.gap > 0.0 and not run.reason


def test_a_robot_that_runs_away_ends_it():
    run = closed(SCENARIO, 0, 0.3, always_slide=[2])
    assert run.reason.startswith("robots[1]: slides when it should turn")
