import copy
import json
import resource
import time
from importlib import resources

import numpy as np
import pytest
import yaml
from driver_support import bench, scenario, scenario_text
from hypothesis import given, settings
from hypothesis import strategies as st

from stressbot_driver.bench import DEFAULT_LENGTH_UNIT, ELECTRICAL_DEFAULTS, load_bench, parse_bench
from stressbot_driver.errors import ErrorCode, StressbotError

NAN, INF = float("nan"), float("inf")
SQUARE = {"x": [-1, 20], "y": [-1, 20]}


def refusal(text):
    with pytest.raises(StressbotError) as refused:
        parse_bench(text)
    assert refused.value.message and refused.value.field
    assert "\n" not in str(refused.value)
    return refused.value


def test_paper_scenario_in_metres():
    loaded = bench(6)
    assert loaded.speed == pytest.approx([1e-4] * len(loaded.ids))
    assert loaded.ids.tolist() == [1, 2, 3, 4, 5, 6]
    assert loaded.start[1].tolist() == pytest.approx([0.0, 2e-4, 0.0])
    assert loaded.group_count == 4
    assert loaded.membership[4].tolist() == [True, False, True]
    assert loaded.electrical.thresholds.tolist() == [20.0, 50.0, 75.0, 115.0]
    assert loaded.electrical.codes.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]
    assert loaded.workspace is None and loaded.obstacles == ()


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        bench().start[0, 0] = 1.0


def test_defaults_equal_the_schema():
    schema = json.loads(resources.files("stressbot_msgs").joinpath("scenario.schema.json").read_text())
    properties = schema["properties"]["electrical"]["properties"]
    assert {key: value["default"] for key, value in properties.items() if "default" in value} == ELECTRICAL_DEFAULTS
    assert schema["properties"]["length_unit"]["default"] == DEFAULT_LENGTH_UNIT
    assert scenario_text(**{"length_unit": ...}) != scenario_text()
    assert bench(**{"length_unit": ...}).swarm_id == bench().swarm_id


def test_swarm_id_follows_the_content_and_nothing_else():
    one = bench()
    assert len(one.swarm_id) == 16 and int(one.swarm_id, 16) >= 0
    assert bench(name="another name").swarm_id == one.swarm_id
    others = [
        bench(**{"swarm.speed": 2.0}),
        bench(**{"robots.0.start": [0.0, 0.1, 0.0]}),
        bench(**{"robots.0.goal": [0.0, 0.1]}),
        bench(**{"electrical.hysteresis": 3.0}),
        bench(**{"obstacles": [{"circle": {"center": [50, 50], "radius": 1}}]}),
        bench(**{"workspace": SQUARE}),
        bench(7),
    ]
    assert len({one.swarm_id, *(other.swarm_id for other in others)}) == len(others) + 1


def test_per_robot_values_and_explicit_groups():
    loaded = bench(2, **{"swarm.turning_radius": [1.0, 2.0], "swarm.body_radius": [0.3, 0.4], "swarm.groups": ["10", "01"]})
    assert loaded.turning_radius.tolist() == pytest.approx([1e-4, 2e-4])
    assert loaded.codewords == ("10", "01")


@pytest.mark.parametrize(
    ("count", "changes", "code", "field"),
    [
        (2, {"robots.1.start": [NAN, 0, 0]}, ErrorCode.NOT_FINITE, "robots[1].start[0]"),
        (2, {"robots.1.goal": [INF, 0]}, ErrorCode.NOT_FINITE, "robots[1].goal[0]"),
        (2, {"swarm.speed": -INF}, ErrorCode.NOT_FINITE, "swarm.speed"),
        (2, {"swarm.speed": 10**400}, ErrorCode.NOT_FINITE, "swarm.speed"),
        (2, {"swarm.speed": "fast"}, ErrorCode.WRONG_TYPE, "swarm.speed"),
        (2, {"swarm.speed": True}, ErrorCode.WRONG_TYPE, "swarm.speed"),
        (2, {"swarm.speed": None}, ErrorCode.WRONG_TYPE, "swarm.speed"),
        (2, {"name": 5}, ErrorCode.WRONG_TYPE, "name"),
        (2, {"name": ""}, ErrorCode.OUT_OF_RANGE, "name"),
        (2, {"robots": {}}, ErrorCode.WRONG_TYPE, "robots"),
        (2, {"swarm": []}, ErrorCode.WRONG_TYPE, "swarm"),
        (2, {"swarm.turning_radius": "one"}, ErrorCode.WRONG_TYPE, "swarm.turning_radius"),
        (2, {"swarm.turning_radius": [1.0, "one"]}, ErrorCode.WRONG_TYPE, "swarm.turning_radius[1]"),
        (2, {"swarm.turning_radius": [1.0]}, ErrorCode.WRONG_COUNT, "swarm.turning_radius"),
        (2, {"swarm.body_radius": [0.3, 0.3, 0.3]}, ErrorCode.WRONG_COUNT, "swarm.body_radius"),
        (2, {"robots.0.start": [0, 0]}, ErrorCode.WRONG_COUNT, "robots[0].start"),
        (2, {"robots.0.goal": [0, 0, 0, 0]}, ErrorCode.WRONG_COUNT, "robots[0].goal"),
        (2, {"swarm.speed": ...}, ErrorCode.MISSING_FIELD, "swarm.speed"),
        (2, {"swarm": ...}, ErrorCode.MISSING_FIELD, "swarm"),
        (2, {"robots.1": {"start": [0, 0, 0]}}, ErrorCode.MISSING_FIELD, "robots[1].goal"),
        (2, {"swarm.spede": 1}, ErrorCode.UNKNOWN_FIELD, "swarm.spede"),
        (2, {"obstacle": []}, ErrorCode.UNKNOWN_FIELD, "obstacle"),
        (2, {"electrical.volts": 1}, ErrorCode.UNKNOWN_FIELD, "electrical.volts"),
        (2, {"swarm.speed": 0}, ErrorCode.OUT_OF_RANGE, "swarm.speed"),
        (2, {"swarm.body_radius": -1}, ErrorCode.OUT_OF_RANGE, "swarm.body_radius"),
        (2, {"swarm.turning_radius": [1.0, 0.0]}, ErrorCode.OUT_OF_RANGE, "swarm.turning_radius[1]"),
        (2, {"swarm.speed": 1e300}, ErrorCode.OUT_OF_RANGE, "swarm.speed"),
        (2, {"robots.0.start": [1e200, 0, 0]}, ErrorCode.OUT_OF_RANGE, "robots[0].start[0]"),
        (2, {"length_unit": 0}, ErrorCode.OUT_OF_RANGE, "length_unit"),
        (2, {"length_unit": 1e-300}, ErrorCode.OUT_OF_RANGE, "length_unit"),
        (2, {"workspace": {"x": [20, 0], "y": [0, 20]}}, ErrorCode.OUT_OF_RANGE, "workspace.x"),
        (2, {"workspace": {"x": [0, 20]}}, ErrorCode.MISSING_FIELD, "workspace.y"),
        (0, {}, ErrorCode.NO_ROBOTS, "robots"),
        (2, {"swarm.groups": "bianry"}, ErrorCode.OUT_OF_RANGE, "swarm.groups"),
        (2, {"swarm.groups": 3}, ErrorCode.WRONG_TYPE, "swarm.groups"),
        (2, {"swarm.groups": [10, 11]}, ErrorCode.INVALID_CODEWORD, "swarm.groups[0]"),
        (2, {"swarm.groups": ["10", "1x"]}, ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        (2, {"swarm.groups": ["10", ""]}, ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        (2, {"swarm.groups": ["10", "100"]}, ErrorCode.INVALID_CODEWORD, "swarm.groups[1]"),
        (2, {"swarm.groups": ["10", "10"]}, ErrorCode.DUPLICATE_CODEWORD, "swarm.groups[1]"),
        (2, {"swarm.groups": ["10", "00"]}, ErrorCode.EMPTY_CODEWORD, "swarm.groups[1]"),
        (2, {"swarm.groups": ["10"]}, ErrorCode.WRONG_COUNT, "swarm.groups"),
        (2, {"robots.1.start": [0.0, 0.59, 0.0]}, ErrorCode.STARTS_OVERLAP, "robots[1].start"),
        (2, {"robots.1.start": [0.0, 0.0, 0.0]}, ErrorCode.STARTS_OVERLAP, "robots[1].start"),
        (2, {"workspace": {"x": [0, 20], "y": [-1, 20]}}, ErrorCode.OUTSIDE_WORKSPACE, "robots[0].start"),
        (
            2,
            {"obstacles": [{"circle": {"center": [1.2, 0], "radius": 1}}]},
            ErrorCode.INSIDE_OBSTACLE,
            "robots[0].start",
        ),
        (2, {"obstacles": [{"polygon": [[-1, 1], [1, 1], [0, 3]]}]}, ErrorCode.INSIDE_OBSTACLE, "robots[1].start"),
        (2, {"obstacles": [{"polygon": [[0.2, -1], [1, -1], [0.2, 1]]}]}, ErrorCode.INSIDE_OBSTACLE, "robots[0].start"),
        (2, {"obstacles": [{"polygon": [[5, 5], [6, 6]]}]}, ErrorCode.WRONG_COUNT, "obstacles[0].polygon"),
        (2, {"obstacles": [{"polygon": [[5, 5], [6, 6], [7, 7]]}]}, ErrorCode.OUT_OF_RANGE, "obstacles[0].polygon"),
        (
            2,
            {"obstacles": [{"polygon": [[5, 5], [7, 7], [7, 5], [5, 7]]}]},
            ErrorCode.OUT_OF_RANGE,
            "obstacles[0].polygon",
        ),
        (2, {"obstacles": [{}]}, ErrorCode.MISSING_FIELD, "obstacles[0]"),
        (2, {"obstacles": [{"square": 1}]}, ErrorCode.UNKNOWN_FIELD, "obstacles[0].square"),
        (
            2,
            {"obstacles": [{"circle": {"center": [9, 9], "radius": 0}}]},
            ErrorCode.OUT_OF_RANGE,
            "obstacles[0].circle.radius",
        ),
        (2, {"electrical.symbol_levels": [40]}, ErrorCode.WRONG_COUNT, "electrical.symbol_levels"),
        (2, {"electrical.symbol_levels": [60, 40]}, ErrorCode.OUT_OF_RANGE, "electrical.symbol_levels[1]"),
        (2, {"electrical.symbol_levels": [0, 40]}, ErrorCode.OUT_OF_RANGE, "electrical.symbol_levels[0]"),
        (2, {"electrical.reset_level": 50}, ErrorCode.OUT_OF_RANGE, "electrical.reset_level"),
        (2, {"electrical.drive_level": 300}, ErrorCode.OUT_OF_RANGE, "electrical.max_level"),
        (2, {"electrical.min_level": 10}, ErrorCode.OUT_OF_RANGE, "electrical.min_level"),
        (2, {"electrical.thresholds": [20, 50, 75]}, ErrorCode.WRONG_COUNT, "electrical.thresholds"),
        (2, {"electrical.thresholds": [20, 50, 75, 150]}, ErrorCode.OUT_OF_RANGE, "electrical.thresholds[3]"),
        (2, {"electrical.hysteresis": 21}, ErrorCode.OUT_OF_RANGE, "electrical.hysteresis"),
        (2, {"electrical.hysteresis": -1}, ErrorCode.OUT_OF_RANGE, "electrical.hysteresis"),
        (2, {"electrical.pull_down": 141}, ErrorCode.OUT_OF_RANGE, "electrical.pull_down"),
        (2, {"electrical.pull_down": 20}, ErrorCode.OUT_OF_RANGE, "electrical.pull_down"),
        (2, {"electrical.release": -1}, ErrorCode.OUT_OF_RANGE, "electrical.release"),
        (2, {"electrical.symbol_dwell": 0.001}, ErrorCode.OUT_OF_RANGE, "electrical.symbol_dwell"),
        (2, {"electrical.guard_dwell": 0}, ErrorCode.OUT_OF_RANGE, "electrical.guard_dwell"),
        (2, {"electrical.codes": []}, ErrorCode.WRONG_COUNT, "electrical.codes"),
        (2, {"electrical.codes": [[0], [1], [0, 1]]}, ErrorCode.WRONG_COUNT, "electrical.codes[2]"),
        (2, {"electrical.codes": [[0, 0], [0, 1], [0, 1]]}, ErrorCode.OUT_OF_RANGE, "electrical.codes[2]"),
        (2, {"electrical.codes": [[0, 0], [0, 1], [0, 2]]}, ErrorCode.OUT_OF_RANGE, "electrical.codes[2]"),
        (2, {"electrical.codes": [[0, 0], [0, 1], [0, 0.5]]}, ErrorCode.WRONG_TYPE, "electrical.codes[2][1]"),
    ],
)
def test_bad_input_names_the_field(count, changes, code, field):
    error = refusal(scenario_text(count, **changes))
    assert (error.code, error.field) == (code, field)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", ErrorCode.MALFORMED_FILE),
        ("just text", ErrorCode.MALFORMED_FILE),
        ("- a\n- b\n", ErrorCode.MALFORMED_FILE),
        ("name: [1, 2", ErrorCode.MALFORMED_FILE),
        ("name: a\nname: b\n", ErrorCode.MALFORMED_FILE),
        ("name: !!python/object:os.system {}\n", ErrorCode.MALFORMED_FILE),
        ("name: \x00\n", ErrorCode.MALFORMED_FILE),
        ("? [1, 2]\n: 3\n", ErrorCode.MALFORMED_FILE),
        ("[" * 100_000, ErrorCode.MALFORMED_FILE),
        ("a: &a [1]\nb: *a\n", ErrorCode.MALFORMED_FILE),
        ("a: &a [*a]\n", ErrorCode.MALFORMED_FILE),
    ],
)
def test_malformed_files(text, code):
    assert refusal(text).code == code


def test_aliases_do_not_unfold_without_end():
    lines = ["a0: &a0 [1, 1]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 30)]
    assert refusal("\n".join(lines)).code == ErrorCode.MALFORMED_FILE


def test_truncated_files():
    text = "name: cut\nswarm: {speed: 1, turning_radius: 1, body_radius: 0.3}\nrobots: [{start: [0, 0, 0], goal: [1, 1]}]\n"
    parse_bench(text)
    for length in range(len(text) - 1):
        assert refusal(text[:length]).code in (ErrorCode.MALFORMED_FILE, ErrorCode.MISSING_FIELD, ErrorCode.WRONG_TYPE)


@pytest.mark.parametrize("text", ["1e-4", "1E-4", "+1.0e-4", ".1e-3", "1.e-4"])
def test_exponents_need_no_decimal_point(text):
    assert parse_bench(scenario_text().replace("length_unit: 0.0001", f"length_unit: {text}")).swarm_id == bench().swarm_id


def test_unquoted_codewords_say_quote_them():
    assert "quote" in refusal(scenario_text(2, **{"swarm.groups": [10, 11]})).message


def test_unreadable_files(tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, code in [
        (tmp_path / "missing.yaml", ErrorCode.UNREADABLE_FILE),
        (tmp_path, ErrorCode.UNREADABLE_FILE),
        ("\x00", ErrorCode.UNREADABLE_FILE),
        (binary, ErrorCode.UNREADABLE_FILE),
    ]:
        with pytest.raises(StressbotError) as refused:
            load_bench(path)
        assert refused.value.code == code


def test_bodies_may_touch():
    bench(2, **{"robots.1.start": [0.0, 0.6, 0.0]})
    bench(2, **{"robots.0.start": [0.0, 2.0, 0.0], "robots.1.start": [0.0, 2.6, 0.0]})
    bench(2, **{"workspace": {"x": [-0.3, 13], "y": [-0.3, 13]}})


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_overlap_sweep_finds_what_all_pairs_find(data):
    from stressbot_driver.geometry import first_overlap, touching_slack

    count = data.draw(st.integers(1, 8))
    coordinate = st.integers(0, 12).map(float)
    xy = np.array(data.draw(st.lists(st.tuples(coordinate, coordinate), min_size=count, max_size=count)))
    radius = np.array(data.draw(st.lists(st.sampled_from([0.0, 0.2, 0.5, 1.5]), min_size=count, max_size=count)))
    slack = touching_slack(radius, [xy], None, [])
    pairs = {
        (a, b)
        for a in range(count)
        for b in range(a + 1, count)
        if np.hypot(*(xy[a] - xy[b])) < radius[a] + radius[b] - slack
    }
    found = first_overlap(xy, radius, slack)
    assert (found in pairs and found[1] == min(b for _, b in pairs)) if pairs else found is None


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_junk_anywhere_is_refused_in_words_or_accepted(data):
    """Replace one value of a valid file by anything at all: nothing but StressbotError comes out."""
    content = scenario(2, **{"workspace": SQUARE, "electrical": ELECTRICAL_DEFAULTS, "obstacles": []})
    content["obstacles"].append({"circle": {"center": [9, 9], "radius": 1}})
    content["obstacles"].append({"polygon": [[15, 9], [16, 9], [15, 11]]})
    content = copy.deepcopy(content)
    target, path = content, []
    while True:
        keys = sorted(target) if isinstance(target, dict) else list(range(len(target)))
        path.append(data.draw(st.sampled_from(keys)))
        inner = target[path[-1]]
        if not isinstance(inner, (dict, list)) or not inner or data.draw(st.booleans()):
            break
        target = inner
    target[path[-1]] = data.draw(junk)
    try:
        parse_bench(yaml.dump(content, Dumper=yaml.SafeDumper))
    except StressbotError as error:
        assert error.message and "\n" not in error.message


@pytest.mark.timing
def test_five_thousand_robots_in_reasonable_time_and_memory():
    robots = [{"start": [k % 71, k // 71, 0], "goal": [k % 71, k // 71 + 100]} for k in range(5000)]
    text = yaml.dump({**scenario(1), "robots": robots}, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper))
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    loaded = parse_bench(text)
    assert time.process_time() - began < 20.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB
    assert loaded.membership.shape == (5000, 13)


def test_too_many_robots():
    line = "{start: [0, 0, 0], goal: [0, 0]}"
    text = scenario_text(0).replace("robots: []", f"robots: [{', '.join([line] * 10_001)}]")
    assert refusal(text).code == ErrorCode.TOO_MANY_ROBOTS


def test_steps_frequency_and_speed_follow_from_each_other():
    assert bench(2).electrical.drive is None
    assert bench(2, **{"electrical.drive": "constant"}).electrical.drive is None
    drive = bench(2, **{"electrical.drive": "pulses", "swarm.speed": [1.0, 2.0]}).electrical.drive
    assert drive.frequency == pytest.approx(2.0 * 1e-4 / 12e-9)
    for fields, frequency in (
        ({"step_length": 1e-3}, 1e3),
        ({"frequency": 500.0}, 500.0),
        ({"step_length": [2e-3, 2e-3], "frequency": 500.0}, 500.0),
    ):
        assert bench(2, **{"electrical.drive": fields}).electrical.drive.frequency == pytest.approx(frequency)


@pytest.mark.parametrize(
    ("drive", "changes", "code", "field"),
    [
        ({"step_length": 0.0}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.step_length"),
        ({"step_length": -1.2e-4}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.step_length"),
        ({"step_length": [1e-4] * 3}, {}, ErrorCode.WRONG_COUNT, "electrical.drive.step_length"),
        ({"step_length": 1e-4}, {"swarm.speed": [1.0, 0.5]}, ErrorCode.NO_COMMON_FREQUENCY, "electrical.drive.step_length"),
        ({"step_length": 1e-4, "frequency": 9e3}, {}, ErrorCode.NO_COMMON_FREQUENCY, "electrical.drive.step_length"),
        ({"frequency": 83_333.0}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.frequency"),
        ({"step_length": 1e9}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.frequency"),
        ({"low_level": 90.0}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.low_level"),
        ({"low_level": 140.0}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive_level"),
        ("pulses", {"electrical.release": 110.0}, ErrorCode.OUT_OF_RANGE, "electrical.drive.low_level"),
        ({"response": 0.01}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.response"),
        ({"polarity": "alternating"}, {}, ErrorCode.OUT_OF_RANGE, "electrical.min_level"),
        ({"polarity": "both"}, {}, ErrorCode.OUT_OF_RANGE, "electrical.drive.polarity"),
        ("pulsed", {}, ErrorCode.OUT_OF_RANGE, "electrical.drive"),
        ({"levels": 3}, {}, ErrorCode.UNKNOWN_FIELD, "electrical.drive.levels"),
        (3, {}, ErrorCode.WRONG_TYPE, "electrical.drive"),
    ],
)
def test_drives_that_cannot_be_are_refused(drive, changes, code, field):
    with pytest.raises(StressbotError) as refused:
        bench(2, **{"electrical.drive": drive, **changes})
    assert (refused.value.code, refused.value.field) == (code, field)
