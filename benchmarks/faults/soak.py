"""`make soak`: random work and random faults for a time; what memory, threads, files and volts came to, in one table.

The system must be as it was at the end: no process grows, every run that is stopped or broken off ends at zero volts.
"""

import argparse
import os
import random
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from stressbot_msgs.domains import reserved
from stressbot_msgs.msg import DriverStatus, ErrorCode

from faults import campaign, settings
from faults.stage import Stage

CHEAP = (
    "stop call",
    "sequencer: kill -9",
    "sequencer: frozen, goes on",
    "driver: frozen, goes on",
    "gate: kill -9",
    "plan doubled while it runs",
    "hostile sequences past the sequencer",
    "all suspended for a second",
)
SETTLED = 0.25
"""Share of the time after which nothing may grow any more."""

GROWTH = 0.1, 10_000
"""Memory that a process may gain afterwards: of what it had, and kB."""

WATCHES = (ErrorCode.PEER_LOST, ErrorCode.NO_HEARTBEAT)


def sample(stage: Stage) -> dict[str, tuple[int, int, int]]:
    """Return kB of memory, threads and open files of each process."""
    found = {}
    pids = {name: stage.pid(name) for name in ("driver", "sequencer", "planner")} | {"gate": stage.children("driver")[0]}
    for name, pid in pids.items():
        status = Path(f"/proc/{pid}/status").read_text()
        lines = [line.split() for line in status.splitlines() if line.startswith(("VmRSS", "Threads"))]
        numbers = {words[0].rstrip(":"): int(words[1]) for words in lines}
        found[name] = numbers["VmRSS"], numbers["Threads"], len(os.listdir(f"/proc/{pid}/fd"))
    return found


def work(stage: Stage) -> str:
    """A plan from the planner, a run to its end, or one that is stopped; return what it was."""
    kind = stage.rng.choice(("plan", "short", "short", "stopped"))
    if kind == "plan":
        stage.planned()
        stage.recover()
    elif kind == "short":
        stage.recover()
    else:
        stage.running()
        since = time.monotonic()
        assert stage.call("stop").success
        assert stage.rested(since) < 1.0
        stage.recover()
    return kind


def soak(stage: Stage, seconds: float, share_of_faults: float) -> tuple[list[str], dict, dict]:
    """Return what happened, and samples early and at the end, of processes that no fault has replaced."""
    done, began, early, replaced = [], time.monotonic(), None, set()
    while time.monotonic() < began + seconds:
        try:
            if stage.rng.random() < share_of_faults:
                name = stage.rng.choice(CHEAP)
                replaced |= {"gate"} if name.startswith("gate") else {"sequencer"} if name == "sequencer: kill -9" else set()
                campaign.FAULTS[name][1](stage)
                done.append(name)
            else:
                done.append(work(stage))
        except AssertionError:
            if stage.status.state != DriverStatus.FAULT or stage.status.error_code not in WATCHES:
                raise
            stage.false_alarms += 1
            done.append("false alarm instead")
            stage.recover()
        if early is None and time.monotonic() > began + SETTLED * seconds:
            early, replaced = sample(stage), set()
    late = sample(stage)
    return done, {name: numbers for name, numbers in (early or late).items() if name not in replaced}, late


def main() -> int:
    """Print the table; return 1 if something grew or volts stayed."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="default: %(default)s")
    parser.add_argument("--faults", type=float, default=0.3, metavar="P", help="share of faults among all that happens")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    options = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with (
        reserved(os.environ), TemporaryDirectory() as folder,
        settings.simulated(Path(folder), random.Random(options.seed)) as stage,
    ):
        done, early, late = soak(stage, 60.0 * options.minutes, options.faults)
        level = stage.status.output_level if stage.status.state != DriverStatus.RUNNING else 0.0
    print("| process | memory (MB): early, at the end | threads | open files |\n|---|---|---|---|")
    grown = []
    for name, last in late.items():
        first = early.get(name)
        if first is None:
            print(f"| {name} | replaced by a fault, {last[0] / 1e3:.0f} | {last[1]} | {last[2]} |")
            continue
        print(f"| {name} | {first[0] / 1e3:.0f}, {last[0] / 1e3:.0f} | {first[1]}, {last[1]} | {first[2]}, {last[2]} |")
        if last[0] > first[0] * (1 + GROWTH[0]) + GROWTH[1] or last[1] > first[1] + 2 or last[2] > first[2] + 5:
            grown.append(name)
    counts = ", ".join(f"{done.count(name)} × {name}" for name in dict.fromkeys(done))
    print(f"\n{counts}\n{stage.false_alarms} false alarms (load of this machine: {os.getloadavg()[1]:.1f})")
    print(f"soak: {len(done)} things in {options.minutes:g} minutes, {', '.join(grown) or 'nobody'} grew, {level:g} V at the end")
    return 1 if grown or level else 0


if __name__ == "__main__":
    sys.exit(main())
