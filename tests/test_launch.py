"""What the launch file starts, and what it refuses before it starts anything."""

from pathlib import Path

import pytest
from stressbot_msgs.transports import RANGE
from system_rig import NEAR, SCENARIOS
from three_robots import SCENARIO as THREE

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.ros import bringup
from stressbot_planner.ros.bringup import arguments, launched

LAUNCH = Path(bringup.share("launch", "stressbot.launch.py"))


def values(**changes):
    return {name: default for name, (default, _) in arguments().items()} | changes


def executables(**changes):
    return [start.executable for start in launched(values(**changes))]


@pytest.fixture
def rviz(monkeypatch):
    """A machine that has RViz."""
    find = bringup.get_package_prefix
    monkeypatch.setattr(bringup, "get_package_prefix", lambda name: "/opt/ros/jazzy" if name == "rviz2" else find(name))


def test_the_defaults_start_three_nodes_and_leave_the_rest_to_the_parameter_file():
    starts = launched(values())
    assert [start.executable for start in starts] == ["driver", "sequencer", "planner"]
    driver = starts[0]
    assert list(driver.parameters) == ["scenario"] and Path(driver.parameters["scenario"]).is_file()
    assert all(start.namespace == "" and Path(start.parameter_file).is_file() for start in starts)


def test_markers_need_no_rviz_and_rviz_brings_its_markers(rviz):
    assert executables(view="true") == ["driver", "sequencer", "planner", "viewer", "paths"]
    assert executables(rviz="true") == ["driver", "sequencer", "planner", "viewer", "paths", "clicks", "rviz2"]
    assert executables(rviz="true", view="True") == executables(rviz="true")
    assert executables(click="true") == ["driver", "sequencer", "planner", "clicks"]
    assert executables(move="true") == ["driver", "sequencer", "planner", "mover"]


def test_other_machines_hear_what_is_launched_only_if_asked_to(monkeypatch):
    monkeypatch.delenv(RANGE, raising=False)
    assert bringup.environment()[RANGE] == "LOCALHOST"
    monkeypatch.setenv(RANGE, "SUBNET")
    assert bringup.environment()[RANGE] == "SUBNET"
    assert "additional_env=environment()" in LAUNCH.read_text()


@pytest.mark.parametrize("text", ["bench", "/bench", "/bench/"])
def test_a_namespace_is_that_of_every_process(rviz, text):
    starts = launched(values(namespace=text, move="true", rviz="true"))
    assert {start.namespace for start in starts} == {"/bench"} and len(starts) == 8


def test_values_reach_the_driver_with_their_kinds():
    driver = launched(values(real_time_factor="10", auto_start="True"))[0]
    assert driver.parameters["real_time_factor"] == 10.0 and driver.parameters["auto_start"] is True


@pytest.mark.parametrize(
    ("changes", "code", "text"),
    [
        ({"scenario": "/no/such.yaml"}, ErrorCode.UNREADABLE_FILE, "/no/such.yaml"),
        ({"scenario": "BROKEN"}, ErrorCode.UNKNOWN_FIELD, "swarm.colour"),
        ({"parameters": "/no/such.yaml"}, ErrorCode.UNREADABLE_FILE, "parameters: cannot read /no/such.yaml"),
        ({"namespace": "a b"}, ErrorCode.OUT_OF_RANGE, "namespace: is 'a b'"),
        ({"namespace": "1st"}, ErrorCode.OUT_OF_RANGE, "namespace: is '1st'"),
        ({"view": "yes please"}, ErrorCode.WRONG_TYPE, "view: is 'yes please': give true or false"),
        ({"move": ""}, ErrorCode.WRONG_TYPE, "move: is '': give true or false"),
        ({"auto_start": "1"}, ErrorCode.WRONG_TYPE, "auto_start: is '1': give true or false"),
        ({"real_time_factor": "fast"}, ErrorCode.WRONG_TYPE, "real_time_factor: is 'fast': give a number"),
        ({"rviz": "true"}, ErrorCode.UNSUPPORTED, "rviz2 is not installed"),
    ],
)
def test_what_is_wrong_or_missing_is_named_before_anything_starts(tmp_path, changes, code, text):
    if changes.get("scenario") == "BROKEN":
        broken = tmp_path / "broken.yaml"
        broken.write_text(THREE.replace("swarm: {", "swarm: {colour: red, "))
        changes = {"scenario": str(broken)}
    with pytest.raises(StressbotError) as caught:
        launched(values(**changes))
    assert caught.value.code == code
    assert text in str(caught.value)


def test_the_launch_file_offers_what_the_readme_names():
    readme = (SCENARIOS.resolve().parents[3] / "README.md").read_text()
    for name in ("rviz:=true", "view:=true", "namespace:="):
        assert name in readme and name.partition(":")[0] in arguments()
    compile(LAUNCH.read_text(), str(LAUNCH), "exec")


@pytest.mark.xdist_group("namespaces")
@pytest.mark.timeout(300)
def test_two_systems_in_two_namespaces_do_not_hear_each_other(new_system, tmp_path):
    path = tmp_path / "three.yaml"
    path.write_text(THREE)
    six = new_system(scenario=SCENARIOS / "paper-six.yaml", real_time_factor=0.0)
    three = new_system(scenario=path, real_time_factor=0.0)
    assert six.namespace != three.namespace and six.client.node.context.get_domain_id() == three.client.node.context.get_domain_id()
    assert (six.client.drivers, three.client.drivers) == (1, 1)
    plans = [system.plan(first=True) for system in (six, three)]
    assert all(answer.success for answer in plans), [answer.error_msg for answer in plans]
    for system, answer in zip((six, three), plans, strict=True):
        poses, scene = system.execute(answer.plan)
        assert len(poses) == scene.swarm.n
        assert abs(poses[:, :2] - scene.goals).max() < NEAR
    assert len(three.client.description.ids) == 3 and len(six.client.description.ids) == 6


def test_a_camera_brings_its_tracker_and_a_simulated_one_its_pictures():
    assert executables(camera="/path/to/camera.yaml") == ["driver", "sequencer", "planner", "camera_tracker"]
    starts = {start.executable: start for start in launched(values(camera="simulated", move="true"))}
    assert list(starts) == ["driver", "sequencer", "planner", "mover", "simulated_camera", "camera_tracker"]
    assert starts["driver"].parameters["tracked"] is True
    assert starts["simulated_camera"].parameters == starts["camera_tracker"].parameters == {"camera": "bench"}
    assert "tracked" not in launched(values(camera="/path/to/camera.yaml"))[0].parameters
