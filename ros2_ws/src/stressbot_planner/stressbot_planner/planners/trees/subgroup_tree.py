"""Trees whose moves are those of subgroups: turn robots toward where they go by Rot, then move a subgroup (EC1, IC3, IC4)."""

from collections.abc import Iterator
from heapq import nlargest
from itertools import combinations
from typing import NamedTuple

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.headings import check_headings_for_rot, turn_to_goals
from stressbot_planner.planners.limit import Limit
from stressbot_planner.planners.motion import Motion, World
from stressbot_planner.planners.trees.tree import MOVE_COST, sampling_box
from stressbot_planner.primitives.expansion import TURN, orientation_matrix, rotation_inputs
from stressbot_planner.primitives.subgroups import BracketSubgroup
from stressbot_planner.problem.definition import Problem

GOAL_BIAS = 0.7
"""Share of attempts from the node nearest to the goals, along shortest ways among obstacles and those at rest."""

NEAR = 0.5
"""Distance from a goal, relative to the tolerance, within which a robot need not come closer."""

LARGEST_CHOICE = 4
"""Number of robots of a large subgroup that are considered for turning: those with the longest ways."""

SHARES = (1.0, 0.5, 0.2)
"""Parts of the way to a waypoint, tried."""

PATIENCE = 100
"""Attempts of the first tree of several."""

MEASURED = 48
"""Number of moves, those that seem best by straight lines to waypoints, whose ways left are measured."""

CANDIDATES, ENOUGH = 24, 3
"""Number of moves that are tried, the most promising first, and of clear ones that end the trials; the best of those is taken."""


_NEGLIGIBLE = 1e-9


class _Option(NamedTuple):
    """A move that is not yet checked.

    Attributes:
        gain: by how much it comes closer.
        cost: what it takes.
        subgroup: that moves.
        robots: ids of those that turn before.
        angles: by which they turn.
        length: that the subgroup moves.
        ends: poses after it, shape (n, 3), right for places only.
    """

    gain: float
    cost: float
    subgroup: BracketSubgroup
    robots: tuple[int, ...]
    angles: tuple[float, ...]
    length: float
    ends: np.ndarray

    @property
    def worth(self) -> float:
        """Gain for each unit of cost."""
        return self.gain / self.cost


class SubgroupTree:
    """A rapidly-exploring random tree (LaValle) over the poses that subgroups can be brought to while all others rest.

    Args:
        world: the problem, whose starts are not looked at.
        poses: where the tree starts, shape (n, 3).
        subgroups: whose moves the tree is made of; their robots are to reach their goals.
        rng: random generator.

    Attributes:
        reachable: whether every robot has a way to its goal among those who rest; the tree grows anyway.
    """

    def __init__(self, world: World, poses: np.ndarray, subgroups: list[BracketSubgroup], rng: np.random.Generator):
        self.world, self.subgroups, self.rng = world, subgroups, rng
        swarm = world.problem.swarm
        self.moving = np.isin(np.arange(swarm.n), [robot - 1 for subgroup in subgroups for robot in subgroup.robots])
        self.robots = np.flatnonzero(self.moving)
        robots = self.robots.tolist()
        paths = [world.paths_to_goal(robot, poses, self.moving, rng) for robot in robots]
        self.reachable = None not in paths
        self.paths = [way or world.straight_to_goal(robot) for robot, way in zip(robots, paths, strict=True)]
        self.goals = world.problem.goals[self.robots]
        self.box = sampling_box(world.problem)
        self.turning = orientation_matrix(swarm)
        self.motions = [Motion(world, poses)]
        self.parents = [-1]
        self.left = [self._ways_left(poses)]
        self.failures = [0]

    def __len__(self):
        return len(self.motions)

    def run(self, patience: int, limit: Limit) -> int | None:
        """Grow until a node has all at their goals; return it, or None after the last attempt."""
        if self.goal_error(0) <= self.world.problem.tolerance:
            return 0
        while patience > 0 and not limit.over():
            patience -= 1
            if self.rng.random() < GOAL_BIAS:
                ways = np.linalg.norm(self.left, axis=1) + self.world.turning_radius * np.array(self.failures)
                node, sample = int(np.argmin(ways)), None
            else:
                sample = self._sample()
                node = int(np.argmin([np.linalg.norm(motion.poses[self.robots, :2] - sample) for motion in self.motions]))
            while node is not None and limit.another():
                start, node = node, self._extend(node, sample)
                if node is None:
                    self.failures[start] += 1
                elif self.goal_error(node) <= self.world.problem.tolerance:
                    return node
        return None

    def closest_node(self) -> int:
        """Return the node with the shortest ways left: the best partial plan of a failure."""
        return int(np.argmin(np.linalg.norm(self.left, axis=1)))

    def way_to(self, node: int) -> Motion:
        """Return the motion from the root to a node."""
        nodes = []
        while node > 0:
            nodes.append(node)
            node = self.parents[node]
        way = self.motions[0].branch()
        for node in reversed(nodes):
            way.append(self.motions[node])
        return way

    def goal_error(self, node: int) -> float:
        """Return the largest distance of a robot from its goal, units."""
        return float(np.max(np.hypot(*(self.motions[node].poses[self.robots, :2] - self.goals).T)))

    def _ways_left(self, poses: np.ndarray) -> np.ndarray:
        """Return how far each robot has to go until it is well within its tolerance."""
        ways = [paths.ahead(poses[robot, :2])[0] for robot, paths in zip(self.robots, self.paths, strict=True)]
        return np.maximum(np.array(ways) - NEAR * self.world.problem.tolerance, 0.0)

    def _sample(self) -> np.ndarray:
        """Return places of all robots: their goals, some of them replaced at random."""
        sample = self.goals.copy()
        strays = self.rng.choice(len(sample), int(self.rng.integers(1, len(sample) + 1)), replace=False)
        sample[strays] = self.rng.uniform(*self.box, (len(strays), 2))
        return sample

    def _extend(self, node: int, sample: np.ndarray | None) -> int | None:
        """Add the move that comes closer to a sample, or to the goals, at the least cost a unit; return its node, or None."""
        motion = Motion(self.world, self.motions[node].poses)
        if self.failures[node]:
            groups = self.world.problem.swarm.m
            if not motion.turn(int(self.rng.integers(1, groups)), float(self.rng.uniform(0, TURN))):
                return None
        targets = np.array(motion.poses[:, :2])
        targets[self.robots] = self._targets(motion.poses) if sample is None else sample
        before = self._to_go(motion.poses, sample)
        found: list[tuple[float, Motion]] = []
        options = nlargest(MEASURED, self._options(motion.poses, targets, before), key=lambda option: option.worth)
        if sample is None:
            whole = np.linalg.norm(before)
            options = [option._replace(gain=whole - np.linalg.norm(self._ways_left(option.ends))) for option in options]
        for option in sorted(options, key=lambda option: -option.worth)[:CANDIDATES]:
            if option.gain <= 0:
                break
            branch = motion.branch()
            branch.robot = option.subgroup.robots[0] - 1
            if not branch.orient(option.robots, option.angles):
                continue
            for moved in branch.move(option.subgroup, option.length, self.rng):
                gain = float(np.linalg.norm(before) - np.linalg.norm(self._to_go(moved.poses, sample)))
                if gain > 0:
                    found.append((gain / (moved.path + self._least_cost(option.subgroup)), moved))
            if len(found) >= ENOUGH:
                break
        if not found:
            return None
        best = max(found, key=lambda pair: pair[0])[1]
        self.motions.append(best)
        self.parents.append(node)
        self.left.append(self._ways_left(best.poses))
        self.failures.append(0)
        return len(self) - 1

    def _targets(self, poses: np.ndarray) -> np.ndarray:
        """Return the first waypoint of each robot."""
        ahead = [paths.ahead(poses[robot, :2])[1] for robot, paths in zip(self.robots, self.paths, strict=True)]
        return np.array([paths.nodes[max(node, 0)] for paths, node in zip(self.paths, ahead, strict=True)])

    def _to_go(self, poses: np.ndarray, sample: np.ndarray | None) -> np.ndarray:
        """Return how far each robot is from a sample, or has to go to its goal."""
        return self._ways_left(poses) if sample is None else np.hypot(*(poses[self.robots, :2] - sample).T)

    def _least_cost(self, subgroup: BracketSubgroup) -> float:
        """Return what a move costs however short it is: half turns, and that many short moves make long searches."""
        swarm = self.world.problem.swarm
        sizes = swarm.group_sizes[[j - 1 for j in subgroup.inside + subgroup.outside]]
        half_turns = np.pi * sizes.mean() * 2 ** len(sizes) if len(sizes) else 0.0
        return self.world.turning_radius * float(MOVE_COST + half_turns)

    def _options(self, poses: np.ndarray, targets: np.ndarray, before: np.ndarray) -> Iterator[_Option]:
        """Yield moves, with what they are worth if every robot goes on by its target."""
        swarm = self.world.problem.swarm
        way = targets - poses[:, :2]
        distance, bearing = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
        beyond = -distance  # from a robot's target to its goal, less what need not be gone
        beyond[self.robots] += before
        squares = np.zeros(swarm.n)
        squares[self.robots] = before**2
        for subgroup in self.subgroups:
            members = np.array(subgroup.robots) - 1
            least = self._least_cost(subgroup)
            others = squares.sum() - squares[members].sum()
            farthest = members[np.argsort(-distance[members])[:LARGEST_CHOICE]]
            for chosen in (np.array(c) for size in (3, 2, 1) for c in combinations(farthest.tolist(), size)):
                robots = tuple((chosen + 1).tolist())
                angles = tuple(np.mod(bearing[chosen] - poses[chosen, 2], TURN).tolist())
                turns = rotation_inputs(swarm, robots, angles)
                heading = poses[members, 2] + self.turning[members] @ turns
                step = swarm.pace[members, None] * np.column_stack([np.cos(heading), np.sin(heading)])
                swings = float(turns[:-1] @ swarm.group_sizes[:-1]) * self.world.turning_radius
                whole = [distance[chosen].mean(), distance[chosen].min(), distance[chosen].max()]
                lengths = np.unique(np.outer(SHARES, whole))
                lengths = lengths[lengths > _NEGLIGIBLE]
                ends = poses[members, :2] + lengths[:, None, None] * step
                after = np.maximum(np.linalg.norm(ends - targets[members], axis=2) + beyond[members], 0.0)
                gain = np.sqrt(squares.sum()) - np.sqrt(others + (after**2).sum(axis=1))
                cost = swings + swarm.group_sizes[subgroup.group - 1] * lengths + least
                for k, length in enumerate(lengths.tolist()):
                    after_it = poses.copy()
                    after_it[members, :2] = ends[k]
                    yield _Option(float(gain[k]), float(cost[k]), subgroup, robots, angles, length, after_it)


def grow(problem: Problem, subgroups: list[BracketSubgroup], settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the plan of the first tree that brings all to their goals; of failures the closest node is kept for inspection.

    A tree may be unlucky for long, so that another one is begun after a while, with twice the patience. A try is an attempt to
    extend a tree.
    """
    check_headings_for_rot(problem)
    limit = Limit(settings)
    world = World(problem)
    patience, nodes = PATIENCE, 0
    closest, least = Motion(world, problem.starts), np.inf
    while True:
        tree = SubgroupTree(world, problem.starts, subgroups, rng)
        goal = tree.run(patience, limit)
        nodes += len(tree)
        if goal is not None:
            way = tree.way_to(goal)
            reason = turn_to_goals(way, rng, limit)
            return Outcome(tuple(way.primitives), reason, details={"nodes": nodes})
        node = tree.closest_node()
        if (error := tree.goal_error(node)) < least:
            closest, least = tree.way_to(node), error
        if limit.over():
            reason = (
                f"no plan found within {limit}; the closest of {nodes} nodes leaves a robot {least:.3g} units from its goal"
            )
            return Outcome(tuple(closest.primitives), reason, details={"nodes": nodes})
        patience *= 2
