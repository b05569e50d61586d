"""The stand-in for `ros2`, in processes of its own, with real nodes: the official words, output and exit codes."""

import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from system_rig import DEADLINE, SCENARIOS

ROOT = Path(__file__).resolve().parents[1]
ROS2 = str(ROOT / "tools/ros2/ros2")


def ros2(*words, code: int = 0, entered: str | None = None) -> subprocess.CompletedProcess:
    done = subprocess.run([sys.executable, ROS2, *words], capture_output=True, text=True, input=entered, timeout=DEADLINE)
    assert done.returncode == code, done
    return done


def lines(*words, **options) -> list[str]:
    return ros2(*words, **options).stdout.splitlines()


def lines_once(found: Callable[[list[str]], object], *words) -> list[str]:
    """Return what a command prints once that is whole: whoever looks round on a busy machine has not met all yet."""
    deadline = time.monotonic() + DEADLINE
    while not found(printed := lines(*words)):
        assert time.monotonic() < deadline, printed
    return printed


@contextmanager
def started(*words):
    """A command that goes on until it is ended, and what it has said so far."""
    process = subprocess.Popen([sys.executable, ROS2, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def read_until(process: subprocess.Popen, found: Callable[[str], object]) -> str:
    text = ""
    while line := process.stdout.readline():
        text += line
        if found(text):
            return text
    raise AssertionError(f"ended with {process.wait()}: {text}")


@pytest.fixture(scope="module")
def system(new_system):
    """Driver, sequencer and planner in a namespace of their own; `name` returns a full name."""
    system = new_system(scenario=SCENARIOS / "paper-six.yaml", real_time_factor=0.0)
    system.name = lambda name: f"{system.namespace}/{name}"
    return system


# --- the graph ----------------------------------------------------------------------------------------------------


def test_nodes_are_listed_and_described(system):
    wanted = {system.name(name) for name in ("driver", "sequencer", "planner")}
    nodes = lines_once(lambda nodes: wanted <= set(nodes), "node", "list")
    assert nodes == sorted(nodes)
    lines_once(lambda count: int(count[0]) == len(nodes), "node", "list", "-c")
    name = system.name("planner")
    text = lines("node", "info", name)
    titles = ["Subscribers", "Publishers", "Service Servers", "Service Clients", "Action Servers", "Action Clients"]
    assert text[0] == name and [line.strip(" :") for line in text if re.fullmatch(r"  \S.*:", line)] == titles
    assert f"    {system.name('plan_motion')}: stressbot_msgs/srv/PlanMotion" in text
    assert f"    {system.name('plan_motion_action')}: stressbot_msgs/action/PlanMotion" in text
    assert not any("/_action/" in line for line in text)
    assert ros2("node", "info", "/nobody", code=1).stderr == "Unable to find node '/nobody'\n"


def test_topics_are_listed_and_described(system):
    name = system.name("driver_status")
    topics = lines_once(lambda topics: f"{name} [stressbot_msgs/msg/DriverStatus]" in topics, "topic", "list", "-t")
    assert topics == sorted(topics)
    assert "/rosout [rcl_interfaces/msg/Log]" in topics
    shown = ["Type: stressbot_msgs/msg/DriverStatus", "Publisher count: 1"]
    info = lines_once(lambda info: info[:2] == shown, "topic", "info", name)
    assert re.fullmatch(r"Subscription count: \d+", info[2]) and len(info) == 3
    verbose = ros2("topic", "info", "-v", name).stdout
    assert "Node name: driver\n" in verbose and "Durability: TRANSIENT_LOCAL" in verbose
    assert lines("topic", "type", name) == ["stressbot_msgs/msg/DriverStatus"]
    assert lines("topic", "type", system.name("nothing"), code=1) == []
    assert ros2("topic", "info", "/nothing", code=1).stderr == "Unknown topic '/nothing'\n"


def test_services_and_actions_are_listed_and_described(system):
    service = f"{system.name('plan_motion')} [stressbot_msgs/srv/PlanMotion]"
    assert not any("/_action/" in line for line in lines_once(lambda lines: service in lines, "service", "list", "-t"))
    assert lines("service", "type", system.name("start")) == ["std_srvs/srv/Trigger"]
    name = system.name("plan_motion_action")
    lines_once(lambda lines: name in lines, "action", "list")
    server = f"    {system.name('planner')} [stressbot_msgs/action/PlanMotion]"
    shown = [f"Action: {name}", "Action clients: 0", "Action servers: 1", server]
    lines_once(lambda lines: lines == shown, "action", "info", "-t", name)


# --- topics -------------------------------------------------------------------------------------------------------


def test_a_latched_topic_is_echoed_as_yaml(system):
    name = system.name("swarm_description")
    whole = ros2("topic", "echo", "--once", "--full-length", name).stdout
    assert whole.endswith("\n---\n")
    message = yaml.safe_load(whole.removesuffix("---\n"))
    assert message["name"] == "paper-six" and message["ids"] == [1, 2, 3, 4, 5, 6]
    assert list(message)[0] == "header" and list(message["header"]["stamp"]) == ["sec", "nanosec"]
    cut = yaml.safe_load(ros2("topic", "echo", "--once", "-l", "2", "--field", "ids", name).stdout.split("---")[0].replace("'", ""))
    assert "1, 2" in str(cut)
    assert "<sequence type: uint32, length: 6>" in ros2("topic", "echo", "--once", "--no-arr", name).stdout
    assert len(lines("topic", "echo", "--once", "--csv", name)) == 1
    assert ros2("topic", "echo", "--timeout", "0.1", "/nothing", "std_msgs/msg/String").stdout == ""
    unknown = ros2("topic", "echo", "/nothing", code=1)
    assert unknown.stdout == "WARNING: topic [/nothing] does not appear to be published yet\n"
    assert unknown.stderr == "Could not determine the type for the passed topic\n"


def test_what_is_published_is_heard(system):
    name = system.name("spoken")
    with started("topic", "echo", "--once", name, "std_msgs/msg/Header") as hearer:
        said = lines("topic", "pub", "--once", name, "std_msgs/msg/Header", "{stamp: now, frame_id: 'ä: 1'}")
        assert said[-3:-1] == ["publisher: beginning loop", said[-2]] and said[-2].startswith("publishing #1: std_msgs.msg.Header(")
        heard = yaml.safe_load(read_until(hearer, lambda text: "---" in text).removesuffix("---\n"))
        assert heard["frame_id"] == "ä: 1" and heard["stamp"]["sec"] > 0
        assert hearer.wait(DEADLINE) == 0
    wrong = ros2("topic", "pub", "--once", "-w", "0", name, "std_msgs/msg/String", "{dat: x}", code=1)
    assert wrong.stderr == "Failed to populate field: 'String' object has no attribute 'dat'\n"


def test_the_rate_of_a_topic_is_told_each_second(system):
    with started("topic", "hz", system.name("driver_status")) as process:
        text = read_until(process, lambda text: "window" in text)
        assert re.search(r"average rate: \d+\.\d{3}\n\tmin: \d+\.\d{3}s max: \d+\.\d{3}s std dev: \d+\.\d{5}s window: \d+\n", text)
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE) == 2


# --- services and actions -----------------------------------------------------------------------------------------


def test_a_service_is_called(system):
    said = ros2("service", "call", system.name("stop"), "std_srvs/srv/Trigger").stdout
    said = said.removeprefix("waiting for service to become available...\n")
    assert said.startswith("requester: making request: std_srvs.srv.Trigger_Request()\n\nresponse:\nstd_srvs.srv.Trigger_Response(")
    plan = "service", "call", system.name("plan_motion"), "stressbot_msgs/PlanMotion"
    refused = ros2(*plan, "--stdin", entered="{objective: fun}")
    assert "success=False" in refused.stdout and "objective: is 'fun'" in refused.stdout
    for words, sentence in (
        (("std_srvs/srv/Nothing",), "The passed service type is invalid\n"),
        (("std_srvs/srv/Trigger", "{a: 1}"), "Failed to populate field: 'Trigger_Request' object has no attribute 'a'\n"),
    ):
        assert ros2("service", "call", system.name("stop"), *words, code=1).stderr == sentence


def test_a_goal_is_sent_and_followed(system):
    words = "action", "send_goal", "--feedback", system.name("plan_motion_action"), "stressbot_msgs/action/PlanMotion"
    said = ros2(*words, "{objective: time, max_tries: 400}").stdout
    assert said.startswith("Waiting for an action server to become available...\nSending goal:\n     ")
    assert re.search(r"\nGoal accepted with ID: [0-9a-f]{32}\n\n", said) and "Feedback:\n    " in said
    assert "Result:\n    success: true\n" in said and said.endswith("\nGoal finished with status: SUCCEEDED\n")


def test_ctrl_c_cancels_a_goal(system):
    words = "action", "send_goal", "-f", system.name("plan_motion_action"), "stressbot_msgs/action/PlanMotion"
    endless = "{planner: rrt, tolerance: 3.1e-6, time_limit: 600}"  # within a tenth of a body of the goals
    with started(*words, endless) as process:
        read_until(process, lambda text: "Feedback" in text)
        process.send_signal(signal.SIGINT)
        assert read_until(process, lambda text: "Goal canceled." in text)
        assert process.wait(DEADLINE) == 2


# --- parameters ---------------------------------------------------------------------------------------------------


def test_parameters_are_read_and_set(system, tmp_path):
    node, name = system.name("driver"), "real_time_factor"
    assert f"  {name}" in lines("param", "list", node)
    assert lines("param", "list", node, "--filter", "real_.*", "--param-type") == [f"  {name} (type: double)"]
    assert lines("param", "get", node, name) == ["Double value is: 0.0"]
    assert lines("param", "describe", node, "scenario")[:2] == ["Parameter name: scenario", "  Type: string"]
    assert lines("param", "set", node, name, "5.0") == ["Set parameter successful"]
    assert lines("param", "get", "--hide-type", node, name) == ["5.0"]
    assert ros2("param", "set", node, name, "fast").stderr.startswith("Setting parameter failed: ")
    file = tmp_path / "parameters.yaml"
    file.write_text(f"{node}:\n  ros__parameters:\n    {name}: 0.0\n    scenario: other.yaml\n")
    loaded = ros2("param", "load", node, str(file))
    assert loaded.stdout == f"Set parameter {name} successful\n" and loaded.stderr.startswith("Set parameter scenario failed: ")
    dumped = yaml.safe_load(ros2("param", "dump", node).stdout)
    assert dumped[node]["ros__parameters"][name] == 0.0 and dumped[node]["ros__parameters"]["imperfections"]["seed"] == 0
    assert ros2("param", "get", node, "nothing", code=1).stderr == "Parameter not set\n"
    assert ros2("param", "get", "/nobody", name, code=1).stderr == "Node not found\n"


# --- what needs no nodes ------------------------------------------------------------------------------------------


def test_interfaces_are_listed_and_shown():
    assert "    stressbot_msgs/srv/PlanMotion" in lines("interface", "list", "-s")
    shown = ros2("interface", "show", "stressbot_msgs/msg/ErrorCode").stdout
    assert shown == (ROOT / "ros2_ws/src/stressbot_msgs/msg/ErrorCode.msg").read_text()
    stamped = lines("interface", "show", "--no-comments", "geometry_msgs/msg/PoseStamped")
    assert stamped[:4] == ["std_msgs/Header header", "\tbuiltin_interfaces/Time stamp", "\t\tint32 sec", "\t\tuint32 nanosec"]
    assert lines("interface", "show", "-", entered="std_srvs/srv/Trigger\n")[0] == "---"
    assert ros2("interface", "show", "no/such/thing", code=1).stderr == "Unknown package 'no'\n"


def test_packages_and_their_executables():
    executables = lines("pkg", "executables", "stressbot_planner")
    assert {"stressbot_planner planner", "stressbot_planner sequencer"} <= set(executables)
    (prefix,) = lines("pkg", "prefix", "stressbot_planner")
    assert (Path(prefix) / "share/stressbot_planner/scenarios/paper-six.yaml").is_file()
    assert lines("pkg", "prefix", "--share", "stressbot_planner") == [f"{prefix}/share/stressbot_planner"]
    assert ros2("pkg", "prefix", "nothing", code=1).stderr == "Package not found\n"


def test_an_executable_is_run_with_its_exit_code(tmp_path):
    refused = ros2("run", "stressbot_planner", "stressbot", "plan", str(tmp_path / "no.yaml"), code=2)
    assert refused.stdout == "[ros2run]: Process exited with failure 2\n" and refused.stderr.startswith("stressbot: ")
    killed = ros2("run", "--prefix", "sh -c 'kill -9 $$'", "stressbot_planner", "stressbot", code=247)
    assert killed.stdout == "[ros2run]: Killed\n"
    assert ros2("run", "stressbot_planner", "nothing", code=1).stderr == "No executable found\n"
    assert ros2("run", "nothing", "nothing", code=1).stderr == "Package 'nothing' not found\n"


def test_the_launch_table_is_launched_and_ends_with_ctrl_c():
    launch = "launch", "-n", "stressbot_planner", "stressbot.launch.py"
    names = lines(*launch, "-s")
    assert names[:3] == ["Arguments (pass arguments as '<name>:=<value>'):", "", "    'scenario':"]
    said = "[ERROR] [launch]: Caught exception in launch (see debug for traceback): scenario: /no.yaml cannot be read"
    assert lines(*launch, "scenario:=/no.yaml", code=1)[-1].startswith(said)
    assert ros2(*launch, "x", code=1).stderr.startswith("malformed launch argument 'x'")
    assert "sigkill_timeout" in ros2(*launch, "sigterm_timeout:=soon", code=1).stderr
    with started(*launch, f"namespace:=launched_{os.getpid()}", "sigterm_timeout:=60") as process:  # on a busy machine
        text = read_until(process, lambda text: all(word in text for word in ("driver]: ", "planner]: swarm", "sequencer]: swarm")))
        numbers = [int(number) for number in re.findall(r"\[INFO\] \[\w+-\d\]: process started with pid \[(\d+)\]", text)]
        assert len(numbers) == 3
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=DEADLINE)[0]
        assert process.returncode == 0 and "[WARNING] [launch]: user interrupted with ctrl-c (SIGINT)\n" in rest
        for number in numbers:
            assert f": process has finished cleanly [pid {number}]\n" in rest, rest
            assert not Path(f"/proc/{number}").exists()


# --- the command itself -------------------------------------------------------------------------------------------


def test_help_says_that_it_is_a_stand_in_and_what_it_lacks():
    said = ros2("--help").stdout
    assert "stand-in" in said and all(word in said for word in ("bag", "lifecycle", "topic bw", "doctor"))
    assert ros2("topic").stdout.startswith("usage: ros2 topic [-h]")
    assert "invalid choice: 'nothing'" in ros2("topic", "nothing", code=2).stderr


def in_shell(script: str, **changes: str) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "_ROS", "VIRTUAL_ENV"))}
    environment["PATH"] = "/usr/bin:/bin"
    done = subprocess.run(
        ["bash", "-c", script], env=environment | changes, cwd=ROOT, capture_output=True, text=True, timeout=DEADLINE
    )
    assert done.returncode == 0, done
    return done.stdout


def test_it_is_on_the_path_once_unless_there_is_an_official_one(tmp_path):
    show = "source tools/env.sh; source tools/env.sh; type -P ros2 || true; grep -o tools/ros2 <<<$PATH | wc -l"
    assert in_shell(show).split() == [ROS2, "1"]
    official = tmp_path / "ros2"
    official.write_text("#!/bin/sh\n")
    official.chmod(0o755)
    assert in_shell(show, PATH=f"{tmp_path}:/usr/bin:/bin").split()[0] == str(official)
    assert in_shell(show, ROS_DISTRO="jazzy").split() == ["0"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("ros2 to", {"topic"}),
        ("ros2 service c", {"call"}),
        ("ros2 pkg prefix stressbot_p", {"stressbot_planner"}),
        ("ros2 run stressbot_planner se", {"sequencer"}),
        ("ros2 interface show stressbot_msgs/msg/Err", {"stressbot_msgs/msg/ErrorCode"}),
        ("ros2 launch stressbot_planner stressbot.launch.py sc", {"scenario:="}),
        ("stressbot pla", {"plan", "planners"}),
        ("stressbot move --ti", {"--time-limit", "--timeout"}),
        ("stressbot demo --real", {"--real-time-factor"}),
    ],
)
def test_words_are_completed(line, words):
    script = f"""source tools/env.sh
        COMP_LINE='{line}' COMP_POINT={len(line)} COMP_TYPE=9 COMP_WORDS=({line})
        compopt() {{ :; }}; _stressbot_complete {line.split()[0]}; printf '%s\\n' "${{COMPREPLY[@]}}" """
    assert set(in_shell(script).split()) == words


def processor_time(run) -> float:
    """Return the least of three, s, of what a call and its children take."""
    taken = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        run()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        taken.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(taken)


@pytest.mark.timing
@pytest.mark.parametrize("words", [("topic", "list"), ("service", "type", "/nothing"), ("interface", "list"), ("node", "list")])
def test_a_call_costs_little_more_than_a_node(words):
    """Python's start and the import of rclpy are most of it: 0.5 to 0.7 s of a processor, as the processor is."""
    node = "import rclpy; rclpy.init(); rclpy.create_node('one').destroy_node(); rclpy.shutdown()"
    least = processor_time(lambda: in_shell(f'source tools/env.sh; python -c "{node}"'))
    assert processor_time(lambda: ros2(*words, code=1 if "/nothing" in words else 0)) < 2.5 * least
