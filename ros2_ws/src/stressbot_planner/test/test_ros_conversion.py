"""Messages and values: there and back again, and what is refused on the way."""

from math import inf, nan, pi
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stressbot_msgs.msg import ElectricalDescription, MotionPlan, Obstacle, SwarmDescription, SwarmPoses
from stressbot_msgs.msg import Primitive as PrimitiveMsg
from stressbot_msgs.srv import PlanMotion

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.execution.worker import Report
from stressbot_planner.model.electrical import Pulses
from stressbot_planner.model.environment import Circle, Polygon, Workspace
from stressbot_planner.primitives import expansion as primitives
from stressbot_planner.primitives.expansion import Activate, Extract, Isolate, Orient, Subgroup, Translate, Turn, TurnAll
from stressbot_planner.problem.definition import Problem
from stressbot_planner.ros import conversion
from stressbot_planner.ros.goals import MOST_STAGES, goals_of_request, in_words, named_for_request
from stressbot_planner.ros.unfolding import activations_of_plan, ends_of_plan
from stressbot_planner.sequencing import VoltageProgram, encode

UNIT = 1e-4


def make_description(**changes):
    n = 6
    values = {
        "name": "test",
        "swarm_id": "abc",
        "length_unit": UNIT,
        "ids": [11, 12, 13, 14, 15, 16],
        "speed": [UNIT * 2.0] * n,
        "turning_radius": [UNIT] * n,
        "body_radius": [0.3 * UNIT] * n,
        "group_count": 4,
        "codewords": [f"{k:03b}" for k in range(1, n + 1)],
        "start": [value for k in range(n) for value in (UNIT * k, UNIT * 2 * k, 0.1 * k)],
        "goal": [value for k in range(n) for value in (UNIT * 10, UNIT * 2 * k)],
        "assign": [15, 12],
        "workspace": [-1e-3, 3e-3, -2e-3, 4e-3],
        "obstacles": [
            Obstacle(kind=Obstacle.CIRCLE, x=[1e-3], y=[-1e-3], radius=2e-4),
            Obstacle(kind=Obstacle.POLYGON, x=[2e-3, 2.5e-3, 2e-3], y=[2e-3, 2e-3, 2.5e-3]),
        ],
        "electrical": ElectricalDescription(
            rest_level=0.0, symbol_levels=[40.0, 60.0], reset_level=90.0, drive_level=140.0,
            thresholds=[20.0, 50.0, 75.0, 115.0], hysteresis=4.0, pull_down=120.0, release=30.0, reset_dwell=0.01,
            symbol_dwell=0.01, guard_dwell=0.005, min_dwell=0.002, code_length=2, codes=[0, 0, 0, 1, 1, 0, 1, 1],
            min_level=0.0, max_level=200.0,
        ),
    }
    return SwarmDescription(**{**values, **changes})


SCENE = conversion.scene_from_description(make_description())


def test_a_description_becomes_a_scene_in_units():
    assert SCENE.swarm.m == 4
    assert SCENE.swarm.speed == pytest.approx(2.0, rel=1e-15) and SCENE.swarm.equal_speeds
    slow = conversion.scene_from_description(make_description(speed=[UNIT * v for v in (1.0, 2.0, 4.0, 1.0, 1.0, 3.0)])).swarm
    assert slow.speed == pytest.approx(4.0, rel=1e-15)
    np.testing.assert_allclose(slow.pace, [0.25, 0.5, 1.0, 0.25, 0.25, 0.75], rtol=1e-15)
    np.testing.assert_allclose(SCENE.swarm.body_radius, 0.3, rtol=1e-15)
    np.testing.assert_allclose(SCENE.starts[2], [2.0, 4.0, 0.2], rtol=1e-15)
    np.testing.assert_allclose(SCENE.goals[5], [10.0, 10.0], rtol=1e-15)
    assert SCENE.exchangeable == (1, 4)
    assert SCENE.environment.workspace == Workspace(-10.0, 30.0, -20.0, 40.0)
    circle, polygon = SCENE.environment.obstacles
    assert isinstance(circle, Circle)
    assert circle.radius == pytest.approx(2.0)
    assert isinstance(polygon, Polygon)
    assert polygon.vertices.shape == (3, 2)
    assert SCENE.electrical.codes == ((0, 0), (0, 1), (1, 0), (1, 1))


@pytest.mark.parametrize(
    "changes",
    [
        {"length_unit": 0.0},
        {"length_unit": nan},
        {"ids": [1, 2]},
        {"assign": [1]},
        {"ids": [1, 2, 3, 4, 5, 5]},
        {"speed": [UNIT] * 5 + [nan]},
        {"speed": [UNIT]},
        {"speed": [0.0] * 6},
        {"group_count": 5},
        {"codewords": ["001"] * 6},
        {"workspace": [0.0, 1.0]},
        {"obstacles": [Obstacle(kind=7, x=[0.0], y=[0.0])]},
        {"obstacles": [Obstacle(kind=Obstacle.POLYGON, x=[0.0], y=[0.0])]},
        {"electrical": ElectricalDescription()},
        {"heading_bias": [0.1] * 6},
    ],
)
def test_a_description_that_contradicts_itself_is_refused(changes):
    with pytest.raises(StressbotError):
        conversion.scene_from_description(make_description(**changes))


lengths = st.one_of(st.just(0.0), st.floats(1e-9, 1e3))
signed = st.one_of(lengths, lengths.map(lambda value: -value))
groups = st.integers(1, 3)
excursions = st.one_of(st.just(inf), st.floats(1e-2, 1e2))
robots = st.integers(1, 6)
some_robots = st.lists(robots, min_size=0, max_size=6, unique=True).map(tuple)
KINDS = {
    Activate: st.builds(Activate, st.integers(1, 4), lengths),
    Turn: st.builds(Turn, groups, signed, excursions),
    TurnAll: st.builds(TurnAll, signed),
    Translate: st.builds(Translate, groups, signed, excursions),
    Orient: some_robots.flatmap(
        lambda ids: st.builds(Orient, st.just(ids), st.tuples(*[signed] * len(ids)), excursions)
    ),
    Subgroup: st.builds(Subgroup, groups, lengths, st.tuples(groups), st.tuples(groups), excursions),
    Isolate: st.builds(Isolate, robots, lengths, groups, excursions),
    Extract: st.builds(Extract, some_robots, groups, lengths, excursions),
}


def test_every_kind_of_primitive_has_a_message():
    assert set(KINDS) == set(primitives.Primitive.__args__)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_primitives_go_there_and_back_again(kind):
    @given(KINDS[kind])
    @settings(max_examples=60, deadline=None)
    def check(primitive):
        back = conversion.primitive_from_message(conversion.primitive_to_message(primitive, SCENE), SCENE)
        assert type(back) is type(primitive)
        for name, value in vars(primitive).items():
            assert getattr(back, name) == pytest.approx(value, rel=4e-16, abs=0)

    check()


def test_messages_name_robots_by_id():
    message = conversion.primitive_to_message(Isolate(2, 1.0, 1), SCENE)
    assert message.robots.tolist() == [12]
    assert message.distance == pytest.approx(UNIT)
    assert message.excursion == 0.0


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"kind": 0}, ErrorCode.INVALID_PLAN),
        ({"kind": 99}, ErrorCode.INVALID_PLAN),
        ({"kind": PrimitiveMsg.ACTIVATE, "group": 1, "distance": nan}, ErrorCode.NOT_FINITE),
        ({"kind": PrimitiveMsg.TURN, "group": 1, "angle": inf}, ErrorCode.NOT_FINITE),
        ({"kind": PrimitiveMsg.TURN, "group": 1, "angle": pi, "excursion": -1.0}, ErrorCode.OUT_OF_RANGE),
        ({"kind": PrimitiveMsg.ORIENT, "robots": [11], "angles": [nan]}, ErrorCode.NOT_FINITE),
        ({"kind": PrimitiveMsg.ORIENT, "robots": [1], "angles": [1.0]}, ErrorCode.UNKNOWN_ROBOT),
        ({"kind": PrimitiveMsg.ISOLATE, "group": 1}, ErrorCode.WRONG_COUNT),
        ({"kind": PrimitiveMsg.ORIENT, "robots": [11], "angles": [1.0] * 100_000}, ErrorCode.WRONG_COUNT),
        ({"kind": PrimitiveMsg.SUBGROUP, "group": 1, "inside": [1] * 100_000}, ErrorCode.WRONG_COUNT),
        ({"kind": PrimitiveMsg.ISOLATE, "group": 1, "robots": [11, 12]}, ErrorCode.WRONG_COUNT),
    ],
)
def test_ill_formed_primitives_are_refused(fields, code):
    with pytest.raises(StressbotError) as refusal:
        conversion.primitive_from_message(PrimitiveMsg(**fields), SCENE)
    assert refusal.value.code == code


def make_poses(ids):
    return SwarmPoses(swarm_id="abc", ids=ids, x=[UNIT * robot for robot in ids], y=[0.0] * len(ids), heading=[0.5] * len(ids))


def test_poses_are_sorted_by_the_scene():
    poses = conversion.starts_from_poses(make_poses([16, 15, 14, 13, 12, 11]), SCENE)
    np.testing.assert_allclose(poses, [[robot, 0.0, 0.5] for robot in range(11, 17)])


def test_robots_that_nobody_sees_are_named():
    with pytest.raises(StressbotError, match="robots 12, 15") as refusal:
        conversion.starts_from_poses(make_poses([11, 13, 14, 16]), SCENE)
    assert refusal.value.code == ErrorCode.NO_SWARM


def test_a_plan_message_is_in_metres_with_headings_wrapped():
    end = np.array([[k, 2.0 * k, 100.0 + k] for k in range(6)])
    report = Report(True, ErrorCode.NONE, "", 0.1, (Activate(1, 2.0),), end, 1, 5.0, 6.0, 1e-8, 0.5, SCENE.goals)
    message = conversion.plan_to_message(report, SCENE.starts, SCENE, "id", "optimize", 3)
    assert (message.swarm_id, message.plan_id, message.planner, message.seed) == ("abc", "id", "optimize", 3)
    assert message.path_length == pytest.approx(5.0 * UNIT)
    assert message.min_clearance == pytest.approx(0.5 * UNIT)
    assert message.selection_time == pytest.approx(SCENE.electrical.selection_time)
    np.testing.assert_allclose(message.goal, SCENE.goals.ravel() * UNIT, rtol=1e-15)
    start, predicted = conversion.poses_from_plan(message, SCENE)
    np.testing.assert_allclose(start, SCENE.starts, rtol=1e-15)
    np.testing.assert_allclose(predicted[:, :2], end[:, :2], rtol=1e-15)
    assert np.all(np.abs(predicted[:, 2]) <= pi)
    np.testing.assert_allclose(np.exp(1j * predicted[:, 2]), np.exp(1j * end[:, 2]), atol=1e-13)


def test_sequences_go_there_and_back_again():
    program = VoltageProgram([1.0, 2.0, 3.0], [0.1, 0.2, 0.3], [2, 3])
    message = conversion.sequence_to_message(program, "plan", "swarm")
    assert message.duration == pytest.approx(0.6)
    assert conversion.program_from_message(message) == program


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("is 1e-06 units: give 0.03 units or more", "is 1e-10 m: give 3e-06 m or more"),
        ("leaves a robot 9.01 units from its goal", "leaves a robot 0.000901 m from its goal"),
        ("leaves a robot 9 units from its goal", "leaves a robot 0.0009 m from its goal"),
        ("0.5 units between robot 2 and robot 1", "5e-05 m between robot 22 and robot 11"),
        ("after 3 nodes, not robots 1, 3", "after 3 nodes, not robots 11, 33"),
        ("at x -2 units, y 3e+05 units", "at x -0.0002 m, y 30 m"),
        ("goals[0] is 2 units from goals[1]", "the goal of robot 11 is 0.0002 m from the goal of robot 33"),
    ],
)
def test_sentences_of_the_library_come_in_metres_and_ids(text, expected):
    scene = SimpleNamespace(unit=1e-4, ids=np.array([11, 22, 33]))
    assert in_words(text, scene, (0, 2)) == expected


def refusal_of(request):
    """Return how a request is refused, from the starts of the scene."""
    asked = goals_of_request(request, SCENE, SCENE.starts)
    try:
        Problem(
            SCENE.swarm, SCENE.environment, SCENE.starts, asked.places, 1e-6, asked.exchangeable, asked.headings,
            parked=asked.parked, waypoints=asked.waypoints,
        )
    except StressbotError as error:
        return named_for_request(error, SCENE, request, asked.exchangeable)
    return None


@given(st.permutations(SCENE.ids.tolist()), st.integers(1, 6), st.integers(1, 5), st.data())
@settings(deadline=None, max_examples=60)
def test_a_place_that_cannot_be_is_named_by_its_entry_whatever_its_stage(ids, count, stages, data):
    robots = ids[:count]
    x, y = ([UNIT * SCENE.starts[robot - 11, axis] for robot in robots] * stages for axis in (0, 1))
    entry = data.draw(st.integers(0, stages * count - 1))
    x[entry] = 2.99e-3
    found = refusal_of(PlanMotion.Request(robots=robots, goal_x=x, goal_y=y))
    assert (found.code, found.field) == (ErrorCode.OUTSIDE_WORKSPACE, f"goal_x[{entry}], goal_y[{entry}]")
    assert f"robot {robots[entry % count]} at x 0.00299 m" in found.message


def test_a_heading_that_cannot_be_and_who_cannot_be_parked_are_named_by_their_entries():
    asked = {"robots": [16, 15, 14, 13, 12], "goal_x": (UNIT * SCENE.starts[:0:-1, 0]).tolist() * 2}
    asked["goal_y"] = (UNIT * SCENE.starts[:0:-1, 1]).tolist() * 2
    found = refusal_of(PlanMotion.Request(**asked, goal_heading=[0.0] * 5))
    assert found.code == ErrorCode.INFEASIBLE and "has a heading that follows from" in found.message
    assert found.field == f"goal_heading[{asked['robots'].index(int(found.message.split()[4]))}]"
    found = refusal_of(PlanMotion.Request(parked=[14, 12]))
    assert (found.code, found.field) == (ErrorCode.INFEASIBLE, "parked[1]") and found.message.startswith("robot 12 is parked")


def test_a_request_has_no_more_stages_than_a_file_may_have_and_parks_nobody_who_has_a_contact():
    one = PlanMotion.Request(robots=[11], goal_x=[0.0] * MOST_STAGES, goal_y=[0.0] * MOST_STAGES)
    assert len(goals_of_request(one, SCENE, SCENE.starts).waypoints) == 100
    one.goal_x, one.goal_y = [0.0] * (MOST_STAGES + 1), [0.0] * (MOST_STAGES + 1)
    with pytest.raises(StressbotError) as refusal:
        goals_of_request(one, SCENE, SCENE.starts)
    assert (refusal.value.code, refusal.value.field) == (ErrorCode.LIMIT_EXCEEDED, "goal_x")
    scene = conversion.scene_from_description(make_description(contact=[12, 16]))
    with pytest.raises(StressbotError, match="is 16, which has a contact") as refusal:
        goals_of_request(PlanMotion.Request(parked=[13, 16]), scene, scene.starts)
    assert (refusal.value.code, refusal.value.field) == (ErrorCode.UNSUPPORTED, "parked[1]")


def pulsing(**changes):
    electrical = make_description().electrical
    for name, value in {
        "frequency": 1e4, "low_level": 110.0, "duty": 0.4, "alternating": True, "response": 1e-5, "min_level": -200.0,
        "thresholds": [20.0, 50.0, 75.0, 100.0, 125.0], **changes,
    }.items():
        setattr(electrical, name, value)
    return conversion.scene_from_description(make_description(electrical=electrical))


def test_a_description_of_pulses_and_a_sequence_of_trains_come_back():
    scene = pulsing()
    assert scene.electrical.drive == Pulses(low_level=110.0, frequency=1e4, duty=0.4, alternating=True, response=1e-5)
    assert SCENE.electrical.drive is None
    program = encode(scene.swarm, scene.electrical, np.array([1, 4, 2]), np.array([1.0, 2.0, 3.0]))
    assert sorted(program.pulses[program.pulses > 0].tolist()) == [5000, 10_000, 15_000]
    assert conversion.program_from_message(conversion.sequence_to_message(program, "plan", "abc")) == program


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"frequency": 4.1e4}, "electrical.drive.frequency"),
        ({"frequency": 1e-4}, "electrical.drive.frequency"),
        ({"frequency": nan}, "electrical.drive.frequency"),
        ({"low_level": 90.0}, "electrical.drive.low_level"),
        ({"low_level": 140.0}, "electrical.drive_level"),
        ({"duty": 1.0}, "electrical.drive.duty"),
        ({"response": 0.1}, "electrical.drive.response"),
        ({"min_level": 0.0}, "electrical.min_level"),
    ],
)
def test_pulses_that_cannot_be_are_refused(changes, field):
    with pytest.raises(StressbotError) as refusal:
        pulsing(**changes)
    assert refusal.value.field == field


def test_a_plan_tells_where_it_begins_and_what_it_does():
    start = np.arange(18.0).reshape(6, 3)
    primitive = conversion.primitive_to_message(Activate(2, 3.0), SCENE)
    plan = MotionPlan(start=(start * (UNIT, UNIT, 1.0)).ravel().tolist(), primitives=[primitive])
    starts, goals = ends_of_plan(plan, SCENE)
    np.testing.assert_allclose(starts, start)
    np.testing.assert_array_equal(goals, SCENE.goals)
    groups, lengths = activations_of_plan(plan, SCENE)
    assert groups.tolist() == [2] and lengths == pytest.approx([3.0])
    plan.goal = [UNIT] * 12
    np.testing.assert_allclose(ends_of_plan(plan, SCENE)[1], np.ones((6, 2)))


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"start": [0.0] * 4}, ErrorCode.WRONG_COUNT),
        ({"start": []}, ErrorCode.WRONG_COUNT),
        ({"start": [0.0] * 18, "goal": [0.0] * 3}, ErrorCode.WRONG_COUNT),
        ({"start": [nan] * 18}, ErrorCode.NOT_FINITE),
        ({"start": [0.0] * 18, "goal": [inf] * 12}, ErrorCode.NOT_FINITE),
    ],
)
def test_a_plan_whose_ends_cannot_be_is_refused(fields, code):
    with pytest.raises(StressbotError) as caught:
        ends_of_plan(MotionPlan(**fields), SCENE)
    assert caught.value.code == code
