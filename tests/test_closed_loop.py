"""Closed loop through volts, in this process: imperfect robots at their goals, robots lost, stuck or running away."""

import numpy as np
import pytest
from closed_loop import TOLERANCE, closed, opened, solver
from three_robots import SCENARIO

from stressbot_planner.estimation.kalman_filters import Prior
from stressbot_planner.execution import closed_loop
from stressbot_planner.execution.windows import Window
from stressbot_planner.formats.scenario import parse

NOISE = {"position_noise": 1e-6, "orientation_noise": np.radians(0.5)}


@pytest.mark.parametrize("seed", range(3))
def test_robots_reach_their_goals_without_a_touch(seed):
    run = closed(SCENARIO, seed, 0.3)
    assert run.error <= TOLERANCE and run.gap > 0.0 and not run.reason


def test_plans_are_driven_and_corrected_where_windows_do_not_help(monkeypatch):
    monkeypatch.setattr(closed_loop, "PATIENCE", 0)
    run = closed(SCENARIO, 0, 0.3)
    assert run.error <= TOLERANCE and run.gap > 0.0 and not run.reason
    assert run.plans > 0 and run.retimings > 0


@pytest.mark.parametrize("lengths", [(1.0, 0.1, 1e-12, 0.1), (0.0, 0.1), (1e-12, 0.0)])
def test_no_activation_of_no_length_leaves_the_loop(monkeypatch, lengths):
    """Precise robots drive some activations in a row."""
    window = Window(1 + np.arange(len(lengths)) % 4, np.array(lengths))
    monkeypatch.setattr(closed_loop, "best_window", lambda *_: window)
    scenario = parse(SCENARIO)
    precise = Prior(0.0, 0.0, 0.0, 0.0, 1e-4, 1e-6, 1e-4)
    problem = scenario.problem
    loop = closed_loop.ClosedLoop(
        scenario.swarm, problem.environment, problem.goals, 0.3, problem.starts, lambda _: None, precise
    )
    decision = loop.decide()
    assert decision.state is closed_loop.State.DRIVE and len(decision.groups) and np.all(decision.lengths > 1e-6)
    if lengths[0] == 1.0:
        assert len(decision.groups) == 3


def test_a_plan_may_hold_activations_of_no_length(monkeypatch):
    monkeypatch.setattr(closed_loop, "PATIENCE", 0)

    def solve(wanted):
        groups, lengths = solver(0.3)(wanted)
        return np.repeat(groups, 2), np.column_stack([np.zeros(len(lengths)), lengths]).ravel()

    scenario = parse(SCENARIO)
    problem = scenario.problem
    loop = closed_loop.ClosedLoop(scenario.swarm, problem.environment, problem.goals, 0.3, problem.starts, solve)
    while (decision := loop.decide()).state is not closed_loop.State.DONE:
        assert decision.state is closed_loop.State.DRIVE and len(decision.groups) and np.all(decision.lengths > 0.0)
        for group, length in zip(decision.groups.tolist(), decision.lengths.tolist(), strict=True):
            loop.observe(group, length, loop.filters.advance(loop.poses, group, length))
    assert loop.plans


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
