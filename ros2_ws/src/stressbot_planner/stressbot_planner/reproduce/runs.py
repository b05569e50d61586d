"""Runs of planners: each by itself, in a worker or a process of its own, many side by side through joblib."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from joblib.parallel import get_active_backend
from stressbot_msgs import lifeline

from stressbot_planner import planners
from stressbot_planner.errors import StressbotError
from stressbot_planner.formats import scenario
from stressbot_planner.formats.plan_file import plan_file
from stressbot_planner.problem.definition import EXACT

OVERRUN = 0.1
"""Share of the time limit by which a planner may end late: the last step, and the check of the plan, take time."""

STARTUP = 60.0
"""Time that a process of its own may take besides planning, s."""

BUSY = 20
"""Seconds by the clock on the wall for one of processor time before a process is ended from outside: others may be busy too."""

_CHILD = f"from {__name__} import main; main()"

Record = dict[str, Any]
"""What a run gave, as plain data; `perform` lists the entries."""


@dataclass(frozen=True)
class Run:
    """One planner on one instance.

    Attributes:
        section: of the report that it belongs to.
        row: within the section.
        text: of the scenario file.
        planner, time_limit, seed, objective, tolerance, order: as for `stressbot plan`.
        fresh: whether in a process of its own, for the peak memory.
    """

    section: str
    row: str
    text: str
    planner: str
    time_limit: float
    seed: int
    objective: str = "path"
    tolerance: float = EXACT
    order: int | None = None
    fresh: bool = False


def perform_all(runs: Sequence[Run], done: Callable[[Record], None] = lambda record: None) -> list[Record]:
    """Perform runs by joblib's active backend (see `joblib.parallel_config`), telling each record as it comes.

    A backend that cannot hand out results one by one, such as Ray's, tells them all at the end.
    """
    backend: Any = get_active_backend()[0]
    performed: Any = Parallel(return_as="generator" if backend.supports_return_generator else "list")(
        delayed(_perform)(run, lifeline.name()) for run in runs
    )
    records = []
    for record in performed:
        done(record)
        records.append(record)
    return records


def _perform(run: Run, starter: str) -> Record:
    lifeline.follow(starter)
    return perform(run)


def perform(run: Run) -> Record:
    """Return the fields of a run but its text, the scenario's name and n, and what came of it:

    `solved` (within the limit, checked), `refused`, `reason`, `planning_time` (s of processor time), `peak_memory` (bytes)
    and the `plan` as in a plan file, if there is one. Its figures stand besides, under the names that a plan file has for them.
    """
    record = {key: value for key, value in asdict(run).items() if key != "text"}
    loaded = scenario.parse(run.text, run.tolerance)
    record |= {"scenario": loaded.name, "n": loaded.swarm.n, "lower_bounds": loaded.problem.lower_bounds._asdict()}
    return record | (_in_a_process_of_its_own(run) if run.fresh else measure(run))


def measure(run: Run) -> Record:
    """Plan here and now, by processor time: planners have one thread, and other work on the machine is not theirs."""
    loaded = scenario.parse(run.text, run.tolerance)
    settings = planners.Settings(
        objective=run.objective, time_limit=run.time_limit, order=run.order, seed=run.seed, clock=time.process_time
    )
    try:
        result = planners.solve(loaded.problem, run.planner, settings)
    except StressbotError as error:
        return {"solved": False, "refused": True, "reason": str(error), "plan": None, "peak_memory": peak_memory()}
    late = result.planning_time > (1 + OVERRUN) * run.time_limit
    data = plan_file(result, loaded.name, loaded.electrical.selection_time)
    figures = ("planning_time", "path_length", "execution_time", "selection_time", "min_clearance", "goal_error", "history")
    record = {name: data[name] for name in figures if name in data}
    return record | {
        "solved": result.success and not late,
        "refused": False,
        "reason": "the limit was overrun" if result.success and late else result.reason,
        "nodes": result.details.get("nodes"),
        "subgroups": result.details.get("subgroups"),
        "activations": len(data["activations"]),
        "peak_memory": peak_memory(),
        "plan": data if result.plan is not None else None,
    }


def peak_memory() -> int | None:
    """Return the most memory that this process has had, bytes; None where the system does not tell.

    Not `getrusage`: there a process begins with what the one that started it had.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), None)


def _in_a_process_of_its_own(run: Run) -> Record:
    failure = {"solved": False, "refused": False, "plan": None, "peak_memory": None}
    try:
        answer = subprocess.run(
            [sys.executable, "-c", _CHILD], input=json.dumps(asdict(run)), capture_output=True, text=True, check=False,
            timeout=BUSY * run.time_limit + STARTUP, env=os.environ | lifeline.environment(),
        )
    except subprocess.TimeoutExpired:
        return failure | {"reason": f"ended from outside: it did not keep its limit of {run.time_limit:g} s"}
    if answer.returncode:
        last = answer.stderr.strip().splitlines()[-1:] or [f"exit code {answer.returncode}"]
        return failure | {"reason": last[0]}
    return json.loads(answer.stdout)


def main() -> None:
    """Read a run from standard input, write its record to standard output."""
    lifeline.follow_starter()
    json.dump(measure(Run(**json.load(sys.stdin))), sys.stdout)
