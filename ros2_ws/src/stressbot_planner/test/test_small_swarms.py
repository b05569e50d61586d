"""Every planner answers every valid problem of a few robots: with a plan, or a reason, or a refusal; never with a defect."""

from itertools import count

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model import allocation
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, names, solve
from stressbot_planner.planners.optimization.optimize import FEW_SHARE
from stressbot_planner.problem.definition import Problem

LIMIT = 4.0
"""s of a clock that is looked at `LOOKS` times in it: what a planner does follows from its seed, not from the machine."""
LOOKS = 200

some = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))

HEADINGS = st.sampled_from([0.0, np.pi, np.pi / 2, -np.pi / 2]) | st.floats(-np.pi, np.pi)
DISTANCES = st.floats(-8.0, 2.0).map(lambda power: 10.0**power) | st.sampled_from([0.0, 1e-7, 1e-6, 2e-6, 100.0])


def ticking():
    ticks = count()
    return lambda: next(ticks) * LIMIT / LOOKS


@st.composite
def problems(draw, most=6):
    """Robots in a row, nearly touching or apart, their goals at some distance; in the open plane, or among obstacles and walls."""
    n = draw(st.integers(1, most))
    body, radius = draw(st.sampled_from([0.3, 0.01, 1e-6])), draw(st.sampled_from([1.0, 0.1, 30.0]))
    shares = st.lists(st.floats(0.5, 1.5), min_size=n, max_size=n, unique=True)
    radii = radius * np.array(draw(shares)) if draw(st.booleans()) else np.full(n, radius)
    pace = np.array(draw(shares)) if draw(st.booleans()) else np.ones(n)
    words = allocation.allocate(draw(st.sampled_from(["binary", "tight", "balanced", "by_radius"])), radii.tolist())
    spacing = draw(st.sampled_from([max(1.0, 4 * body), 2.5 * body]))
    same = draw(st.booleans())
    heading = [draw(HEADINGS)] * n if same else [draw(HEADINGS) for _ in range(n)]
    starts = np.column_stack([np.zeros(n), spacing * np.arange(n), heading])
    # where robots look, or anywhere
    aim = draw(st.sampled_from([0.0, np.pi]).map(lambda turn: turn + heading[0]) | HEADINGS)
    goals = starts[:, :2] + draw(DISTANCES) * np.array([np.cos(aim), np.sin(aim)])
    stay = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    if draw(st.booleans()):
        goals[stay] = starts[stay, :2]
    if draw(st.booleans()):
        goals = goals[draw(st.permutations(range(n)))]
    low, high = (reach(np.vstack([starts[:, :2], goals]), axis=0) for reach in (np.min, np.max))
    room = max(3 * radius, 4 * body)
    walls = Workspace(low[0] - room, high[0] + room, low[1] - room, high[1] + room)
    corner = Polygon([high + 0.5 * room, high + room * np.array([0.6, 0.5]), high + room * np.array([0.5, 0.6])])
    disc = Circle(starts[0, :2] + spacing * np.array([1.0, 0.5]), 0.2 * spacing)
    environment = draw(
        st.sampled_from([Environment(), Environment(walls), Environment(None, (disc,)), Environment(walls, (corner, disc))])
    )
    try:
        swarm = Swarm(1.0, radii, body, words, pace / pace.max())
        return Problem(swarm, environment, starts, goals, draw(st.sampled_from([1e-6, 1e-6, 1e-9, 0.1 * body, 0.5, 5.0])))
    except StressbotError:
        return draw(st.nothing())


@st.composite
def choices(draw, n=6):
    """Everything that may be asked for."""
    warm = st.lists(st.tuples(st.integers(1, 2), st.floats(0.0, 3.0)), max_size=12).map(lambda plan: tuple(zip(*plan, strict=True)))
    return {
        "objective": draw(st.sampled_from(["path", "time", "0.3"])),
        "first": draw(st.booleans()),
        "seed": draw(st.integers(0, 99)),
        "min_clearance": draw(st.sampled_from([0.0, 0.0, 1e-9, 0.01])),
        "max_epochs": draw(st.none() | st.integers(1, 12 * n)),
        "max_tries": draw(st.none() | st.integers(1, 12)),
        "warm_start": draw(st.none() | warm.map(lambda plan: plan or None)),
    }


def answered(problem, planner, limit=LIMIT, **chosen):
    """Return the result, None if the planner refuses the problem; assert that it is one of what may be."""
    try:
        result = solve(problem, planner, Settings(time_limit=limit, clock=ticking(), **chosen))
    except StressbotError as refusal:
        assert refusal.code in (ErrorCode.UNSUPPORTED, ErrorCode.OUT_OF_RANGE), refusal
        return None
    assert result.success or result.reason
    if result.success:
        assert result.plan.valid
        assert len(result.plan.groups) <= (chosen.get("max_epochs") or np.inf)
        assert result.plan.path_length >= problem.lower_bounds.path_length * (1 - 1e-6)
    return result


@some
@given(problem=problems(), chosen=choices())
def test_optimize_finds_a_plan_where_one_robot_after_the_other_can_go(problem, chosen):
    result = answered(problem, "optimize", **chosen)
    alone = answered(problem, "pure_control", 0.5 * FEW_SHARE * LIMIT, **chosen) if problem.swarm.alike else None
    if result is None or alone is None or not alone.success or chosen["max_tries"] is not None:
        return  # a try of one planner is not a try of the other
    if chosen["max_epochs"] is None or len(alone.plan.groups) <= chosen["max_epochs"]:
        assert result.success, result.reason


@pytest.mark.parametrize("planner", sorted(set(names()) - {"optimize"}))
@settings(some, max_examples=12)
@given(problem=problems(most=4), chosen=choices())
def test_every_planner_answers(planner, problem, chosen):
    answered(problem, planner, LIMIT / 10, **chosen)


@some
@given(
    distance=DISTANCES.filter(lambda d: d > 1e-5), aim=HEADINGS, heading=HEADINGS, objective=st.sampled_from(["path", "time"]),
    first=st.booleans(),
)
def test_one_robot_turns_to_its_goal_and_goes_there(distance, aim, heading, objective, first):
    goal = distance * np.array([np.cos(aim), np.sin(aim)])
    problem = Problem(Swarm(1.0, 1.0, 0.3, ("1",)), Environment(), [[0.0, 0.0, heading]], [goal], min(1e-6, 1e-3 * distance))
    plan = answered(problem, "optimize", objective=objective, first=first).plan
    turn = (aim - heading) % (2 * np.pi)
    assert objective == "time" or plan.path_length <= 1.001 * distance
    assert plan.execution_time <= 1.001 * (distance + (turn if turn < 6.28 else 0.0)) + 0.004  # turns of a few mrad are left over


@pytest.mark.parametrize("n", [1, 2, 3])
def test_no_distance_straight_ahead_is_too_short(n):
    starts = np.column_stack([np.zeros(n), 3.0 * np.arange(n), np.zeros(n)])
    for distance in np.geomspace(1e-5, 0.3, 20):
        goals = starts[:, :2] + (distance, 0.0)
        problem = Problem(Swarm(1.0, 1.0, 0.3, allocation.binary(n)), Environment(), starts, goals)
        result = answered(problem, "optimize", first=n > 2)
        assert result.success, (distance, result.reason)


@pytest.mark.parametrize("planner", names())
@pytest.mark.parametrize("seed", range(10))
def test_no_time_at_all_for_one_robot_is_a_plan_or_a_reason(planner, seed):
    problem = Problem(Swarm(1.0, 1.0, 0.3, ("1",)), Environment(), [[0.0, 0.0, 0.0]], [[5.0, 1.0]], 0.5)
    answered(problem, planner, 1e-9, seed=seed)
