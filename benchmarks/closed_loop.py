"""Whether imperfect robots reach their goals without a touch, in closed loop and in open loop: whole runs through volts."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from calibration import corridor as row
from joblib import Parallel, delayed
from simulated_bench import SimulatedBench

from stressbot_planner import planners
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.execution.closed_loop import ClosedLoop, PlanRequest, Remainder, State
from stressbot_planner.planners import Settings
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table

TOLERANCE = 0.3
LONGEST = 2000.0
"""s on the substrate, after which a run is given up."""

PLANNING_TIME = 0.5
"""s of processor time, of one attempt at a new plan."""

EFFORTS = (1, 8, 32)
"""How many times as long a plan for an open loop is looked for, one after the other."""

FIRST_SEED = 1000
"""Seeds below were driven while the loop was made."""

UNEVEN = {"missed_steps": 0.01, "step_spread": 0.03}

IMPERFECTIONS = {"speed_error": 0.03, "heading_bias": np.radians(5.0), "heading_noise": np.radians(2.0)}


class Run(NamedTuple):
    """Largest error at the end and smallest true gap, units; counts; s on the substrate and s of planning (CPU); why it failed."""

    error: float
    gap: float
    decisions: int
    activations: int
    plans: int
    retimings: int
    seconds: float
    planning: float
    reason: str


def solver(time_limit: float):
    """Return a `Solver` that plans in this process."""

    def solve(wanted: PlanRequest) -> Remainder:
        settings = Settings(
            time_limit=wanted.effort * time_limit,
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
    """Drive one scenario in open loop: one plan, to its end, whatever happens; nothing is driven if none is found."""
    bench = SimulatedBench(text, seed=seed, **(IMPERFECTIONS | more))
    problem = bench.scenario.problem
    for effort in EFFORTS:
        try:
            groups, lengths = solver(time_limit)(PlanRequest(problem, effort, None, seed))
            break
        except StressbotError as error:
            if error.code is not ErrorCode.NO_PLAN_FOUND:
                raise
            reason = str(error)
    else:
        error = np.hypot(*(problem.starts[:, :2] - problem.goals).T).max()
        return Run(float(error), np.inf, 0, 0, len(EFFORTS), 0, 0.0, 0.0, reason)
    for group, length in zip(groups.tolist(), lengths.tolist(), strict=True):
        bench.execute(group, length)
    error = np.hypot(*(bench.true_poses()[:, :2] - problem.goals).T).max()
    return Run(float(error), float(bench.gap), 1, len(groups), 1, 0, bench.time, 0.0, "")


def closed(text: str, seed: int, time_limit: float, **more) -> Run:
    """Drive one scenario in closed loop."""
    bench = SimulatedBench(text, seed=seed, **(IMPERFECTIONS | more))
    return brought(bench, bench.measure(), time_limit, LONGEST)


def brought(bench: SimulatedBench, measured: np.ndarray, time_limit: float, longest: float) -> Run:
    """Bring robots that were measured at poses (n, 3), units, to their goals in closed loop, for so many s on the substrate."""
    problem = bench.scenario.problem
    loop = ClosedLoop(bench.scenario.swarm, problem.environment, problem.goals, TOLERANCE, measured, solver(time_limit))
    decisions, activations, planning, reason = 0, 0, 0.0, ""
    while bench.time < longest:
        spent = time.process_time()
        decision = loop.decide()
        planning += time.process_time() - spent
        if decision.state is not State.DRIVE:
            reason = str(decision.error or "")
            break
        decisions += 1
        for group, length in zip(decision.groups.tolist(), decision.lengths.tolist(), strict=True):
            loop.observe(group, length, bench.execute(group, length))
            activations += 1
    error = np.hypot(*(bench.true_poses()[:, :2] - problem.goals).T)[loop.moving].max()
    gap = float(bench.gap)
    return Run(float(error), gap, decisions, activations, loop.plans, loop.retimings, bench.time, planning, reason)


class Case(NamedTuple):
    """The scenario for a seed, and how many runs."""

    text: Callable[[int], str]
    runs: int
    more: dict


def cases(full: bool) -> dict[str, Case]:
    """Return what is measured, with as many runs as the targets name if it shall be full."""
    return {
        "paper's six, two discs": Case(_six, 100 if full else 10, {}),
        "paper's six, robot 4 stuck": Case(_six, 10 if full else 2, {"always_turn": [4]}),
        "14 across a band of 7 discs": Case(instances.band, 100 if full else 4, {}),
        "14 through a row of 7 discs": Case(_row_of_discs, 20 if full else 1, {}),
        "paper's six, two discs, pulses": Case(_pulsed(_six), 100 if full else 10, UNEVEN),
        "14 across a band of 7 discs, pulses": Case(_pulsed(instances.band), 100 if full else 4, UNEVEN),
    }


def _six(seed: int) -> str:
    return instances.paper(True)


def _pulsed(text: Callable[[int], str]) -> Callable[[int], str]:
    return lambda seed: instances.pulsed(text(seed))


def _row_of_discs(seed: int) -> str:
    return row()


def tables(full: bool) -> list[Table]:
    """Return one table, for each case a row of open and one of closed loop."""
    rows = []
    for name, case in cases(full).items():
        for way, run in (("open loop", opened), ("closed loop", closed)):
            seeds = range(FIRST_SEED, FIRST_SEED + case.runs)
            runs = Parallel()(delayed(run)(case.text(seed), seed, PLANNING_TIME, **case.more) for seed in seeds)
            rows.append(_row(name, way, runs))
    header = (
        "robots", "", "at their goals, no touch", "within 0.3", "no touch", "largest error: median (max)", "smallest gap",
        "activations", "plans", "corrections", "on the substrate (s)", "planning (s, CPU)",
    )
    note = (
        "- Speed error sigma = 3 %, heading bias 5 deg, white heading noise 2 deg per activation. Pulses: "
        "1 % of all steps missed, spread 3 %. Errors and gaps of the true "
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
