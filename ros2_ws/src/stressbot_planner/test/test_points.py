"""Robots of radius 0, the paper's own case: they pass each other, but no body, wall or obstacle."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_planner.collision.clearance import Shapes, clearance, is_clear, slide_is_clear
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace, standing
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, names, solve
from stressbot_planner.primitives.expansion import Activate
from stressbot_planner.problem.definition import EXACT, Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.problem.reachability import walled_in

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"

BAR = Polygon([(2, -3), (2.4, -3), (2.4, 3), (2, 3)])
EXACT_ONES = ("optimize", "optimize_paper", "pure_control")


def pair(body, starts, goals=None) -> Problem:
    starts = np.array(starts, dtype=float)
    return Problem(Swarm(1.0, 1.0, body, ("10", "01")), Environment(), starts, starts[:, :2] + 7 if goals is None else goals)


def test_points_pass_through_each_other_and_bodies_do_not():
    crossing = [[0, 0, 0], [4, 0, np.pi]]
    ways = Activate(1, 4.0), Activate(2, 4.0)
    goals = [[4, 0], [0, 0]]
    assert Plan(pair(0.0, [[0, 0, 0], [0, 0, 1]], goals=[[4, 0], [4, 0]]), ways[:1]).keeps(0.0)
    for body, passes in ((0.0, True), ([0.0, 0.3], False), ([0.3, 0.0], False), (1e-3, False)):
        assert Plan(pair(body, crossing, goals), ways).keeps(0.0) == passes


def test_points_in_one_place_are_taken_unless_a_clearance_is_asked_for():
    problem = pair(0.0, [[1, 1, 0], [1, 1, 2]], [[5, 5], [5, 5]])
    assert solve(problem, "optimize", Settings(time_limit=30.0, first=True)).success
    with pytest.raises(StressbotError, match="min_clearance"):
        solve(problem, "optimize", Settings(time_limit=5.0, min_clearance=0.1))
    for where in ({"starts": [[1, 1, 0], [1, 1.2, 2]]}, {"starts": [[1, 1, 0], [4, 4, 2]], "goals": [[5, 5], [5, 5.2]]}):
        with pytest.raises(StressbotError) as caught:
            pair([0.0, 0.3], **where)
        assert caught.value.code in (ErrorCode.STARTS_OVERLAP, ErrorCode.GOALS_TOO_CLOSE)


def test_a_clearance_holds_between_points_too_where_it_is_asked_for():
    problem = pair(0.0, [[0, 0, 0], [4, 0, np.pi]], [[4, 0], [0, 0]])
    result = solve(problem, "optimize", Settings(time_limit=30.0, first=True, min_clearance=0.2))
    assert result.success and result.plan.clearance.gap >= 0.2 - problem.slack
    assert not Plan(problem, (Activate(1, 4.0), Activate(2, 4.0))).keeps(0.2)


@pytest.mark.parametrize(
    ("environment", "goal"),
    [
        (Environment(obstacles=(Circle((2, 0), 0.5),)), (4, 0)),
        (Environment(obstacles=(BAR,)), (4, 0)),
        (Environment(obstacles=(Polygon([(0, -1), (4, -1), (2, 1)]),)), (4, 0.5)),
        (Environment(Workspace(-1, 3, -9, 9)), (2, 0)),
    ],
    ids=["disc", "bar", "triangle", "wall"],
)
def test_a_point_does_not_pass_through_anything_else(environment, goal):
    problem = Problem(Swarm(1.0, 1.0, 0.0, ("1",)), environment, [[-0.5, 0, 0]], [goal])
    assert not Plan(problem, (Activate(1, 4.5),)).keeps(0.0)
    assert Plan(problem, (Activate(1, 0.2),)).keeps(0.0)


@given(st.floats(-3.2, 3.2), st.floats(0, 1), st.integers(0, 4), st.floats(0, 2 * np.pi))
def test_a_point_may_touch_a_polygon_and_leave_it_but_not_enter_it(turn, share, edge, heading):
    corners = 3 * np.array([(np.cos(a), np.sin(a)) for a in turn + np.array([0, 1.1, 2.0, 3.3, 4.9])])
    a, b = corners[edge], np.roll(corners, -1, axis=0)[edge]
    outward = np.array([b[1] - a[1], a[0] - b[0]]) / np.hypot(*(b - a))
    ahead = np.array([np.cos(heading), np.sin(heading)])
    problem = Problem(
        Swarm(1.0, 1.0, 0.0, ("1",)), Environment(obstacles=(Polygon(corners),)), [[*(a + share * (b - a)), heading]], [[50.0, 0.0]]
    )
    plan = Plan(problem, (Activate(1, 1.0),))
    if ahead @ outward > 1e-6:
        assert plan.keeps(0.0)
    elif ahead @ outward < -0.01 and 0.05 < share < 0.95:
        assert not plan.keeps(0.0)


@st.composite
def mixed_motions(draw):
    n = draw(st.integers(2, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    swarm = Swarm(1.0, rng.uniform(0.5, 2.0, n), rng.uniform(0.05, 0.4, n) * (rng.random(n) < 0.5), binary(n))
    start = np.column_stack([rng.uniform(-4, 4, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
    groups = rng.integers(1, swarm.m + 1, draw(st.integers(1, 8)))
    return swarm, start, groups, rng.uniform(0, 4, len(groups))


@given(mixed_motions(), st.floats(-0.3, 0.5))
def test_what_is_clear_leaves_out_pairs_of_points_and_nothing_else(motion, wanted):
    swarm, start, groups, lengths = motion
    environment = Environment(obstacles=(BAR,))
    poses, shapes = replay(swarm, start, groups, lengths), Shapes.of(environment)
    points = swarm.body_radius == 0
    # the smallest gap is that of a robot by itself, or of a pair that counts
    gaps = []
    pairs = [[i, j] for j in range(swarm.n) for i in range(j) if not (points[i] and points[j])]
    for chosen in [[j] for j in range(swarm.n)] + pairs:
        some = Swarm(1.0, swarm.turning_radius[chosen], swarm.body_radius[chosen], tuple(swarm.codewords[j] for j in chosen))
        gaps.append(clearance(some, environment, start[chosen], groups, lengths).gap)
    gap = min(gaps)
    if abs(gap - wanted) > 1e-9:
        assert is_clear(swarm, shapes, poses, groups, lengths, wanted) == (gap >= wanted)
    assert clearance(swarm, environment, start, groups, lengths).gap <= gap + 1e-12
    slides = swarm.slides[groups[0] - 1]
    crossing = np.column_stack([np.zeros((swarm.n, 2)), np.arange(swarm.n)])
    nothing = Shapes.of(Environment()).kernel_arguments
    assert slide_is_clear(crossing, slides, 1.0, np.zeros(swarm.n), *nothing, 0.1, 1e-9)


@pytest.mark.parametrize(
    ("planner", "name"),
    [*((planner, "paper-six") for planner in names()),
     *((planner, "paper-six-two-discs") for planner in names() if planner != "optimize_paper")],  # which sees no obstacles
)
@pytest.mark.parametrize("body", [0, [0, 0.3, 0, 0.2, 0, 0]], ids=["points", "mixed"])
def test_every_planner_plans_for_the_papers_points(planner, body, name):
    data = yaml.safe_load((SCENARIOS / f"{name}.yaml").read_text(encoding="utf-8"))
    data["swarm"]["body_radius"] = body
    problem = scenario.parse(yaml.safe_dump(data), EXACT if planner in EXACT_ONES else 1.5).problem
    result = solve(problem, planner, Settings(time_limit=500.0, first=True))
    assert result.success and result.plan.valid, result.reason
    gap = plan_file(result, "six", 0.0)["min_clearance"]
    assert gap == result.plan.clearance.gap and gap >= -problem.slack


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5), st.booleans())
def test_points_that_all_go_to_one_place_get_there(seed, n, among):
    rng = np.random.default_rng(seed)
    among_them = Environment(Workspace(0, 12, 0, 12), (Circle((6, 5), 1.0), Polygon([(3, 8), (5, 8), (4, 9.5)])))
    environment = among_them if among else Environment()
    places = np.array([[1, 1], [11, 1], [11, 11], [1, 11], [8, 8]], dtype=float)
    starts = np.column_stack([rng.permutation(places)[:n], rng.uniform(-3, 3, n)])
    problem = Problem(Swarm(1.0, 1.0, 0.0, binary(n)), environment, starts, np.tile([6.0, 8.0], (n, 1)))
    result = solve(problem, "pure_control", Settings(time_limit=60.0))
    assert result.success, result.reason


def test_a_point_finds_a_gap_of_any_width_and_none_where_there_is_none():
    swarm = Swarm(1.0, 1.0, 0.0, ("1",))
    for width in (1e-9, 0.01, 0.5):
        bars = Polygon([(4, -1), (5, -1), (5, 5), (4, 5)]), Polygon([(4, 5 + width), (5, 5 + width), (5, 11), (4, 11)])
        problem = Problem(swarm, Environment(Workspace(0, 9, 0, 10), bars), [[1, 1, 0]], [[8, 8]])
        assert walled_in(problem) is None
    closed = Polygon([(4, -1), (5, -1), (5, 11), (4, 11)])
    assert walled_in(Problem(swarm, Environment(Workspace(0, 9, 0, 10), (closed,)), [[1, 1, 0]], [[8, 8]])) == 1


def test_a_point_that_stands_for_good_is_in_the_way_of_bodies_only():
    place = np.array([[1.0, 2.0]])
    assert standing(place, np.zeros(1), np.zeros(3)) == ()
    (disc,) = standing(place, np.zeros(1), np.array([0.0, 0.3]))
    assert disc.radius > 0
    (body,) = standing(place, np.array([0.2]), np.zeros(3))
    assert body.radius == 0.2
