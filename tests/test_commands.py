"""What README and docs/ tell a reader to type exists: files, targets, executables, options, parameters, topics, types, fields.

The README's own blocks are run as they stand.
"""

import contextlib
import importlib
import os
import re
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import run as benchmarks
import yaml
from ros2_stand_in import command_line
from system_rig import DEADLINE

from stressbot_driver.backends.waveform_generator import WaveformGeneratorBackend
from stressbot_driver.ros import (
    camera_tracker_node,
    driver_node,
    image_source_node,
    instrument_emulator_node,
    simulated_camera_node,
    viewer_node,
)
from stressbot_planner.cli import tool as cli
from stressbot_planner.ros import bringup, clicks_node, mover_node, paths_node, planner_node, recorder_node

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))]
PROGRAMS = ("stressbot", "make", "ros2", "docker", "source", "cd")
PLACEHOLDER = re.compile(r"…|<.*>|/path/|/my_|^[A-Z]+(\.\w+)?$")

PARAMETERS = {
    "driver": {entry.name for entry in driver_node.PARAMETERS}
    | {f"waveform_generator.{option.name}" for option in WaveformGeneratorBackend.OPTIONS},
    "camera_tracker": {entry.name for entry in camera_tracker_node.PARAMETERS},
    "simulated_camera": {entry.name for entry in simulated_camera_node.PARAMETERS},
    "image_source": {entry.name for entry in image_source_node.PARAMETERS},
    "viewer": {entry.name for entry in viewer_node.PARAMETERS},
    "instrument_emulator": {entry.name for entry in instrument_emulator_node.PARAMETERS},
    "planner": {entry.name for entry in planner_node.PARAMETERS},
    "mover": {entry.name for entry in mover_node.PARAMETERS},
    "clicks": {entry.name for entry in clicks_node.PARAMETERS},
    "paths": {entry.name for entry in paths_node.PARAMETERS},
    "recorder": {recorder_node.OUTPUT.name, recorder_node.TOPICS},
}


def blocks(page: Path) -> list[str]:
    """Return what a page shows as code, in paragraphs of their own."""
    text = page.read_text(encoding="utf-8")
    indented = re.findall(r"(?:^    .*\n)+", text, re.MULTILINE)
    return [*indented, *re.findall(r"^```(?:bash|sh)?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)]


def commands(text: str) -> Iterator[str]:
    """Yield the lines of a block that call one of our programs, without comments and prompts."""
    for line in text.replace("\\\n", " ").splitlines():
        line = re.sub(r"\s+#.*$", "", line).strip().removesuffix("&").strip()
        words = [word for word in line.split() if not re.match(r"^[A-Z_]+=", word)]
        if words and words[0].removeprefix(".venv/bin/") in PROGRAMS:
            yield " ".join(words) if '"' not in line else line[line.index(words[0]) :]


def inline(page: Path) -> list[str]:
    return [text for text in re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8")) if text.split()[0] in PROGRAMS]


WHOLE = [(page.name, command) for page in PAGES for block in blocks(page) for command in commands(block)]
MENTIONED = [(page.name, command) for page in PAGES for command in inline(page)]


def words_of(command: str) -> list[str]:
    return shlex.split(command.replace("$PWD", str(ROOT)))


def check_stressbot(words: list[str], whole: bool) -> None:
    parser = cli._parser(with_demo=True)
    (actions,) = (action.choices for action in parser._actions if action.dest == "command")
    subcommand = next((word for word in words[1:] if not word.startswith("-")), None)
    assert subcommand in actions
    for option in (word for word in words if word.startswith("--")):
        assert option in actions[subcommand].format_help()
    if whole:
        parser.parse_args(words[1:])


def check_make(words: list[str], whole: bool) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert all(word in targets for word in words[1:2])
    arguments = [part for word in words if word.startswith("ARGS=") for part in word.removeprefix("ARGS=").split()]
    if words[1:2] == ["bench"]:
        assert {part for part in arguments if not part.startswith("-")} <= set(benchmarks.PARTS)


def check_ros2(words: list[str], whole: bool) -> None:
    if len(words) == 1:
        return
    verb, rest = words[1], words[2:]
    if whole:
        command_line.make_parser(verb).parse_args(words[1:])
    if verb == "run" and len(rest) > 1:
        package, executable = rest[:2]
        assert os.access(ROOT / "ros2_ws/install" / package / "lib" / package / executable, os.X_OK)
        given = {rest[k + 1].split(":=")[0] for k, word in enumerate(rest) if word == "-p"}
        assert given <= PARAMETERS.get(executable, set())
    elif verb == "launch" and rest:
        package, file = rest[:2]
        assert (ROOT / "ros2_ws/src" / package / "launch" / file).is_file()
        assert {word.split(":=")[0] for word in rest[2:]} <= set(bringup.arguments())
    elif verb == "interface":
        interface(rest[1])
    elif whole and (verb, rest[0]) in (("service", "call"), ("action", "send_goal")):
        name, kind, *values = (word for word in rest[1:] if not word.startswith("--"))
        part = interface(kind).Request if verb == "service" else interface(kind).Goal
        fill(part(), yaml.safe_load("".join(values)) or {})
        assert name.strip("/") in README_NAMES
    elif whole and verb == "topic":
        assert rest[1].strip("/") in README_NAMES


def interface(kind: str):
    package, group, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), name)


def fill(message, values: dict) -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, float(value) if isinstance(getattr(message, name), float) else value)


README_NAMES = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| `.*$", (ROOT / "README.md").read_text(), re.MULTILINE))))


@pytest.mark.parametrize(("page", "command", "whole"), [(*one, True) for one in WHOLE] + [(*one, False) for one in MENTIONED])
def test_every_command_of_the_pages_exists(page, command, whole):
    words = words_of(command)
    program = words[0].removeprefix(".venv/bin/")
    check = {"stressbot": check_stressbot, "make": check_make, "ros2": check_ros2}.get(program)
    if check:
        check(words, whole)
    for word in words[1:]:
        path = word.split(":=")[-1]
        if re.search(r"\.(yaml|py|sh|rviz)$", path) and "/" in path and not PLACEHOLDER.search(path):
            assert (ROOT / path).exists(), path


def test_the_pages_have_commands_of_every_kind():
    assert {words_of(command)[0].removeprefix(".venv/bin/") for _, command in WHOLE} >= {"stressbot", "make", "ros2", "source"}
    assert len(WHOLE) > 25


def readme_block(start: str) -> str:
    (block,) = (block for block in blocks(ROOT / "README.md") if block.strip().startswith(start))
    return block


def test_the_offline_commands_of_the_readme_run_as_they_stand(tmp_path):
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    quick = [line for line in commands(readme_block("stressbot init")) if line.split()[1] in ("init", "show", "plan", "plot")]
    assert len(quick) == 4
    environment = os.environ | {"PATH": f"{ROOT / '.venv/bin'}:{os.environ['PATH']}"}
    for line in quick:
        done = subprocess.run(line, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=DEADLINE)
        assert (done.returncode, done.stderr) == (0, ""), done
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")


def shell(script: str, output) -> subprocess.Popen:
    """A shell at the root of the checkout, in a session of its own, which has sourced what the README says."""
    source = f"cd '{ROOT}'\nsource tools/env.sh\nexport ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST\n"
    return subprocess.Popen(
        ["bash", "-c", source + script], stdout=output, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


@contextlib.contextmanager
def running(script: str, output):
    process = shell(script, output)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
        process.wait(timeout=DEADLINE)
        if process.stdout is not None:
            process.stdout.close()


def said_by(line: str, last: str, endless: bool = False) -> str:
    """Return what a command says, up to a text; then it ends by itself, or is interrupted."""
    text = ""
    with running(line, subprocess.PIPE) as process:
        while last not in text and (read := process.stdout.readline()):
            text += read
        if endless:
            os.killpg(process.pid, signal.SIGINT)
        text += process.stdout.read()
    return text


def test_the_nodes_of_the_readme_plan_and_play_as_they_stand(tmp_path):
    """Both blocks: the one that starts the nodes, and each command to them."""
    plan, follow, start, echo = commands(readme_block("ros2 service call"))
    with open(tmp_path / "log", "w") as log, running(f"{readme_block('source tools/env.sh')}\nwait\n", log):
        assert "success=True" in said_by(plan, "response:\n")
        assert "Goal finished with status: SUCCEEDED" in said_by(follow.replace("60", "2"), "Result:")
        deadline = time.monotonic() + DEADLINE
        while "success=True" not in (said := said_by(start, "response:\n")):  # until the sequence is on its way through
            assert time.monotonic() < deadline, said
        said = said_by(echo, "\nplan_id: ", endless=True)
        assert re.search(r"^backend: simulated$", said, re.MULTILINE) and re.search(r"^plan_id: \w+$", said, re.MULTILINE)
