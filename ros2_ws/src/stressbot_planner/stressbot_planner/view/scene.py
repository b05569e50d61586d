"""What a page shows, as plain data: lengths in µm, times in s, angles in rad. `page/model.js` is its reader.

A swarm is told once, with all that its motion follows from: of a plan only groups and lengths are sent, and the page computes poses
and volts in closed form, as `model.kinematics` and `sequencing` do.
"""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from stressbot_planner.formats.plan_file import StoredPlan
from stressbot_planner.formats.scenario import Scenario
from stressbot_planner.model.electrical import Electrical
from stressbot_planner.model.environment import Circle, Environment
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.reporting import icons
from stressbot_planner.reporting.palette import COLOURS
from stressbot_planner.sequencing import VoltageProgram, decode, encode

MICRO = 1e6
"""µm per m"""

PLACE, ANGLE, LENGTH = 2, 4, 5
"""Decimals of places (µm), headings (rad) and lengths of activations (µm): thousands of these add up."""


def scene(
    name: str,
    unit: float,
    swarm: Swarm,
    environment: Environment,
    electrical: Electrical,
    starts: np.ndarray,
    goals: np.ndarray,
    headings: np.ndarray,
    waypoints: np.ndarray,
    parked: Collection[int],
    contacts: Collection[tuple[int, int]],
    ids: Sequence[int] | None = None,
    calibrated: Sequence[bool] | None = None,
) -> dict[str, Any]:
    """Return a swarm on its substrate.

    Args:
        name: of the scenario.
        unit: m per scenario unit; all other lengths are in these units.
        swarm: the robots.
        environment: walls and obstacles.
        electrical: how the swarm reads volts.
        starts: poses, shape (n, 3).
        goals: places, shape (n, 2).
        headings: at the goals, shape (n,), rad, NaN where they are free.
        waypoints: of the stages before, shape (s, n, 2).
        parked: rows of robots that stay where they are.
        contacts: pairs of rows of robots that may touch.
        ids: of the robots; 1 to n if None.
        calibrated: which of them a calibration has measured; none if None.
    """
    scale = unit * MICRO
    walls = environment.workspace
    names = range(1, swarm.n + 1) if ids is None else ids
    known = [False] * swarm.n if calibrated is None else calibrated
    return {
        "name": name,
        "speed": scale * swarm.speed,
        "robots": [
            {
                "id": int(names[k]),
                "word": swarm.codewords[k],
                "pace": float(swarm.pace[k]),
                "turning": round(scale * float(swarm.turning_radius[k]), LENGTH),
                "body": round(scale * float(swarm.body_radius[k]), PLACE),
                "calibrated": bool(known[k]),
                "goalHeading": None if np.isnan(headings[k]) else round(float(headings[k]), ANGLE),
                "waypoints": places(waypoints[:, k], scale),
                "parked": k in parked,
            }
            for k in range(swarm.n)
        ],
        "starts": poses(starts, scale),
        "goals": places(goals, scale),
        "contacts": [list(pair) for pair in contacts],
        "walls": None if walls is None else places(np.array([[walls.x_min, walls.x_max], [walls.y_min, walls.y_max]]), scale),
        "obstacles": [
            {"circle": [*places(item.center, scale), round(scale * item.radius, PLACE)]}
            if isinstance(item, Circle)
            else {"polygon": places(item.vertices, scale)}
            for item in environment.obstacles
        ],
        "volts": _volts(electrical),
        "colours": list(COLOURS),
        "outline": icons.outline().tolist(),
        "icons": [round(scale * float(length), PLACE) for length in _icons(swarm, unit)],
    }


def _icons(swarm: Swarm, unit: float) -> np.ndarray:
    """Return how long robots are, shape (n,), units: in a picture so small that no icon is made smaller."""
    largest = max(icons.LENGTH / unit, 2 * float(swarm.girth.max()))
    return icons.size(swarm.girth, unit, largest / icons.LARGEST).lengths


def _volts(electrical: Electrical) -> dict[str, Any]:
    drive = electrical.drive
    return {
        "rest": electrical.rest_level,
        "symbols": list(electrical.symbol_levels),
        "reset": electrical.reset_level,
        "drive": electrical.drive_level,
        "pullDown": electrical.pull_down,
        "byLevel": bool(electrical.pull_downs),
        "resetDwell": electrical.reset_dwell,
        "symbolDwell": electrical.symbol_dwell,
        "guardDwell": electrical.guard_dwell,
        "codes": [list(code) for code in electrical.codes],
        "pulses": None if drive is None else {
            "low": drive.low_level, "frequency": drive.frequency, "duty": drive.duty, "alternating": drive.alternating,
        },
    }


def motion(
    scale: float,
    starts: np.ndarray,
    goals: np.ndarray,
    groups: np.ndarray,
    lengths: np.ndarray,
    signs: np.ndarray | None = None,
    **told: Any,
) -> dict[str, Any]:
    """Return a motion: activations of groups (K,), 1..m, of lengths (K,), units; those of no length have no epoch.

    Args:
        scale: µm per unit.
        starts: poses that it begins from, shape (n, 3), units and rad.
        goals: places, shape (n, 2), units.
        groups, lengths: the activations.
        signs: of each epoch's volts, shape (K,), where pulses alternate.
        told: figures that are passed on, in the units of the page.
    """
    moves = np.asarray(lengths) > 0
    data = {
        "starts": poses(starts, scale),
        "goals": places(goals, scale),
        "groups": np.asarray(groups)[moves].tolist(),
        "lengths": np.round(scale * np.asarray(lengths)[moves], LENGTH).tolist(),
        **told,
    }
    if signs is not None:
        data["signs"] = np.asarray(signs)[moves].astype(int).tolist()
    return data


def signs_of(program: VoltageProgram) -> np.ndarray | None:
    """Return the sign of each epoch's volts, shape (E,), where pulses alternate; else None."""
    if not program.alternating:
        return None
    begins = np.append(0, program.epoch_ends)[: program.epoch_count]
    return np.sign(program.levels[begins.astype(int)])


def places(xy: np.ndarray, scale: float) -> list:
    """Return places (…, 2), units, as lists, µm."""
    return np.round(scale * np.asarray(xy, dtype=float), PLACE).tolist()


def poses(rows: np.ndarray, scale: float) -> list[list[float]]:
    """Return poses (n, 3), units and rad, as lists."""
    rows = np.asarray(rows, dtype=float)
    return np.column_stack([np.round(scale * rows[:, :2], PLACE), np.round(rows[:, 2], ANGLE)]).tolist()


def of_scenario(loaded: Scenario, goals: np.ndarray | None = None) -> dict[str, Any]:
    """Return the scene of a scenario file, with other goals (n, 2), units, if they are given."""
    problem = loaded.problem
    places_ = problem.goals if goals is None else goals
    return scene(
        loaded.name, loaded.length_unit, loaded.swarm, problem.environment, loaded.electrical, problem.starts, places_,
        np.broadcast_to(problem.goal_headings, loaded.swarm.n), problem.waypoints, problem.parked, problem.contacts,
    )


def of_plan(loaded: Scenario, stored: StoredPlan) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return scene and motion of a plan file."""
    plan, scale = stored.plan, MICRO * loaded.length_unit
    groups, lengths, signs = plan.groups, plan.lengths, None
    drive = loaded.electrical.drive
    if drive is not None:  # half a step and less is no pulse, and has no epoch
        program = encode(loaded.swarm, loaded.electrical, groups, lengths)
        groups, lengths = decode(loaded.swarm, loaded.electrical, program)
        signs = signs_of(program)
    gap = plan.clearance.gap
    told = {
        "planner": stored.planner,
        "solved": stored.success,
        "path": round(scale * plan.path_length, PLACE),
        "clearance": round(scale * gap, PLACE) if np.isfinite(gap) else None,
        "bounds": [round(scale * plan.problem.lower_bounds.path_length, PLACE), plan.problem.lower_bounds.execution_time],
    }
    shown = motion(scale, plan.problem.starts, plan.problem.goals, groups, lengths, signs, **told)
    return of_scenario(loaded, plan.problem.goals), shown
