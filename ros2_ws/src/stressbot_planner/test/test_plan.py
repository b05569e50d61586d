"""Plans follow from their primitives; plan files come back as they went, or are refused by field."""

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import plan_file as plan
from stressbot_planner.formats.plan_file import plan_file, primitive_to_dict, read_plan_file, write_plan_file
from stressbot_planner.model.allocation import binary
from stressbot_planner.model.environment import Circle, Environment
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import Settings, solve
from stressbot_planner.primitives.expansion import Activate, Extract, Isolate, Orient, Subgroup, Translate, Turn, TurnAll
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Failed, Plan, Result, Solved

EVERY_KIND = (
    Activate(1, 1.5), Turn(2, -0.5, 0.3), TurnAll(1.0), Translate(3, -2.0, 0.7), Orient((1, 2, 6), (0.1, -0.2, 0.3)),
    Subgroup(1, 1.0, (), (2,)), Subgroup(1, 0.5, (3,), (), 0.4), Isolate(6, 0.25, 2), Extract((4, 5), 1, 0.5, 1.0),
)


def problem(**changes) -> Problem:
    heights = np.linspace(2, 18, 6)
    values = {
        "swarm": Swarm(2.0, 1.0, 0.3, binary(6)), "environment": Environment(),
        "starts": np.column_stack([np.zeros(6), heights, np.zeros(6)]), "goals": np.column_stack([np.full(6, 12), heights]),
    }
    return Problem(**(values | changes))


def result(primitives=EVERY_KIND, success=False, **changes) -> Result:
    plan = None if primitives is None else Plan(problem(), primitives)
    values = {"planner": "optimize", "seed": 3, "plan": plan, "planning_time": 0.5}
    if success:
        return Solved(**(values | changes))
    return Failed(**({"code": ErrorCode.NO_PLAN_FOUND, "reason": "too hard"} | values | changes))


def stored(tmp_path, change=None, text=None, name="six"):
    """Write a plan file, change it, read it back."""
    data = json.loads(json.dumps(plan_file(result(), "six", 0.05)))
    if change is not None:
        change(data)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(data) if text is None else text)
    return read_plan_file(path, problem(), name)


# --- plans ----------------------------------------------------------------------------------------------------------


def test_figures_of_a_plan_follow_from_its_activations():
    plan = Plan(problem(), (Activate(1, 3.0), TurnAll(1.0), Activate(2, 2.0)))
    assert plan.groups.tolist() == [1, 4, 2]
    assert plan.lengths.tolist() == [3.0, 1.0, 2.0]
    np.testing.assert_array_equal(plan.poses, replay(problem().swarm, problem().starts, plan.groups, plan.lengths))
    assert plan.path_length == 3 * 3.0 + 3 * 2.0
    assert plan.execution_time == 6.0 / 2.0
    assert plan.goal_error == pytest.approx(np.hypot(*(plan.poses[-1, :, :2] - problem().goals).T).max())
    assert not plan.valid


def test_plans_are_immutable():
    plan = Plan(problem(), EVERY_KIND)
    for array in (plan.groups, plan.lengths, plan.poses):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_a_plan_is_valid_only_without_a_collision_and_at_its_goals():
    start = [[0, 0, 0]]
    swarm = Swarm(1.0, 1.0, 0.3, ("1",))
    there = (Activate(1, 10.0),)
    assert Plan(Problem(swarm, Environment(), start, [[10, 0]]), there).valid
    assert not Plan(Problem(swarm, Environment(), start, [[10, 0.001]]), there).valid
    assert Plan(Problem(swarm, Environment(), start, [[10, 0.001]], tolerance=0.01), there).valid
    assert not Plan(Problem(swarm, Environment(None, (Circle((5, 0), 1),)), start, [[10, 0]]), there).valid


# --- plan files -----------------------------------------------------------------------------------------------------


def test_a_plan_file_has_the_fields_of_the_contract():
    data = plan_file(result(history=((0.1, 5.0, 6.0),), details={"starts": 2}), "six", 0.05)
    wanted = {
        "scenario", "planner", "seed", "success", "planning_time", "primitives", "activations", "path_length", "execution_time",
        "min_clearance", "goal_error", "lower_bounds", "history",
    }
    assert wanted <= set(data)
    assert all(1 <= group <= 4 and length >= 0 for group, length in data["activations"])
    assert data["lower_bounds"].keys() == {"path_length", "execution_time"}
    assert data["selection_time"] == pytest.approx(0.05 * len(data["activations"]))
    json.dumps(data, allow_nan=False)


def test_a_plan_without_anything_to_hit_has_no_clearance():
    lone = Problem(Swarm(1.0, 1.0, 0.3, ("1",)), Environment(), [[0, 0, 0]], [[1, 0]])
    data = plan_file(result(plan=Plan(lone, (Activate(1, 1.0),))), "one", 0.05)
    assert data["min_clearance"] is None


def test_a_failure_without_any_plan_is_written_too(tmp_path):
    data = plan_file(result(None), "six", 0.05)
    assert (data["success"], data["reason"], data["primitives"], data["activations"]) == (False, "too hard", [], [])
    write_plan_file(tmp_path / "p.json", data)
    assert read_plan_file(tmp_path / "p.json", problem(), "six").plan.groups.size == 0


def test_goals_that_were_assigned_are_recorded_and_read_back(tmp_path):
    listed = problem(exchangeable=(0, 3, 4))
    taken = replace(listed, goals=listed.goals[[4, 1, 2, 0, 3, 5]])
    write_plan_file(tmp_path / "p.json", plan_file(result(plan=Plan(taken, EVERY_KIND)), "six", 0.05))
    back = read_plan_file(tmp_path / "p.json", listed, "six").plan
    np.testing.assert_array_equal(back.problem.goals, taken.goals)
    assert back.goal_error == Plan(taken, EVERY_KIND).goal_error
    # the same goals in another scenario, where they are not free to take
    for other in (problem(), problem(exchangeable=(0, 3)), problem(exchangeable=(0, 3, 4), goals=listed.goals + [[1, 0]])):
        with pytest.raises(StressbotError) as caught:
            read_plan_file(tmp_path / "p.json", other, "six")
        assert (caught.value.code, caught.value.field) == (ErrorCode.INVALID_PLAN, "goals")


def test_a_plan_is_judged_by_the_tolerance_that_it_was_made_with(tmp_path):
    wide = Plan(replace(problem(), tolerance=100.0), (Activate(1, 3.0),))
    write_plan_file(tmp_path / "p.json", plan_file(result(plan=wide), "six", 0.05))
    assert wide.valid and read_plan_file(tmp_path / "p.json", problem(), "six").plan.valid
    data = json.loads((tmp_path / "p.json").read_text())
    del data["tolerance"]  # as in older files
    (tmp_path / "p.json").write_text(json.dumps(data))
    assert not read_plan_file(tmp_path / "p.json", problem(), "six").plan.valid


def test_goals_that_are_fixed_are_not_recorded():
    assert "goals" not in plan_file(result(), "six", 0.05)


def test_every_kind_of_primitive_comes_back_as_it_went(tmp_path):
    write_plan_file(tmp_path / "p.json", plan_file(result(), "six", 0.05))
    back = read_plan_file(tmp_path / "p.json", problem(), "six")
    assert back.plan.primitives == EVERY_KIND
    assert (back.planner, back.seed, back.success) == ("optimize", 3, False)
    np.testing.assert_array_equal(back.plan.lengths, Plan(problem(), EVERY_KIND).lengths)


@given(st.lists(st.tuples(st.integers(1, 4), st.floats(0, 1e6)), max_size=10))
def test_any_activations_come_back_exactly(tmp_path_factory, pairs):
    path = tmp_path_factory.mktemp("plan") / "p.json"
    primitives = tuple(Activate(*pair) for pair in pairs)
    write_plan_file(path, plan_file(result(primitives), "six", 0.05))
    assert read_plan_file(path, problem(), "six").plan.primitives == primitives


def test_an_unlimited_excursion_is_left_out():
    assert primitive_to_dict(Turn(1, 2.0)) == {"kind": "Turn", "group": 1, "angle": 2.0}
    assert primitive_to_dict(Orient((1,), (2.0,), 0.5)) == {"kind": "Orient", "robots": [1], "angles": [2.0], "excursion": 0.5}


def put(*way):
    """Return a change that puts the last argument at the place that the others lead to, or removes it by `...`."""
    *path, last, value = way

    def change(data):
        place = data
        for part in path:
            place = place[part]
        if value is ...:
            del place[last]
        else:
            place[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "code", "field"),
    [
        *(
            (put(key, ...), ErrorCode.MISSING_FIELD, key)
            for key in ("scenario", "planner", "seed", "success", "primitives", "activations")
        ),
        (put("scenario", "seven"), ErrorCode.WRONG_SWARM, "scenario"),
        (put("scenario", 7), ErrorCode.WRONG_TYPE, "scenario"),
        (put("planner", "rrt\x1b[2J"), ErrorCode.OUT_OF_RANGE, "planner"),
        (put("planner", "\ud800"), ErrorCode.OUT_OF_RANGE, "planner"),
        (put("planner", "a" * 5000), ErrorCode.OUT_OF_RANGE, "planner"),
        (put("seed", "3"), ErrorCode.WRONG_TYPE, "seed"),
        (put("seed", True), ErrorCode.WRONG_TYPE, "seed"),
        (put("success", 1), ErrorCode.WRONG_TYPE, "success"),
        (put("primitives", {}), ErrorCode.WRONG_TYPE, "primitives"),
        (put("primitives", 0, 3), ErrorCode.WRONG_TYPE, "primitives[0]"),
        (put("primitives", 0, "kind", "Jump"), ErrorCode.INVALID_PLAN, "primitives[0].kind"),
        (put("primitives", 0, "kind", ["Turn"]), ErrorCode.INVALID_PLAN, "primitives[0].kind"),
        (put("primitives", 0, "kind", ...), ErrorCode.INVALID_PLAN, "primitives[0].kind"),
        (put("primitives", 0, "length", ...), ErrorCode.MISSING_FIELD, "primitives[0].length"),
        (put("primitives", 0, "speed", 1), ErrorCode.UNKNOWN_FIELD, "primitives[0].speed"),
        (put("primitives", 0, "length", float("nan")), ErrorCode.NOT_FINITE, "primitives[0].length"),
        (put("primitives", 0, "length", float("inf")), ErrorCode.NOT_FINITE, "primitives[0].length"),
        (put("primitives", 0, "length", 10**400), ErrorCode.NOT_FINITE, "primitives[0].length"),
        (put("primitives", 0, "length", -1.0), ErrorCode.OUT_OF_RANGE, "primitives[0].length"),
        (put("primitives", 0, "group", 9), ErrorCode.UNKNOWN_GROUP, "primitives[0].group"),
        (put("primitives", 0, "group", 1.5), ErrorCode.WRONG_TYPE, "primitives[0].group"),
        (put("primitives", 4, "robots", [1, 2, "6"]), ErrorCode.WRONG_TYPE, "primitives[4].robots[2]"),
        (put("primitives", 4, "robots", [1, 2, 9]), ErrorCode.UNKNOWN_ROBOT, "primitives[4].robot"),
        (put("primitives", 1, "excursion", 1e-12), ErrorCode.OUT_OF_RANGE, "primitives[1].excursion"),
        (put("activations", 0, 3), ErrorCode.WRONG_TYPE, "activations[0]"),
        (put("activations", 0, [1]), ErrorCode.WRONG_COUNT, "activations[0]"),
        (put("activations", 0, 0, 9), ErrorCode.UNKNOWN_GROUP, "activations[0][0]"),
        (put("activations", 0, 0, "1"), ErrorCode.WRONG_TYPE, "activations[0][0]"),
        (put("activations", 2, 1, -1.0), ErrorCode.OUT_OF_RANGE, "activations[2][1]"),
        (put("activations", 2, 1, float("nan")), ErrorCode.NOT_FINITE, "activations[2][1]"),
        (put("activations", 0, 1, 7.0), ErrorCode.INVALID_PLAN, "activations"),
        (put("activations", []), ErrorCode.INVALID_PLAN, "activations"),
        (put("goals", 3), ErrorCode.WRONG_TYPE, "goals"),
        (put("goals", [[1, 2]]), ErrorCode.WRONG_COUNT, "goals"),
        (put("goals", [[1, 2]] * 5 + [3]), ErrorCode.WRONG_TYPE, "goals[5]"),
        (put("goals", [[1, 2]] * 5 + [[1]]), ErrorCode.WRONG_COUNT, "goals[5]"),
        (put("goals", [[1, 2]] * 5 + [[1, "2"]]), ErrorCode.WRONG_TYPE, "goals[5][1]"),
        (put("goals", [[1, 2]] * 5 + [[1, float("nan")]]), ErrorCode.NOT_FINITE, "goals[5][1]"),
        (put("goals", [[1, 2]] * 6), ErrorCode.INVALID_PLAN, "goals"),
        (put("tolerance", "1"), ErrorCode.WRONG_TYPE, "tolerance"),
        (put("tolerance", 0), ErrorCode.OUT_OF_RANGE, "tolerance"),
        (put("tolerance", float("nan")), ErrorCode.NOT_FINITE, "tolerance"),
    ],
)
def test_bad_plan_files_are_refused_with_their_own_code(tmp_path, change, code, field):
    with pytest.raises(StressbotError) as caught:
        stored(tmp_path, change)
    assert (caught.value.code, caught.value.field) == (code, field)


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "3", "null", "{'a': 1}", "[" * 100_000, "9" * 5000, '{"scenario": "six"',
                                  '{"a": 1, "a": 2}', '{"a": {"b": 1, "b": 1}}'])
def test_what_is_not_a_json_object_is_malformed(tmp_path, text):
    with pytest.raises(StressbotError) as caught:
        stored(tmp_path, text=text)
    assert caught.value.code == ErrorCode.MALFORMED_FILE


def test_files_without_an_end_or_a_writer_and_too_large_ones_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "MAX_BYTES", 1000)
    os.mkfifo(tmp_path / "pipe")
    for path in ("/dev/zero", tmp_path / "pipe"):
        with pytest.raises(StressbotError, match="no regular file"):
            read_plan_file(path, problem(), "six")
    (tmp_path / "large").write_text(" " * 1001)
    with pytest.raises(StressbotError, match="more than 1000 bytes"):
        read_plan_file(tmp_path / "large", problem(), "six")


@pytest.mark.parametrize("number", [np.int64, np.uint8, np.float32, np.float64])
def test_numbers_of_numpy_are_written_as_numbers(tmp_path, number):
    found = replace(result((Activate(1, number(2)),)), seed=number(3), history=((number(1), number(2), number(3)),))
    details = {"nodes": number(7), "rows": np.arange(2)}
    write_plan_file(tmp_path / "p.json", plan_file(replace(found, details=details), "six", number(1)))
    data = json.loads((tmp_path / "p.json").read_text())
    assert (data["seed"], data["details"]) == (3, {"nodes": 7, "rows": [0, 1]})


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    for name in ("missing", "binary", ".", "nul\0"):
        with pytest.raises(StressbotError) as caught:
            read_plan_file(tmp_path / name, problem(), "six")
        assert caught.value.code == ErrorCode.UNREADABLE_FILE


def test_a_plan_that_fails_the_check_says_what_was_asked_for():
    """`pure_control` knows of no clearance."""
    close = problem(swarm=Swarm(2.0, 1.0, [0.3] * 5 + [2.85], binary(6)))
    failed = solve(close, "pure_control", Settings(max_tries=50, min_clearance=0.2))
    assert isinstance(failed, Failed) and failed.reason.endswith("; min_clearance is 0.2 units")
    assert re.search(r"clearance [-\d.e]+ units between .*, goal error [-\d.e]+ units \(tolerance 1e-06 units\)", failed.reason)
