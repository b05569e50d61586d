"""What trees over swarm poses have in common."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue] - compiled, without stub

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.primitives.expansion import Primitive
from stressbot_planner.problem.definition import Problem

MOVE_COST = 10.0
"""Cost of any move in turning radii, besides its path length: many small moves make long searches."""

LEAST_TOLERANCE = 0.1
"""Smallest goal radius, relative to the smallest `Swarm.girth`, that a tree is asked to hit."""

_TAIL = 64


class Tree:
    """Nodes with poses, and what led there; nearest neighbours by a k-d tree that is rebuilt as the tree doubles."""

    def __init__(self, poses: np.ndarray, features: Callable[[np.ndarray], np.ndarray]):
        self.features = features
        self.poses: list[np.ndarray] = []
        self._parents: list[int] = []
        self._moves: list[tuple[Primitive, ...]] = []
        self._rows: list[np.ndarray] = []
        self._index, self._indexed = None, 0
        self.add(-1, (), poses)

    def __len__(self):
        return len(self.poses)

    def add(self, parent: int, move: tuple[Primitive, ...], poses: np.ndarray) -> int:
        """Append a node and return its number."""
        self.poses.append(poses)
        self._parents.append(parent)
        self._moves.append(move)
        self._rows.append(self.features(poses))
        return len(self) - 1

    def nearest(self, poses: np.ndarray) -> int:
        """Return the node nearest to poses."""
        wanted = self.features(poses)
        if len(self) - self._indexed > max(_TAIL, self._indexed):
            self._index, self._indexed = cKDTree(np.array(self._rows)), len(self)
        best, node = (np.inf, 0) if self._index is None else self._index.query(wanted)
        tail = self._rows[self._indexed :]
        if tail:
            distance = np.linalg.norm(np.array(tail) - wanted, axis=1)
            closest = int(np.argmin(distance))
            if distance[closest] < best:
                node = self._indexed + closest
        return int(node)

    def primitives_to(self, node: int) -> tuple[Primitive, ...]:
        """Return all primitives from the root to a node."""
        moves = []
        while node > 0:
            moves.append(self._moves[node])
            node = self._parents[node]
        return tuple(primitive for move in reversed(moves) for primitive in move)


def sampling_box(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the walls, or of a box some way around starts and goals."""
    walls = problem.environment.workspace
    if walls is not None:
        return np.array([walls.x_min, walls.y_min]), np.array([walls.x_max, walls.y_max])
    places = np.vstack([problem.starts[:, :2], problem.goals])
    spare = 0.1 * np.ptp(places, axis=0).max()
    return places.min(axis=0) - spare, places.max(axis=0) + spare


def check_tolerance(problem: Problem) -> None:
    """Raise unless goals are wide enough for a tree to hit."""
    least = LEAST_TOLERANCE * float(problem.swarm.girth.min())
    if problem.tolerance < least:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            "tolerance",
            f"is {problem.tolerance:g} units: a tree only comes near its goals; give {least:g} units or more (the "
            "paper: 1.5 units to 2 units), or use the planner 'optimize'",
        )
