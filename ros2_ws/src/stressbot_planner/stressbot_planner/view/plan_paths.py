"""The path of each robot in a plan: it slides along a line or turns on the spot, so that few poses say it all."""

from collections.abc import Sequence

import numpy as np

from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm

LONGEST = 10_000
"""Poses of one robot; what comes after them is left out."""

_CHUNK = 1_000_000
"""Poses that are computed in one go."""


def plan_paths(
    swarm: Swarm, starts: np.ndarray, groups: np.ndarray, lengths: np.ndarray, rows: Sequence[int], longest: int = LONGEST
) -> list[np.ndarray]:
    """Return for each of the robots `rows` the poses where it begins or ends to slide, shape (at most `longest`, 3).

    Between two of them it either slides straight on or turns on the spot. The first is where it starts, the last where it ends.

    Args:
        swarm: the robots.
        starts: poses, shape (n, 3), units and rad.
        groups: 1..m, shape (K,).
        lengths: units, >= 0, shape (K,).
        rows: of the robots.
        longest: most poses of one path.
    """
    groups, lengths = groups[lengths > 0], lengths[lengths > 0]
    slid = swarm.membership[groups[:1] - 1][:, rows]
    parts = [[starts[row][None]] for row in rows]
    poses, step = starts, max(1, _CHUNK // swarm.n)
    for first in range(0, len(groups), step):
        now = slice(first, first + step)
        track = replay(swarm, poses, groups[now], lengths[now])
        slides = swarm.membership[groups[now] - 1][:, rows]
        changes = slides != np.concatenate([slid, slides[:-1]])
        for column, row in enumerate(rows):
            parts[column].append(track[:-1][changes[:, column], row])
        poses, slid = track[-1], slides[-1:]
        if all(sum(map(len, part)) >= longest for part in parts):
            break
    return [np.concatenate([*part, poses[row][None]])[:longest] for part, row in zip(parts, rows, strict=True)]
