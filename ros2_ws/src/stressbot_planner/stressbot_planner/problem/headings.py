"""Headings at goals: which may be prescribed together.

Robot j ends turned by the sum of (1 - alpha_ij) T_i / c_j, with T_i the total length of group i and c_j its turning length. So
headings follow from m totals, and those of some robots can be prescribed if their rows of the orientation matrix are independent.
"""

from collections.abc import Iterable

import numpy as np

from stressbot_planner.model.swarm import Swarm
from stressbot_planner.primitives.expansion import orientation_matrix

EXACT_HEADING = 1e-6
"""Difference from a goal heading, rad, that counts as none."""

_NOTHING = 1e-9


def dependent(swarm: Swarm, rows: Iterable[int]) -> tuple[int, list[int]] | None:
    """Return the first of some robots (rows) whose heading follows from those before it, and from which; None: none does."""
    matrix = orientation_matrix(swarm)
    kept: list[int] = []
    for row in rows:
        if np.linalg.matrix_rank(matrix[[*kept, row]]) == len(kept):
            shares = np.linalg.lstsq(matrix[kept].T, matrix[row], rcond=None)[0]
            return row, [other for other, share in zip(kept, shares, strict=True) if abs(share) > _NOTHING]
        kept.append(row)
    return None
