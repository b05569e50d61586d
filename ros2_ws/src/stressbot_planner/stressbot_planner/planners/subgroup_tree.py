"""Trees whose moves are those of subgroups: turn robots toward where they go by Rot, then move a subgroup (EC1, IC3, IC4)."""

from collections.abc import Callable, Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.motion import Motion, World
from stressbot_planner.planners.tree import MOVE_COST, sampling_box
from stressbot_planner.primitives import TURN, orientation_matrix, rotation_inputs
from stressbot_planner.subgroups import BracketSubgroup

GOAL_BIAS = 0.7
"""Share of attempts from the node nearest to the goals, along shortest ways among obstacles and those at rest."""

NEAR = 0.5
"""Distance from a goal, relative to the tolerance, within which a robot need not come closer."""

LARGEST_CHOICE = 4
"""Of a large subgroup so many robots are considered for turning, those with the longest ways."""

SHARES = (1.0, 0.5, 0.2)
"""Parts of the way to a waypoint, tried."""

CANDIDATES, ENOUGH = 24, 3
"""So many moves are tried, the most promising first, until so many are clear; the best of those is taken."""


class _Option(NamedTuple):
    """A move that is not yet checked: worth, the subgroup, robots (ids) to turn by angles, length to move."""

    worth: float
    subgroup: BracketSubgroup
    robots: tuple[int, ...]
    angles: tuple[float, ...]
    length: float


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
        paths = [world.paths_to_goal(robot, poses, self.moving, rng) for robot in self.robots]
        self.reachable = None not in paths
        self.paths = [way or world.straight_to_goal(robot) for robot, way in zip(self.robots, paths, strict=True)]
        self.goals = world.problem.goals[self.robots]
        self.box = sampling_box(world.problem)
        self.turning = orientation_matrix(swarm)
        self.motions = [Motion(world, poses)]
        self.parents = [-1]
        self.left = [self._ways_left(poses)]
        self.failures = [0]

    def __len__(self):
        return len(self.motions)

    def run(self, patience: float, out_of_time: Callable[[], bool]) -> int | None:
        """Grow until a node has all at their goals; return it, or None after so many attempts."""
        if self._goal_error(0) <= self.world.problem.tolerance:
            return 0
        while patience > 0 and not out_of_time():
            patience -= 1
            if self.rng.random() < GOAL_BIAS:
                ways = np.linalg.norm(self.left, axis=1) + self.world.turning_radius * np.array(self.failures)
                node, sample = int(np.argmin(ways)), None
            else:
                sample = self._sample()
                node = int(np.argmin([np.linalg.norm(motion.poses[self.robots, :2] - sample) for motion in self.motions]))
            while node is not None and not out_of_time():
                start, node = node, self._extend(node, sample)
                if node is None:
                    self.failures[start] += 1
                elif self._goal_error(node) <= self.world.problem.tolerance:
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

    def _goal_error(self, node: int) -> float:
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
        distances = self._distances(sample)
        before = distances(motion.poses, self.robots)
        targets = np.array(motion.poses[:, :2])
        targets[self.robots] = self._targets(motion.poses) if sample is None else sample
        found: list[tuple[float, Motion]] = []
        options = [o for o in self._options(motion.poses, targets, before, distances) if o.worth > 0]
        for option in sorted(options, key=lambda option: -option.worth)[:CANDIDATES]:
            branch = motion.branch()
            if not branch.orient(option.robots, option.angles):
                continue
            for moved in branch.move(option.subgroup, option.length, self.rng):
                gain = float(np.linalg.norm(before) - np.linalg.norm(distances(moved.poses, self.robots)))
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

    def _distances(self, sample: np.ndarray | None) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """Return a function that tells how far some robots are at poses (n, 3) from a sample, or have to go."""
        index = np.full(self.world.problem.swarm.n, -1)
        index[self.robots] = np.arange(len(self.robots))

        def to_sample(poses, robots):
            return np.hypot(*(poses[robots, :2] - sample[index[robots]]).T)

        def to_goals(poses, robots):
            ways = [self.paths[index[robot]].ahead(poses[robot, :2])[0] for robot in robots]
            return np.maximum(np.array(ways) - NEAR * self.world.problem.tolerance, 0.0)

        return to_goals if sample is None else to_sample

    def _least_cost(self, subgroup: BracketSubgroup) -> float:
        """Return what a move costs however short it is: half turns, and that many short moves make long searches."""
        swarm = self.world.problem.swarm
        sizes = swarm.group_sizes[[j - 1 for j in subgroup.inside + subgroup.outside]]
        half_turns = np.pi * sizes.mean() * 2 ** len(sizes) if len(sizes) else 0.0
        return self.world.turning_radius * float(MOVE_COST + half_turns)

    def _options(self, poses: np.ndarray, targets: np.ndarray, before: np.ndarray, distances) -> Iterator[_Option]:
        swarm = self.world.problem.swarm
        whole = float(before @ before)
        every = np.zeros(swarm.n)
        every[self.robots] = before
        way = targets - poses[:, :2]
        distance, bearing = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
        for subgroup in self.subgroups:
            members = np.array(subgroup.robots) - 1
            least = self._least_cost(subgroup)
            squares = float(every[members] @ every[members])
            farthest = members[np.argsort(-distance[members])[:LARGEST_CHOICE]]
            for chosen in (np.array(c) for size in (3, 2, 1) for c in combinations(farthest.tolist(), size)):
                robots = tuple((chosen + 1).tolist())
                angles = tuple(np.mod(bearing[chosen] - poses[chosen, 2], TURN).tolist())
                turns = rotation_inputs(swarm, robots, angles)
                heading = poses[members, 2] + self.turning[members] @ turns
                step = np.column_stack([np.cos(heading), np.sin(heading)])
                swings = float(turns[:-1] @ swarm.group_sizes[:-1]) * self.world.turning_radius
                lengths = {float(of(distance[chosen])) for of in (np.mean, np.min, np.max)}
                ends = poses.copy()
                for length in sorted({share * length for share in SHARES for length in lengths}):
                    if length > 1e-9:
                        ends[members, :2] = poses[members, :2] + length * step
                        after = distances(ends, members)
                        gain = np.sqrt(whole) - np.sqrt(max(whole - squares + after @ after, 0.0))
                        cost = swings + swarm.group_sizes[subgroup.group - 1] * length + least
                        yield _Option(float(gain / cost), subgroup, robots, angles, length)


def outcome_of(tree: SubgroupTree, goal: int | None, settings: Settings) -> Outcome:
    """Return the outcome of a single tree; without a goal node the closest one is kept for inspection."""
    node = tree.closest_node() if goal is None else goal
    reason = ""
    if goal is None:
        error = float(np.max(np.hypot(*(tree.motions[node].poses[tree.robots, :2] - tree.goals).T)))
        reason = (
            f"no plan found within {settings.time_limit:g} s; the closest of {len(tree)} nodes leaves a robot "
            f"{error:.3g} from its goal"
        )
    return Outcome(tuple(tree.way_to(node).primitives), reason, details={"nodes": len(tree)})
