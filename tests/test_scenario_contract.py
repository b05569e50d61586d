"""The planner and the driver read scenario files by themselves: both must see the same scene, and refuse the same files."""

from pathlib import Path

import numpy as np
import pytest

from stressbot_driver import bench
from stressbot_driver.errors import BenchError, ErrorCode
from stressbot_planner import allocation, errors, scenario

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
    "zero body": changed("body_radius: 0.3", "body_radius: 0.0"),
    "speeds for other robots": changed("speed: 1.0", "speed: [1, 1, 1]"),
    "a robot without speed": changed("speed: 1.0", "speed: [1, 0]"),
    "radii for other robots": changed("turning_radius: 1.0", "turning_radius: [1, 1, 1]"),
    "codewords for other robots": changed('"01", "10"', '"01", "10", "11"'),
    "duplicate codeword": changed('"01", "10"', '"01", "01"'),
    "duplicate codeword and radius": changed("turning_radius: 1.0", "turning_radius: [0.5, 0.5]").replace('"01", "10"', '"1", "1"'),
    "empty codeword": changed('"01", "10"', '"00", "10"'),
    "codewords of two lengths": changed('"01", "10"', '"01", "100"'),
    "text for a goal": changed("goal: [2, 8]", "goal: anywhere"),
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
    with pytest.raises(errors.StressbotError) as caught:
        scenario.load(path)
    return int(caught.value.code)


def driver_code(path) -> int:
    with pytest.raises(BenchError) as caught:
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


def test_both_take_robots_that_share_a_codeword_but_no_radius(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(changed("turning_radius: 1.0", "turning_radius: [1.0, 0.5]").replace('"01", "10"', '"1", "1"'))
    assert scenario.load(path).swarm.codewords == tuple(bench.load_bench(path).codewords) == ("1", "1")


@pytest.mark.parametrize("text", [GOOD, GOOD + CALIBRATED.format(now=2, half=0.1)], ids=["plain", "calibrated"])
def test_the_good_file_is_good(text, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    scenario.load(path)
    bench.load_bench(path)
