"""Safe prefixes of a plan: the nodes of the search."""

from dataclasses import dataclass

import numpy as np

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.planners.optimization.central_path import GOAL_PRECISION, OF_TOLERANCE
from stressbot_planner.planners.optimization.receding_horizon.aims import ShortestPaths
from stressbot_planner.planners.optimization.receding_horizon.soft_goals import Crowd
from stressbot_planner.problem.bounds import least_lengths
from stressbot_planner.problem.definition import Problem


@dataclass(frozen=True, eq=False)
class Prefix:
    """Activations from the start on that touch nothing, and what is left to do after them.

    Attributes:
        poses: after it, shape (n, 3).
        groups, t: the activations of the last piece.
        parent: the prefix before that piece, None for the start.
        done: cost of the whole.
        tail: groups and lengths of the last window behind the piece, to go on from; None: nothing known.
        clean: activations of the tail that are clear.
        ways: left to each robot, shape (n,).
        lengths: of the groups that the rest needs at least, shape (m,).
        rest: cost of these.
    """

    poses: np.ndarray
    groups: np.ndarray
    t: np.ndarray
    parent: "Prefix | None"
    done: float
    tail: tuple[np.ndarray, np.ndarray] | None
    clean: int
    ways: np.ndarray
    lengths: np.ndarray
    rest: float

    def trail(self) -> list["Prefix"]:
        """Return all prefixes from the start to this one."""
        chain: list[Prefix] = []
        node: Prefix | None = self
        while node is not None:
            chain.append(node)
            node = node.parent
        return chain[::-1]

    def activations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return groups (K,) and lengths (K,) from the start to here."""
        trail = self.trail()
        return np.concatenate([node.groups for node in trail]), np.concatenate([node.t for node in trail])


class Ground:
    """What all prefixes of one problem share; lengths in mean turning lengths (`Crowd`).

    Attributes:
        crowd: the robots and what is around them.
        goals: shape (n, 2).
        headings: at goals, shape (n,), all free: who follows the horizon sees to them afterwards.
        margin, least_gap: gaps below the one are too small, those up to the other collisions.
        cost: of a unit of length of each group, shape (m,), the largest is 1.
        used: groups that are worth an activation, from 0.
        precision: largest miss of a goal that is none.
        paths: of each robot alone.
    """

    def __init__(self, problem: Problem, shapes: Shapes, margin: float, least_gap: float, cost_of_group: np.ndarray):
        """Take gaps below margin as too small and up to least_gap as collisions, units; cost_of_group has shape (m,)."""
        self._swarm = swarm = problem.swarm
        self.crowd = Crowd.of(swarm, shapes)
        unit = self.crowd.unit
        self.goals, self.headings = problem.goals / unit, np.full(swarm.n, np.nan)
        self.margin, self.least_gap = margin / unit, least_gap / unit
        self.cost = cost_of_group / cost_of_group.max()
        self.used = np.flatnonzero((swarm.group_sizes > 0) | (np.arange(swarm.m) == swarm.m - 1))
        self.precision = min(GOAL_PRECISION, OF_TOLERANCE * problem.tolerance / unit, 0.25 * problem.slack / unit)
        start = problem.starts.copy()
        start[:, :2] /= unit
        obstacles = None if problem.environment.is_open_plane else self.crowd.shapes
        self.paths = ShortestPaths(obstacles, self.crowd.body, start[:, :2], self.goals)
        self.root = self._prefix(start, np.empty(0, np.int64), np.empty(0), None, None, 0)

    def after(self, node: Prefix, groups: np.ndarray, t: np.ndarray, kept: int, clean: int) -> Prefix:
        """Return the prefix with the first `kept` of so many activations more; `clean` of those behind are clear."""
        poses = self.end_poses(node.poses, groups[:kept], t[:kept])
        return self._prefix(poses, groups[:kept], t[:kept], node, (groups[kept:], t[kept:]), clean)

    def end_poses(self, start: np.ndarray, groups: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return poses (n, 3) after activations from poses (n, 3), headings from 0 to one turn."""
        poses = trajectory(np.ascontiguousarray(self.crowd.slides_of(groups).T), self.crowd.turning_length, start, t)[-1]
        poses[:, 2] %= 2 * np.pi
        return poses

    def clear_until(self, node: Prefix, groups: np.ndarray, t: np.ndarray) -> int:
        """Return how many activations after a prefix touch nothing."""
        return self.crowd.clear_until(node.poses, groups, t, self.least_gap)

    def _prefix(self, poses, groups, t, parent, tail, clean) -> Prefix:
        ways = self.paths.left(poses[:, :2])
        lengths = least_lengths(self._swarm, ways, self.cost)
        done = (parent.done if parent else 0.0) + float(self.cost[groups - 1] @ t)
        return Prefix(poses, groups, t, parent, done, tail, clean, ways, lengths, float(self.cost @ lengths))
