"""Scenario files: good ones are read as written, each kind of bad one is refused with its own code and field."""

import os
import re
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.model.environment import Circle, Polygon

NAN, INF = float("nan"), float("inf")
SCENARIOS = sorted((Path(__file__).resolve().parents[1] / "scenarios").glob("*.yaml"))


def good() -> dict:
    return {
        "name": "two-discs",
        "length_unit": 1e-4,
        "workspace": {"x": [0, 20], "y": [0, 20]},
        "obstacles": [
            {"circle": {"center": [6, 6], "radius": 1.5}},
            {"polygon": [[9, 9], [11, 9], [10, 11]]},
        ],
        "swarm": {"speed": 1.0, "turning_radius": 1.0, "body_radius": 0.3, "groups": "binary"},
        "robots": [{"start": [1, 2, 0.0], "goal": [12, 11.6]}, {"start": [1, 4, 0.5], "goal": [14, 3]}],
    }


def changed(path: str, value) -> dict:
    """Return the good scenario with the value at a dotted path replaced, or removed by `...`."""
    data = good()
    *way, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    place = data
    for part in way:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return data


def refused(text: str) -> StressbotError:
    with pytest.raises(StressbotError) as caught:
        scenario.parse(text)
    return caught.value


# --- what is read ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_scenarios_of_the_repository_load(path):
    loaded = scenario.load(path)
    assert loaded.name == path.stem
    assert np.isfinite(loaded.problem.lower_bounds).all()


def test_there_are_scenarios():
    assert {"paper-six", "paper-six-two-discs"} <= {path.stem for path in SCENARIOS}


def test_the_paper_scenario_has_the_positions_that_the_paper_lists():
    loaded = scenario.load(next(path for path in SCENARIOS if path.stem == "paper-six"))
    np.testing.assert_allclose(loaded.problem.starts[:, :2], [(0, y) for y in (2.0, 5.2, 8.4, 11.6, 14.8, 18.0)])
    np.testing.assert_allclose(loaded.problem.goals, [(12, y) for y in (11.6, 18.0, 5.2, 2.0, 8.4, 14.8)])
    assert (loaded.swarm.n, loaded.swarm.m) == (6, 4)


def test_every_field_arrives():
    loaded = scenario.parse(yaml.safe_dump(good()), tolerance=0.5)
    problem = loaded.problem
    assert (loaded.name, loaded.length_unit, problem.tolerance) == ("two-discs", 1e-4, 0.5)
    assert problem.environment.workspace.x_max == 20.0
    circle, polygon = problem.environment.obstacles
    assert isinstance(circle, Circle)
    assert isinstance(polygon, Polygon)
    assert (circle.radius, circle.center.tolist()) == (1.5, [6, 6])
    assert polygon.vertices.shape == (3, 2)
    np.testing.assert_array_equal(problem.starts, [[1, 2, 0], [1, 4, 0.5]])
    np.testing.assert_array_equal(problem.goals, [[12, 11.6], [14, 3]])
    assert loaded.swarm.codewords == ("01", "10")
    assert loaded.electrical.codes == ((0, 0), (0, 1), (1, 0))


def test_defaults():
    data = changed("workspace", ...)
    del data["obstacles"], data["length_unit"], data["swarm"]["groups"]
    loaded = scenario.parse(yaml.safe_dump(data))
    assert loaded.length_unit == 1e-4
    assert loaded.problem.environment.is_open_plane
    assert loaded.swarm.codewords == ("01", "10")
    assert loaded.electrical.levels == (0.0, 40.0, 60.0, 90.0, 140.0)
    assert loaded.electrical.thresholds == (20.0, 50.0, 75.0, 115.0)


@pytest.mark.parametrize(("groups", "codewords"), [
    ("tight", ("01", "10")), ("balanced", ("01", "10")), ("by_radius", ("01", "10")), (["011", "101"], ("011", "101")),
])
def test_group_schemes_and_explicit_codewords(groups, codewords):
    assert scenario.parse(yaml.safe_dump(changed("swarm.groups", groups))).swarm.codewords == codewords


def test_radii_per_robot():
    data = changed("swarm.turning_radius", [1.0, 2.0])
    data["swarm"]["body_radius"] = [0.1, 0.2]
    swarm = scenario.parse(yaml.safe_dump(data)).swarm
    assert (swarm.turning_radius.tolist(), swarm.body_radius.tolist()) == ([1, 2], [0.1, 0.2])
    assert not swarm.equal_radii


def test_speeds_per_robot():
    swarm = scenario.parse(yaml.safe_dump(changed("swarm.speed", [1.5, 2.0]))).swarm
    assert (swarm.speed, swarm.pace.tolist(), swarm.turning_length.tolist()) == (2.0, [0.75, 1.0], [1 / 0.75, 1.0])
    assert swarm.equal_radii and not swarm.equal_speeds and not swarm.alike
    with pytest.raises(StressbotError) as caught:
        swarm.common_turning_radius()
    assert (caught.value.code, caught.value.field) == (ErrorCode.UNSUPPORTED, "swarm.speed")
    for speeds, code in (([1.0], ErrorCode.WRONG_COUNT), ([1.0, 0.0], ErrorCode.OUT_OF_RANGE), ([1.0, "x"], ErrorCode.WRONG_TYPE)):
        with pytest.raises(StressbotError) as caught:
            scenario.parse(yaml.safe_dump(changed("swarm.speed", speeds)))
        assert caught.value.code == code and caught.value.field.startswith("swarm.speed")


@pytest.mark.parametrize(("groups", "codewords"), [("by_radius", ("1", "1")), (["1", "1"], ("1", "1")), ("tight", ("01", "10"))])
def test_different_radii_may_share_codewords(groups, codewords):
    data = changed("swarm.turning_radius", [1.0, 2.0])
    data["swarm"]["groups"] = groups
    assert scenario.parse(yaml.safe_dump(data)).swarm.codewords == codewords


def test_who_turns_alike_may_not_share_a_codeword():
    data = changed("swarm.turning_radius", [1.0, 2.0])
    data["swarm"] |= {"speed": [1.0, 2.0], "groups": "by_radius"}
    assert scenario.parse(yaml.safe_dump(data)).swarm.codewords == ("01", "10")
    data["swarm"]["groups"] = ["1", "1"]
    with pytest.raises(StressbotError) as caught:
        scenario.parse(yaml.safe_dump(data))
    assert caught.value.code == ErrorCode.DUPLICATE_CODEWORD


def test_numbers_without_a_point_are_numbers():
    # YAML 1.1 reads 1e-4 as text
    text = yaml.safe_dump(good()).replace("length_unit: 0.0001", "length_unit: 1e-4")
    assert "1e-4" in text
    assert scenario.parse(text).length_unit == 1e-4


def test_electrical_values_become_what_messages_take():
    data = good() | {"electrical": {"symbol_levels": [40, 60], "drive_level": 150, "codes": [[0.0, 0], [1, 0], [1, 1]]}}
    electrical = scenario.parse(yaml.safe_dump(data)).electrical
    assert all(isinstance(level, float) for level in electrical.levels)
    assert all(type(symbol) is int for code in electrical.codes for symbol in code)


# --- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "value", "code", "field"),
    [
        # NaN and infinite numbers
        ("robots.1.start", [1, NAN, 0], ErrorCode.NOT_FINITE, "robots[1].start[1]"),
        ("robots.0.goal", [INF, 3], ErrorCode.NOT_FINITE, "robots[0].goal[0]"),
        ("robots.0.goal", [-INF, 3], ErrorCode.NOT_FINITE, "robots[0].goal[0]"),
        ("robots.0.goal", [10**400, 3], ErrorCode.NOT_FINITE, "robots[0].goal[0]"),
        ("swarm.speed", NAN, ErrorCode.NOT_FINITE, "swarm.speed"),
        ("swarm.body_radius", [0.3, INF], ErrorCode.NOT_FINITE, "swarm.body_radius[1]"),
        ("length_unit", INF, ErrorCode.NOT_FINITE, "length_unit"),
        ("workspace.x", [0, INF], ErrorCode.NOT_FINITE, "workspace.x[1]"),
        ("obstacles.0.circle.radius", NAN, ErrorCode.NOT_FINITE, "obstacles[0].circle.radius"),
        ("obstacles.1.polygon.2", [NAN, 1], ErrorCode.NOT_FINITE, "obstacles[1].polygon[2][0]"),
        # wrong types
        ("name", 3, ErrorCode.WRONG_TYPE, "name"),
        ("name", None, ErrorCode.WRONG_TYPE, "name"),
        ("robots", {"start": [0, 0, 0]}, ErrorCode.WRONG_TYPE, "robots"),
        ("robots.0", 3, ErrorCode.WRONG_TYPE, "robots[0]"),
        ("robots.0.goal", 12, ErrorCode.WRONG_TYPE, "robots[0].goal"),
        ("goals", "assign", ErrorCode.WRONG_TYPE, "goals"),
        ("goals", [3], ErrorCode.WRONG_TYPE, "goals[0]"),
        ("robots.0.goal", ["12", 3], ErrorCode.WRONG_TYPE, "robots[0].goal[0]"),
        ("robots.0.goal", [True, 3], ErrorCode.WRONG_TYPE, "robots[0].goal[0]"),
        ("swarm.speed", "fast", ErrorCode.WRONG_TYPE, "swarm.speed"),
        ("swarm.groups", [1, 10], ErrorCode.INVALID_CODEWORD, "swarm.groups[0]"),
        ("swarm", [], ErrorCode.WRONG_TYPE, "swarm"),
        ("obstacles", {}, ErrorCode.WRONG_TYPE, "obstacles"),
        # missing fields
        *((key, ..., ErrorCode.MISSING_FIELD, key) for key in ("name", "swarm", "robots")),
        *((f"swarm.{key}", ..., ErrorCode.MISSING_FIELD, f"swarm.{key}") for key in ("speed", "turning_radius", "body_radius")),
        ("robots.1.goal", ..., ErrorCode.MISSING_FIELD, "robots[1].goal"),
        ("robots.0.start", ..., ErrorCode.MISSING_FIELD, "robots[0].start"),
        ("robots.0.goal", "assign", ErrorCode.MISSING_FIELD, "goals"),
        ("workspace.y", ..., ErrorCode.MISSING_FIELD, "workspace.y"),
        ("obstacles.0.circle.radius", ..., ErrorCode.MISSING_FIELD, "obstacles[0].circle.radius"),
        ("obstacles.0", {}, ErrorCode.MISSING_FIELD, "obstacles[0]"),
        # unknown keys
        ("speed", 1.0, ErrorCode.UNKNOWN_FIELD, "speed"),
        ("swarm.color", "red", ErrorCode.UNKNOWN_FIELD, "swarm.color"),
        ("robots.0.id", 7, ErrorCode.UNKNOWN_FIELD, "robots[0].id"),
        ("obstacles.0", {"square": 1}, ErrorCode.UNKNOWN_FIELD, "obstacles[0].square"),
        # counts
        ("robots.0.start", [1, 2], ErrorCode.WRONG_COUNT, "robots[0].start"),
        ("robots.0.goal", [1, 2, 3, 4], ErrorCode.WRONG_COUNT, "robots[0].goal"),
        ("goals", [[12, 12]], ErrorCode.WRONG_COUNT, "goals"),
        ("goals", [], ErrorCode.WRONG_COUNT, "goals"),
        ("goals", [[1, 2, 3]], ErrorCode.WRONG_COUNT, "goals[0]"),
        ("swarm.groups", ["01"], ErrorCode.WRONG_COUNT, "swarm.groups"),
        ("swarm.turning_radius", [1.0], ErrorCode.WRONG_COUNT, "swarm.turning_radius"),
        ("obstacles.1.polygon", [[0, 0], [1, 1]], ErrorCode.WRONG_COUNT, "obstacles[1].polygon"),
        ("electrical", {"codes": [[0], [1]]}, ErrorCode.WRONG_COUNT, "electrical.codes"),
        # codewords
        ("swarm.groups", ["01", "01"], ErrorCode.DUPLICATE_CODEWORD, "swarm.groups[1]"),
        ("swarm.groups", ["01", ""], ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        ("swarm.groups", ["01", "1"], ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        ("swarm.groups", ["01", "1x"], ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        ("swarm.groups", ["00", "01"], ErrorCode.EMPTY_CODEWORD, "swarm.groups[0]"),
        ("swarm.groups", "ternary", ErrorCode.OUT_OF_RANGE, "swarm.groups"),
        # places
        ("robots.0.goal", [25, 3], ErrorCode.OUTSIDE_WORKSPACE, "robots[0].goal"),
        ("robots.1.start", [0.1, 4, 0], ErrorCode.OUTSIDE_WORKSPACE, "robots[1].start"),
        ("robots.0.goal", [6, 7], ErrorCode.INSIDE_OBSTACLE, "robots[0].goal"),
        ("robots.0.goal", [10, 9.5], ErrorCode.INSIDE_OBSTACLE, "robots[0].goal"),
        ("robots.1.start", [1, 2.5, 0], ErrorCode.STARTS_OVERLAP, "robots[1].start"),
        ("robots.1.goal", [12, 11.2], ErrorCode.GOALS_TOO_CLOSE, "robots[1].goal"),
        ("obstacles.1.polygon", [[9, 9], [11, 11], [11, 9], [9, 11]], ErrorCode.OUT_OF_RANGE, "obstacles[1].polygon"),
        ("obstacles.1.polygon", [[9, 9], [10, 9], [11, 9]], ErrorCode.OUT_OF_RANGE, "obstacles[1].polygon"),
        ("workspace.x", [20, 0], ErrorCode.OUT_OF_RANGE, "workspace.x"),
        # zero, negative, absurd
        *(
            (path, value, ErrorCode.OUT_OF_RANGE, path)
            for path in ("swarm.speed", "swarm.turning_radius", "swarm.body_radius", "length_unit")
            for value in (0, -1.0)
            if (path, value) != ("swarm.body_radius", 0)
        ),
        ("swarm.turning_radius", [1.0, 0.0], ErrorCode.OUT_OF_RANGE, "swarm.turning_radius[1]"),
        ("obstacles.0.circle.radius", -1, ErrorCode.OUT_OF_RANGE, "obstacles[0].circle.radius"),
        ("robots.0.goal", [1e300, 3], ErrorCode.OUT_OF_RANGE, "robots[0].goal[0]"),
        ("robots.0.goal", "12, 11.6", ErrorCode.OUT_OF_RANGE, "robots[0].goal"),
        ("name", "", ErrorCode.OUT_OF_RANGE, "name"),
        # nobody
        ("robots", [], ErrorCode.NO_ROBOTS, "robots"),
        # electrical
        ("electrical", {"drive_level": 80.0}, ErrorCode.OUT_OF_RANGE, "electrical.drive_level"),
        ("electrical", {"max_level": 100.0}, ErrorCode.OUT_OF_RANGE, "electrical.max_level"),
        ("electrical", {"volts": 3}, ErrorCode.UNKNOWN_FIELD, "electrical.volts"),
        ("electrical", {"symbol_dwell": 0.001}, ErrorCode.OUT_OF_RANGE, "electrical.symbol_dwell"),
        ("electrical", {"codes": [[0, 0], [0, 1], [0, 1]]}, ErrorCode.OUT_OF_RANGE, "electrical.codes[2]"),
    ],
)
def test_bad_scenarios_are_refused_with_their_own_code(path, value, code, field):
    error = refused(yaml.safe_dump(changed(path, value)))
    assert (error.code, error.field) == (code, field)
    assert str(error).startswith(f"{field}: ")


def with_free_robots(*goals) -> dict:
    """Return the good scenario with a third robot; it and the first take what is listed."""
    data = good() | {"goals": list(goals)}
    data["robots"] = [
        {"start": [1, 2, 0.0], "goal": "assign"}, data["robots"][1], {"start": [1, 6, 0.0], "goal": "assign"},
    ]
    return data


def test_robots_that_take_any_goal():
    problem = scenario.parse(yaml.safe_dump(with_free_robots([12, 11], [12, 17]))).problem
    np.testing.assert_array_equal(problem.goals, [[12, 11], [14, 3], [12, 17]])
    assert problem.exchangeable == (0, 2)


@pytest.mark.parametrize(
    ("goals", "code", "field", "text"),
    [
        ([[12, 11]], ErrorCode.WRONG_COUNT, "goals", "1 entries for 2 robots"),
        ([[12, 11], [12, 13], [12, 15]], ErrorCode.WRONG_COUNT, "goals", "3 entries for 2 robots"),
        ([[12, 11], [NAN, 13]], ErrorCode.NOT_FINITE, "goals[1][0]", "finite"),
        ([[12, 11], [12, 11.5]], ErrorCode.GOALS_TOO_CLOSE, "goals[1]", r"0.5 units from goals\[0\]"),
        ([[12, 11], [14, 3.5]], ErrorCode.GOALS_TOO_CLOSE, "goals[1]", "the goal of robot 2"),
        ([[12, 11], [6, 7]], ErrorCode.INSIDE_OBSTACLE, "goals[1]", r"obstacles\[0\]"),
        ([[12, 25], [12, 11]], ErrorCode.OUTSIDE_WORKSPACE, "goals[0]", "wall y_max"),
        ([[12, 11], [1e300, 0]], ErrorCode.OUT_OF_RANGE, "goals[1][0]", "e.300"),
    ],
)
def test_goals_to_assign_that_cannot_be(goals, code, field, text):
    error = refused(yaml.safe_dump(with_free_robots(*goals)))
    assert (error.code, error.field) == (code, field)
    assert re.search(text, error.message)


NO_MAPPINGS = (
    "", "null", "3", "- a", "name: [", "name: a\n  b: c", "\0", "a: b: c", "name: 'open", "{a: 1,", "%YAML 9.9",
    "a: 1\na: 2", "--- {}\n--- {}", "? [1]\n: 2", "a: !!python/object/apply:os.system [ls]", "a: !!timestamp x",
    "a: !!float x", "[" * 100_000, "{a: " * 50_000, "- " * 20_000, "a: &x [*x]",
)


@pytest.mark.parametrize("text", NO_MAPPINGS, ids=range(len(NO_MAPPINGS)))
def test_what_is_not_a_mapping_in_yaml_is_malformed(text):
    assert refused(text).code == ErrorCode.MALFORMED_FILE


@pytest.mark.timing
def test_what_is_not_a_mapping_is_refused_cheaply():
    for text in (*NO_MAPPINGS, *BOMBS):
        begin = time.process_time()
        refused(text)
        assert time.process_time() - begin < 1.0, text[:80]


def test_a_file_cut_short_anywhere_is_refused_or_lacks_something():
    text = yaml.safe_dump(good())
    for end in range(0, text.index("turning_radius"), 7):
        assert refused(text[:end]).code in (
            ErrorCode.MALFORMED_FILE, ErrorCode.MISSING_FIELD, ErrorCode.WRONG_COUNT, ErrorCode.WRONG_TYPE, ErrorCode.NO_ROBOTS,
        )


LINES = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
MERGES = ["b0: &b0 {x: 1}"] + [f"b{k}: &b{k} {{<<: [{', '.join([f'*b{k - 1}'] * 10)}]}}" for k in range(1, 12)]
BOMBS = "\n".join(LINES), "\n".join(MERGES)


def test_alias_bombs_are_refused_with_little_memory():
    for bomb in BOMBS:
        tracemalloc.start()
        error = refused(bomb)
        assert tracemalloc.get_traced_memory()[1] < 5e6
        tracemalloc.stop()
        assert error.code == ErrorCode.MALFORMED_FILE
        assert re.search("line 2: .* alias", error.message)


@pytest.mark.parametrize("name", ["missing.yaml", "folder", "binary.yaml", "nul\0.yaml"])
def test_files_that_cannot_be_read(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(StressbotError) as caught:
        scenario.load(tmp_path / name)
    assert caught.value.code == ErrorCode.UNREADABLE_FILE
    assert name.replace("\0", r"\x00") in caught.value.message


def test_a_file_without_an_end_or_a_writer_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in ("/dev/zero", tmp_path / "pipe"):
        with pytest.raises(StressbotError, match="no regular file") as caught:
            scenario.load(path)
        assert caught.value.code == ErrorCode.UNREADABLE_FILE


def many(n: int) -> str:
    robots = (f"  - {{start: [{k % 100}, {k // 100}, 0], goal: [{k % 100}.5, {k // 100}]}}\n" for k in range(n))
    return "name: many\nswarm: {speed: 1, turning_radius: 1, body_radius: 0.3}\nrobots:\n" + "".join(robots)


@pytest.mark.timing
def test_5000_robots_load_within_seconds():
    begin = time.process_time()
    loaded = scenario.parse(many(5000))
    assert time.process_time() - begin < 10
    assert (loaded.swarm.n, loaded.swarm.m) == (5000, 14)


def test_1000_robots_load_with_little_memory():
    tracemalloc.start()
    scenario.parse(many(1000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30e6


def test_more_robots_than_can_be_planned_for_are_refused():
    assert refused(many(10_001)).code == ErrorCode.TOO_MANY_ROBOTS


anything = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.sampled_from([1e308, -1e308, 5e-324])),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=6,
)
PATHS = [
    "name", "length_unit", "workspace", "workspace.x", "obstacles", "obstacles.0", "obstacles.0.circle.radius",
    "obstacles.1.polygon", "obstacles.1.polygon.1", "swarm", "swarm.speed", "swarm.turning_radius", "swarm.body_radius",
    "swarm.groups", "robots", "robots.0", "robots.0.start", "robots.1.goal", "robots.1.goal.0", "electrical",
]


@given(st.sampled_from(PATHS), anything)
def test_any_value_anywhere_is_taken_or_refused_by_name(path, value):
    text = yaml.safe_dump(changed(path, value), allow_unicode=True)
    try:
        loaded = scenario.parse(text)
    except StressbotError as error:
        assert error.code != ErrorCode.INTERNAL
        assert error.field
        assert error.message
    else:
        assert np.isfinite(loaded.problem.lower_bounds).all()


@given(st.text(max_size=60))
def test_any_text_is_refused_without_another_exception(text):
    refused(text)


@given(st.binary(max_size=60))
def test_any_bytes_are_refused_without_another_exception(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("bytes") / "s.yaml"
    path.write_bytes(content)
    with pytest.raises(StressbotError):
        scenario.load(path)
