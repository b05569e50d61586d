"""`pip install ./ros2_ws/src/stressbot_planner` is enough to plan: no ROS, no workspace, only the libraries that it declares."""

import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import distribution, requires
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCENARIO = ROOT / "scenarios/paper-six-two-discs.yaml"

COMPILED_WITHIN = 1700.0
"""s; who plans first compiles all loops, 50 s of a processor, however busy it is."""

pytestmark = pytest.mark.timeout(COMPILED_WITHIN + 100.0)


def closure(names):
    """Names of distributions and of all that they require here."""
    found, left = set(), list(names)
    while left:
        name = re.match(r"[\w.-]+", left.pop())[0].lower().replace("_", "-")
        if name in found:
            continue
        try:
            left += [required for required in requires(name) or [] if "extra ==" not in required]
        except ModuleNotFoundError:  # not for this platform
            continue
        found.add(name)
    return found


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """A folder of packages with the wheel and what it requires, and nothing else: no rclpy, no messages."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "src"
    for package in ("stressbot_planner", "stressbot_msgs"):
        ignored = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
        shutil.copytree(ROOT / "ros2_ws/src" / package, source / package, ignore=ignored)
    site = folder / "site"
    pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-build-isolation", "--no-deps"]
    made = subprocess.run([*pip, "--target", site, source / "stressbot_planner"], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    declared = (site / next(site.glob("stressbot_planner-*.dist-info")).name / "METADATA").read_text(encoding="utf-8")
    for name in closure(re.findall(r"^Requires-Dist: (.*)$", declared, re.M)):
        for file in distribution(name).files or []:
            top = file.parts[0]
            target = site / top
            if top not in ("..", "__pycache__") and not target.exists():
                target.symlink_to(Path(distribution(name).locate_file(top)))
    return site


def run(environment, *arguments, cwd):
    inherited = {name: os.environ[name] for name in ("HOME", "PATH", "TMPDIR") if name in os.environ}
    program = [sys.executable, "-S", *arguments]
    return subprocess.run(
        program, env={**inherited, "PYTHONPATH": str(environment)}, cwd=cwd, capture_output=True, text=True, timeout=COMPILED_WITHIN
    )


def test_it_brings_no_ros_and_no_commands_of_nodes(environment, tmp_path):
    for module in ("rclpy", "stressbot_msgs.msg", "stressbot_driver"):
        assert "ModuleNotFoundError" in run(environment, "-c", f"import {module}", cwd=tmp_path).stderr
    assert [path.name for path in (environment / "bin").iterdir()] == ["stressbot"]
    assert (environment / "stressbot_planner/py.typed").is_file()


def test_the_public_names_plan(environment, tmp_path):
    page = (ROOT / "ros2_ws/src/stressbot_planner/README.md").read_text(encoding="utf-8")
    shutil.copy(SCENARIO, tmp_path / "scenario.yaml")
    done = run(environment, "-c", re.search(r"```python\n(.*?)```", page, re.S)[1], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_the_tool_plans_and_says_what_needs_ros(environment, tmp_path):
    tool = ("-c", "from stressbot_planner.cli.tool import main; raise SystemExit(main())")
    done = run(environment, *tool, "plan", SCENARIO, "--max-tries", "5", "--output", tmp_path / "plan.json", cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "plan.json").exists(), done.stderr
    refused = run(environment, *tool, "demo", cwd=tmp_path)
    assert refused.returncode == 1
    assert len(refused.stderr.splitlines()) == 1 and "ROS" in refused.stderr, refused.stderr


def test_names_are_imported_when_they_are_asked_for(environment, tmp_path):
    script = (
        "import sys, stressbot_planner as s\n"
        "print({'numba', 'scipy', 'matplotlib', 'numpy'} & set(sys.modules))\n"
        "s.load, s.solve, s.Settings\n"
        "print({'scipy.optimize', 'matplotlib', 'joblib'} & set(sys.modules))\n"
    )
    done = run(environment, "-c", script, cwd=tmp_path)
    assert done.stdout.split("\n")[:2] == ["set()", "set()"], done.stdout + done.stderr
