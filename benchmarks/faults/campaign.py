"""All faults, and letting them happen."""

import random
import traceback
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from faults import cameras, clocks, drivers, gates, hosts, instruments, loads, messages, movers, planners, sequencers, trackers

KINDS = (sequencers, planners, movers, drivers, gates, loads, messages, clocks, trackers, cameras, instruments, hosts)
FAULTS = {name: fault for kind in KINDS for name, fault in kind.FAULTS.items()}
"""Each with the system that it happens to, which it leaves as it found it."""


def campaign(names: list[str], repeats: int, seed: int) -> list[dict]:
    """Let faults happen, `repeats` times each; return what came of each, in order. A system that breaks is made anew."""
    results = []
    setting, stage = None, None
    with TemporaryDirectory() as folder, ExitStack() as stack:
        for number, name in enumerate(name for name in names for _ in range(repeats)):
            needed, fault = FAULTS[name]
            rng = random.Random(f"{seed} {number}")
            try:
                if setting is not needed:
                    stack.close()
                    logs = Path(folder, str(number))
                    logs.mkdir()
                    setting, stage = needed, stack.enter_context(needed(logs, rng))
                stage.rng = rng
                outcome = {"fault": name, "documented": True, **asdict(fault(stage)), "false_alarms": stage.false_alarms}
                stage.false_alarms = 0
            except Exception as error:
                outcome = {"fault": name, "documented": False, "error": f"{error!r}", "traceback": traceback.format_exc()}
                setting = None
            print(f"{name}: {_told(outcome)}", flush=True)
            results.append(outcome)
    return results


def _told(outcome: dict) -> str:
    if not outcome["documented"]:
        return f"NOT DOCUMENTED: {outcome['error']}"
    zero = "" if outcome["zero"] is None else f", zero volts after {1e3 * outcome['zero']:.0f} ms"
    return f"{outcome['state']}{zero}; {outcome['recovered']}"
