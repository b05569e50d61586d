"""Sets of equal radii: slides of one group with turns of all between, after which robots of some sets, or of all, are back.

A robot that slides d_k after all have been turned by tau_k, each by tau_k / c_j, ends displaced by sum d_k e^{i tau_k / c_j} along
its heading. Two equal ways with a turn between that is half a turn for robots of one turning length c send all of these back.
Repeated for every other turning length that leaves one set of robots alone; repeated for all it moves nobody, and turns those
that are not in the group: what h_i is where all radii are equal.
"""

from math import cos, sin
from typing import NamedTuple

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import MAX_ACTIVATIONS, TURN

_STOPS = (2, 3, 5, 7, 11, 13)
"""Slides on which a robot of another turning radius goes once around a polygon and is back."""

_MOST_TURNS, _FARTHEST = 16, 10**6
"""Whole turns between two slides, at most; and where radii are so close that those tell nobody apart."""

_GOOD_SHARE, _LEAST_SHARE = 0.5, 1e-3
"""Of what a robot slides, how much should be left of it when others have been sent back, and how much must be."""


class Way(NamedTuple):
    """Slides (+) and turns of all (-) in turn, units; how far all have turned in it, and where a slide of 1 leads the robot."""

    steps: tuple[float, ...]
    turned: float
    gain: complex

    @property
    def slides(self) -> int:
        """Number of slides, each of length 1."""
        return (len(self.steps) + 1) // 2


ONE_SLIDE = Way((1.0,), 0.0, 1.0 + 0.0j)


def set_of(swarm: Swarm, robot: int) -> np.ndarray:
    """Return which robots have the turning length of a robot (row), shape (n,): activations turn them all by one angle."""
    return swarm.turning_length == swarm.turning_length[robot]


def alone(swarm: Swarm, group: int, robot: int) -> Way:
    """Return the way after which of a group's members only those of one robot's (row) set are displaced.

    Raises:
        StressbotError: turning radii are too close to each other, or there are too many of them.
    """
    way, own = ONE_SLIDE, float(swarm.turning_length[robot])
    others = [length for length in _lengths(swarm, group) if length != own]
    for other in others:
        way = sent_back(way, own, other)
    return way


def closed(swarm: Swarm, group: int) -> Way:
    """Return the way after which all members of a group are back.

    Raises:
        StressbotError: there are too many turning radii.
    """
    way = ONE_SLIDE
    for length in _lengths(swarm, group):
        turn = (0.5 * TURN * length - way.turned) % (TURN * length)
        way = _checked(Way((*way.steps, -turn, *way.steps), 2 * way.turned + turn, 0j))
    return way


def sent_back(way: Way, own: float, other: float) -> Way:
    """Return the way repeated with turns between, so that a robot of radius `other` comes back and one of `own` does not.

    The paper's P_{k+1} = (P_k, f_m, P_k) sends a robot of radius r_l back by turning it by pi between two equal ways. That
    also sends back robots of radius r_l / 3, r_l / 5, …; three, five, … equal ways with a third, a fifth, … of a turn
    between them do not, so that no ratio of radii is an exception.

    Raises:
        StressbotError: they are too close to each other, or the way gets too long.
    """
    best, best_share = None, 0.0
    for stops in _STOPS:
        for whole_turns in range(_MOST_TURNS):
            repeated = _repeated(way, own, other, stops, whole_turns)
            if repeated is not None and (share := _share(way, repeated, stops)) > best_share:
                best, best_share = repeated, share
            if best is not None and best_share >= _GOOD_SHARE:
                return _checked(best)
    if best_share < _LEAST_SHARE:
        # nearly equal radii: as many whole turns as take the robot from nearly half a turn to a whole one
        drift = abs(other / own - round(other / own))
        turns = round(0.5 / drift) if drift else _FARTHEST + 1
        best = _repeated(way, own, other, 2, turns) if turns <= _FARTHEST else None
        best_share = _share(way, best, 2) if best is not None else 0.0
    if best is None or best_share < _LEAST_SHARE:
        raise StressbotError(
            ErrorCode.UNSUPPORTED, "swarm.turning_radius", f"{own:g} and {other:g} are too close to tell robots apart by them"
        )
    return _checked(best)


def _repeated(way: Way, own: float, other: float, stops: int, whole_turns: float) -> Way | None:
    turn = other * ((TURN / stops - way.turned / other) % TURN + TURN * whole_turns)
    angle = (way.turned + turn) / own
    gain = sum((complex(cos(k * angle), sin(k * angle)) for k in range(stops)), 0j)
    if not abs(gain):
        return None
    return Way((way.steps + (-turn,)) * (stops - 1) + way.steps, stops * way.turned + (stops - 1) * turn, way.gain * gain)


def _share(way: Way, repeated: Way, stops: int) -> float:
    return abs(repeated.gain) / abs(way.gain) / stops


def _checked(way: Way) -> Way:
    if len(way.steps) > MAX_ACTIVATIONS:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            "swarm.turning_radius",
            f"takes so many values in one group that a robot of it alone needs more than {MAX_ACTIVATIONS} activations: give "
            "robots codewords of their own",
        )
    return way


def _lengths(swarm: Swarm, group: int) -> list[float]:
    """Return the turning lengths of a group's members, each once."""
    return list(dict.fromkeys(swarm.turning_length[swarm.membership[group - 1]].tolist()))
