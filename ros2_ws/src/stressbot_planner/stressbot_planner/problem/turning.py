"""What robots have to turn at least: more rows for the linear program of the lower bounds.

A robot whose heading goes from 0 to R [rad], its start at 0, ends within the cone of these headings. So, for a goal in direction
delta in (0, 2 pi),

    R >= min(delta, pi),

and between pi and delta it gets there by its first and its last heading at best, which is a detour:

    slide >= distance (cos delta + sin delta tan(R / 2)),

convex and decreasing in R, so that tangents bound it from below. A goal heading says what R is but for whole turns.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.model.swarm import Swarm

TANGENTS = 16
"""To the detour of a robot."""

STEEPEST = 0.05
"""rad from half a turn, within which there is none: it would be too steep for the solver."""


class Rows(NamedTuple):
    """matrix (k, m) times total lengths of groups (m,) is at least need (k,); numbers, of sizes around 1 where lengths are."""

    matrix: np.ndarray
    need: np.ndarray


def turning_rows(
    swarm: Swarm, starts: np.ndarray, goals: np.ndarray, tolerance: float, goal_headings: np.ndarray, heading_tolerance: float
) -> Rows:
    """Return what holds for every plan.

    Args:
        swarm: of n robots in m groups.
        starts: shape (n, 3).
        goals: shape (n, 2), or NaN where a robot has no goal of its own.
        tolerance: of goals, units.
        goal_headings: shape (n,), rad, NaN where they are free.
        heading_tolerance: rad.
    """
    slides, turns = swarm.slides.T, ~swarm.membership.T / swarm.turning_length[:, None]
    ways = np.asarray(goals) - np.asarray(starts)[:, :2]
    rows: list[np.ndarray] = []
    needs: list[float] = []
    for j, distance in enumerate(np.hypot(*ways.T).tolist()):
        least = 0.0
        if distance > tolerance:
            beside = np.arcsin(tolerance / distance)
            direction = (np.arctan2(ways[j, 1], ways[j, 0]) - starts[j, 2]) % (2 * np.pi)
            if beside < direction < 2 * np.pi - beside:
                least = min(direction - beside, np.pi)
                for slope, need in _detours(direction - beside, direction + beside):
                    rows.append(slides[j] / (distance - tolerance) + slope * turns[j])
                    needs.append(need)
        if not np.isnan(goal_headings[j]):
            turn = (goal_headings[j] - starts[j, 2] + heading_tolerance) % (2 * np.pi)
            whole = np.ceil((least - turn) / (2 * np.pi))
            least = max(least, turn - 2 * heading_tolerance + 2 * np.pi * max(whole, 0.0))
        if least > 0:
            rows.append(turns[j])
            needs.append(least)
    return Rows(np.array(rows).reshape(-1, swarm.m), np.array(needs))


def _detours(first: float, last: float) -> list[tuple[float, float]]:
    """Return slopes and needs: slide / distance + slope R >= need, for a goal in a direction between two, rad."""
    steep, flat = min(-np.sin(first), -np.sin(last)), min(np.cos(first), np.cos(last))
    if steep <= 0:
        return []
    turned = np.linspace(np.pi, first, TANGENTS + 1)
    turned = turned[turned >= np.pi + STEEPEST]
    slopes = 0.5 * steep / np.cos(0.5 * turned) ** 2
    return list(zip(slopes, flat - steep * np.tan(0.5 * turned) + slopes * turned, strict=True))
