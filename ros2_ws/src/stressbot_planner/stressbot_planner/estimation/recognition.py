"""Recognition: a motion after which a tracker that knows nobody knows everybody, safe whoever is where.

One group after the other slides a little, by d, while all others turn on the spot; then all make half a turn, and it slides back.
Nobody knows who slides. So a slide is only driven where no two bodies come closer than a share of d, whichever of them slide and
whichever do not, and none comes closer to a wall or an obstacle. Where there is no room for it, all turn first: that moves no body.
At the very first, all turn a little: what does not is no robot.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stressbot_planner.collision.clearance import Shapes, environment_gap, moving_points_gap
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.identification import FIRST_MARGIN, FIRST_TURNS
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.swarm import Swarm

SLIDES = (2.0, 1.6, 1.25, 1.0, 0.8, 0.65, 0.5)
"""Candidates for d, in radii of the largest body: a quarter of a length and more, which a tracker tells from a turn."""

MOST_ROUNDS = 6

FIRST_TURN, MOST_TURNS = np.pi / 4, 4
"""rad, and how often all turn so where there is no room, or a robot is missed."""


class Bodies(NamedTuple):
    """What a tracker sees at rest, units and rad.

    Attributes:
        known: poses of the robots, shape (n, 3), NaN for those that are not known.
        nameless: of what else looks like a robot, shape (k, 3), first who moves most like one.
    """

    known: np.ndarray
    nameless: np.ndarray


def recognise(
    swarm: Swarm, environment: Environment, look: Callable[[], Bodies], drive: Callable[[int, float], object]
) -> int:
    """Drive groups until a tracker knows all robots; return how many activations that took.

    Args:
        swarm: the robots.
        environment: walls and obstacles.
        look: returns what is seen at rest.
        drive: puts an activation on the substrate: group, length [units].

    Raises:
        StressbotError: NO_SWARM if fewer bodies than robots are seen, or some are never known; INFEASIBLE if there is no room; both
            after some turns of all. And what `look` and `drive` raise.
    """
    shapes, activations = Shapes.of(environment), 0
    half = np.pi * float(swarm.turning_radius.mean())
    unknown, poses = _robots(swarm, shapes, look())

    def go(group: int, length: float) -> None:
        nonlocal activations, unknown, poses
        if length and unknown:
            drive(group, length)
            activations += 1
            unknown, poses = _robots(swarm, shapes, look())

    def find_room() -> tuple[float, float]:
        for _ in range(MOST_TURNS):
            try:
                return room(swarm, shapes, poses)
            except StressbotError:  # dust may be in the way, or taken for a robot that is missed
                go(swarm.m, FIRST_TURN / np.pi * half)
        return room(swarm, shapes, poses)

    go(swarm.m, FIRST_TURN / np.pi * half)
    for _ in range(MOST_ROUNDS):
        for group in (np.flatnonzero(swarm.group_sizes[:-1]) + 1).tolist():
            if not unknown:
                return activations
            first, slide = find_room()
            for turn in (first, half):
                go(swarm.m, turn)
                go(group, min(slide, longest(swarm, shapes, poses)))
    if not unknown:
        return activations
    raise StressbotError(
        ErrorCode.NO_SWARM,
        "swarm_poses",
        f"do not show robots {', '.join(map(str, unknown))} after {2 * MOST_ROUNDS} slides of each group: are their arms stuck, or "
        "is another thing taken for a robot?",
    )


def _robots(swarm: Swarm, shapes: Shapes, seen: Bodies) -> tuple[list[int], np.ndarray]:
    """Return the numbers of robots that are not known, and the poses of all that are seen, at most n, in any order, shape (k, 3).

    What lies in walls or obstacles is no robot.
    """
    unknown, body = np.flatnonzero(np.isnan(seen.known[:, 0])), float(swarm.body_radius.max())
    free = [environment_gap(*pose[:2], 1.0, 0.0, 0.0, 0.5 * body, *shapes.kernel_arguments)[0] > 0.0 for pose in seen.nameless]
    nameless = seen.nameless[np.array(free, dtype=bool)]
    return (unknown + 1).tolist(), np.vstack([np.delete(seen.known, unknown, axis=0), nameless[: len(unknown)]])


def room(swarm: Swarm, shapes: Shapes, poses: np.ndarray) -> tuple[float, float]:
    """Return the lengths of a turn of all, 0 for none, and of the longest slide that whoever may drive after it.

    Poses have the shape (k, 3). Robots are taken to turn alike: look again after the turn. Raises StressbotError (NO_SWARM,
    INFEASIBLE).
    """
    if len(poses) < swarm.n:
        raise StressbotError(
            ErrorCode.NO_SWARM,
            "nameless_poses",
            f"and swarm_poses show {len(poses)} of {swarm.n} robots: bring all into the picture, nobody can keep clear of the "
            "others",
        )
    radius = float(swarm.turning_radius.mean())
    turns = np.arange(FIRST_TURNS) * (2 * np.pi / FIRST_TURNS)
    for slide in _slides(swarm):
        for turn in turns.tolist():
            if _is_clear(swarm, shapes, poses + (0.0, 0.0, turn), slide):
                return turn * radius, slide
    raise StressbotError(
        ErrorCode.INFEASIBLE,
        "nameless_poses",
        f"leave no room: even a slide of {_slides(swarm)[-1]:.3g} units may bring robots closer than {FIRST_MARGIN:g} of that "
        "to each other, a wall or an obstacle; move them apart",
    )


def longest(swarm: Swarm, shapes: Shapes, poses: np.ndarray) -> float:
    """Return the longest slide that whoever may drive now; 0: none, or not all robots are seen."""
    slides = _slides(swarm) if len(poses) == swarm.n else []
    return next((slide for slide in slides if _is_clear(swarm, shapes, poses, slide)), 0.0)


def _slides(swarm: Swarm) -> list[float]:
    return np.multiply(SLIDES, swarm.body_radius.max()).tolist()


def _is_clear(swarm: Swarm, shapes: Shapes, poses: np.ndarray, slide: float) -> bool:
    return least_gap(shapes, poses, slide, float(swarm.body_radius.max())) >= FIRST_MARGIN * slide


def least_gap(shapes: Shapes, poses: np.ndarray, slide: float, body: float) -> float:
    """Return the smallest gap of bodies at poses (k, 3) if any of them slide so far and the others stay where they are, units.

    Each slides at a constant rate: two that slide alike keep their difference in step, as `moving_points_gap` has it.
    """
    units = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    best = np.inf
    for i in range(len(poses)):
        best = min(best, environment_gap(*poses[i, :2], *units[i], slide, body, *shapes.kernel_arguments)[0])
        for j in range(i):
            for way in (units[i] - units[j], units[i], -units[j]):
                best = min(best, moving_points_gap(*(poses[i, :2] - poses[j, :2]), *way, slide)[0] - 2.0 * body)
    return float(best)

