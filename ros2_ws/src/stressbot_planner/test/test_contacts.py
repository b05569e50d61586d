"""Pairs that may touch where others keep a clearance: exact in the checker, and met by plans."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file, plan_text, read_plan_file
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.model.whole_pulses import contact_depth
from stressbot_planner.planners import Settings, solve
from stressbot_planner.planners.optimization.gaps import near_gaps
from stressbot_planner.primitives.expansion import Activate
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.reproduce import instances

STEP = 1.2e-4
NOTHING = Shapes.of(Environment())


def docking(contacts=((0, 1),), **changes) -> Problem:
    """Return the paper's six robots among two discs; robots 1 and 2 touch at their goals."""
    problem = scenario.parse(instances.paper(True)).problem
    goals = problem.goals.copy()
    goals[1] = goals[0] + [0.0, 2 * problem.swarm.body_radius[0]]
    return replace(problem, goals=goals, contacts=contacts, **changes)


def random_motion(seed: int):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    swarm = Swarm(1.0, rng.uniform(0.5, 1.5, n), rng.uniform(0.05, 0.4, n), binary(n))
    groups = rng.integers(1, swarm.m + 1, 12)
    lengths = rng.uniform(0.0, 2.0, 12)
    starts = np.column_stack([rng.uniform(-3, 3, (n, 2)), rng.uniform(-3, 3, n)])
    credit = np.triu(rng.choice([0.0, 0.3, 1.0, np.inf], (n, n)), 1)
    return swarm, replay(swarm, starts, groups, lengths), groups, lengths, credit + credit.T


# The checker


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=80)
def test_each_pair_counts_with_its_credit_and_no_other(seed):
    swarm, poses, groups, lengths, credit = random_motion(seed)
    found = clearance_of(swarm, NOTHING, poses, groups, lengths, credit).gap
    gaps = []
    for i in range(swarm.n):
        for j in range(i):
            pair = [j, i]
            two = Swarm(1.0, swarm.turning_radius[pair], swarm.body_radius[pair], tuple(swarm.codewords[k] for k in pair))
            gaps.append(clearance_of(two, NOTHING, poses[:, pair].copy(), groups, lengths).gap + credit[i, j])
    assert found == pytest.approx(min(gaps), abs=1e-12)


@given(st.integers(0, 10**6), st.floats(0.01, 1.0))
@settings(deadline=None, max_examples=40)
def test_gaps_for_the_optimiser_are_larger_by_the_credit(seed, credit):
    swarm, poses, groups, lengths, _ = random_motion(seed)
    slides, body = swarm.slides[groups - 1], swarm.body_radius
    every = np.full((swarm.n, swarm.n), credit)
    plain, _ = near_gaps(2.0 - credit, slides, poses, lengths, body, NOTHING)
    with_credit, _ = near_gaps(2.0, slides, poses, lengths, body, NOTHING, credit=every)
    np.testing.assert_allclose(with_credit, plain + credit, atol=1e-12)


def test_a_contact_may_touch_and_overlap_by_no_more_than_its_depth_and_others_keep_their_gap():
    swarm = Swarm(1.0, 1.0, 0.5, ("001", "010", "100"))
    starts = [[0, 0, 0], [4, 0, 0], [0, 1.1, 0]]

    def plan(slid: float, contacts=((0, 1),), depth: float = 0.0) -> Plan:
        goals = [[slid, 0], [4, 0], [0, 1.1]]
        problem = Problem(swarm, Environment(), starts, [[2, 0], *goals[1:]], tolerance=2.0, contacts=contacts, contact_depth=depth)
        return Plan(problem, (Activate(3, slid),))

    assert plan(3.0).valid and plan(3.0).keeps(0.1) and not plan(3.0, ()).keeps(0.1)
    assert not plan(3.0).keeps(0.11), "robots 1 and 3"
    assert "without contacts 0.1 units between robot 3 and robot 1" in plan(3.0).account
    assert not plan(3.001).valid and plan(3.001, depth=0.001).valid and not plan(3.0011, depth=0.001).valid
    assert not plan(3.001, (), 0.001).valid, "a depth is for contacts only"


def test_starts_in_contact_may_overlap_by_their_depth_and_goals_by_nothing():
    swarm = Swarm(1.0, 1.0, 0.5, ("01", "10"))

    def problem(begin: float, end: float, depth: float) -> Problem:
        places = [[[0, 0], [distance, 0]] for distance in (begin, end)]
        starts = np.column_stack([places[0], np.zeros(2)])
        return Problem(swarm, Environment(), starts, places[1], contacts=((0, 1),), contact_depth=depth)

    problem(0.999, 1.0, 0.001)
    with pytest.raises(StressbotError) as caught:
        problem(0.999, 1.0, 0.0)
    assert caught.value.code == ErrorCode.STARTS_OVERLAP
    with pytest.raises(StressbotError) as caught:
        problem(1.0, 0.999, 0.001)
    assert caught.value.code == ErrorCode.GOALS_TOO_CLOSE


# Plans


@pytest.mark.parametrize("pulse_length", [None, STEP])
@pytest.mark.parametrize("seed", range(3))
def test_two_robots_dock_where_others_keep_apart(seed, pulse_length):
    problem = docking(contact_depth=contact_depth(pulse_length))
    asked = Settings(seed=seed, max_tries=400, first=True, min_clearance=0.2, time_limit=100, pulse_length=pulse_length)
    result = solve(problem, "optimize", asked)
    assert result.success, result.reason
    plan = result.plan
    assert plan.valid and plan.clearance_of_others.gap >= 0.2 - problem.slack
    assert -contact_depth(pulse_length) - problem.slack <= plan.clearance.gap < 0.01
    with pytest.raises(StressbotError, match="a goal leaves only"):
        solve(replace(problem, contacts=()), "optimize", asked)


@pytest.mark.parametrize("seed", range(3))
def test_from_a_dock_robots_part_again(seed):
    problem = docking(contact_depth=contact_depth(STEP))
    starts = np.column_stack([problem.goals, np.zeros(6)])
    starts[1, 1] -= 0.9 * problem.contact_depth  # as whole steps left them
    back = replace(problem, starts=starts, goals=problem.starts[:, :2])
    result = solve(back, "optimize", Settings(seed=seed, max_tries=400, first=True, time_limit=100, pulse_length=STEP))
    assert result.success, result.reason
    assert result.plan.valid and result.plan.clearance.gap >= -problem.contact_depth - problem.slack


def test_a_plan_file_tells_the_clearance_of_others(tmp_path):
    problem = docking()
    result = solve(problem, "optimize", Settings(seed=1, max_tries=400, first=True, min_clearance=0.2, time_limit=100))
    data = plan_file(result, "docking", 0.1)
    assert data["min_clearance_of_others"] == result.plan.clearance_of_others.gap >= 0.2 - problem.slack > data["min_clearance"]
    path = tmp_path / "plan.json"
    path.write_text(plan_text(data))
    assert read_plan_file(path, problem, "docking").plan.valid


def test_contacts_of_a_part_are_those_of_the_whole():
    problem = docking()
    words = tuple(word + word.translate({48: "1", 49: "0"}) for word in problem.swarm.codewords)
    swarm = replace(problem.swarm, codewords=words)
    goals = problem.goals.copy()
    goals[2] = problem.starts[2, :2]
    around = replace(problem, swarm=swarm, goals=goals, parked=(2,), contacts=((1, 0), (5, 3)))
    result = solve(around, "optimize", Settings(seed=1, max_tries=400, first=True, min_clearance=0.1, time_limit=100))
    assert result.success and result.plan.valid and result.plan.keeps(0.1), result.reason
    assert result.plan.problem.contacts == ((1, 0), (5, 3))
    with pytest.raises(StressbotError, match="names robot 3, which is parked") as caught:
        replace(around, contacts=((1, 0), (1, 2)))
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "contacts[1]")


@pytest.mark.parametrize("pair", [(0, 0), (0, 6), (-1, 2)])
def test_a_contact_is_of_two_robots(pair):
    with pytest.raises(StressbotError) as caught:
        docking(contacts=((0, 1), pair))
    assert (caught.value.code, caught.value.field) == (ErrorCode.OUT_OF_RANGE, "contacts[1]")


def test_a_scenario_lists_contacts_with_the_depth_of_its_steps():
    text = instances.paper(True)
    assert scenario.parse(text).problem.contacts == ()
    problem = scenario.parse(text + "contacts: [[1, 2], [6, 3]]\n").problem
    assert problem.contacts == ((0, 1), (5, 2))
    step = scenario.parse(text).electrical.pulse_length(problem.swarm.speed)
    assert problem.contact_depth == contact_depth(step)
