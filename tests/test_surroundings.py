"""Folders that cannot be written, disks that are full, files that never end: one true line, at once, and a documented exit code."""

import os
import subprocess
import sys

import pytest
from system_rig import DEADLINE, SCENARIOS

from stressbot_planner.ros.bringup import NODES, command

SIX = SCENARIOS / "paper-six.yaml"
TOOL = [sys.executable, "-m", "stressbot_planner.cli.tool"]


def run(line, **environment):
    done = subprocess.run(
        [str(word) for word in line],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=DEADLINE,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize("folder", ["/proc/none", "/dev/null/none"])
@pytest.mark.parametrize("entry", NODES, ids=lambda entry: entry.executable)
def test_a_node_that_cannot_write_its_log_says_so_in_one_line(entry, folder):
    code, said = run(command(entry, {"scenario": SIX} if entry.executable == "driver" else {}), ROS_LOG_DIR=folder)
    change = f"the folder {folder} for logs cannot be made or written to: set ROS_LOG_DIR to one that can"
    assert (code, said) == (2, f"{entry.executable}: ROS_LOG_DIR: {change}\n")


def test_a_demo_that_cannot_write_its_log_says_so_in_one_line(tmp_path):
    code, said = run([*TOOL, "demo", SIX, "--output", tmp_path], ROS_LOG_DIR="/proc/none")
    assert (code, len(said.splitlines())) == (2, 1)
    assert said.startswith("stressbot: ROS_LOG_DIR: the folder /proc/none ")


@pytest.mark.parametrize("kind", ["pipe", "zero", "large", "folder"])
@pytest.mark.parametrize("which", ["plan", "show", "plot", "demo", "plan file", "driver"])
def test_what_is_no_scenario_or_plan_file_is_refused_at_once(tmp_path, kind, which):
    path = {"zero": "/dev/zero", "folder": tmp_path}.get(kind, tmp_path / kind)
    if kind == "pipe":
        os.mkfifo(path)
    if kind == "large":
        path.write_text("name: x\n" * 1_800_000)  # 14 MB
    line = [*TOOL, which, path]
    if which == "plan file":
        line = [*TOOL, "plot", SIX, path, "--output", tmp_path / "x.png"]
    if which == "driver":
        line = command(NODES[0], {"scenario": path})
    code, said = run(line)
    assert (code, len(said.splitlines())) == (2, 1), said
    assert not list(tmp_path.glob("*.png"))
