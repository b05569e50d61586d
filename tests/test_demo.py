"""`stressbot demo` as a user runs it: its last line, its files, its exit codes, and that it leaves nothing behind."""

import json
import os
import re
import signal
import subprocess
import sys
import uuid
from pathlib import Path

import pytest
from system_rig import DEADLINE, NEAR, SCENARIOS

from stressbot_planner.formats.plan_file import read_plan_file
from stressbot_planner.formats.scenario import load

pytestmark = pytest.mark.xdist_group("demo")

LAST_LINE = re.compile(
    r"demo: 6/6 robots at their goals, worst error \S+ units, plan \d+\.\d\d s, execution \d+\.\d\d s, min clearance \S+ units"
)


class Demo:
    """A demo in a process of its own, which can be told from every other process by a mark in its environment."""

    def __init__(self, *arguments, cwd=None):
        self.mark = uuid.uuid4().hex
        environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
        command = [sys.executable, "-m", "stressbot_planner.cli.tool", "demo", *map(str, arguments)]
        self.process = subprocess.Popen(
            command, env={**environment, "STRESSBOT_TEST_MARK": self.mark}, cwd=cwd, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )

    def finish(self):
        """Return exit code, output and errors."""
        out, err = self.process.communicate(timeout=3 * DEADLINE)
        return self.process.returncode, out, err

    def relatives(self):
        """Return the processes that carry the mark."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if self.mark.encode() in (folder / "environ").read_bytes():
                    found.append(int(folder.name))
            except OSError:  # it has ended meanwhile
                continue
        return found


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A demo of the default scenario, run from another folder than the repository's."""
    folder = tmp_path_factory.mktemp("demo")
    demo = Demo(cwd=folder)
    return demo, demo.finish(), folder / "results" / "demo"


def test_the_demo_ends_with_one_line_that_says_it_all(finished):
    demo, (code, out, err), _ = finished
    assert code == 0, out + err
    assert err == ""
    assert LAST_LINE.fullmatch(out.splitlines()[-1]), out
    assert sum(line.startswith("demo:") for line in out.splitlines()) == 1
    assert demo.relatives() == []


def test_the_demo_writes_figures_a_plan_and_pictures(finished):
    _, _, folder = finished
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["success"]
    assert summary["robots_at_goal"] == len(summary["robots"]) == 6
    assert summary["worst_prediction_error"] < 1e-6
    assert summary["worst_goal_error"] < NEAR
    assert summary["path_length"] >= summary["path_length_bound"]
    for name in ("paths.png", "voltage.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_the_plan_of_the_demo_can_be_read_again(finished):
    _, _, folder = finished
    scenario = load(SCENARIOS / "paper-six.yaml")
    stored = read_plan_file(folder / "plan.json", scenario.problem, scenario.name)
    assert stored.success
    assert stored.plan.valid


def test_the_log_of_each_node_is_kept(finished):
    _, _, folder = finished
    for name in ("driver", "sequencer", "planner"):
        assert "paper-six" in (folder / "logs" / f"{name}.log").read_text()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["no-such-file.yaml"], "no-such-file.yaml"),
        (["--planner", "magic"], "planner: is 'magic': use one of"),
        (["--tolerance", "0"], "tolerance"),
        (["--time-limit", "nan"], "time-limit"),
        (["--max-tries", "0"], "max-tries"),
        (["--seed", "-1"], "seed"),
        (["--real-time-factor", "-2"], "real-time-factor"),
        (["--output", "/proc/nowhere"], "output"),
    ],
)
def test_bad_arguments_are_named_in_one_line_and_start_nothing(tmp_path, arguments, text):
    code, out, err = Demo(*arguments, cwd=tmp_path).finish()
    assert code == 2
    assert out == ""
    assert text in err
    assert len(err.splitlines()) == 1


def test_no_plan_is_told_apart_from_a_failure(tmp_path):
    arguments = ["--planner", "rrt", "--tolerance", "0.031", "--max-tries", "20", "--output", tmp_path]
    demo = Demo(*arguments)
    code, out, _ = demo.finish()
    assert code == 3
    assert out.splitlines()[-1].startswith("demo: no plan: rrt: no plan found within 20 tries;")
    assert demo.relatives() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_demo_leaves_no_process_behind(tmp_path, number):
    demo = Demo("--real-time-factor", "1", "--output", tmp_path)
    for line in demo.process.stdout:
        if line.startswith("driving"):
            break
    assert len(demo.relatives()) >= 4
    assert not any("/dev/shm/fastrtps" in Path(f"/proc/{process}/maps").read_text() for process in demo.relatives())
    demo.process.send_signal(number)
    code, _, err = demo.finish()
    assert code == 130, err
    assert "interrupted" in err
    assert demo.relatives() == []


def test_a_node_that_dies_ends_the_demo_and_its_log_is_shown(tmp_path):
    demo = Demo("--real-time-factor", "1", "--output", tmp_path)
    for line in demo.process.stdout:
        if line.startswith("driving"):
            break
    driver = next(
        process for process in demo.relatives() if b"stressbot_driver/driver" in Path(f"/proc/{process}/cmdline").read_bytes()
    )
    os.kill(driver, signal.SIGKILL)
    code, out, err = demo.finish()
    assert code == 1
    assert "demo: failed: the driver node ended by itself" in out
    assert "driver.log" in err
    assert demo.relatives() == []
