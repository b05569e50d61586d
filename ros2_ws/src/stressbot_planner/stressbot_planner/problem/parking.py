"""Parked robots: they stay where they are as long as none of their groups is activated, and turn on the spot meanwhile.

So the others have the groups that no parked robot belongs to, and have to be told apart by these alone.
"""

from collections.abc import Sequence

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm, check_told_apart


def groups_left(swarm: Swarm, parked: Sequence[int]) -> np.ndarray:
    """Return the groups, 1..m, G_m last, that no parked robot (rows) belongs to."""
    return np.flatnonzero(~swarm.membership[:, list(parked)].any(axis=1)) + 1


def words_left(swarm: Swarm, parked: Sequence[int]) -> dict[int, str]:
    """Return what is left of the codewords of robots (rows) that are not parked."""
    bits = groups_left(swarm, parked)[:-1] - 1
    return {row: "".join(word[bit] for bit in bits) for row, word in enumerate(swarm.codewords) if row not in parked}


def check_parked(swarm: Swarm, parked: Sequence[int]) -> None:
    """Raise INFEASIBLE unless some robots move, each in some group without parked ones (rows), and told apart by these."""
    if len(parked) == 0:
        return
    names = f"robot{'s' if len(parked) > 1 else ''} {', '.join(str(row + 1) for row in parked)}"
    words = words_left(swarm, parked)
    rows = list(words)
    if not rows:
        reason = "is parked, and so are all others: give one of them a goal"
        raise StressbotError(ErrorCode.INFEASIBLE, f"robots[{parked[0]}].goal", reason)
    still = next((row for row, word in words.items() if "1" not in word), None)
    if still is not None:
        reason = f"robot {still + 1} is in no group that leaves out {names}"
    else:
        try:
            check_told_apart(tuple(words.values()), swarm.turning_radius[rows], swarm.pace[rows])
            return
        except StressbotError:
            reason = f"the groups that leave out {names} do not tell the others apart"
    raise StressbotError(
        ErrorCode.INFEASIBLE,
        f"robots[{parked[0]}].goal",
        f"is parked, and {reason}: give it a goal, or give the swarm groups that leave it out (each group and its complement "
        "leave out any one robot)",
    )
