"""What the page is told, and the page as one file."""

import base64
import hashlib
import json
import math
import re

import numpy as np
import pytest

from stressbot_planner import planners
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import StoredPlan
from stressbot_planner.planners import assignment
from stressbot_planner.sequencing import encode
from stressbot_planner.view import page, scene
from stressbot_planner.view.trail import MOST_PLACES, STEP, Trail

SCENARIO = """
name: few
length_unit: 1.0e-4
workspace: {x: [0, 12], y: [0, 12]}
obstacles: [{circle: {center: [5, 6], radius: 1.0}}, {polygon: [[9, 9], [10, 9], [10, 10]]}]
swarm: {speed: 1.0, turning_radius: 1.0, body_radius: 0.3, groups: binary}
robots:
  - {start: [2, 2, 0], goal: [7, 8]}
  - {start: [2, 6, 0], goal: [8, 2, 2.5]}
"""


@pytest.fixture(scope="module", params=["constant", "pulses", "{polarity: alternating, low_level: 110}"])
def planned(request):
    text = SCENARIO + f"electrical: {{drive: {request.param}, min_level: -200}}\n"
    loaded = scenario.parse(text)
    limits = planners.Settings(
        max_tries=1, first=True, selection_time=loaded.electrical.selection_time,
        pulse_length=loaded.electrical.pulse_length(loaded.swarm.speed),
    )
    result = assignment.solve(loaded.problem, "optimize", limits)
    assert result.success
    return loaded, StoredPlan(result.planner, 0, True, result.plan)


def test_a_scene_is_told_in_micrometres(planned):
    told, _ = scene.of_plan(*planned)
    word = planned[0].swarm.codewords[1]
    robot = {"id": 2, "word": word, "pace": 1.0, "turning": 100.0, "body": 30.0, "calibrated": False, "goalHeading": 2.5}
    robot |= {"waypoints": [], "parked": False}
    assert told["robots"][1] == robot and told["robots"][0]["goalHeading"] is None
    assert told["starts"] == [[200.0, 200.0, 0.0], [200.0, 600.0, 0.0]] and told["goals"] == [[700.0, 800.0], [800.0, 200.0]]
    assert told["walls"] == [[0.0, 1200.0], [0.0, 1200.0]] and told["obstacles"][0] == {"circle": [500.0, 600.0, 100.0]}
    assert told["obstacles"][1]["polygon"][2] == [1000.0, 1000.0]
    assert told["icons"] == [120.0, 120.0]
    json.dumps(told, allow_nan=False)


def test_stages_parked_robots_and_contacts_are_told():
    robots = """robots:
  - {start: [2, 2, 0], waypoints: [[2, 4], [5, 9]], goal: [7, 8]}
  - {start: [2, 6, 0], waypoints: [[3, 7], [4, 7]], goal: [8, 2]}
  - {start: [10, 2, 0], goal: parked}
contacts: [[1, 2]]
"""
    text = SCENARIO.partition("robots:")[0].replace("groups: binary", "groups: ['100', '010', '001']") + robots
    told = scene.of_scenario(scenario.parse(text))
    ways = [robot["waypoints"] for robot in told["robots"]]
    assert ways == [[[200, 400], [500, 900]], [[300, 700], [400, 700]], [[1000, 200]] * 2]
    assert [robot["parked"] for robot in told["robots"]] == [False, False, True]
    assert told["contacts"] == [[0, 1]] and told["goals"][2] == told["starts"][2][:2]


def moved(told, motion):
    """Poses at the end of a motion, as the page computes them."""
    poses = np.array(motion["starts"])
    for group, length in zip(motion["groups"], motion["lengths"], strict=True):
        for row, robot in enumerate(told["robots"]):
            way = length * robot["pace"]
            if group <= len(robot["word"]) and robot["word"][group - 1] == "1":
                poses[row, :2] += way * math.cos(poses[row, 2]), way * math.sin(poses[row, 2])
            else:
                poses[row, 2] += way / robot["turning"]
    return poses


def test_groups_and_lengths_lead_where_the_plan_does(planned):
    loaded, stored = planned
    told, motion = scene.of_plan(loaded, stored)
    assert np.abs(moved(told, motion)[:, :2] - 100 * stored.plan.poses[-1, :, :2]).max() < 0.5
    assert (len(motion["groups"]), motion["solved"]) == (encode_count(loaded, stored), True)
    assert motion["path"] == pytest.approx(100 * stored.plan.path_length, abs=0.01)


def encode_count(loaded, stored):
    return encode(loaded.swarm, loaded.electrical, stored.plan.groups, stored.plan.lengths).epoch_count


def test_volts_follow_from_what_is_told(planned):
    """The page's own arithmetic: reset, rest, symbols and rests, drive, rest."""
    loaded, stored = planned
    told, motion = scene.of_plan(loaded, stored)
    program = encode(loaded.swarm, loaded.electrical, stored.plan.groups, stored.plan.lengths)
    volts, levels = told["volts"], []
    for k, group in enumerate(motion["groups"]):
        sign = motion["signs"][k] if "signs" in motion else 1
        levels += [sign * volts["reset"], volts["rest"]]
        for symbol in volts["codes"][group - 1]:
            levels += [sign * volts["symbols"][symbol], volts["rest"]]
        levels += [sign * volts["drive"], volts["rest"]]
    assert levels == program.levels.tolist()
    drives = [length / told["speed"] for length in motion["lengths"]]
    assert np.allclose(drives, program.dwells[program.epoch_ends - 2], atol=1e-6)


def test_the_file_stands_alone(planned):
    told, motion = scene.of_plan(*planned)
    told["name"] = "</script><script>alert(1)</script>"
    html = page.alone({"file": "PLAN", "scene": told, "motion": motion})
    assert html.count("<script") == html.count("</script>") == 2
    inside = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', html)[1])
    assert inside["scene"]["name"] == told["name"] and inside["motion"]["groups"] == motion["groups"]
    assert "WebSocket" not in html


@pytest.mark.parametrize("html", [page.live(), page.alone({"file": "PLAN"})])
def test_nothing_is_loaded_from_outside(html):
    text = html.replace("ws://${location.host}", "")
    assert not re.search(r"https?://|//\w+\.\w+/|@import|\bsrc=|url\(|import\(|fetch\(|eval\(", text)
    assert re.findall(r'href="(.*?)"', html) == ["data:,"]


def test_the_policy_names_the_very_script_and_style():
    html = page.live()
    for kind in ("script", "style"):
        (text,) = re.findall(rf"<{kind}>(.*?)</{kind}>", html, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in page.policy(html)


def test_the_page_is_small():
    assert len(page.alone({})) < 60_000 and len(page.live()) < 65_000


def test_a_trail_keeps_places_that_are_apart_and_no_more_than_can_be_drawn():
    trail = Trail()
    assert trail.add(np.zeros((2, 2))) and not trail.add(np.full((2, 2), STEP / 2))
    assert trail.add(np.array([[0.0, 0.0], [STEP, 0.0]]))
    assert trail.told() == [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, STEP, 0.0]]
    trail.clear()
    assert trail.told() == []
    count = 1000
    for k in range(2 * MOST_PLACES // count):
        trail.add(np.full((count, 2), 10.0 * k))
    assert sum(len(row) // 2 for row in trail.told()) <= MOST_PLACES


def test_a_robot_out_of_sight_leaves_a_gap():
    trail = Trail()
    trail.add(np.array([[0.0, 0.0], [np.nan, np.nan]]))
    assert trail.told() == [[0.0, 0.0, None, None]]
    assert trail.add(np.array([[0.0, 0.0], [5.0, 5.0]]))
