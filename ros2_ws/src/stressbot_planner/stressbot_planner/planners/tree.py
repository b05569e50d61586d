"""Rapidly-exploring random trees over swarm poses (LaValle), for any kind of move."""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial import cKDTree

from stressbot_planner.collision import Shapes, is_clear
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.kinematics import path_length, replay
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.primitives import Primitive, expand
from stressbot_planner.problem import Problem

GOAL_BIAS = 0.5
"""Share of samples with all robots at their goals; in the others half of the robots are drawn at random."""

MOVE_COST = 10.0
"""Cost of any move in turning radii, besides its path length: many small moves make long searches."""

LEAST_TOLERANCE = 0.1
"""Smallest goal radius, relative to the smallest body, that a tree is asked to hit."""

_LEAST_WORTH = 1e-3
_TAIL = 64

Moves = list[tuple[Primitive, ...]]

Steer = Callable[[np.ndarray, np.ndarray], Iterator[Moves]]
"""From poses (n, 3) toward poses (n, 3): lists of moves. A later list is tried if all moves before it failed."""


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


class Growth:
    """A tree that grows until some robots are at their goals.

    Args:
        problem: environment, bodies, goals and tolerance; its starts are not looked at.
        poses: where the tree starts, shape (n, 3).
        concerned: robots (from 0) that have to reach their goals; samples differ from the goals in these only.
        steer: makes moves.
        rng: random generator.
        heading_weight: length that a unit vector of heading counts as, in the distance of poses.
    """

    def __init__(self, problem: Problem, poses: np.ndarray, concerned: np.ndarray, steer: Steer, rng, heading_weight=0.0):
        self.problem, self.concerned, self.steer, self.rng = problem, concerned, steer, rng
        self.shapes = Shapes.of(problem.environment)
        self.heading_weight = heading_weight
        self.tree = Tree(poses, self._features)
        self.low, self.high = sampling_box(problem)
        self.move_cost = MOVE_COST * float(problem.swarm.turning_radius.mean())

    def run(self, out_of_time: Callable[[], bool]) -> int | None:
        """Grow until a node has all concerned robots within tolerance of their goals; return it, or None."""
        if self.goal_error(self.tree.poses[0]) <= self.problem.tolerance:
            return 0
        while not out_of_time():
            sample = self._sample()
            node: int | None = self.tree.nearest(sample)
            while node is not None and not out_of_time():
                node = self._extend(node, sample)
                if node is not None and self.goal_error(self.tree.poses[node]) <= self.problem.tolerance:
                    return node
        return None

    def closest_node(self) -> int:
        """Return the node with the smallest goal error: the best partial plan of a failure."""
        return int(np.argmin([self.goal_error(poses) for poses in self.tree.poses]))

    def _features(self, poses: np.ndarray) -> np.ndarray:
        places = poses[self.concerned, :2].ravel()
        if not self.heading_weight:
            return places
        heading = poses[self.concerned, 2]
        return np.concatenate([places, self.heading_weight * np.cos(heading), self.heading_weight * np.sin(heading)])

    def goal_error(self, poses: np.ndarray) -> float:
        """Return the largest distance of a concerned robot from its goal."""
        return float(np.max(np.hypot(*(poses[self.concerned, :2] - self.problem.goals[self.concerned]).T)))

    def _sample(self) -> np.ndarray:
        sample = np.column_stack([self.problem.goals, self.rng.uniform(-np.pi, np.pi, self.problem.swarm.n)])
        if self.rng.random() > GOAL_BIAS:
            strays = self.concerned[self.rng.random(len(self.concerned)) < 0.5]
            sample[strays, :2] = self.rng.uniform(self.low, self.high, (len(strays), 2))
        return sample

    def _extend(self, node: int, sample: np.ndarray) -> int | None:
        """Add the move that comes closer to sample at the least cost a unit; return the new node, or None."""
        before = self.tree.poses[node]
        swarm = self.problem.swarm
        wanted = self._features(sample)
        distance = np.linalg.norm(self._features(before) - wanted)
        for moves in self.steer(before, sample):
            best, best_worth = None, _LEAST_WORTH
            for move in moves:
                groups, lengths = expand(swarm, move)
                poses = replay(swarm, before, groups, lengths)
                gain = distance - np.linalg.norm(self._features(poses[-1]) - wanted)
                worth = gain / (path_length(swarm, groups, lengths) + self.move_cost)
                if worth > best_worth and is_clear(swarm, self.shapes, poses, groups, lengths, 1e-6):
                    best, best_worth = (move, poses[-1]), worth
            if best is not None:
                return self.tree.add(node, *best)
        return None


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
    least = LEAST_TOLERANCE * float(problem.swarm.body_radius.min())
    if problem.tolerance < least:
        raise StressbotError(
            ErrorCode.UNSUPPORTED,
            "tolerance",
            f"is {problem.tolerance:g}: a tree only comes near its goals; give {least:g} or more (the paper: 1.5 to 2), "
            "or use the planner 'optimize'",
        )


def outcome_of(growth: Growth, goal: int | None, settings: Settings) -> Outcome:
    """Return the outcome of a single tree; without a goal node the closest one is kept for inspection."""
    node = growth.closest_node() if goal is None else goal
    reason = ""
    if goal is None:
        reason = (
            f"no plan found within {settings.time_limit:g} s; the closest of {len(growth.tree)} nodes leaves a robot "
            f"{growth.goal_error(growth.tree.poses[node]):.3g} from its goal"
        )
    return Outcome(growth.tree.primitives_to(node), reason, details={"nodes": len(growth.tree)})
