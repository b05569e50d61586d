"""The offline tool: exit codes, one line for each refusal, files that can be read back."""

import contextlib
import json
import os
import pty
import re
import resource
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from command import run
from PIL import Image, ImageSequence

from stressbot_planner import planners
from stressbot_planner.cli import printing
from stressbot_planner.cli import tool as cli
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.formats import scenario as scenario_module
from stressbot_planner.system import files

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
STEP = 1.2e-4
"""units, of one pulse"""

SIX, DISCS = str(SCENARIOS / "paper-six.yaml"), str(SCENARIOS / "paper-six-two-discs.yaml")
CAGED = """
name: caged
swarm: {speed: 1, turning_radius: 1, body_radius: 0.3}
obstacles:
  - polygon: [[4, 4], [6, 4], [6, 3.8], [4, 3.8]]
  - polygon: [[4, 6], [6, 6], [6, 6.2], [4, 6.2]]
  - polygon: [[4, 3.8], [4, 6.2], [3.8, 6.2], [3.8, 3.8]]
  - polygon: [[6, 3.8], [6, 6.2], [6.2, 6.2], [6.2, 3.8]]
robots:
  - {start: [0, 0, 0], goal: [5, 5]}
"""


@pytest.fixture
def caged(tmp_path):
    path = tmp_path / "caged.yaml"
    path.write_text(CAGED)
    return path


WAIT = 300.0
"""s, for a process to end, on however busy a machine."""

# --- plan -----------------------------------------------------------------------------------------------------------


def test_plan_prints_a_summary_and_no_json(capsys):
    code, out, err = run(capsys, "plan", SIX)
    assert (code, err) == (0, "")
    assert "result:         solved" in out
    for word in ("path length:", "lower bound 144.84", "lower bound 48.28", "min clearance:", "goal error:", "optimize, seed 0"):
        assert word in out
    assert "{" not in out


@pytest.mark.parametrize(("scenario", "planner"), [(SIX, "optimize"), (DISCS, "optimize"), (DISCS, "pure_control")])
def test_plan_writes_a_file_that_plot_draws(capsys, tmp_path, scenario, planner):
    plan, picture = tmp_path / "plan.json", tmp_path / "plan.png"
    code, out, err = run(capsys, "plan", scenario, "--planner", planner, "--seed", 4, "--objective", "time", "--output", plan)
    assert (code, err) == (0, "")
    data = json.loads(plan.read_text())
    assert (data["success"], data["planner"], data["seed"], data["scenario"]) == (True, planner, 4, Path(scenario).stem)
    assert data["goal_error"] <= data["tolerance"] == pytest.approx(1e-6 + 5 * STEP)
    assert data["min_clearance"] >= 0
    assert str(plan) in out
    assert run(capsys, "plot", scenario, plan, "--output", picture) == (0, f"{picture}\n", "")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_goals_that_any_robot_may_take_are_assigned_recorded_and_drawn(capsys, tmp_path):
    path, plan, picture = tmp_path / "free.yaml", tmp_path / "plan.json", tmp_path / "plan.png"
    text = Path(SIX).read_text()
    goals = re.findall(r"goal: (\[.*?\])", text)
    path.write_text(re.sub(r"goal: \[.*?\]", "goal: assign", text) + f"goals: [{', '.join(goals)}]\n")
    code, out, err = run(capsys, "plan", path, "--planner", "pure_control", "--output", plan)
    assert (code, err) == (0, "")
    assert "goals:          6 assigned among robots 1-6" in out
    data = json.loads(plan.read_text())
    assert sorted(data["goals"]) == sorted(map(json.loads, goals))
    assert data["lower_bounds"]["path_length"] < 144.8  # as the paper assigns them
    assert data["goal_error"] <= data["tolerance"]
    assert run(capsys, "plot", path, plan, "--output", picture)[0] == 0
    code, out, err = run(capsys, "show", path)
    assert (code, err) == (0, "")
    shown = float(re.search(r"path ([\d.]+) units", out)[1])
    assert shown == pytest.approx(data["lower_bounds"]["path_length"], abs=0.01 + 30 * STEP)


def test_no_plan_is_exit_code_3_with_a_reason_and_the_closest_attempt(capsys, tmp_path, caged):
    plan = tmp_path / "plan.json"
    code, out, err = run(capsys, "plan", caged, "--time-limit", "0.3", "--output", plan)
    assert code == 3
    assert len(err.splitlines()) == 1
    assert err.startswith("stressbot: no plan found: ")
    assert "no plan found" in out
    data = json.loads(plan.read_text())
    assert data["success"] is False
    assert data["reason"]
    assert {"primitives", "activations"} <= data.keys()
    picture = tmp_path / "attempt.svg"
    assert run(capsys, "plot", caged, plan, "--output", picture)[0] == 0
    assert "<svg" in picture.read_text()


def test_so_many_tries_give_one_plan_however_long_they_take(capsys, tmp_path):
    plans = []
    for limit in ([], ["--time-limit", "1e5"]):
        code, out, err = run(capsys, "plan", DISCS, "--seed", 3, "--max-tries", 4, *limit, "--output", tmp_path / "plan.json")
        assert (code, err) == (0, "")
        plans.append(json.loads((tmp_path / "plan.json").read_text())["activations"])
    assert plans[0] == plans[1]


def test_the_order_of_subgroups_reaches_the_planner(capsys):
    code, out, err = run(capsys, "plan", SIX, "--planner", "sequential", "--order", 9, "--tolerance", 1.5)
    assert code == 2
    assert "order" in err


@pytest.mark.parametrize(
    ("options", "name"),
    [
        *(
            ([option, value], option)
            for option in ("--tolerance", "--time-limit")
            for value in ("nan", "inf", "-inf", "0", "-1", "x", "1e999", "")
        ),
        (["--seed", "-1"], "--seed"),
        (["--seed", "1.5"], "--seed"),
        (["--seed", "nan"], "--seed"),
        (["--seed", "9" * 30], "--seed"),
        (["--order", "0"], "--order"),
        (["--order", "-1"], "--order"),
        (["--objective", "beauty"], "objective"),
        (["--objective", "1.5"], "objective"),
        (["--max-epochs", "0"], "--max-epochs"),
        (["--max-tries", "0"], "--max-tries"),
        (["--max-tries", "1e3"], "--max-tries"),
        (["--jobs", "none"], "--jobs"),
        (["--min-clearance", "-1"], "--min-clearance"),
        (["--planner", "magic"], "planner"),
        (["--output", "/nowhere/at/all.json"], "--output"),
        (["--output", "/"], "--output"),
        (["--colour", "red"], "--colour"),
    ],
)
def test_bad_options_are_refused_in_one_line_that_names_them(capsys, options, name):
    code, out, err = run(capsys, "plan", SIX, *[f"{options[0]}={options[1]}"])
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert name in err


def test_an_unknown_planner_lists_the_known_ones(capsys):
    message = run(capsys, "plan", SIX, "--planner", "magic")[2]
    assert "optimize" in message
    assert "pure_control" in message


@pytest.mark.parametrize("command", ["plan", "plot", "show"])
@pytest.mark.parametrize(
    ("text", "field"),
    [
        (CAGED.replace("goal: [5, 5]", "goal: [.nan, 5]"), "robots[0].goal[0]"),
        (CAGED.replace("goal: [5, 5]", "goal: [4, 5]"), "robots[0].goal"),
        (CAGED.replace("speed: 1", "speed: 0"), "swarm.speed"),
        (CAGED.replace("name: caged", '"odd\\nkey": 1\nname: caged'), r"odd\nkey"),
        (CAGED[: CAGED.index("5]")], "line"),
        (None, "scenario"),
    ],
)
def test_bad_scenarios_are_refused_in_one_line_that_names_the_field(capsys, tmp_path, command, text, field):
    path = tmp_path / "bad.yaml"
    if text is not None:
        path.write_text(text)
    code, out, err = run(capsys, command, path)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert field in err


# --- plot and show --------------------------------------------------------------------------------------------------


def test_plot_without_a_plan_or_an_output_names_the_picture_after_the_scenario(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(capsys, "plot", DISCS) == (0, "paper-six-two-discs.png\n", "")
    assert (tmp_path / "paper-six-two-discs.png").stat().st_size > 10_000


def test_a_film_shows_the_motion_from_starts_to_goals(capsys, tmp_path):
    plan, film = tmp_path / "plan.json", tmp_path / "plan.gif"
    run(capsys, "plan", DISCS, "--max-tries", 3, "--output", plan)
    code, out, _ = run(capsys, "plot", DISCS, plan, "--output", film)
    assert (code, out) == (0, f"{film}\n")
    with Image.open(film) as picture:
        frames = [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(picture)]
    assert 30 < len(frames) <= 192
    shown = frames[1], frames[len(frames) // 2], frames[-1]
    moved = [np.count_nonzero(np.abs(frame - frames[0]).max(axis=2) > 40) for frame in shown]
    assert moved[0] < moved[1] < moved[2]  # the trails grow
    code, _, err = run(capsys, "plot", DISCS, "--output", film)
    assert code == 2 and err.startswith("stressbot: PLAN.json: is missing")


def test_a_film_that_takes_a_program_says_so(capsys, tmp_path, monkeypatch):
    plan = tmp_path / "plan.json"
    run(capsys, "plan", DISCS, "--max-tries", 3, "--output", plan)
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, err = run(capsys, "plot", DISCS, plan, "--output", tmp_path / "plan.mp4")
    assert code == 2 and err == "stressbot: --output: ends in '.mp4', which takes ffmpeg: install it, or write a .gif\n"


def test_plot_refuses_a_format_that_it_cannot_write(capsys, tmp_path):
    code, _, err = run(capsys, "plot", SIX, "--output", tmp_path / "x.doc")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "--output" in err


def test_plot_refuses_a_bad_plan_naming_the_field(capsys, tmp_path):
    plan = tmp_path / "plan.json"
    plan.write_text('{"scenario": "paper-six"}')
    code, _, err = run(capsys, "plot", SIX, plan)
    assert (code, err) == (2, "stressbot: planner: is missing: add it\n")
    plan.write_text('{"scenario": "other", "planner": "", "seed": 0, "success": true, "primitives": [], "activations": []}')
    assert "scenario" in run(capsys, "plot", SIX, plan)[2]


def test_a_dash_is_standard_output_and_the_summary_goes_elsewhere(capsys, tmp_path, caged):
    code, out, err = run(capsys, "plan", caged, "--planner", "pure_control", "--time-limit", "0.01", "--output", "-")
    assert (code, json.loads(out)["scenario"]) == (3, "caged")
    assert "planner:" in err and "written" not in err
    code, out, err = run(capsys, "plot", caged, "--output", "-")
    assert (code, out) == (2, "") and "./-" in err


@pytest.mark.parametrize("command", ["plan", "plot"])
@pytest.mark.parametrize("name", ["caged.yaml", "./caged.yaml", "hard.yaml"])
def test_an_input_is_not_written_over(capsys, caged, command, name, monkeypatch):
    monkeypatch.chdir(caged.parent)
    Path("hard.yaml").hardlink_to(caged)
    code, out, err = run(capsys, command, "caged.yaml", "--output", name)
    assert (code, out) == (2, "")
    assert "--output" in err and "is read by this command" in err
    assert caged.read_text() == CAGED


def test_plot_does_not_write_over_a_plan_or_its_default_over_the_scenario(capsys, tmp_path, caged, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("plan.png").write_text("{}")
    assert run(capsys, "plot", caged, "plan.png", "--output", "plan.png")[0] == 2
    caged.rename("odd.png")
    code, _, err = run(capsys, "plot", "odd.png")
    assert (code, Path("odd.png").read_text()) == (2, CAGED)
    assert "is read by this command" in err


def test_plot_says_that_its_arguments_are_the_wrong_way_round(capsys, tmp_path, caged):
    plan = tmp_path / "plan.json"
    assert run(capsys, "plan", caged, "--planner", "pure_control", "--time-limit", "0.01", "--output", plan)[0] == 3
    for command in (["plot", plan, caged], ["show", plan]):
        code, _, err = run(capsys, *command)
        assert code == 2 and "this is a plan file" in err


def test_show_prints_table_1_codewords_codes_and_bounds(capsys):
    code, out, err = run(capsys, "show", SIX)
    assert (code, err) == (0, "")
    lines = [line.split() for line in out.splitlines()]
    assert ["Group", "R1", "R2", "R3", "R4", "R5", "R6", "size", "code", "volts"] in lines
    assert ["G1", "0", "0", "0", "1", "1", "1", "3", "0", "0", "40", "40"] in lines
    assert ["G2", "0", "1", "1", "0", "0", "1", "3", "0", "1", "40", "60"] in lines
    assert ["G3", "1", "0", "1", "0", "1", "0", "3", "1", "0", "60", "40"] in lines
    assert ["G4", "0", "0", "0", "0", "0", "0", "0", "1", "1", "60", "60"] in lines
    assert "R3 011" in out
    assert "path 144.84 units, driving time 48.28 s" in out
    assert "0.05 s for each activation" in out
    assert "1 for every robot" in out


def test_show_of_a_large_swarm_with_different_radii(capsys, tmp_path):
    robots = "".join(f"  - {{start: [{2 * k}, 0, 0], goal: [{2 * k}, 9]}}\n" for k in range(40))
    radii = [1.0] * 39 + [2.0]
    path = tmp_path / "forty.yaml"
    path.write_text(f"name: forty\nswarm: {{speed: 1, turning_radius: {radii}, body_radius: 0.3}}\nrobots:\n{robots}")
    code, out, _ = run(capsys, "show", path)
    assert code == 0
    assert "members" in out
    assert "32-40" in out
    assert "h_i, g_i and Rot for those of one radius" in out
    assert max(map(len, out.splitlines())) < 200


def test_a_terminal_gets_a_table(capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    code, out, _ = run(capsys, "show", SIX)
    assert code == 0
    assert "G1" in out
    assert "40 60" in out


# --- the command itself ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [[], ["fly"], ["plan"], ["plan", SIX, SIX], ["show"], ["--colour"]])
def test_wrong_usage_is_exit_code_2_and_one_line(capsys, arguments):
    code, out, err = run(capsys, *arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1)


@pytest.mark.parametrize("arguments", [["--help"], ["plan", "--help"], ["plot", "--help"], ["show", "--help"], ["demo", "--help"]])
def test_help_is_exit_code_0(capsys, arguments):
    code, out, err = run(capsys, *arguments)
    assert (code, err) == (0, "")
    assert out.startswith("usage: stressbot")


def fresh(*arguments):
    """Run the tool in a process of its own."""
    path = os.pathsep.join([str(Path(cli.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": path}
    )


MODULE = ("-m", "stressbot_planner.cli.tool")
HEAVY = """
import sys
from stressbot_planner.cli import tool as cli
assert cli.main({}) == {}
print([name for name in ("numpy", "numba", "scipy", "matplotlib", "rich", "yaml") if name in sys.modules])
"""


@pytest.mark.parametrize(("arguments", "code"), [(["--help"], 0), (["plan", "x", "--seed=-1"], 2), (["plan", "", "--output=/"], 2)])
def test_help_and_refused_options_come_without_heavy_imports(arguments, code):
    assert fresh("-c", HEAVY.format(arguments, code)).stdout.splitlines()[-1] == "[]"


@pytest.mark.timing
def test_help_comes_at_once():
    def processor_time():
        return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])

    fresh(*MODULE, "--help")
    begin = processor_time()
    fresh(*MODULE, "--help")
    assert processor_time() - begin < 1.0


def test_a_process_exits_with_the_code(tmp_path):
    (tmp_path / "bad.yaml").write_text("name: [")
    result = fresh(*MODULE, "plan", str(tmp_path / "bad.yaml"))
    assert (result.returncode, result.stdout, len(result.stderr.splitlines())) == (2, "", 1)


def test_a_reader_that_stops_early_and_a_plain_terminal_are_no_errors():
    path = os.pathsep.join([str(Path(cli.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, *MODULE, "show", SIX], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": path, "PYTHONIOENCODING": "ascii"},
    )
    process.stdout.close()
    assert (process.wait(WAIT), process.stderr.read()) == (0, b"")
    process.stderr.close()


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("stressbot show $SIX >/dev/full", 1, "No space left"),
        ("stressbot plan $SIX --first --output /dev/full", 2, "--output: cannot write /dev/full: No space left"),
        ("cd gone && rmdir ../gone && stressbot plan $SIX --output plan.json", 1, "the working directory is gone"),
        ("env -u HOME -u TERM stressbot show $SIX <&- >&-", 0, ""),
    ],
)
def test_odd_surroundings_are_one_line(tmp_path, line, code, said):
    (tmp_path / "gone").mkdir()
    line = line.replace("stressbot", '"$PYTHON" -m stressbot_planner.cli.tool')
    path = os.pathsep.join([str(Path(cli.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "PYTHON": sys.executable, "SIX": SIX}
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=100)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == (1 if said else 0), done.stderr
    assert not list(tmp_path.glob("*.json")) and not list(tmp_path.glob(".*"))


def test_interrupting_ends_with_130(capsys, monkeypatch):
    def interrupted(options):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.show, "run", interrupted)
    code, _, err = run(capsys, "show", SIX)
    assert (code, err) == (130, "stressbot: interrupted\n")
    code, out, _ = run(capsys, "show", SIX, "--json")
    assert code == 130 and json.loads(out)["error"] == "CANCELLED"


def test_refusals_keep_their_code():
    with pytest.raises(StressbotError) as caught:
        files.check_output(Path("/nowhere/at/all.json"))
    assert caught.value.code == ErrorCode.UNREADABLE_FILE


# --- for programs -------------------------------------------------------------------------------------------------


def test_every_command_can_speak_json():
    (commands,) = (action.choices for action in cli._parser(with_demo=False)._actions if action.dest == "command")
    assert all("--json" in command.format_help() for command in commands.values())


def test_json_is_one_object_of_what_is_printed_otherwise(capsys, tmp_path):
    plan = tmp_path / "plan.json"
    code, out, _ = run(capsys, "plan", DISCS, "--max-tries", 3, "--output", plan, "--json")
    told = json.loads(out)
    stored = json.loads(plan.read_text())
    assert code == 0 and told["success"] and not told["interrupted"] and told["written"] == str(plan)
    assert (told["path_length"], told["activations"]) == (stored["path_length"], len(stored["activations"]))
    code, out, _ = run(capsys, "check", DISCS, plan, "--samples", 5, "--json")
    told = json.loads(out)
    assert code == 0 and told["valid"] and told["lowest_level"] >= 0.0 and told["highest_level"] == 140.0
    assert told["duration"] == pytest.approx(stored["execution_time"] + stored["selection_time"], rel=1e-3)
    assert len(told["risk"]["goal_errors"]) == 5 and told["risk"]["collisions"] <= 5
    code, out, _ = run(capsys, "show", SIX, "--json")
    assert code == 0 and [group["members"] for group in json.loads(out)["groups"]][-1] == []
    code, out, _ = run(capsys, "planners", "--json")
    assert code == 0 and json.loads(out)["planners"].keys() == set(planners.names())


def test_json_has_a_refusal_too(capsys, tmp_path):
    code, out, err = run(capsys, "show", tmp_path / "no.yaml", "--json")
    told = json.loads(out)
    assert code == 2 and (told["success"], told["error"]) == (False, "UNREADABLE_FILE")
    assert err == f"stressbot: {told['field']}: {told['message']}\n"


def test_what_is_not_finite_is_null(capsys):
    printing.print_json({"gap": np.inf, "of": [np.float64("nan"), np.arange(2)]})
    assert json.loads(capsys.readouterr().out) == {"gap": None, "of": [None, [0, 1]]}


def test_the_version_is_that_of_the_package(capsys):
    assert run(capsys, "--version")[:2] == (0, f"stressbot {version('stressbot_planner')}\n")


def test_planners_are_listed_with_a_line_each(capsys):
    code, out, _ = run(capsys, "planners")
    assert code == 0 and [line.split(":")[0] for line in out.splitlines()] == planners.names()
    assert all(len(line.split(":", 1)[1].strip()) > 20 for line in out.splitlines())


# --- check --------------------------------------------------------------------------------------------------------


def test_without_errors_there_is_no_risk(capsys, tmp_path):
    plan = tmp_path / "plan.json"
    run(capsys, "plan", DISCS, "--max-tries", 3, "--output", plan)
    code, out, _ = run(capsys, "check", DISCS, plan, "--speed-error", 0, "--samples", 3, "--json")
    told = json.loads(out)
    assert code == 0 and told["risk"]["collisions"] == 0
    np.testing.assert_allclose(told["risk"]["min_clearances"], told["min_clearance"], atol=1e-9)
    np.testing.assert_allclose(told["risk"]["goal_errors"], told["goal_error"], atol=1e-9)


def test_more_of_a_risk_than_allowed_is_told(capsys, tmp_path):
    plan = tmp_path / "plan.json"
    run(capsys, "plan", DISCS, "--max-tries", 3, "--output", plan)
    options = ("--samples", 2, "--heading-noise", 0.002, "--radius-error", 0.001, "--speed-error", 0.001, "--tolerance", 0.5)
    code, out, _ = run(capsys, "check", DISCS, plan, *options, "--max-risk", 1, "--json")
    told = json.loads(out)["risk"]
    likely = max(told["collides"], told["misses"])
    assert code == 0 and 0 < likely < 1 and np.shape(told["covariances"]) == (6, 2, 2)
    code, out, err = run(capsys, "check", DISCS, plan, *options, "--max-risk", likely / 2)
    assert code == 3 and "more of a risk than" in err and "turning radii by 0.1 %" in out
    for wrong in (("--max-risk", 1.5), ("--radius-error", 0.5)):
        code, _, err = run(capsys, "check", DISCS, plan, *wrong)
        assert code == 2 and wrong[0] in err


def test_a_plan_that_collides_is_told(capsys, tmp_path, caged):
    plan = tmp_path / "plan.json"
    plan.write_text(
        json.dumps(
            {"scenario": "caged", "planner": "x", "seed": 0, "success": False,
             "primitives": [{"kind": "Activate", "group": 1, "length": 5.0}], "activations": [[1, 5.0]]}
        )
    )
    code, out, err = run(capsys, "check", caged, plan, "--samples", 2)
    assert code == 3 and "NOT valid" in out and err.startswith(f"stressbot: {plan} is not valid: clearance")


def test_an_error_too_large_to_mean_anything_is_refused(capsys, tmp_path):
    assert run(capsys, "check", SIX, tmp_path / "x.json", "--speed-error", 0.5)[::2] == (
        2, "stressbot: --speed-error: is 0.5: give at most 0.3\n"
    )


# --- Ctrl-C and the live line -------------------------------------------------------------------------------------


def planned_until(condition, *arguments):
    """Plan on a terminal, press Ctrl-C once a condition on what stands there holds; return the process and what was shown."""
    terminal, end = pty.openpty()
    words = [sys.executable, *MODULE, "plan", *map(str, arguments), "--time-limit", "3000"]
    process = subprocess.Popen(words, stderr=end, stdout=subprocess.PIPE, text=True)
    os.close(end)
    shown, is_pressed = "", False
    with open(terminal, "rb", buffering=0) as stream, contextlib.suppress(OSError):  # EIO at the end
        while data := stream.read(4096):
            shown += data.decode()
            if not is_pressed and condition(shown):
                process.send_signal(signal.SIGINT)
                is_pressed = True
    return process, shown


@pytest.mark.parametrize("jobs", [1, 2])
def test_ctrl_c_keeps_the_best_plan(capsys, tmp_path, jobs):
    scenario, plan = tmp_path / "scenario.yaml", tmp_path / "plan.json"
    run(capsys, "init", scenario, "--robots", 10, "--obstacles", 3)
    process, shown = planned_until(lambda text: "best path " in text, scenario, "--output", plan, "--jobs", jobs)
    told = process.communicate(timeout=WAIT)[0]
    assert process.returncode == 0 and "solved, ended by Ctrl-C" in told and "× the lower bound" in shown
    assert "planner:        optimize, seed 0, " in told and float(told.split("seed 0, ")[1].split(" s")[0]) < WAIT
    assert run(capsys, "check", scenario, plan, "--samples", 1)[0] == 0


def test_ctrl_c_before_there_is_a_plan_ends_with_130():
    words = (DISCS, "--planner", "rrt", "--tolerance", "0.031")  # a tree that grows for as long as it may
    process, shown = planned_until(lambda text: "no plan yet" in text, *words)
    assert process.wait(WAIT) == 130 and shown.endswith("stressbot: interrupted\r\n")
    process.stdout.close()


# --- init -----------------------------------------------------------------------------------------------------------


def test_init_writes_the_papers_robots(capsys, tmp_path):
    path = tmp_path / "mine.yaml"
    assert run(capsys, "init", path) == (0, f"{path}\n", "")
    mine, shipped = scenario_module.load(path), scenario_module.load(SIX)
    np.testing.assert_array_equal(mine.problem.starts, shipped.problem.starts)
    np.testing.assert_array_equal(mine.problem.goals, shipped.problem.goals)
    assert mine.electrical == shipped.electrical


@pytest.mark.parametrize(("robots", "obstacles"), [(1, None), (1, 0), (1, 30), (2, 1), (6, 2), (14, 40), (62, 20), (300, None)])
@pytest.mark.parametrize("seed", range(3))
def test_init_writes_random_swarms_that_are_valid_and_repeat_themselves(capsys, tmp_path, robots, obstacles, seed):
    path, again = tmp_path / "a.yaml", tmp_path / "b.yaml"
    more = () if obstacles is None else ("--obstacles", obstacles)
    for file in (path, again):
        assert run(capsys, "init", file, "--robots", robots, *more, "--seed", seed)[0] == 0
    loaded = scenario_module.load(path)
    environment = loaded.problem.environment
    assert (loaded.swarm.n, len(environment.obstacles)) == (robots, obstacles or 0)
    assert (environment.workspace is None) == (obstacles is None)
    assert loaded.electrical.drive is not None
    assert path.read_text().replace("a.yaml", "b.yaml") == again.read_text()


@pytest.mark.parametrize("path", ["-", "/nowhere/mine.yaml", "/dev/full", "a" * 300])
def test_init_names_a_place_that_cannot_be(capsys, path):
    code, out, err = run(capsys, "init", path)
    assert (code, out, len(err.splitlines())) == (2, "", 1) and err.startswith("stressbot: SCENARIO: ")


def test_init_replaces_no_file(capsys, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("mine")
    code, out, err = run(capsys, "init", path)
    assert (code, out) == (2, "") and "exists" in err and path.read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--robots", "0"), "--robots"), (("--robots", "2001"), "--robots"), (("--obstacles", "-1"), "--obstacles"),
        (("--obstacles", "301"), "--obstacles"), (("--seed", "x"), "--seed"),
    ],
)
def test_init_refuses_what_it_cannot_place(capsys, tmp_path, arguments, named):
    code, out, err = run(capsys, "init", tmp_path / "x.yaml", *arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1) and named in err and not (tmp_path / "x.yaml").exists()
