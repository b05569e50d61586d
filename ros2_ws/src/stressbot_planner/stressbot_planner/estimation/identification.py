"""Excitation: a motion from which robots can be told apart and measured, short and clear of each other.

It has three kinds of stages, each planned from the poses measured after the one before and from what is known by then:

    1. everybody turns a little, twice: nobody may slide
    2. everybody turns, several times, on the spot: turning rates
    3. one group slides by d, all turn by half a turn, it slides back, all turn again; the same with the next group

Stages of the third kind go round until the intervals are narrow enough. Each is checked as any plan is: of several slides
d and first turns the longest d is taken whose gaps stay above a share of d, which is what unknown heading biases, speeds
and jumps of the heading may take away.
"""

from collections.abc import Callable

import numpy as np

from stressbot_planner.collision.clearance import Shapes, is_clear
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.estimation.calibration import Estimate, Fault, Record, estimate
from stressbot_planner.model.environment import Environment, standing
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm, fastest

SLIDES = (3.0, 2.5, 2.0, 1.6, 1.25, 1.0, 0.8, 0.63, 0.5, 0.4, 0.3)
"""Candidates for d, in mean turning radii."""

FIRST_TURNS = 12
"""Candidates for the turn that a stage begins with, over a full turn."""

MARGIN, FIRST_MARGIN = 0.3, 0.5
"""Least gap while a group slides, as a share of d; the second while the heading bias of a member is unknown.

Two robots that both head off by σ come closer by √2 σ d: 3 σ of them, for a bias of 5 degrees and jumps of 2.
"""

LEAST_ROUNDS, MOST_ROUNDS = 2, 12

CAUTIOUS = (np.pi / 4, 2)
ON_THE_SPOT = (2 * np.pi / 3, 6)
"""Turns of the first two stages: angle of each, and how many."""

Motion = tuple[np.ndarray, np.ndarray]
"""Groups (K,) and lengths (K,), units, of activations."""


def identify(
    swarm: Swarm,
    environment: Environment,
    measure: Callable[[], np.ndarray],
    drive: Callable[[Motion], list[Record]],
    precision: float,
) -> tuple[tuple[Estimate, ...], list[Record]]:
    """Drive the whole identification and return the estimates with the records that they were made from.

    Args:
        swarm: as it is described.
        environment: walls and obstacles.
        measure: returns the poses now, shape (n, 3), units and rad; NaN for a robot that cannot be seen.
        drive: puts activations on the substrate and returns one record each.
        precision: rounds go on until all speeds and turning radii are known so well: half of the interval over the value.

    Raises:
        StressbotError: UNSUPPORTED if a robot always slides, INFEASIBLE if no group has room to slide; and what
            `measure` and `drive` raise. NO_SWARM if a robot has got lost on the way.
    """
    records: list[Record] = []
    for angle, count in (CAUTIOUS, ON_THE_SPOT):
        records += drive(turn_on_the_spot(swarm, angle, count))
        estimates = estimate(swarm, records)
        for found in estimates:
            if found.fault is Fault.ALWAYS_SLIDES:
                raise StressbotError(
                    ErrorCode.UNSUPPORTED,
                    f"robot {found.robot}",
                    "slides while all should turn: its arm is stuck, take it off the substrate and start the driver without it",
                )
    for turn in range(MOST_ROUNDS):
        moved = False
        for group in (np.flatnonzero(swarm.group_sizes) + 1).tolist():
            known, places, poses = _as_known(swarm, environment, measure(), estimates)
            motion = design_stage(known, places, poses, group, _margin(swarm, group, estimates))
            if motion is not None:
                moved = True
                groups, lengths = motion
                records += drive((groups, lengths * swarm.speed / known.speed))
                estimates = estimate(swarm, records)
        if not moved and not turn:
            raise StressbotError(
                ErrorCode.INFEASIBLE,
                "swarm_poses",
                f"leave no room: even a slide of {SLIDES[-1] * swarm.turning_radius.mean():.3g} units brings robots closer than "
                f"{FIRST_MARGIN:g} of that to each other, a wall or an obstacle; move them apart",
            )
        if turn + 1 >= LEAST_ROUNDS and (not moved or all(_is_precise(found, precision) for found in estimates)):
            break
    return estimates, records


def turn_on_the_spot(swarm: Swarm, angle: float, count: int) -> Motion:
    """Return activations of the all-rotate group, each by an angle (rad) at the mean turning radius."""
    return np.full(count, swarm.m), np.full(count, angle * swarm.turning_radius.mean())


def design_stage(swarm: Swarm, environment: Environment, poses: np.ndarray, group: int, margin: float) -> Motion | None:
    """Return a first turn, and slide d, half a turn, slide d, half a turn of a group; None if no candidate is clear.

    Args:
        swarm: the robots.
        environment: walls and obstacles.
        poses: shape (n, 3).
        group: whose members slide.
        margin: least gap, as a share of d.
    """
    if not swarm.group_sizes[group - 1]:
        return None
    shapes, radius = Shapes.of(environment), float(swarm.turning_radius.mean())
    half = np.pi * radius
    for slide in np.multiply(SLIDES, radius):
        for first in np.arange(FIRST_TURNS) * (2 * half / FIRST_TURNS):
            groups = np.array([swarm.m, group, swarm.m, group, swarm.m])
            lengths = np.array([first, slide, half, slide, half])
            if is_clear(swarm, shapes, replay(swarm, poses, groups, lengths), groups, lengths, margin * slide):
                return groups[lengths > 0], lengths[lengths > 0]
    return None


def _margin(swarm: Swarm, group: int, estimates: tuple[Estimate, ...]) -> float:
    unknown = [found.heading_bias is None for found in estimates if swarm.membership[group - 1, found.robot - 1]]
    return FIRST_MARGIN if any(unknown) else MARGIN


def _is_precise(found: Estimate, precision: float) -> bool:
    """Whether more rounds would tell nothing new that is wanted."""
    if found.fault in (Fault.NOT_SEEN, Fault.ALWAYS_TURNS, Fault.STANDS_STILL):
        return True
    known = (found.speed, found.turning_radius)
    return all(entry is not None and entry.half_width <= precision * entry.value for entry in known)


def _as_known(
    swarm: Swarm, environment: Environment, poses: np.ndarray, estimates: tuple[Estimate, ...]
) -> tuple[Swarm, Environment, np.ndarray]:
    """Return swarm, environment and poses of the robots that move, by what is known so far.

    Robots slide and turn as measured and head where they slide. Those that never slide are obstacles at their places; a robot that
    has never been seen is left out, since nothing is known of where it is.
    """
    steady = np.isfinite(poses[:, 0])
    for found in estimates:
        if found.fault is not Fault.NOT_SEEN and not steady[found.robot - 1]:
            raise StressbotError(
                ErrorCode.NO_SWARM, "swarm_poses", f"do not show robot {found.robot} any more: bring it into the tracker's view"
            )
    poses, words, stuck = poses.copy(), list(swarm.codewords), np.zeros(swarm.n, dtype=bool)
    speed, radius = swarm.speed * swarm.pace, swarm.turning_radius.copy()
    for j, found in enumerate(estimates):
        if found.speed is not None:
            speed[j] = found.speed.value
        if found.turning_rate is not None:
            radius[j] = speed[j] / found.turning_rate.value
        if found.heading_bias is not None:
            poses[j, 2] += found.heading_bias.value
        if found.fault is Fault.OTHER_GROUPS:
            words[j] = found.codeword
        if found.fault in (Fault.ALWAYS_TURNS, Fault.STANDS_STILL) and steady[j] and _has_slid_nowhere(swarm, found):
            stuck[j], steady[j] = True, False
    rows = np.flatnonzero(steady)
    words = tuple(words[j] for j in rows)
    if not rows.size:
        raise StressbotError(ErrorCode.NO_SWARM, "swarm_poses", "show no robot that slides: is the tracker running?")
    u, pace = fastest(speed[rows])
    known = Swarm(u, radius[rows], swarm.body_radius[rows], words, pace)
    obstacles = standing(poses[stuck, :2], swarm.body_radius[stuck], known.body_radius)
    return known, Environment(environment.workspace, (*environment.obstacles, *obstacles)), poses[rows]


def _has_slid_nowhere(swarm: Swarm, found: Estimate) -> bool:
    """Whether the robot stood in the groups that it should slide in, which it has tried."""
    described = swarm.membership[:, found.robot - 1]
    return bool(found.trials[described].any()) and not found.slid[described].any()
