"""The set-up itself: make, the lock, the launcher, the environment and what docker/ refers to."""

import fnmatch
import json
import os
import re
import resource
import shutil
import stat
import subprocess
from pathlib import Path

import pytest
import yaml
from compose_spec import PyCompose

ROOT = Path(__file__).resolve().parents[1]
LAUNCHER = ROOT / ".venv/bin/stressbot"
BASE_PYTHON = os.path.realpath(ROOT / ".venv/bin/python")
COMPOSE = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())
SERVICES = COMPOSE["services"]


def run(*command, **options):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, **options)


# --- make and the lock -----------------------------------------------------------------------------------------------


def test_make_help_lists_every_target():
    listed = {line.split()[1] for line in run("make", "help", cwd=ROOT).stdout.splitlines()}
    assert listed >= {"help", "build", "demo", "test", "bench", "clean"}


def test_continuous_integration_runs_the_test_command():
    script = ROOT / ".ci/run"
    assert script.stat().st_mode & stat.S_IXUSR
    assert script.read_text().rstrip().endswith("make test")


def test_second_build_does_nothing():
    result = run(ROOT / "tools/build.sh", cwd="/")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@pytest.mark.timing
def test_second_build_is_quick():
    def processor_time():
        return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])

    begin = processor_time()
    run(ROOT / "tools/build.sh", cwd="/")
    assert processor_time() - begin < 2


def names(path):
    lines = (line.split("#")[0].strip() for line in path.read_text().splitlines())
    return [line for line in lines if line]


def pins(name):
    return re.findall(r"^\w.*(?:\n    .*)*$", (ROOT / "requirements" / name).read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("locks", "sources"),
    [
        (("lock.txt",), ("runtime.in", "ros.in", "recording.in", "view.in", "test.in", "docs.in")),
        (("lock.txt", "comparison.txt"), ("comparison.in",)),
        (("sbom.txt",), ("sbom.in",)),
    ],
)
def test_locks_pin_every_requirement_exactly(locks, sources):
    found = [pin for lock in locks for pin in pins(lock)]
    assert all(re.fullmatch(r"[a-z0-9-]+==[0-9a-z.]+( \\\n    --hash=sha256:[0-9a-f]{64})+", pin) for pin in found), found
    locked = {pin.split("==")[0] for pin in found}
    assert len(locked) == len(found), "comparison.txt pins what lock.txt does: run tools/lock.sh"
    for source in sources:
        wanted = {re.split(r"[<>=\[]", name)[0] for name in names(ROOT / "requirements" / source)}
        assert wanted <= locked, f"{source}: run tools/lock.sh"


def test_every_list_of_requirements_is_locked():
    locked = {"runtime", "ros", "recording", "view", "test", "docs", "comparison", "sbom"}
    assert {path.stem for path in (ROOT / "requirements").glob("*.in")} == locked


# --- what a machine lacks ----------------------------------------------------------------------------------------------


@pytest.fixture
def bare_machine(tmp_path):
    """A copy of the set-up, and an environment that finds few commands and is not root's."""
    commands = tmp_path / "bin"
    commands.mkdir()
    for name in ("bash", "basename", "cat", "dirname", "env", "flock", "mkdir", "readlink", "sed"):
        (commands / name).symlink_to(shutil.which(name))
    (commands / "id").write_text("#!/bin/sh\necho 1000\n")
    (commands / "id").chmod(0o755)
    tree = tmp_path / "tree"
    for name in ("tools", "requirements"):
        shutil.copytree(ROOT / name, tree / name)
    return tree, {"PATH": str(commands), "HOME": str(tmp_path)}


def test_missing_system_packages_are_named_in_one_apt_line(bare_machine):
    tree, environment = bare_machine
    result = run(tree / "tools/build.sh", env=environment | {"PYTHON": BASE_PYTHON})
    assert result.returncode == 1
    command = "sudo apt-get install -y --no-install-recommends make cmake g++"
    assert result.stderr == f"build: system packages are missing; run: {command}\n"


def test_too_old_a_python_is_not_used(bare_machine):
    tree, environment = bare_machine
    old = Path(environment["PATH"]) / "python3"
    old.write_text("#!/bin/sh\nexit 1\n")
    old.chmod(0o755)
    result = run(tree / "tools/build.sh", env=environment | {"PYTHON": "python3"})
    assert result.returncode == 1
    assert result.stderr.strip().endswith("make cmake g++ python3.11 python3.11-venv python3.11-dev")


def test_our_own_python_is_not_what_our_own_environment_is_made_anew_from():
    """Whoever has sourced tools/env.sh finds it first."""
    script = f"""
        mode=wheels venv='{ROOT}/.venv' PATH="{ROOT}/.venv/bin:$PATH"
        eval "$(sed -n '/^python_is_suitable/,/^}}/p; /^find_python/,/^}}/p' '{ROOT}/tools/build.sh')"
        command -v python3
        find_python
    """
    result = run("bash", "-c", script, env={key: value for key, value in os.environ.items() if key != "PYTHON"})
    assert result.returncode == 0, result.stderr
    first, found = result.stdout.splitlines()
    assert first == f"{ROOT}/.venv/bin/python3" and Path(found).is_file()
    assert not found.startswith(f"{ROOT}/.venv/")


def test_sourced_jazzy_is_used_instead_of_wheels(bare_machine, tmp_path):
    tree, environment = bare_machine
    prefix = tmp_path / "jazzy"
    (prefix / "share/rclpy").mkdir(parents=True)
    (prefix / "share/rclpy/package.xml").touch()
    (prefix / "lib/rclpy").mkdir(parents=True)
    (prefix / "lib/rclpy/__init__.py").touch()
    environment |= {"AMENT_PREFIX_PATH": f"/nowhere:{prefix}", "PYTHONPATH": str(prefix / "lib"), "PYTHON": BASE_PYTHON}
    build = tree / "tools/build.sh"
    native_only = "python3-colcon-common-extensions"
    assert native_only in run(build, env=environment | {"ROS_DISTRO": "jazzy"}).stderr
    assert native_only not in run(build, env=environment | {"ROS_DISTRO": "humble"}).stderr
    assert native_only not in run(build, env=environment).stderr


def test_path_with_a_space_is_refused(bare_machine):
    tree, environment = bare_machine
    spaced = tree.rename(tree.with_name("my tree"))
    result = run(spaced / "tools/build.sh", env=environment)
    assert result.returncode == 1
    assert "contains a space" in result.stderr


# --- the launcher and the environment --------------------------------------------------------------------------------


def test_launcher_needs_no_environment_and_any_folder_will_do(tmp_path):
    link = tmp_path / "tool"
    link.symlink_to(LAUNCHER)
    result = run("/usr/bin/env", "-i", link, "--help", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "usage" in result.stdout.lower()
    assert result.stderr == ""


def test_launcher_passes_arguments_folder_and_exit_code_on(tmp_path):
    (tmp_path / "not a scenario.yaml").mkdir()
    result = run(LAUNCHER, "plan", "not a scenario.yaml", cwd=tmp_path)
    assert result.returncode == 2
    assert "not a scenario.yaml cannot be read (Is a directory)" in result.stderr


def test_launcher_survives_another_ros_in_the_callers_environment(tmp_path):
    foreign = tmp_path / "opt/ros/other/lib/python3/site-packages"
    (foreign / "rclpy").mkdir(parents=True)
    (foreign / "rclpy/__init__.py").write_text("raise ImportError('another ROS')\n")
    script = "source .venv/workspace.sh && exec .venv/bin/python -c 'import rclpy, stressbot_msgs.msg; print(rclpy.__file__)'"
    result = run("bash", "-c", script, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(foreign)})
    assert result.returncode == 0, result.stderr
    assert str(foreign) not in result.stdout


def test_environment_by_hand_finds_messages_packages_and_tools(tmp_path):
    script = f"""
        source '{ROOT}/tools/env.sh'
        python - <<'PY'
import rclpy
from ament_index_python.packages import get_package_prefix
from stressbot_msgs.msg import SwarmPoses
from stressbot_msgs.srv import PlanMotion
for package in ("stressbot_msgs", "stressbot_planner", "stressbot_driver"):
    print(get_package_prefix(package))
PY
        command -v ruff lint-imports stressbot
    """
    result = run("bash", "-c", script, cwd=tmp_path, env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)})
    assert result.returncode == 0, result.stderr
    prefixes = [str(ROOT / "ros2_ws/install" / name) for name in ("stressbot_msgs", "stressbot_planner", "stressbot_driver")]
    assert result.stdout.splitlines()[:3] == prefixes


# --- docker ----------------------------------------------------------------------------------------------------------


def test_compose_file_follows_the_specification():
    PyCompose.from_json(json.dumps(COMPOSE)).validate()


def test_compose_file_with_a_typing_error_is_refused():
    broken = json.loads(json.dumps(COMPOSE))
    broken["services"]["driver"]["comand"] = []
    with pytest.raises(ValueError, match="comand"):
        PyCompose.from_json(json.dumps(broken))


def test_compose_runs_each_node_of_the_system():
    assert {(s["command"][2], s["command"][3]) for s in SERVICES.values()} == {
        ("stressbot_planner", "planner"),
        ("stressbot_planner", "sequencer"),
        ("stressbot_driver", "driver"),
    }


@pytest.mark.parametrize("name", SERVICES)
def test_compose_command_is_an_installed_executable(name):
    ros2, verb, package, executable, *arguments = SERVICES[name]["command"]
    assert (ros2, verb) == ("ros2", "run")
    installed = ROOT / "ros2_ws/install" / package / "lib" / package / executable  # where ros2 run looks
    assert os.access(installed, os.X_OK)
    assert not arguments or arguments[0] == "--ros-args"


@pytest.mark.parametrize("name", SERVICES)
def test_compose_container_stops_cleanly_and_finds_its_peers(name):
    service = SERVICES[name]
    assert (service["init"], service["stop_signal"], service["environment"]["TINI_KILL_PROCESS_GROUP"]) == (True, "SIGINT", "1")
    assert service["networks"] == ["nodes"] and service["environment"]["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert "ROS_DOMAIN_ID" in service["environment"]
    assert (ROOT / "docker" / service["build"]["context"] / service["build"]["dockerfile"]).is_file()


@pytest.mark.parametrize("name", SERVICES)
def test_compose_container_has_no_rights_and_says_whether_it_is_well(name):
    service = SERVICES[name]
    assert not {"network_mode", "ipc", "pid", "privileged", "cap_add", "devices", "volumes"} & service.keys()
    assert (service["read_only"], service["cap_drop"]) == (True, ["ALL"])
    assert service["security_opt"] == ["no-new-privileges:true"] and service["tmpfs"] == ["/tmp"]
    assert service["healthcheck"]["test"][:3] == ["CMD", "stressbot-entrypoint", "ros2"]


def test_compose_scenario_exists_in_the_image():
    (scenario,) = (word.split(":=")[1] for word in SERVICES["driver"]["command"] if word.startswith("scenario:="))
    scenario = re.sub(r"\$\{SCENARIO:-([\w-]+)\}", r"\1", scenario)
    assert (ROOT / Path(scenario).relative_to("/opt/stressbot")).is_file()


def copied_paths():
    for line in (ROOT / "docker/Dockerfile").read_text().splitlines():
        if line.startswith("COPY "):
            yield from line.split()[1:-1]


def test_dockerfile_copies_what_exists_and_is_not_ignored():
    kept = [line[1:] for line in (ROOT / "docker/Dockerfile.dockerignore").read_text().splitlines() if line.startswith("!")]
    for path in copied_paths():
        assert (ROOT / path).exists(), path
        assert any(path == pattern or fnmatch.fnmatch(path, f"{pattern}/*") for pattern in kept), path


def test_dockerfile_installs_what_each_package_needs():
    manifests = {str(path.relative_to(ROOT)) for path in (ROOT / "ros2_ws/src").glob("*/package.xml")}
    assert manifests <= set(copied_paths())


def test_entrypoint_is_executable_and_keeps_the_process():
    script = ROOT / "docker/entrypoint.sh"
    assert script.stat().st_mode & stat.S_IXUSR
    assert script.read_text().rstrip().endswith('exec "$@"')
    assert run("bash", "-n", script).returncode == 0


def test_tests_of_a_file_share_a_worker(request):
    in_groups = bool(getattr(request.config.option, "loadgroup", False))  # of a worker of xdist, with --dist loadgroup
    assert request.node.nodeid.endswith("@test_workspace") == in_groups
