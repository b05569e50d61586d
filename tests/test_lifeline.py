"""Nobody outlives who started them, even if that is killed with signal 9; and who was started by a shell lives on without it."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from marked import marked, new_mark, wait_until
from stressbot_msgs import lifeline
from system_rig import SCENARIOS

from stressbot_planner.reproduce import instances
from stressbot_planner.ros.bringup import NODES, command

pytestmark = [pytest.mark.xdist_group("lifeline"), pytest.mark.timeout(300)]

ENTRIES = {entry.executable: entry for entry in NODES}

ALL_NODES = f"""
import sys, time
from pathlib import Path
from stressbot_planner.ros.bringup import NODES, command
from stressbot_planner.ros.child_processes import ChildProcesses
processes = ChildProcesses(Path(sys.argv[1]))
for entry in NODES:
    needed = {{"scenario": {str(SCENARIOS / "paper-six.yaml")!r}, "camera": "bench"}}
    parameters = {{name: value for name, value in needed.items() if name in entry.arguments}}
    processes.start(entry.executable, command(entry, parameters))
print("started", flush=True)
time.sleep(1000)
"""


@pytest.fixture
def start():
    """Return a function that starts a marked process; it returns the process and a function that lists its relatives."""
    marks, processes = [], []

    def start(arguments, **options):
        marks.append(new_mark())
        mark = marks[-1]
        process = subprocess.Popen(arguments, env=os.environ | mark, stdout=subprocess.PIPE, text=True, **options)
        processes.append(process)
        return process, lambda: [relative for relative in marked(mark) if relative != process.pid]

    yield start
    for mark in marks:
        for process in marked(mark):
            os.kill(process, signal.SIGKILL)
    for process in processes:
        process.communicate()


def kill(process):
    process.kill()
    process.wait()


def test_nodes_end_in_good_order_with_the_one_that_started_them(start, tmp_path):
    process, relatives = start([sys.executable, "-c", ALL_NODES, tmp_path])
    log = tmp_path / "driver.log"
    wait_until(lambda: log.exists() and "on backend" in log.read_text() and len(relatives()) >= len(NODES), "all nodes")
    kill(process)
    wait_until(lambda: not relatives(), f"the end of {relatives()}")
    assert "Traceback" not in "".join(path.read_text() for path in tmp_path.glob("*.log"))


@pytest.mark.parametrize("node", ["planner"])
def test_the_planning_process_ends_with_its_node(start, node):
    process, relatives = start(command(ENTRIES[node], {}))
    wait_until(relatives, "the planning process")
    kill(process)
    wait_until(lambda: not relatives(), "its end")


def test_processes_that_plan_side_by_side_end_with_the_tool(start, tmp_path):
    scenario = tmp_path / "thirty.yaml"  # a search that goes on
    scenario.write_text(instances.random(30, True, 0))
    # of tries, so that others are waited for while they load their kernels
    arguments = ["plan", scenario, "--jobs", "2", "--max-tries", "1000000", "--output", tmp_path / "plan.json"]
    process, relatives = start([sys.executable, "-m", "stressbot_planner.cli.tool", *map(str, arguments)])

    def busy():
        """Those that have computed for 3 s."""
        found = []
        for child in relatives():
            with suppress(OSError):  # it has ended meanwhile
                ticks = int(Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11])
                found += [child] if ticks > 300 else []
        return found

    wait_until(busy, "another process at work")
    kill(process)
    wait_until(lambda: not relatives(), "their end")


def test_a_killed_demo_leaves_nobody(start, tmp_path):
    process, relatives = start(
        [sys.executable, "-m", "stressbot_planner.cli.tool", "demo", "--real-time-factor", "1", "--output", tmp_path]
    )
    for line in process.stdout:
        if line.startswith("driving"):
            break
    assert len(relatives()) >= 4
    kill(process)
    wait_until(lambda: not relatives(), "their end")


def test_a_node_that_nobody_told_to_follow_outlives_its_shell(start):
    line = " ".join(map(str, command(ENTRIES["driver"], {"scenario": SCENARIOS / "paper-six.yaml"})))
    shell, relatives = start(["sh", "-c", f"nohup {line} 2>&1 & read forever"], stdin=subprocess.PIPE)
    (node,) = wait_until(relatives, "the node")
    for text in iter(shell.stdout.readline, ""):
        if "on backend" in text:
            break
    os.kill(shell.pid, signal.SIGKILL)
    shell.wait()
    assert Path(f"/proc/{node}/environ").exists()
    # One that follows has gone by then.
    follower, _ = start([sys.executable, "-c", FOLLOWER, lifeline.name().replace(f" {os.getpid()} ", f" {shell.pid} ")])
    follower.wait(300.0)
    assert node in relatives()


FOLLOWER = """
import sys, time
from stressbot_msgs import lifeline
lifeline.follow(sys.argv[1])
time.sleep(1000)
"""


@pytest.mark.parametrize(
    "starter",
    ["", "nonsense", "1 2", "another-machine pid:[1] 1 5", lifeline.name()],
    ids=["none", "text", "numbers", "elsewhere", "itself"],
)
def test_nobody_follows_who_cannot_be_or_itself(starter):
    environment = os.environ | {lifeline.VARIABLE: starter}
    expected = 1 if starter == lifeline.name() else 0  # this process is the starter, and lives
    assert subprocess.run([sys.executable, "-c", WATCHES], env=environment).returncode == expected


WATCHES = """
import sys, threading
from stressbot_msgs import lifeline
lifeline.follow_starter()
sys.exit(threading.active_count() - 1)
"""


def test_a_process_follows_its_starter_only_while_it_is_the_same():
    """Another process with the number of one that is gone does not stand for it."""
    place, process, since = lifeline.name().rsplit(" ", 2)
    done = subprocess.run([sys.executable, "-c", FOLLOWER, f"{place} {process} {int(since) - 1}"], timeout=300.0)
    assert done.returncode == -signal.SIGKILL
