"""One robot alone, in any direction: the paper's proof of small-time local controllability (STLC) as a construction (section 4)."""

from math import cos, sin
from typing import NamedTuple

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import (
    TURN,
    Activate,
    Extract,
    Isolate,
    Primitive,
    TurnAll,
    check_finite,
    check_length,
    check_robot,
)

FORMS = ("halving", "recursion", "radii")

_STOPS = (2, 3, 5, 7, 11, 13)
"""Slides on which a robot of another turning radius goes once around a polygon and is back."""

_MOST_TURNS = 16
"""Whole turns between two slides, at most."""

_GOOD_SHARE, _LEAST_SHARE = 0.5, 1e-3
"""Of what a robot slides, how much should be left of it when others have been sent back, and how much must be."""


def isolate(
    swarm: Swarm, poses: np.ndarray, robot: int, direction: float, distance: float, form: str = "halving"
) -> tuple[Primitive, ...]:
    """Return primitives that move one robot by a distance in a direction of the plane and displace nobody else.

    All robots turn first, until the robot looks where it has to; then it moves alone, by one of the forms

    - `halving`: `primitives.Isolate`, at most 2^(m - 2) pulses; headings of its group are restored.
    - `recursion`: `primitives.Extract`, P_{k+1} = (P_k, Rot, P_k) of the paper, exponentially many pulses in the size of
      a group, but fewer in small swarms.
    - `radii`: for different turning radii, where h_i and Rot do not exist, see `_by_radii`.

    Of the robot's groups the one with the fewest pulses is taken; `pulses` of the two primitives counts them.

    Args:
        swarm: the robots.
        poses: where they are, shape (n, 3), units and rad.
        robot: id.
        direction: in the plane, rad.
        distance: units, >= 0.
        form: one of FORMS.

    Raises:
        StressbotError: unknown robot or form, a direction or distance that is not finite, a negative distance, or a form
            that these turning radii do not allow.
    """
    check_robot(swarm, robot)
    check_finite("direction", direction)
    check_length("distance", distance)
    heading = float(np.asarray(poses, dtype=float)[robot - 1, 2])
    groups = (np.flatnonzero(swarm.membership[:, robot - 1]) + 1).tolist()
    if form == "radii":
        return _by_radii(swarm, heading, robot, groups, direction, distance)
    alone: list[Isolate] | list[Extract]
    if form == "halving":
        alone = [Isolate(robot, distance, group) for group in groups]
    elif form == "recursion":
        alone = [Extract((robot,), group, distance) for group in groups]
    else:
        raise StressbotError(ErrorCode.UNSUPPORTED, "form", f"is '{form}': use one of {', '.join(FORMS)}")
    return TurnAll((direction - heading) % TURN), min(alone, key=lambda primitive: primitive.pulses(swarm))


class _Way(NamedTuple):
    """Slides (+) and turns of all (-) in turn, units; how far all have turned in it, and where a slide of 1 leads the robot."""

    steps: tuple[float, ...]
    turned: float
    gain: complex


def _by_radii(
    swarm: Swarm, heading: float, robot: int, groups: list[int], direction: float, distance: float
) -> tuple[Primitive, ...]:
    """Return f_i and f_m in turn, such that of the members of G_i only one robot does not come back.

    The paper's P_{k+1} = (P_k, f_m, P_k) sends a robot of radius r_l back by turning it by pi between two equal ways. That
    also sends back robots of radius r_l / 3, r_l / 5, …; three, five, … equal ways with a third, a fifth, … of a turn
    between them do not, so that no ratio of radii is an exception.
    """
    radius = swarm.turning_length
    members = {group: [int(j) for j in np.flatnonzero(swarm.membership[group - 1]) if j != robot - 1] for group in groups}
    usable = [group for group in groups if not np.any(radius[members[group]] == radius[robot - 1])]
    if not usable:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            "form",
            f"is 'radii', but in each of its groups robot {robot} has company of its own turning radius: give it a group in "
            "which its radius is unique, or use 'halving' where all radii are equal",
        )
    group = min(usable, key=lambda group: len(members[group]))
    own = float(radius[robot - 1])
    way = _Way((1.0,), 0.0, 1.0 + 0.0j)
    for other in members[group]:
        way = _sent_back(way, own, float(radius[other]))
    aim = (direction - heading - float(np.angle(way.gain))) % TURN
    scale = distance / (abs(way.gain) * float(swarm.pace[robot - 1]))
    return (
        Activate(swarm.m, aim * own),
        *(Activate(group, step * scale) if step > 0 else Activate(swarm.m, -step) for step in way.steps),
    )


def _sent_back(way: _Way, own: float, other: float) -> _Way:
    """Return the way repeated with turns between, so that a robot of radius `other` comes back and one of `own` does not."""
    best, best_share = None, 0.0
    for stops in _STOPS:
        for whole_turns in range(_MOST_TURNS):
            turn = other * ((TURN / stops - way.turned / other) % TURN + TURN * whole_turns)
            angle = (way.turned + turn) / own
            gain = sum((complex(cos(k * angle), sin(k * angle)) for k in range(stops)), 0j)
            if abs(gain) / stops > best_share:
                best_share = abs(gain) / stops
                best = _Way(
                    (way.steps + (-turn,)) * (stops - 1) + way.steps,
                    stops * way.turned + (stops - 1) * turn,
                    way.gain * gain,
                )
            if best is not None and best_share >= _GOOD_SHARE:
                return best
    if best is None or best_share < _LEAST_SHARE:
        raise StressbotError(
            ErrorCode.UNSUPPORTED, "swarm.turning_radius", f"{own:g} and {other:g} are too close to tell robots apart by them"
        )
    return best
