"""One robot alone, in any direction: the paper's proof of small-time local controllability (STLC) as a construction (section 4)."""

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import (
    MAX_ACTIVATIONS,
    TURN,
    Activate,
    Extract,
    Isolate,
    Primitive,
    TurnAll,
    check_finite,
    check_length,
    check_robot,
    halvings,
)
from stressbot_planner.primitives.radius_sets import Way, alone, closed, set_of

FORMS = ("halving", "recursion", "radii")

def isolate(
    swarm: Swarm, poses: np.ndarray, robot: int, direction: float, distance: float, form: str = "halving"
) -> tuple[Primitive, ...]:
    """Return primitives that move one robot by a distance in a direction of the plane and displace nobody else.

    All robots turn first, until the robot looks where it has to; then it moves alone, by one of the forms

    - `halving`: `primitives.Isolate`, at most 2^(m - 2) pulses; headings of its group are restored.
    - `recursion`: `primitives.Extract`, P_{k+1} = (P_k, Rot, P_k) of the paper, exponentially many pulses in the size of
      a group, but fewer in small swarms.
    - `radii`: for any turning radii, where h_i and Rot do not exist, see `_by_sets`.

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
        return _by_sets(swarm, heading, robot, groups, direction, distance)
    alone: list[Isolate] | list[Extract]
    if form == "halving":
        alone = [Isolate(robot, distance, group) for group in groups]
    elif form == "recursion":
        alone = [Extract((robot,), group, distance) for group in groups]
    else:
        raise StressbotError(ErrorCode.UNSUPPORTED, "form", f"is '{form}': use one of {', '.join(FORMS)}")
    return TurnAll((direction - heading) % TURN), min(alone, key=lambda primitive: primitive.pulses(swarm))


def _by_sets(
    swarm: Swarm, heading: float, robot: int, groups: list[int], direction: float, distance: float
) -> tuple[Primitive, ...]:
    """Return slides and turns of all by which only one robot is displaced, whatever turning radii there are.

    Members of G_i of other radii are sent back by turns of all between its slides (`radius_sets.alone`). Those of the robot's own
    radius are halved as in `Subgroup`: half of the ways are made after the members of G_j, or those outside, have been turned by
    pi, which takes a way of G_j that brings all of its members back (`radius_sets.closed`).
    """
    own = float(swarm.turning_length[robot - 1])
    same = set_of(swarm, robot - 1)

    def members(group: int) -> tuple[int, int]:
        others = swarm.membership[group - 1]
        return int((others & same).sum()), int(others.sum())

    group = min(groups, key=members)
    way = alone(swarm, group, robot - 1)
    inside, outside = halvings(swarm, group, robot, same & swarm.membership[group - 1])
    scale = distance / (abs(way.gain) * float(swarm.pace[robot - 1]) * 2 ** len(inside + outside))
    word, turned = _driven(group, way, scale, swarm.m), way.turned
    for other in (*outside, *inside):
        back = closed(swarm, other)
        turning = _driven(other, back, 0.5 * TURN * own / back.slides, swarm.m)
        half = back.turned + (0.0 if other in inside else 0.5 * TURN * own)  # by which it turns the robot itself
        rest = -(turned + half) % (TURN * own)
        word = [*word, *turning, Activate(swarm.m, rest), *word]
        turned = 2 * turned + half + rest
        if len(word) > MAX_ACTIVATIONS:
            raise StressbotError(
                ErrorCode.UNSUPPORTED,
                "robot",
                f"{robot} needs more than {MAX_ACTIVATIONS} activations: give it a group with less company",
            )
    aim = (direction - heading - float(np.angle(way.gain))) % TURN
    return Activate(swarm.m, aim * own), *word


def _driven(group: int, way: Way, scale: float, all_turn: int) -> list[Activate]:
    return [Activate(group, step * scale) if step > 0 else Activate(all_turn, -step) for step in way.steps]
