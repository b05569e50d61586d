"""What calibration has found, as a scenario file that driver and planner read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stressbot_planner.estimation.calibration import Estimate, Fault, Interval
from stressbot_planner.formats.scenario import ASSIGN, PARKED, Scenario, text
from stressbot_planner.model.allocation import BY_LEVEL
from stressbot_planner.model.electrical import Electrical
from stressbot_planner.model.environment import Circle, standing
from stressbot_planner.system import files

DIGITS = 6
"""Significant digits of measured values; intervals are far wider."""

IMMOBILE = (Fault.ALWAYS_TURNS, Fault.STANDS_STILL)


def calibrated(scenario: Scenario, estimates: Sequence[Estimate], places: np.ndarray, confidence: float) -> dict[str, Any]:
    """Return the content of a scenario file with robots as they were found to be.

    Args:
        scenario: as it is described.
        estimates: one for each robot. Where nothing was seen the description stays.
        places: of the robots, shape (n, 2), units. Those that never slide become discs there, and are no robots any more; one
            goal goes with each, that of its row.
        confidence: of the intervals.
    """
    swarm, problem = scenario.swarm, scenario.problem
    moving = [found for found in estimates if found.fault not in IMMOBILE]
    rows = [found.robot - 1 for found in moving]
    speeds = swarm.speed * swarm.pace
    stuck = [found.robot - 1 for found in estimates if found.fault in IMMOBILE]
    immobile = standing(places[stuck], swarm.body_radius[stuck], swarm.body_radius[rows])
    obstacles = [_obstacle(item) for item in (*problem.environment.obstacles, *immobile)]
    content: dict[str, Any] = {"name": scenario.name, "length_unit": scenario.length_unit}
    if (walls := problem.environment.workspace) is not None:
        content["workspace"] = {"x": [walls.x_min, walls.x_max], "y": [walls.y_min, walls.y_max]}
    if obstacles:
        content["obstacles"] = obstacles
    content["swarm"] = {
        "speed": [_measured(found.speed, speeds[found.robot - 1]) for found in moving],
        "turning_radius": [_measured(found.turning_radius, swarm.turning_radius[found.robot - 1]) for found in moving],
        "body_radius": swarm.body_radius[rows].tolist(),
        "groups": _groups(scenario.electrical, moving),
    }
    exchanged = [j for j in rows if j in problem.exchangeable]
    poses = np.column_stack([problem.goals, problem.goal_headings]).tolist()
    words = dict.fromkeys(problem.parked, PARKED) | dict.fromkeys(exchanged, ASSIGN)
    goals = [words.get(j) or (poses[j] if j in problem.headed else poses[j][:2]) for j in rows]
    content["robots"] = [{"start": problem.starts[j].tolist(), "goal": goal} for j, goal in zip(rows, goals, strict=True)]
    if kept := [pair for pair in problem.contacts if set(pair) <= set(rows)]:
        content["contacts"] = [[rows.index(row) + 1 for row in pair] for pair in kept]
    if len(problem.waypoints):
        for j, robot in zip(rows, content["robots"], strict=True):
            if robot["goal"] != PARKED:
                robot["waypoints"] = problem.waypoints[:, j].tolist()
    if exchanged:
        content["goals"] = problem.goals[exchanged].tolist()
    content["electrical"] = _electrical(scenario.electrical, rows)
    numbers = {j: number for number, j in enumerate(rows, start=1)}
    entries = [_found(found, numbers.get(found.robot - 1)) for found in estimates]
    content["calibration"] = {"confidence": confidence, "robots": entries}
    return content


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a scenario file.

    Raises:
        StressbotError: UNREADABLE_FILE if it cannot be written.
    """
    files.write_text(path, text(content))


def _measured(found: Interval | None, described: float) -> float:
    return float(described) if found is None else _rounded(found.value)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _found(found: Estimate, now: int | None) -> dict[str, Any]:
    data: dict[str, Any] = {"robot": found.robot} | ({} if now is None else {"now": now})
    for name in ("speed", "turning_radius", "heading_bias"):
        interval = getattr(found, name)
        if interval is not None and np.isfinite(interval.half_width):
            data[name] = [_rounded(interval.value), _rounded(interval.half_width)]
    data["selections"], data["missed"] = int(found.trials.sum()), found.missed
    if found.fault:
        data["fault"] = str(found.fault)
    return data


def _obstacle(obstacle) -> dict[str, Any]:
    if isinstance(obstacle, Circle):
        return {"circle": {"center": obstacle.center.tolist(), "radius": float(obstacle.radius)}}
    return {"polygon": obstacle.vertices.tolist()}


def _groups(electrical: Electrical, moving: Sequence[Estimate]) -> str | list[str]:
    if electrical.pull_downs and not any(found.fault is Fault.OTHER_GROUPS for found in moving):
        return BY_LEVEL
    return [found.codeword for found in moving]


def _electrical(electrical: Electrical, rows: Sequence[int]) -> dict[str, Any]:
    values = dict(vars(electrical))
    values["codes"] = [list(code) for code in electrical.codes]
    pull_downs = values.pop("pull_downs")
    if pull_downs:
        values["pull_down"] = [pull_downs[row] for row in rows]
        del values["symbol_levels"], values["codes"]
    values["drive"] = "constant"
    if electrical.drive is not None:  # with the frequency at which the speeds were measured: steps follow from both
        values["drive"] = dict(vars(electrical.drive))
        values["drive"]["polarity"] = "alternating" if values["drive"].pop("alternating") else "unipolar"
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
