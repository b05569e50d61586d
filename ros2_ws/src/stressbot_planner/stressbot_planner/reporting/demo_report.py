"""What the demo reports: whether the robots are where they should be, figures and pictures."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stressbot_planner.formats.plan_file import plan_file, write_plan_file
from stressbot_planner.formats.scenario import Scenario
from stressbot_planner.model.angles import wrapped
from stressbot_planner.problem.plan import Solved
from stressbot_planner.sequencing import VoltageProgram
from stressbot_planner.system import files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AGREEMENT = 1e-6
"""Executed and predicted poses may differ by this, units and rad."""

EPOCHS_SHOWN = 4

RESULTS = ("summary.json", "plan.json", "paths.png", "voltage.png")


@dataclass(frozen=True, eq=False)
class Executed:
    """A plan and what came of it. Row k of the arrays is the robot with id ids[k].

    Attributes:
        scenario: that was run.
        result: of the planner.
        ids: robot ids, shape (n,).
        predicted: poses at the end by the plan, shape (n, 3), units and rad.
        recorded: measured poses, shape (T, n, 3), units and rad; the last ones are from after the end.
        program: the volts as they were on the wire, None if there was nothing to do.
        sequence_time: substrate time that they took, s.
        call_time: that the planning service took to answer, s.
        execution_wall_time: s.
    """

    scenario: Scenario
    result: Solved
    ids: np.ndarray
    predicted: np.ndarray
    recorded: np.ndarray
    program: VoltageProgram | None
    sequence_time: float
    call_time: float
    execution_wall_time: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether all went well.

    Attributes:
        goal_errors: distance of each robot from its goal at the end, units, shape (n,).
        prediction_errors: distance from the predicted position, units, shape (n,).
        heading_errors: from the predicted heading, rad, shape (n,).
        at_goal: whether each robot is at its goal, and looks where it should there, shape (n,).
        problems: what went wrong, one text each.
    """

    goal_errors: np.ndarray
    prediction_errors: np.ndarray
    heading_errors: np.ndarray
    at_goal: np.ndarray
    problems: tuple[str, ...]

    @property
    def success(self) -> bool:
        """Whether every robot is at its goal and nothing went wrong."""
        return bool(self.at_goal.all()) and not self.problems


def judge(executed: Executed, exit_codes: dict[str, int]) -> Verdict:
    """Compare the last poses with goals and prediction, and look at how the nodes ended."""
    problem, last = executed.result.plan.problem, executed.recorded[-1]
    goal_errors = np.hypot(*(last[:, :2] - problem.goals).T)
    prediction_errors = np.hypot(*(last[:, :2] - executed.predicted[:, :2]).T)
    turned = last[:, 2] - executed.predicted[:, 2]
    heading_errors = np.abs(np.arctan2(np.sin(turned), np.cos(turned)))
    problems = [f"the {name} node ended with code {code}" for name, code in exit_codes.items() if code]
    worst = float(max(prediction_errors.max(), heading_errors.max()))
    if not worst <= AGREEMENT:
        problems.append(f"poses differ from the plan by up to {worst:.2g}")
    at_goal = goal_errors <= problem.tolerance + AGREEMENT
    missed = np.abs(wrapped(last[:, 2] - problem.goal_headings))[problem.headed]
    at_goal[problem.headed] &= missed <= problem.heading_tolerance + AGREEMENT
    return Verdict(goal_errors, prediction_errors, heading_errors, at_goal, tuple(problems))


def write(folder: Path, executed: Executed, verdict: Verdict) -> None:
    """Write the files of `RESULTS`.

    Raises:
        StressbotError: UNREADABLE_FILE if one cannot be written.
    """
    from stressbot_planner.reporting.plotting import plot_plan, plot_voltages

    scenario, plan = executed.scenario, executed.result.plan
    files.write_text(folder / "summary.json", json.dumps(summary(executed, verdict), indent=1, allow_nan=False) + "\n")
    write_plan_file(folder / "plan.json", plan_file(executed.result, scenario.name, scenario.electrical.selection_time))
    title = (
        f"{scenario.name}, {executed.result.planner}: planned paths, executed poses as dots\n"
        f"path {plan.path_length:.2f}, {executed.sequence_time:.2f} s, "
        f"worst distance from the prediction {verdict.prediction_errors.max():.1g}"
    )
    _draw(folder / "paths.png", plot_plan(plan.problem, plan.poses, scenario.length_unit, title, executed.recorded))
    if executed.program is not None:
        electrical = scenario.electrical
        symbols = {level: str(symbol) for symbol, level in enumerate(electrical.symbol_levels)}
        symbols |= {electrical.reset_level: "reset", electrical.drive_level: "drive"}
        program = executed.program
        trains = program.pulses, program.low_levels, program.duty, program.alternating
        figure = plot_voltages(program.levels, program.dwells, program.epoch_ends, EPOCHS_SHOWN, symbols, *trains)
        _draw(folder / "voltage.png", figure)


def _draw(path: Path, figure: "Figure") -> None:
    with files.replacing(path) as stream:
        figure.savefig(stream, format="png")


def summary(executed: Executed, verdict: Verdict) -> dict[str, Any]:
    """Return the figures as plain data; lengths in scenario units."""
    result, plan = executed.result, executed.result.plan
    problem = plan.problem
    gap = plan.clearance.gap
    return {
        "scenario": executed.scenario.name,
        "success": verdict.success,
        "problems": list(verdict.problems),
        "robots_at_goal": int(verdict.at_goal.sum()),
        "robot_count": problem.swarm.n,
        "tolerance": problem.tolerance,
        "worst_goal_error": float(verdict.goal_errors.max()),
        "worst_prediction_error": float(verdict.prediction_errors.max()),
        "worst_heading_error": float(verdict.heading_errors.max()),
        "planner": result.planner,
        "seed": result.seed,
        "planning_time": result.planning_time,
        "service_overhead": executed.call_time - result.planning_time,
        "path_length": plan.path_length,
        "path_length_bound": problem.lower_bounds.path_length,
        "driving_time": plan.execution_time,
        "execution_time": executed.sequence_time,
        "execution_wall_time": executed.execution_wall_time,
        "epochs": 0 if executed.program is None else executed.program.epoch_count,
        "min_clearance": float(gap) if np.isfinite(gap) else None,
        "min_clearance_at": str(plan.clearance),
        "robots": [
            {
                "id": int(executed.ids[k]),
                "goal": problem.goals[k].tolist(),
                "predicted": executed.predicted[k].tolist(),
                "executed": executed.recorded[-1][k].tolist(),
                "goal_error": float(verdict.goal_errors[k]),
                "prediction_error": float(verdict.prediction_errors[k]),
            }
            for k in range(problem.swarm.n)
        ],
    }
