"""Whether imperfect robots reach their goals without a touch, in closed loop and in open loop: whole runs through volts."""

import time
from typing import NamedTuple

import numpy as np
from calibration import corridor
from joblib import Parallel, delayed, parallel_config
from simulated_bench import SimulatedBench

from stressbot_planner import planners
from stressbot_planner.closed_loop import ClosedLoop, Rest, State, Wanted
from stressbot_planner.errors import StressbotError
from stressbot_planner.planners import Settings
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table

TOLERANCE = 0.3
LONGEST = 2000.0
"""s on the substrate, after which a run is given up."""

IMPERFECTIONS = {"speed_error": 0.03, "heading_bias": np.radians(5.0), "heading_noise": np.radians(2.0)}


class Run(NamedTuple):
    """Largest error at the end and smallest true gap, units; counts; s on the substrate and s of planning (CPU); why it failed."""

    error: float
    gap: float
    activations: int
    plans: int
    retimings: int
    seconds: float
    planning: float
    reason: str


def solver(time_limit: float):
    """Return a `Solver` that plans in this process."""

    def solve(wanted: Wanted) -> Rest:
        settings = Settings(
            time_limit=wanted.effort * time_limit,
            first=wanted.nearly is not None,
            warm_start=wanted.nearly,
            max_epochs=wanted.max_epochs,
            seed=wanted.seed,
            clock=time.process_time,
        )
        result = planners.solve(wanted.problem, "optimize", settings)
        if not result.success:
            raise StressbotError(result.code, "planner", result.reason)
        return np.array(result.plan.groups), np.array(result.plan.lengths)

    return solve


def opened(text: str, seed: int, time_limit: float, **more) -> Run:
    """Drive one scenario in open loop: one plan, to its end, whatever happens."""
    bench = SimulatedBench(text, seed=seed, **(IMPERFECTIONS | more))
    problem = bench.scenario.problem
    groups, lengths = solver(time_limit)(Wanted(problem, None, 1, None, seed))
    for group, length in zip(groups.tolist(), lengths.tolist(), strict=True):
        bench.execute(group, length)
    error = np.hypot(*(bench.true_poses()[:, :2] - problem.goals).T).max()
    return Run(float(error), float(bench.gap), len(groups), 1, 0, bench.time, 0.0, "")


def closed(text: str, seed: int, time_limit: float, **more) -> Run:
    """Drive one scenario in closed loop."""
    bench = SimulatedBench(text, seed=seed, **(IMPERFECTIONS | more))
    problem = bench.scenario.problem
    loop = ClosedLoop(
        bench.scenario.swarm, problem.environment, problem.goals, TOLERANCE, bench.measure(), solver(time_limit)
    )
    activations, planning, reason = 0, 0.0, ""
    while bench.time < LONGEST:
        spent = time.process_time()
        decision = loop.decide()
        planning += time.process_time() - spent
        if decision.state is not State.DRIVE:
            reason = str(decision.error or "")
            break
        for group, length in zip(decision.groups.tolist(), decision.lengths.tolist(), strict=True):
            loop.observe(group, length, bench.execute(group, length))
            activations += 1
    error = np.hypot(*(bench.true_poses()[:, :2] - problem.goals).T)[loop.moving].max()
    return Run(float(error), float(bench.gap), activations, loop.plans, loop.retimings, bench.time, planning, reason)


class Case(NamedTuple):
    """A scenario, how many runs, and s of planning for one attempt."""

    text: str
    runs: int
    time_limit: float
    more: dict


def cases(full: bool) -> dict[str, Case]:
    """Return what is measured, with as many runs as the targets name if it shall be full."""
    six = instances.paper(True)
    return {
        "paper's six, two discs": Case(six, 100 if full else 10, 0.4, {}),
        "paper's six, robot 4 stuck": Case(six, 10 if full else 2, 0.4, {"always_turn": [4]}),
        "14 in a corridor": Case(corridor(), 20 if full else 2, 2.0, {}),
    }


def tables(jobs: int, full: bool) -> list[Table]:
    """Return one table, for each case a row of open and one of closed loop."""
    rows = []
    for name, case in cases(full).items():
        for way, run in (("open loop", opened), ("closed loop", closed)):
            with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
                calls = [delayed(run)(case.text, seed, case.time_limit, **case.more) for seed in range(case.runs)]
                runs = Parallel()(calls)
            rows.append(_row(name, way, runs))
    header = (
        "robots", "", "at their goals, no touch", "within 0.3", "no touch", "largest error: median (max)", "smallest gap",
        "activations", "plans", "corrections", "on the substrate (s)", "planning (s, CPU)",
    )
    note = (
        "- Speed error sigma = 3 %, heading bias 5 deg, white heading noise 2 deg per activation. Errors and gaps of the true "
        "poses, gaps exact along the way, in units; medians. A stuck robot is an obstacle and has no goal."
    )
    return [Table("Closed loop", header, tuple(rows), note)]


def _row(name: str, way: str, runs: list[Run]) -> tuple[str, ...]:
    there, apart = [run.error <= TOLERANCE for run in runs], [run.gap >= 0 for run in runs]
    both = sum(a and b for a, b in zip(there, apart, strict=True))
    median = {field: np.median([getattr(run, field) for run in runs]) for field in Run._fields if field != "reason"}
    return (
        name, way, f"{both}/{len(runs)}", str(sum(there)), str(sum(apart)),
        f"{median['error']:.2f} ({max(run.error for run in runs):.2f})", f"{min(run.gap for run in runs):.3f}",
        f"{median['activations']:.0f}", f"{median['plans']:.0f}", f"{median['retimings']:.0f}", f"{median['seconds']:.0f}",
        f"{median['planning']:.1f}",
    )
