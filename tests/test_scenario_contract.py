"""The planner and the driver build their own values from scenario files: both see the same scene, and refuse the same files."""

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stressbot_msgs import scenario_text

from stressbot_driver import bench
from stressbot_driver.ros.conversions import description_message
from stressbot_driver.simulation.substrate import Substrate
from stressbot_planner import planners
from stressbot_planner.cli import tool as cli
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file, plan_text
from stressbot_planner.model import allocation
from stressbot_planner.ros.conversion import scene_from_description

SCENARIOS = sorted((Path(__file__).parents[1] / "scenarios").glob("*.yaml"))

GOOD = """
name: one
length_unit: 1.0e-4
workspace: {x: [0, 20], y: [0, 20]}
obstacles: [{circle: {center: [10, 10], radius: 1}}, {polygon: [[4, 4], [6, 4], [5, 6]]}]
swarm: {speed: 1.0, turning_radius: 1.0, body_radius: 0.3, groups: ["01", "10"]}
robots: [{start: [2, 2, 0], goal: [2, 8]}, {start: [2, 12, 0], goal: [8, 12]}]
"""

CALIBRATED = """
calibration:
  confidence: 0.95
  robots:
    - {{robot: 1, now: 1, selections: 9, missed: 0}}
    - {{robot: 3, now: {now}, heading_bias: [0.2, {half}], selections: 9, missed: 0}}
"""


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


BAD = {
    "not a number": changed("speed: 1.0", "speed: .nan"),
    "infinite": changed("start: [2, 2, 0]", "start: [.inf, 2, 0]"),
    "wrong type": changed("speed: 1.0", "speed: fast"),
    "boolean for a number": changed("speed: 1.0", "speed: true"),
    "missing": changed("name: one\n", ""),
    "missing within": changed("body_radius: 0.3, ", ""),
    "unknown key": changed("name: one", "name: one\ncolour: red"),
    "zero speed": changed("speed: 1.0", "speed: 0"),
    "negative radius": changed("turning_radius: 1.0", "turning_radius: -1"),
    "negative body": changed("body_radius: 0.3", "body_radius: -0.3"),
    "a body of nearly nothing": changed("body_radius: 0.3", "body_radius: [0, 1e-300]"),
    "speeds for other robots": changed("speed: 1.0", "speed: [1, 1, 1]"),
    "a robot without speed": changed("speed: 1.0", "speed: [1, 0]"),
    "radii for other robots": changed("turning_radius: 1.0", "turning_radius: [1, 1, 1]"),
    "codewords for other robots": changed('"01", "10"', '"01", "10", "11"'),
    "duplicate codeword": changed('"01", "10"', '"01", "01"'),
    "duplicate codeword and radius": changed("turning_radius: 1.0", "turning_radius: [0.5, 0.5]").replace('"01", "10"', '"1", "1"'),
    "empty codeword": changed('"01", "10"', '"00", "10"'),
    "codewords of two lengths": changed('"01", "10"', '"01", "100"'),
    "text for a goal": changed("goal: [2, 8]", "goal: anywhere"),
    "a goal of four numbers": changed("goal: [2, 8]", "goal: [2, 8, 0, 0]"),
    "a heading that is no number": changed("goal: [2, 8]", "goal: [2, 8, .nan]"),
    "headings of robots that turn together": changed("turning_radius: 1.0", "turning_radius: [1, 2]").replace(
        '"01", "10"', '"1", "1"'
    ).replace("goal: [2, 8]", "goal: [2, 8, 0]").replace("goal: [8, 12]", "goal: [8, 12, 1]"),
    "the fewest groups, and one is parked": changed("goal: [2, 8]", "goal: parked").replace('"01", "10"', '"11", "10"'),
    "the others not told apart": GOOD.replace('"01", "10"', '"011", "101", "110"').replace("goal: [2, 8]", "goal: parked").replace(
        "goal: [8, 12]}", "goal: [8, 12]}, {start: [15, 2, 0], goal: [15, 8]}"
    ).replace('"110"', '"100"'),
    "everybody parked": GOOD.replace("goal: [2, 8]", "goal: parked").replace("goal: [8, 12]", "goal: parked"),
    "parked, with waypoints": changed("goal: [2, 8]", "goal: parked, waypoints: [[3, 3]]"),
    "stages of two counts": changed("goal: [2, 8]", "goal: [2, 8], waypoints: [[3, 3]]").replace(
        "goal: [8, 12]", "goal: [8, 12], waypoints: [[3, 12], [4, 12]]"
    ),
    "a contact with nobody": GOOD + "contacts: [[1, 3]]\n",
    "a contact with itself": GOOD + "contacts: [[2, 2]]\n",
    "a contact of three": GOOD + "contacts: [[1, 2, 1]]\n",
    "a contact with half a robot": GOOD + "contacts: [[1, 1.5]]\n",
    "a contact with a parked robot": changed("goal: [2, 8]", "goal: parked") + "contacts: [[2, 1]]\n",
    "starts of a contact that overlap by a step": changed("[2, 2, 0]", "[2, 11.4001, 0]") + (
        "contacts: [[1, 2]]\nelectrical: {drive: pulses}\n"
    ),
    "no stage": changed("goal: [2, 8]", "goal: [2, 8], waypoints: []"),
    "a waypoint of three numbers": changed("goal: [2, 8]", "goal: [2, 8], waypoints: [[2, 3, 0]]"),
    "a waypoint in a disc": changed("goal: [2, 8]", "goal: [2, 8], waypoints: [[10, 10]]"),
    "a waypoint where another robot is": changed("goal: [2, 8]", "goal: [2, 8], waypoints: [[2, 12.1]]"),
    "a waypoint outside": changed("goal: [2, 8]", "goal: [2, 8], waypoints: [[2, 3], [2, 21]]"),
    "number for a goal": changed("goal: [2, 8]", "goal: 3"),
    "goal to assign, none listed": changed("goal: [2, 8]", "goal: assign"),
    "goals that nobody takes": GOOD + "goals: [[2, 8]]\n",
    "too many goals": changed("goal: [2, 8]", "goal: assign") + "goals: [[2, 8], [5, 8]]\n",
    "too few goals": GOOD.replace("goal: [2, 8]", "goal: assign").replace("goal: [8, 12]", "goal: assign") + "goals: [[2, 8]]\n",
    "empty list of goals": changed("goal: [2, 8]", "goal: assign") + "goals: []\n",
    "short goal in the list": changed("goal: [2, 8]", "goal: assign") + "goals: [[2]]\n",
    "listed goal not finite": changed("goal: [2, 8]", "goal: assign") + "goals: [[2, .nan]]\n",
    "listed goal far away": changed("goal: [2, 8]", "goal: assign") + "goals: [[2, 1e300]]\n",
    "letters in a codeword": changed('"01", "10"', '"01", "1x"'),
    "unquoted codeword": changed('"01", "10"', '10, 11'),
    "unknown scheme": changed('["01", "10"]', "ternary"),
    "no robots": GOOD[: GOOD.index("robots:")] + "robots: []\n",
    "short start": changed("[2, 2, 0]", "[2, 2]"),
    "start outside": changed("[2, 2, 0]", "[-2, 2, 0]"),
    "start in a disc": changed("[2, 2, 0]", "[10, 10.5, 0]"),
    "start in a polygon": changed("[2, 2, 0]", "[5, 4.5, 0]"),
    "starts overlap": changed("[2, 2, 0]", "[2, 11.7, 0]"),
    "walls the wrong way round": changed("x: [0, 20]", "x: [20, 0]"),
    "polygon that crosses itself": changed("[[4, 4], [6, 4], [5, 6]]", "[[4, 4], [6, 6], [6, 4], [4, 6]]"),
    "cut short": GOOD[: GOOD.index("goal: [8")],
    "not a mapping": "- 1\n- 2\n",
    "nested without end": "[" * 5000,
    "alias": GOOD + "electrical: &e {}\nother: *e\n",
    "volts out of order": GOOD + "electrical: {reset_level: 50}\n",
    "a code too few": GOOD + "electrical: {codes: [[0, 0], [0, 1]]}\n",
    "key twice": GOOD + "name: two\n",
    "a third of two robots calibrated": GOOD + CALIBRATED.format(now=3, half=0.1),
    "a robot calibrated twice": GOOD + CALIBRATED.format(now=1, half=0.1),
    "an interval of negative width": GOOD + CALIBRATED.format(now=2, half=-0.1),
}


def planner_code(path) -> int:
    with pytest.raises(StressbotError) as caught:
        scenario.load(path)
    return int(caught.value.code)


def driver_code(path) -> int:
    with pytest.raises(StressbotError) as caught:
        bench.load_bench(path)
    return int(caught.value.code)


def test_both_see_the_same_goals_to_assign(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(changed("goal: [8, 12]", "goal: assign") + "goals: [[8, 12]]\n")
    ours, theirs = scenario.load(path), bench.load_bench(path)
    np.testing.assert_allclose(theirs.goal, ours.problem.goals * ours.length_unit)
    assert theirs.assign.tolist() == [row + 1 for row in ours.problem.exchangeable] == [2]


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_both_see_the_same_scene(path):
    ours, theirs = scenario.load(path), bench.load_bench(path)
    unit = ours.length_unit
    assert tuple(theirs.codewords) == ours.swarm.codewords
    np.testing.assert_allclose(theirs.speed, ours.swarm.speed * ours.swarm.pace * unit)
    np.testing.assert_allclose(theirs.turning_radius, ours.swarm.turning_radius * unit)
    np.testing.assert_allclose(theirs.body_radius, ours.swarm.body_radius * unit)
    np.testing.assert_allclose(theirs.start, ours.problem.starts * (unit, unit, 1))
    np.testing.assert_allclose(theirs.goal, ours.problem.goals * unit)
    for field in ("symbol_levels", "thresholds", "codes", "drive_level", "symbol_dwell"):
        np.testing.assert_array_equal(getattr(theirs.electrical, field), getattr(ours.electrical, field))


@pytest.mark.parametrize("scheme", ["by_radius", *sorted(allocation.SCHEMES)])
@pytest.mark.parametrize("n", [1, 2, 5, 6, 7, 30, 31])
@pytest.mark.parametrize("radii", [(1,), (1, 0.5, 0.7)])
def test_both_allocate_the_same_codewords(scheme, n, radii, tmp_path):
    radius = [radii[k % len(radii)] for k in range(n)] if len(radii) > 1 else radii[0]
    robots = "\n".join(f"  - {{start: [{3 * k}, 0, 0], goal: [{3 * k}, 5]}}" for k in range(n))
    path = tmp_path / "scenario.yaml"
    path.write_text(
        f"name: n\nswarm: {{speed: 1e0, turning_radius: {radius}, body_radius: 0.3, groups: {scheme}}}\nrobots:\n{robots}\n"
    )
    assert tuple(bench.load_bench(path).codewords) == scenario.load(path).swarm.codewords


@pytest.mark.parametrize("text", BAD.values(), ids=BAD)
def test_both_refuse_the_same_file_for_the_same_reason(text, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    assert ErrorCode(planner_code(path)).name == ErrorCode(driver_code(path)).name


@pytest.mark.parametrize("robots", [1, 6, 14])
@pytest.mark.parametrize("symbols", ["[40, 60]", "[20, 40, 60]"])
def test_both_give_checked_codes(robots, symbols, tmp_path):
    listed = "\n".join(f"  - {{start: [{3 * k}, 0, 0], goal: [{3 * k}, 5]}}" for k in range(robots))
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "name: n\nswarm: {speed: 1, turning_radius: 1, body_radius: 0.3, groups: binary}\n"
        f"electrical: {{codes: checked, release: 10, symbol_levels: {symbols}}}\nrobots:\n{listed}\n"
    )
    ours, theirs = scenario.load(path).electrical, bench.load_bench(path).electrical
    np.testing.assert_array_equal(theirs.codes, ours.codes)
    assert not (np.sum(ours.codes, axis=1) % len(ours.symbol_levels)).any()


def test_both_take_robots_that_share_a_codeword_but_no_radius(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(changed("turning_radius: 1.0", "turning_radius: [1.0, 0.5]").replace('"01", "10"', '"1", "1"'))
    assert scenario.load(path).swarm.codewords == tuple(bench.load_bench(path).codewords) == ("1", "1")


def test_both_read_headings_at_goals_and_the_description_carries_them(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(changed("goal: [8, 12]", "goal: [8, 12, -1.5]"))
    ours, theirs = scenario.load(path).problem, bench.load_bench(path)
    np.testing.assert_array_equal(ours.goal_headings, [math.nan, -1.5])
    np.testing.assert_array_equal(theirs.goal_heading, ours.goal_headings)
    np.testing.assert_array_equal(scene_from_description(description_message(theirs)).goal_headings, ours.goal_headings)


def test_both_read_who_is_parked_and_the_description_tells(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(changed("goal: [2, 8]", "goal: parked"))
    ours, theirs = scenario.load(path).problem, bench.load_bench(path)
    scene = scene_from_description(description_message(theirs))
    assert ours.parked == scene.parked == (0,) and theirs.parked.tolist() == [1]
    np.testing.assert_allclose(theirs.goal * 1e4, ours.goals)
    np.testing.assert_array_equal(ours.goals, [[2, 2], [8, 12]])


def test_both_read_waypoints_and_the_description_tells(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(changed("goal: [2, 8]", "goal: [2, 8], waypoints: [[3, 3], [4, 3]]"))
    ours, theirs = scenario.load(path).problem, bench.load_bench(path)
    scene = scene_from_description(description_message(theirs))
    np.testing.assert_array_equal(ours.waypoints, [[[3, 3], [2, 12]], [[4, 3], [2, 12]]])
    np.testing.assert_allclose(theirs.waypoint * 1e4, ours.waypoints)
    np.testing.assert_allclose(scene.waypoints, ours.waypoints)


def test_both_read_contacts_and_the_description_tells(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(GOOD + "contacts: [[2, 1]]\n")
    ours, theirs = scenario.load(path).problem, bench.load_bench(path)
    scene = scene_from_description(description_message(theirs))
    assert ours.contacts == scene.contacts == ((1, 0),) and theirs.contact.tolist() == [[2, 1]]


@pytest.mark.parametrize("text", [GOOD, GOOD + CALIBRATED.format(now=2, half=0.1)], ids=["plain", "calibrated"])
def test_the_good_file_is_good(text, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    scenario.load(path)
    bench.load_bench(path)


# --- limits -----------------------------------------------------------------------------------------------------------

FULL = {
    "name": "full",
    "length_unit": 1e-4,
    "workspace": {"x": [-20, 20], "y": [-20, 20]},
    "obstacles": [{"circle": {"center": [10, 10], "radius": 1}}, {"polygon": [[4, 4], [6, 4], [5, 6]]}],
    "swarm": {"speed": [1.0, 2.0], "turning_radius": 1.0, "body_radius": 0.3, "groups": ["01", "10"]},
    "robots": [{"start": [2, 2, 0], "goal": [2, 8, 1], "waypoints": [[3, 3], [3, 4]]}, {"start": [2, 12, 0], "goal": "assign"}],
    "goals": [[8, 12]],
    "contacts": [[1, 2], [2, 1]],
    "electrical": {
        **bench.ELECTRICAL_DEFAULTS, "thresholds": [20.0, 50.0, 75.0, 100.0, 125.0], "codes": [[0, 0], [0, 1], [1, 0]],
        "drive": {**bench.PULSE_DEFAULTS, "step_length": [6e-5, 1.2e-4], "frequency": 16666.6667},
    },
    "calibration": {
        "confidence": 0.95,
        "robots": [
            {"robot": 1, "now": 1, "speed": [1, 0.1], "turning_radius": [1, 0.1], "heading_bias": [0, 0.1], "selections": 9,
             "missed": 0, "fault": "none"},
        ],
    },
}
"""Every field that the schema knows."""


def resolved(rule):
    """Return a rule with what it refers to."""
    if "$ref" not in rule:
        return rule
    return {**scenario_text.schema()["$defs"][rule["$ref"].rsplit("/", 1)[1]], **{k: v for k, v in rule.items() if k != "$ref"}}


KINDS = {"object": dict, "array": list, "string": str, "number": int | float}


def places(content, rule, path=()):
    """Yield path and schema rule of every value."""
    while "$ref" in rule or "oneOf" in rule:
        if "$ref" in rule:
            rule = resolved(rule)
        else:
            kind = next(name for name, kind in KINDS.items() if isinstance(content, kind))
            rule = next(option for option in map(resolved, rule["oneOf"]) if option["type"] == kind)
    yield path, rule
    if isinstance(content, dict):
        for key, value in content.items():
            yield from places(value, rule["properties"][key], (*path, key))
    elif isinstance(content, list):
        for index, value in enumerate(content):
            inner = rule["prefixItems"][index] if "prefixItems" in rule else rule["items"]
            yield from places(value, inner, (*path, index))


def with_value(path, value):
    content = copy.deepcopy(FULL)
    place = content
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    return content


def value_at(path):
    value = FULL
    for part in path:
        value = value[part]
    return value


PLACES = list(places(FULL, scenario_text.schema()))
LIMITS, BEYOND = [], []
for path, rule in PLACES:
    for bound, way in (("minimum", -math.inf), ("maximum", math.inf)):
        if bound in rule:
            LIMITS.append((path, rule[bound]))
            BEYOND.append((path, rule[bound] + int(math.copysign(1, way)) if rule["type"] == "integer" else
                           math.nextafter(float(rule[bound]), way), "OUT_OF_RANGE"))
    if rule.get("type") in ("number", "integer"):
        for value in (math.nan, math.inf, "1e400"):
            BEYOND.append((path, value, "NOT_FINITE" if rule["type"] == "number" or value == "1e400" else None))
    if "minItems" in rule and rule["minItems"]:
        BEYOND.append((path, value_at(path)[: rule["minItems"] - 1], "NO_ROBOTS" if path == ("robots",) else "WRONG_COUNT"))
    if "maxItems" in rule:
        more = (value_at(path) * rule["maxItems"])[: rule["maxItems"] + 1]
        BEYOND.append((path, more, "TOO_MANY_ROBOTS" if path == ("robots",) else "WRONG_COUNT"))
        if len(more) <= 1001:  # reading more takes seconds
            LIMITS.append((path, more[:-1]))
    if "maxLength" in rule:
        BEYOND.append((path, "1" * (rule["maxLength"] + 1), "INVALID_CODEWORD" if "groups" in path else "OUT_OF_RANGE"))
        LIMITS.append((path, "1" * rule["maxLength"]))
    if "pattern" in rule:
        BEYOND.append((path, "a\u0007b", "OUT_OF_RANGE"))


def verdicts(content, tmp_path) -> list[tuple[str, str] | None]:
    """What both readers say to a file: code and field, or None where they take it."""
    path = tmp_path / "scenario.yaml"
    path.write_text(json.dumps(content).replace("NaN", ".nan").replace("Infinity", ".inf").replace('"1e400"', "1e400"))
    said = []
    for read in (scenario.load, bench.load_bench):
        try:
            read(path)
            said.append(None)
        except StressbotError as error:
            assert len(str(error)) < 1000 and str(error).isprintable()
            said.append((error.code.name, error.field))
    return said


def name_of(path) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")


def test_the_full_file_has_every_field_that_the_schema_knows():
    def known(rule):
        for key, inner in rule.get("properties", {}).items():
            yield key
            yield from known(inner)
        inner = [rule["items"]] if "items" in rule else rule.get("oneOf", ())
        for option in inner:
            yield from known(option)

    named = {part for path, _ in PLACES for part in path if isinstance(part, str)}
    assert set(known(scenario_text.schema())) == named
    assert sum("minimum" in rule for _, rule in PLACES) > 40


def test_every_number_and_every_list_that_can_hurt_has_limits():
    for path, rule in PLACES:
        if rule.get("type") in ("number", "integer"):
            assert {"minimum", "maximum"} <= rule.keys(), path
        if rule.get("type") == "string" and "enum" not in rule:
            assert "maxLength" in rule, path


def test_both_take_the_full_file(tmp_path):
    assert verdicts(FULL, tmp_path) == [None, None]


@pytest.mark.parametrize(("path", "value", "code"), BEYOND, ids=[f"{name_of(p)}-{str(v)[:12]}" for p, v, _ in BEYOND])
def test_both_refuse_what_lies_beyond_a_limit(path, value, code, tmp_path):
    ours, theirs = verdicts(with_value(path, value), tmp_path)
    assert ours == theirs
    assert ours[1] == name_of(path)
    assert ours[0] == code or code is None


@pytest.mark.parametrize(("path", "value"), LIMITS, ids=[f"{name_of(p)}-{str(v)[:12]}" for p, v in LIMITS])
def test_both_say_the_same_at_a_limit(path, value, tmp_path):
    ours, theirs = verdicts(with_value(path, value), tmp_path)
    assert ours == theirs
    if ours and not isinstance(value, list):  # another rule than the limit itself
        assert ours != ("OUT_OF_RANGE", name_of(path)) or path[0] in ("electrical", "workspace", "calibration")


SCALARS = [(path, value) for path, value in LIMITS if isinstance(value, int | float)]


@pytest.mark.parametrize(("path", "value"), SCALARS, ids=[f"{name_of(p)}-{v}" for p, v in SCALARS])
def test_whatever_both_take_can_be_described_shown_and_planned_for(path, value, tmp_path, capsys):
    """A limit that is legal works: on the substrate, as a message and back, in words, and for a planner."""
    content = with_value(path, value)
    for section in ("workspace", "obstacles"):  # so that more of them are legal
        if path[0] != section:
            del content[section]
    if verdicts(content, tmp_path) != [None, None]:
        return
    lying = bench.load_bench(tmp_path / "scenario.yaml")
    assert np.isfinite(Substrate(lying).poses().x).all()
    scene = scene_from_description(description_message(lying))
    loaded = scenario.load(tmp_path / "scenario.yaml")
    np.testing.assert_allclose(scene.starts, loaded.problem.starts, rtol=1e-12)
    assert cli.main(["show", str(tmp_path / "scenario.yaml")]) == 0
    assert "nan" not in capsys.readouterr().out
    limits = planners.Settings(time_limit=0.1, first=True, selection_time=loaded.electrical.selection_time)
    result = planners.solve(loaded.problem, "optimize", limits)
    assert result.success or result.reason
    plan_text(plan_file(result, loaded.name, loaded.electrical.selection_time))


def test_both_refuse_what_is_no_file_of_text(tmp_path):
    path = tmp_path / "scenario.yaml"
    for content, code in (
        (b"name: \xff", "UNREADABLE_FILE"),
        (GOOD.encode("utf-16"), "UNREADABLE_FILE"),
        (GOOD.encode() + b"#" * 16_000_000, "MALFORMED_FILE"),
    ):
        path.write_bytes(content)
        assert ErrorCode(planner_code(path)).name == ErrorCode(driver_code(path)).name == code


small = st.integers(0, 4)
corners = st.lists(st.tuples(small, small).map(list), min_size=3, max_size=7)


@settings(deadline=None)
@given(corners, st.sampled_from([1, 1e-9, 3e-10, 1e7]))
def test_both_take_the_same_polygons(tmp_path_factory, polygon, scale):
    content = {key: value for key, value in FULL.items() if key != "workspace"}
    content["obstacles"] = [{"polygon": [[50 + x * scale, 50 + y * scale] for x, y in polygon]}]
    ours, theirs = verdicts(content, tmp_path_factory.getbasetemp())
    assert ours == theirs


volts = st.sampled_from([-1, 0, 20, 30, 40, 50, 60, 75, 90, 115, 120, 140, 200])
dwell = st.sampled_from([0.001, 0.002, 0.005, 0.01])
DRIVE = st.fixed_dictionaries(
    {},
    optional={
        "low_level": volts,
        "step_length": st.sampled_from([1e-9, 1.2e-4, [6e-5, 1.2e-4], [1e-4, 1e-4], [1e-4], 1e9]),
        "frequency": st.sampled_from([1e-3, 100, 1e4, 1e5]),
        "duty": st.sampled_from([0.01, 0.5, 0.9]),
        "polarity": st.sampled_from(["unipolar", "alternating"]),
        "response": st.sampled_from([1e-9, 1e-5, 1e-2]),
    },
)
ELECTRICAL = {
    **{key: volts for key in ("rest_level", "reset_level", "drive_level", "pull_down", "release", "min_level", "max_level")},
    **{key: dwell for key in ("reset_dwell", "symbol_dwell", "guard_dwell", "min_dwell")},
    "drive": st.sampled_from(["constant", "pulses"]) | DRIVE,
    "symbol_levels": st.lists(volts, min_size=2, max_size=3),
    "thresholds": st.lists(volts, min_size=3, max_size=5),
    "hysteresis": st.sampled_from([0, 4, 20, 50]),
    "codes": st.lists(st.lists(st.integers(0, 2), min_size=1, max_size=3), max_size=4),
}


@settings(deadline=None)
@given(st.sampled_from(sorted(ELECTRICAL)), st.sampled_from(sorted(ELECTRICAL)), st.data())
def test_both_take_the_same_levels(tmp_path_factory, one, other, data):
    """Any two fields changed: the same verdict, and the same field."""
    content = FULL | {"electrical": {key: data.draw(ELECTRICAL[key]) for key in {one, other}}}
    ours, theirs = verdicts(content, tmp_path_factory.getbasetemp())
    assert ours == theirs


@settings(deadline=None)
@given(DRIVE, volts, volts)
def test_both_take_the_same_pulses(tmp_path_factory, drive, release, lowest):
    """A drive and two levels beside it: the same verdict, the same field, and the same frequency."""
    content = FULL | {"electrical": {"drive": drive, "release": release, "min_level": -lowest}}
    ours, theirs = verdicts(content, tmp_path_factory.getbasetemp())
    assert ours == theirs
    if ours is None:
        path = tmp_path_factory.getbasetemp() / "scenario.yaml"
        described, lying = scenario.load(path).electrical.drive, bench.load_bench(path).electrical.drive
        assert vars(described) == pytest.approx(vars(lying), rel=1e-12)


@settings(deadline=None)
@given(
    st.lists(st.sampled_from([60, 119, 140, 141, 150, 150.0001, 160, 170, 199, 200]), max_size=4) | volts,
    st.sampled_from(["by_level", "binary", "tight", ["1", "1"], ["10", "11"], ["11", "10"], ["10", "11", "01"]]),
    st.sampled_from(sorted(ELECTRICAL)),
    st.data(),
)
def test_both_take_the_same_levels_of_arms(tmp_path_factory, pull_down, groups, other, data):
    electrical = {"drive": "pulses", other: data.draw(ELECTRICAL[other]), "pull_down": pull_down}
    content = FULL | {"swarm": FULL["swarm"] | {"groups": groups}, "electrical": electrical}
    ours, theirs = verdicts(content, tmp_path_factory.getbasetemp())
    assert ours == theirs


@settings(deadline=None)
@given(st.data())
def test_both_find_the_same_places_taken(tmp_path_factory, data):
    """All robots put anywhere, with their goals, among walls, a disc and a triangle: several faults at once have one order."""
    content = copy.deepcopy(FULL)
    places = st.tuples(*[st.integers(-1, 12)] * 2).map(list)
    for robot in content["robots"]:
        robot["start"] = [*data.draw(places), 0]
        if robot["goal"] != "assign":
            robot["goal"] = data.draw(places)
    ours, theirs = verdicts(content, tmp_path_factory.getbasetemp())
    assert ours == theirs


@settings(deadline=None)
@given(st.lists(st.text("01", max_size=3), max_size=3), st.sampled_from([1, [1, 1], [1, 2], [2, 1], [1, 1, 1]]), st.booleans())
def test_both_take_the_same_codewords(tmp_path_factory, groups, values, fast):
    content = copy.deepcopy(FULL)
    content["swarm"] |= {"groups": groups, "speed": 1, "turning_radius": 1, "speed" if fast else "turning_radius": values}
    ours, theirs = verdicts(content, tmp_path_factory.getbasetemp())
    assert ours == theirs


def test_both_refuse_speeds_that_lie_too_far_apart(tmp_path):
    content = copy.deepcopy(FULL)
    del content["electrical"]  # pulses fit the speeds that it has
    content["swarm"]["speed"] = [1e5, 0.099]
    assert verdicts(content, tmp_path) == [("OUT_OF_RANGE", "swarm.speed")] * 2
    content["swarm"]["speed"] = [1e5, 0.1]
    assert verdicts(content, tmp_path) == [None, None]


def test_both_take_a_file_with_other_codewords_and_nothing_else_of_it_changes(tmp_path):
    path, other = tmp_path / "scenario.yaml", tmp_path / "other.yaml"
    path.write_text(json.dumps(FULL))
    codewords = scenario.load(path).swarm.codewords[::-1]
    other.write_text(scenario.with_codewords(path, codewords))
    assert scenario.load(other).swarm.codewords == tuple(bench.load_bench(other).codewords) == codewords
    before, after = scenario_text.read(path), scenario_text.read(other)
    assert after["swarm"].pop("groups") == list(codewords)
    del before["swarm"]["groups"]
    assert before == after


@given(name=st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=20), number=st.floats(-1e9, 1e9))
def test_what_is_written_reads_as_it_was(name, number):
    content = scenario_text.parse(GOOD) | {"name": name, "length_unit": 1e-12}
    content["robots"][0]["start"] = [number, 1, -0.0]
    assert scenario_text.parse(scenario.text(content)) == content
