"""`stressbot allocate`: files that keep what they had, one line for each refusal, what is proved and what is found."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from command import run
from PIL import Image

from stressbot_planner import planners
from stressbot_planner.formats import scenario as scenario_module
from stressbot_planner.model import allocation
from stressbot_planner.reproduce import instances

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
SIX, DISCS = str(SCENARIOS / "paper-six.yaml"), str(SCENARIOS / "paper-six-two-discs.yaml")
FEW = "--max-tries", 6
WAIT = 300.0
"""s, for a process to end, on however busy a machine."""

WHOLE = """
# a comment
name: "1e5"
length_unit: 1.0e-4
workspace: {x: [-20, 30], y: [-10, 30]}
obstacles: [{circle: {center: [10, 10], radius: 1}}, {polygon: [[4, 14], [6, 14], [5, 16]]}]
swarm: {speed: [1, 0.5, 1], turning_radius: [1, 2, 3], body_radius: 0.3, groups: by_radius}
goals: [[2, 8], [8, 12]]
robots:
  - {start: [2, 2, 0], goal: assign}
  - {start: [2, 12, 0], goal: assign}
  - {start: [12, 2, 0.5], goal: [12, 6]}
calibration: {confidence: 0.95, robots: [{robot: 1, now: 1, selections: 9, missed: 0, speed: [1, 0.1]}]}
electrical: {drive: {polarity: alternating}, min_level: -200, symbol_levels: [30, 50, 70]}
"""


def test_it_says_what_is_proved_and_found_and_writes_a_scenario(capsys, tmp_path):
    output = tmp_path / "chosen.yaml"
    code, out, err = run(capsys, "allocate", DISCS, "--groups", 4, "--max-tries", 30, "--output", output)
    assert (code, err) == (0, "")
    assert "no allocation to 4 groups gets below 27.79 s" in out and "less than as given" in out
    chosen, given = scenario_module.load(output), scenario_module.load(DISCS)
    assert f"R1 {chosen.swarm.codewords[0]}  R2 {chosen.swarm.codewords[1]}" in out
    assert chosen.swarm.codewords != given.swarm.codewords and len(set(chosen.swarm.codewords)) == 6
    settings = planners.Settings(objective="time", max_tries=30, seed=77, selection_time=0.05)
    times = [planners.solve(one.problem, "optimize", settings).plan.execution_time for one in (chosen, given)]
    assert times[0] < 0.9 * times[1]


@pytest.mark.parametrize("groups", [3, 4])
def test_everything_else_of_the_file_stays(capsys, tmp_path, groups):
    path, output = tmp_path / "whole.yaml", tmp_path / "chosen.yaml"
    path.write_text(WHOLE)
    assert run(capsys, "allocate", path, "--groups", groups, *FEW, "--output", output)[::2] == (0, "")
    before, after = (yaml.safe_load(file.read_text().replace("1.0e-4", "0.0001")) for file in (path, output))
    words = after["swarm"].pop("groups")
    assert before["swarm"].pop("groups") == "by_radius" and before == after
    assert len(set(words)) == 3 and {len(word) for word in words} == {groups - 1}
    assert scenario_module.load(output).name == "1e5"


def test_programs_read_all_of_it(capsys, tmp_path):
    output = tmp_path / "chosen.yaml"
    words = ("--groups", 5, "--modules", 2, "--objective", "0.5", *FEW, "--json")
    code, out, _ = run(capsys, "allocate", SIX, *words, "--output", output)
    data = json.loads(out)
    assert code == 0 and data["written"] == str(output) and data["unit"] == "× the straight ways"
    found, given = data["found"]["allocation"], data["given"]
    assert (found["groups"], given["groups"], found["symbols"], given["symbols"]) == (5, 4, 3, 2)
    assert (found["states"], found["epoch_selection_time"]) == (5, pytest.approx(0.065))
    assert max(found["modules"]) <= 2 and found["modules"] == [word.count("1") for word in found["codewords"]]
    assert found["selection_time"] == pytest.approx(found["epoch_selection_time"] * found["activations"])
    assert data["found"]["proved"] <= found["bound"] <= found["cost"]
    assert data["found"]["tries"] == 6
    assert list(scenario_module.load(output).swarm.codewords) == found["codewords"]


def test_the_same_seed_writes_the_same_file(capsys, tmp_path):
    texts = []
    for name in "ab":
        run(capsys, "allocate", SIX, "--groups", 4, *FEW, "--seed", 3, "--output", tmp_path / name)
        texts.append((tmp_path / name).read_text())
    assert texts[0] == texts[1]


def test_nothing_better_leaves_the_given_codewords_as_they_are(capsys, tmp_path):
    path, output = tmp_path / "one.yaml", tmp_path / "chosen.yaml"
    path.write_text("name: one\nswarm: {speed: 1, turning_radius: 1, body_radius: 0.3, groups: ['1']}\n"
                    "robots: [{start: [0, 0, 0], goal: [5, 5]}]\n")
    code, out, _ = run(capsys, "allocate", path, "--groups", 2, *FEW, "--output", output)
    assert code == 0 and "no better allocation than the given one" in out
    assert scenario_module.load(output).swarm.codewords == ("1",)


def test_tasks_of_files_and_at_random(capsys, tmp_path):
    output = tmp_path / "chosen.yaml"
    for tasks, count in ((("random:2",), 2), ((DISCS, SIX), 2)):
        words = ("--groups", 4, "--max-tries", 6, "--tasks", *tasks, "--json", "--output", output)
        code, out, err = run(capsys, "allocate", SIX, *words)
        assert (code, err, json.loads(out)["tasks"]) == (0, "", count)
        assert scenario_module.load(output).name == "paper-six"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--groups", 3, "--output", "x.yaml"), "--groups: is 3: 6 robots need 4 for a codeword each"),
        (("--groups", 8, "--output", "x.yaml"), "--groups: is 8: 6 robots have no use for more than 7"),
        (("--groups", 0, "--output", "x.yaml"), "--groups: is '0'"),
        (("--groups", 4), "--output: is missing"),
        (("--output", "x.yaml"), "--groups --sweep is required"),
        (("--groups", 4, "--sweep", "--output", "x.yaml"), "not allowed with argument --groups"),
        (("--groups", 4, "--modules", 1, "--output", "x.yaml"), "--modules: is 1: 4 groups then make 3 codewords for 6"),
        (("--groups", 4, "--modules", 4, "--output", "x.yaml"), "--modules: is 4: give 1 to 3"),
        (("--groups", 4, "--objective", "speed", "--output", "x.yaml"), "objective: is 'speed'"),
        (("--groups", 4, "--output", SIX), "--output: "),
        (("--groups", 4, "--output", "nowhere/x.yaml"), "--output: the folder nowhere does not exist"),
        (("--groups", 4, "--output", "x.yaml", "--tasks", "random:0"), "--tasks: is 'random:0'"),
        (("--groups", 4, "--output", "x.yaml", "--tasks", "random:2", SIX), "--tasks: is 'random:2 "),
        (("--groups", 4, "--output", "x.yaml", "--tasks", str(SCENARIOS / "different-radii.yaml")), "--tasks: "),
        (("--groups", 4, "--output", "x.yaml", "--tasks", "none.yaml"), "none.yaml cannot be read"),
        (("--groups", 4, "--output", "x.yaml", "--max-tries", "no"), "--max-tries"),
        (("--sweep", "--output", "x.yaml"), "--output: ends in '.yaml': of a sweep use .png"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(capsys, tmp_path, monkeypatch, words, named):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "allocate", SIX, *words)
    assert (code, out, len(err.splitlines())) == (2, "", 1) and named in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("goal", "field"),
    [
        ("goal: [14.0, 18.0, 0.5]", "robots[1].goal has a heading"),
        ("goal: parked", "robots[1].goal is parked"),
        ("goal: [14.0, 18.0]\n  waypoints: [[9, 9]]", "robots[1].waypoints are in the way"),
    ],
)
def test_headings_parked_robots_and_stages_are_refused_in_the_scenario_and_in_tasks(capsys, tmp_path, goal, field):
    path, output = tmp_path / "more.yaml", tmp_path / "x.yaml"
    text = instances.paper(True).replace("goal: [14.0, 18.0]", goal)
    words = [word + word.translate({48: "1", 49: "0"}) for word in allocation.binary(6)]
    path.write_text(text.replace("groups: binary", "groups: " + str(words).replace("'", '"')))
    assert scenario_module.load(path).problem.swarm.n == 6
    code, out, err = run(capsys, "allocate", path, "--groups", 4, *FEW, "--output", output)
    assert (code, out) == (2, "") and err.startswith(f"stressbot: {field.replace(' ', ': ', 1)}")
    code, out, err = run(capsys, "allocate", DISCS, "--groups", 4, "--tasks", path, *FEW, "--output", output)
    assert (code, out) == (2, "") and err.startswith(f"stressbot: --tasks: {path}: {field}")
    assert not output.exists()


def test_codes_of_its_own_fit_its_own_number_of_groups_only(capsys, tmp_path):
    path, output = tmp_path / "six.yaml", tmp_path / "x.yaml"
    text = Path(SIX).read_text().replace("{drive: pulses}", "{drive: pulses, codes: [[0, 1], [1, 0], [1, 1], [0, 0]]}")
    path.write_text(text)
    code, _, err = run(capsys, "allocate", path, "--groups", 5, *FEW, "--output", output)
    assert code == 2 and "electrical.codes" in err and not output.exists()
    assert run(capsys, "allocate", path, "--groups", 4, *FEW, "--output", output)[0] == 0
    assert scenario_module.load(output).electrical.codes == ((0, 1), (1, 0), (1, 1), (0, 0))


def test_no_plan_at_all_ends_with_3_and_writes_nothing(capsys, tmp_path):
    path, output = tmp_path / "caged.yaml", tmp_path / "x.yaml"
    path.write_text(
        "name: caged\nswarm: {speed: 1, turning_radius: 1, body_radius: 0.3}\nworkspace: {x: [0, 10], y: [0, 10]}\n"
        "obstacles: [{polygon: [[4.9, 0], [5.1, 0], [5.1, 10], [4.9, 10]]}]\n"
        "robots: [{start: [1, 1, 0], goal: [9, 9]}, {start: [1, 4, 0], goal: [1, 8]}]\n"
    )
    code, _, err = run(capsys, "allocate", path, "--groups", 3, *FEW, "--output", output)
    assert code == 3 and "no plan found for 3 groups" in err and "robot 1 cannot get" in err and not output.exists()


def test_too_little_time_for_one_run_says_so(capsys, tmp_path):
    code, _, err = run(capsys, "allocate", SIX, "--groups", 4, "--time-limit", 1e-6, "--output", tmp_path / "x.yaml")
    assert code == 3 and "not one run of the planner ended in time, allow more" in err


def test_a_sweep_is_a_table_and_a_picture(capsys, tmp_path):
    path, picture = tmp_path / "four.yaml", tmp_path / "curve.png"
    run(capsys, "init", path, "--robots", 4)
    code, out, err = run(capsys, "allocate", path, "--sweep", "--max-tries", 6, "--output", picture)
    assert (code, err) == (0, "")
    assert [line.split()[1] for line in out.splitlines() if line.startswith("  found ")] == ["4", "5"]
    pixels = np.asarray(Image.open(picture).convert("RGB"))
    for colour in ((0, 114, 178), (230, 159, 0), (0, 158, 115)):
        assert (np.abs(pixels.astype(int) - colour).sum(axis=2) < 30).sum() > 50
    data = json.loads(run(capsys, "allocate", path, "--sweep", "--max-tries", 6, "--json")[1])
    assert [one["allocation"]["groups"] for one in data["found"]] == [4, 5]


@pytest.mark.parametrize("jobs", [1, 2])
def test_ctrl_c_keeps_the_best_allocation(tmp_path, jobs):
    output = tmp_path / "x.yaml"
    terminal, end = pty.openpty()
    words = ["allocate", DISCS, "--groups", "4", "--time-limit", "3000", "--jobs", str(jobs), "--output", str(output)]
    module = [sys.executable, "-m", "stressbot_planner.cli.tool"]
    process = subprocess.Popen([*module, *words], stderr=end, stdout=subprocess.PIPE, text=True)
    os.close(end)
    shown, is_pressed = "", False
    with open(terminal, "rb", buffering=0) as stream, contextlib.suppress(OSError):  # EIO at the end
        while data := stream.read(4096):
            shown += data.decode()
            if not is_pressed and "4 groups, best " in shown:
                process.send_signal(signal.SIGINT)
                is_pressed = True
    told = process.communicate(timeout=WAIT)[0]
    assert process.returncode == 0 and "ended by Ctrl-C" in told and "Ctrl-C keeps the best allocation" in shown
    assert len(set(scenario_module.load(output).swarm.codewords)) == 6


def test_more_groups_than_a_swarm_has_now_begin_with_those(capsys, tmp_path):
    """Groups without members cost no more than longer codes do: so what is found is at most that much worse."""
    code, out, _ = run(capsys, "allocate", SIX, "--groups", 7, *FEW, "--json", "--output", tmp_path / "x.yaml")
    data = json.loads(out)
    given, found = data["given"], data["found"]["allocation"]
    assert code == 0 and allocation.binary(6) == tuple(given["codewords"])
    assert found["cost"] <= given["cost"] + 0.02 * given["activations"]
