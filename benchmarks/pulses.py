"""Plans of whole pulses, driven from volts alone: how many steps robots end from their goals, and from where the plan says."""

from typing import NamedTuple

import numpy as np
import witness
from joblib import Parallel, delayed

from stressbot_planner import planners
from stressbot_planner.formats import scenario
from stressbot_planner.reproduce import instances
from stressbot_planner.reproduce.tables import Table
from stressbot_planner.sequencing import encode

MOST_STEPS, MEDIAN_STEPS, AGREEMENT = 5.0, 2.0, 1e-9
TRIES = 50


class Ended(NamedTuple):
    """Steps of each robot from its goal, largest distance from the plan's end in units, pulses in all."""

    steps: np.ndarray
    error: float
    pulses: float


def run(n: int, discs: bool, seed: int) -> Ended | None:
    """Plan for n robots at random and drive the plan; None: no plan within so many tries."""
    text = instances.pulsed(instances.random(n, discs, seed))
    loaded = scenario.parse(text)
    step = loaded.electrical.pulse_length(loaded.swarm.speed)
    settings = planners.Settings(max_tries=TRIES, first=True, seed=seed, pulse_length=step)
    plan = planners.solve(loaded.problem, "optimize", settings).plan
    if plan is None or not plan.valid:
        return None
    program = encode(loaded.swarm, loaded.electrical, plan.groups, plan.lengths)
    places = witness.driven(text, program) / loaded.length_unit
    steps = np.hypot(*(places - plan.problem.goals).T) / step
    return Ended(steps, float(np.abs(places - plan.poses[-1, :, :2]).max()), float(program.pulses.sum()))


def tables(full: bool) -> list[Table]:
    """Return one table: six and fourteen robots at random, with and without discs."""
    rows = []
    for n, discs in ((6, False), (6, True), (14, False), (14, True)):
        seeds = range(100 if full else 10)
        found = [ended for ended in Parallel()(delayed(run)(n, discs, seed) for seed in seeds) if ended]
        medians = [float(np.median(ended.steps)) for ended in found]
        largest = max(float(ended.steps.max()) for ended in found)
        error = max(ended.error for ended in found)
        rows.append(
            (
                f"{n}, {'discs' if discs else 'open plane'}", f"{len(found)}/{len(seeds)}",
                f"{np.median([ended.pulses for ended in found]):.3g}",
                f"{error:.1e}, {'same' if error <= AGREEMENT else 'DIFFERS'}",
                f"{largest:.2f}", f"{sum(ended.steps.max() <= MOST_STEPS for ended in found)}/{len(found)}",
                f"{np.median(medians):.2f} ({max(medians):.2f})", f"{sum(m <= MEDIAN_STEPS for m in medians)}/{len(found)}",
            )
        )
    header = (
        "robots", "plans", "pulses", "from the plan's end (units)", "steps from the goal: largest", f"at most {MOST_STEPS:g}",
        "median (largest)", f"at most {MEDIAN_STEPS:g}",
    )
    note = (
        f"- Steps of 12 nm at 8333 Hz. First plan within {TRIES} tries. Volts alone reach the simulated robots; "
        f"they must end within {AGREEMENT:g} units of the plan's end."
    )
    return [Table("Plans of whole pulses, from volts", header, tuple(rows), note)]
