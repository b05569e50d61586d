"""What was reached exactly can be left again: plan, volts, robots, poses in metres, plan again, though every length is rounded."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_driver.bench import parse_bench
from stressbot_driver.geometry import touching_slack as slack_of_driver
from stressbot_driver.ros.conversions import description_message, poses_message
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner.collision import clearance as collision
from stressbot_planner.errors import StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.planners import Settings, names, solve
from stressbot_planner.primitives.expansion import Activate
from stressbot_planner.problem.definition import EXACT, Problem
from stressbot_planner.problem.plan import Plan
from stressbot_planner.ros.conversion import scene_from_description, starts_from_poses
from stressbot_planner.sequencing import encode

UNITS = st.sampled_from([1e-4, 3.7e-5, 1.0, 1e-6, 7.3e-7])


class Bench:
    """A file, read by the driver; its robots under volts; and what a planner node makes of both."""

    def __init__(self, text: str):
        bench = parse_bench(text)
        self.swarm_id, self.substrate = bench.swarm_id, Substrate(bench)
        self.scene = scene_from_description(description_message(bench))

    def drive(self, groups, lengths) -> None:
        program = encode(self.scene.swarm, self.scene.electrical, np.asarray(groups), np.asarray(lengths))
        for level, dwell in zip(program.levels, program.dwells, strict=True):
            self.substrate.apply(level)
            self.substrate.advance(dwell)

    def problem(self, goals=None) -> Problem:
        """Return the problem of a request made now; raises if the robots may not be where they are."""
        starts = starts_from_poses(poses_message(self.swarm_id, 0.0, self.substrate.poses()), self.scene)
        goals = starts[:, :2] if goals is None else goals
        return Problem(self.scene.swarm, self.scene.environment, starts, goals)


def file_of(unit, body, starts, goals, more="") -> str:
    robots = "\n".join(f"  - {{start: {list(s)}, goal: {list(g)}}}" for s, g in zip(starts, goals, strict=True))
    swarm = f"swarm: {{speed: 1.3, turning_radius: 0.7, body_radius: {body}, groups: balanced}}"
    return f"name: touching\nlength_unit: {unit:.17e}\n{swarm}\n{more}\nrobots:\n{robots}\n"


@st.composite
def approaches(draw):
    """Return (text of a file, distance): robot 1 is to slide by so much, then it touches a wall, a disc, an edge or robot 2."""
    x, y, away = (draw(st.integers(-9999, 9999)) / 100 for _ in range(3))
    heading, gap, body = draw(st.floats(-3.2, 3.2)), draw(st.integers(1, 9999)) / 1000, draw(st.integers(1, 999)) / 1000
    ahead, beside = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    kind, more, other = draw(st.sampled_from(["wall", "disc", "edge", "robot"])), "", [x - 200.0, y, 0.0]
    if kind == "wall":
        side = x + body + gap
        more = f"workspace: {{x: [{x - 500}, {side}], y: [{y - 500}, {y + 500}]}}"
        gap = (side - body - x) / np.cos(heading) if abs(heading) < 1.2 else gap / 2
    elif kind == "disc":
        radius = abs(away) / 10 + 0.01
        center = np.array([x, y]) + (body + gap + radius) * ahead
        more = f"obstacles: [{{circle: {{center: {center.tolist()}, radius: {radius}}}}}]"
    elif kind == "edge":
        near = np.array([x, y]) + (body + gap) * ahead
        corners = [(near + a * beside + b * ahead).tolist() for a, b in ((-3, 0), (2, 0), (2.5, 4))]
        more = f"obstacles: [{{polygon: {corners}}}]"
    else:
        other = [*(np.array([x, y]) + (2 * body + gap) * ahead).tolist(), 0.0]
    starts = [[x, y, heading], other]
    return file_of(draw(UNITS), body, starts, [start[:2] for start in starts], more), gap


@settings(max_examples=60, deadline=None)
@given(approaches())
def test_a_robot_that_touches_is_where_it_may_be_time_after_time(approach):
    text, distance = approach
    bench = Bench(text)
    swarm = bench.scene.swarm
    alone = int(np.flatnonzero(swarm.membership[:, 0])[0]) + 1
    half = np.pi * float(swarm.turning_radius[0])
    for _ in range(15):
        there = Plan(bench.problem(), (Activate(alone, distance),))
        assert there.keeps(0.0), there.clearance
        bench.drive(there.groups, there.lengths)
        back = Plan(bench.problem(), (Activate(swarm.m, half), Activate(alone, distance), Activate(swarm.m, half)))
        assert back.keeps(0.0), back.clearance
        bench.drive(back.groups, back.lengths)
    ends = bench.problem().starts
    np.testing.assert_allclose(ends[:, :2], bench.scene.starts[:, :2], atol=bench.problem().slack)


CROWD = """
workspace: {x: [0, 9], y: [0.1, 8.3]}
obstacles: [{circle: {center: [4.5, 4.1], radius: 0.7}}, {polygon: [[6.3, 6.1], [7.9, 6.1], [7.1, 7.3]]}]
"""
APART = [[1.1, 1.3, 0.3], [1.2, 4.0, 0.1], [1.3, 6.9, -0.4], [3.1, 2.0, 2.0]]
TOUCHING = [[8.7, 0.4], [8.1, 0.4], [5.5, 4.1], [7.0, 5.8]]  # two walls · a robot and a wall · the disc · an edge


@pytest.mark.parametrize("planner", ["optimize", "pure_control"])
@pytest.mark.parametrize("unit", [1e-4, 3.7e-5])
def test_planners_reach_places_that_touch_and_leave_them_again(planner, unit):
    bench = Bench(file_of(unit, 0.3, APART, TOUCHING, CROWD))
    for goals in 2 * (TOUCHING, [start[:2] for start in APART]):
        result = solve(bench.problem(np.array(goals)), planner, Settings(time_limit=60.0, first=True))
        assert result.success, result.reason
        bench.drive(result.plan.groups, result.plan.lengths)
    bench.problem()


@pytest.mark.parametrize("planner", names())
def test_every_planner_leaves_a_wall_and_a_neighbour_that_are_touched(planner):
    starts, goals = [[0.3, 3.0, 2.0], [0.9, 3.0, 0.1], [5.0, 0.3, -0.5]], [[3.0, 1.0], [4.0, 5.0], [6.0, 3.0]]
    bench = Bench(file_of(1e-4, 0.3, starts, goals, "workspace: {x: [0, 9], y: [0, 9]}"))
    exact = planner in ("optimize", "optimize_paper", "pure_control")
    problem = replace(bench.problem(np.array(goals)), tolerance=EXACT if exact else 1.0)
    result = solve(problem, planner, Settings(time_limit=60.0, first=True))
    assert result.success, result.reason


@st.composite
def decimal_neighbours(draw):
    """Return (digits, x_1, x_2, y, body) of two bodies in a row that touch, as decimals of so many digits."""
    digits = draw(st.integers(1, 6))
    first, body, y = (draw(st.integers(low, 10**6)) for low in (-(10**6), 1, -(10**6)))
    return digits, *(f"{value}e-{digits}" for value in (first, first + 2 * body, y, body))


@settings(max_examples=150, deadline=None)
@given(decimal_neighbours(), UNITS, st.booleans())
def test_decimal_places_that_touch_are_taken_by_file_driver_and_node(neighbours, unit, apart):
    _, first, second, y, body = neighbours
    # the walls touch too
    walls = f"workspace: {{x: [{float(first) - float(body)!r}, {float(second) + float(body)!r}], y: [-1e7, 1e7]}}" if apart else ""
    starts = [[first, y, 0], [second, y, 0]]
    text = file_of(unit, body, starts, [start[:2] for start in starts], walls).replace("'", "")
    scenario.parse(text)
    Bench(text).problem()


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 10**6), st.floats(-7, -1), UNITS, st.sampled_from([0.0, 0.01, 3.0, 1e5]))
def test_who_overlaps_by_more_is_refused_by_both_alike(place, share, unit, body):
    x, overlap = place / 1000, 10**share * (body or 1.0)
    starts = [[x, 1.0, 0.0], [x + 2 * body - overlap if body else x + 5.0, 1.0, 0.0]]
    walls = "" if body else f"workspace: {{x: [{x + overlap}, 1e5], y: [-5, 5]}}"
    text = file_of(unit, body, starts, [start[:2] for start in starts], walls)
    if overlap < 10 * slack_of_driver(np.array([body]), [np.array(starts)], np.full(4, 1e5 if walls else 0.0), []):
        return
    with pytest.raises(StressbotError) as ours:
        scenario.parse(text)
    with pytest.raises(StressbotError) as theirs:
        parse_bench(text)
    assert int(ours.value.code) == int(theirs.value.code)


@settings(max_examples=60, deadline=None)
@given(approaches())
def test_both_halves_have_one_slack(approach):
    loaded, bench = scenario.parse(approach[0]), parse_bench(approach[0])
    slack = slack_of_driver(bench.body_radius, [bench.start[:, :2], bench.goal], bench.workspace, bench.obstacles)
    assert slack == pytest.approx(loaded.problem.slack * loaded.length_unit, rel=1e-12)
    assert collision.TOUCHING <= 1e-9  # small beside anything that can be measured


def test_a_robot_at_a_wall_may_turn_and_slide_along_it():
    starts, goals = [[0.3, 3.0, np.pi / 2], [5.0, 5.0, 0.0]], [[0.3, 4.0], [5.0, 5.0]]
    problem = Bench(file_of(1e-4, 0.3, starts, goals, "workspace: {x: [0, 9], y: [0, 9]}")).problem()
    swarm = problem.swarm
    surroundings = swarm.body_radius, *collision.Shapes.of(problem.environment).kernel_arguments
    for heading, clear in ((np.pi / 2, True), (-np.pi / 2, True), (0.1, True), (np.pi / 2 + 1e-6, False), (3.0, False)):
        poses = problem.starts.copy()
        poses[0, 2] = heading
        assert collision.slide_is_clear(poses, swarm.membership[1], 1.0, *surroundings, 0.015, problem.slack) == clear
