"""`make faults`: prints a table of what came of each fault, and writes it to results/ as Markdown and JSON; the last line counts.

The time to zero volts is from the fault to the arrival, in this process, of the `driver_status` that says so.
"""

import argparse
import json
import os
import shutil
import sys
from pathlib import Path

from stressbot_msgs.domains import reserved

import faults
from faults import ROOT
from faults.campaign import FAULTS, campaign
from faults.settings import PEER_TIMEOUT, Setting, failing_calls, lossy_hosts, moving_with_shifted_clocks, shifted_clocks, two_hosts
from faults.shifted_clock import compiler
from faults.table import table

LIMIT = 0.1
"""Zero volts must come within this time, s."""


def lacking() -> dict[Setting, str]:
    """Return the systems that this machine cannot make, and what they need."""
    missing = {}
    if os.geteuid() != 0 or not shutil.which("ip"):
        missing |= {two_hosts: "root and ip", lossy_hosts: "root and ip"}
    elif not os.access("/dev/net/tun", os.W_OK):
        missing[lossy_hosts] = "/dev/net/tun"
    if not compiler():
        missing |= dict.fromkeys((shifted_clocks, moving_with_shifted_clocks, failing_calls), "a C compiler")
    return missing


def main() -> int:
    """Let all faults happen, or those asked for; return 1 if one ended undocumented, or zero volts came too late."""
    parser = argparse.ArgumentParser(prog="faults", description=faults.__doc__.splitlines()[0])
    parser.add_argument("faults", nargs="*", metavar="FAULT", help="part of a name (default: all)")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="times each (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the random moments (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=ROOT / "results", metavar="FOLDER", help="for faults.md and faults.json")
    options = parser.parse_args()
    names = [name for name in FAULTS if not options.faults or any(part in name for part in options.faults)]
    if not names:
        parser.error(f"no such fault: use parts of {'; '.join(FAULTS)}")
    for setting, wanted in lacking().items():
        left_out = [name for name in names if FAULTS[name][0] is setting]
        if left_out:
            print(f"not tried, since this needs {wanted}: {'; '.join(left_out)}")
            names = [name for name in names if name not in left_out]
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with reserved(os.environ):
        results = campaign(names, options.repeats, options.seed)
    text = table(results).markdown()
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "faults.md").write_text(text, encoding="utf-8")
    (options.output / "faults.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    good = sum(outcome["documented"] for outcome in results)
    worst = max((outcome["zero"] for outcome in results if outcome.get("zero") is not None), default=0.0)
    print("\n" + text)
    alarms = sum(outcome.get("false_alarms", 0) for outcome in results)
    print(f"{alarms} times a living sequencer seemed lost for {PEER_TIMEOUT:g} s (load of this machine: {os.getloadavg()[1]:.1f})")
    print(f"faults: {good}/{len(results)} ended in a documented state, worst time to zero volts {1e3 * worst:.0f} ms")
    return 0 if good == len(results) and worst <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
