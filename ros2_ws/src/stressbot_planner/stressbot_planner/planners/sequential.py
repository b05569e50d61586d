"""`sequential`: disjoint subgroups one after the other, each with a tree of its own (the paper's IC4)."""

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np

from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.motion import Motion, World
from stressbot_planner.planners.tree import MOVE_COST, check_tolerance, sampling_box
from stressbot_planner.primitives import TURN, orientation_matrix, rotation_inputs
from stressbot_planner.problem import Problem
from stressbot_planner.subgroups import BracketSubgroup, default_order, disjoint_cover

TREES = 5
"""Grown for each subgroup; the shortest way is taken."""

TREES_SHARE = 0.1
"""Of the time limit that all trees but the first ones may take."""

PATIENCE = 100
"""Attempts of one tree before other subgroups are given the way."""

GOAL_BIAS = 0.7
"""Share of attempts from the node nearest to the goals, along shortest ways among those at rest."""

LARGEST_CHOICE = 4
"""Of a large subgroup so many robots are considered for turning, those with the longest ways."""

SHARES = (1.0, 0.5, 0.2)
"""Parts of the way to a waypoint, tried."""

CANDIDATES, ENOUGH = 8, 3
"""So many moves are tried, the most promising first, until so many are clear; the best of those is taken."""


class _Search:
    """A tree over the poses that one subgroup can be brought to while all others rest."""

    def __init__(self, world: World, poses: np.ndarray, subgroup: BracketSubgroup, rng: np.random.Generator):
        self.world, self.subgroup, self.rng = world, subgroup, rng
        self.robots = np.array(subgroup.robots) - 1
        moving = np.isin(np.arange(world.problem.swarm.n), self.robots)
        self.paths = [world.paths_to_goal(robot, poses, moving, rng) for robot in self.robots]
        self.goals = world.problem.goals[self.robots]
        self.motions: list[Motion] = []
        self.parents: list[int] = []
        self.left: list[float] = []
        self.failures: list[int] = []
        if None not in self.paths:
            self._add(-1, Motion(world, poses))
        self.box = sampling_box(world.problem)
        swarm = world.problem.swarm
        others = [swarm.group_sizes[j - 1] for j in subgroup.inside + subgroup.outside]
        # two half turns of every group for a pulse pair, and then some: what a move costs however short it is
        self.move_cost = world.turning_radius * (MOVE_COST + np.pi * float(np.mean(others or [0])) * 2 ** len(others))
        self.turning = orientation_matrix(swarm)[self.robots]

    def run(self, patience: int, out_of_time: Callable[[], bool]) -> int | None:
        """Grow until a node has the subgroup at its goals; return it, or None after so many attempts."""
        if None in self.paths:
            return None
        if self._at_goals(0):
            return 0
        for _ in range(patience):
            to_goals = self.rng.random() < GOAL_BIAS
            if to_goals:
                node, sample = int(np.argmin(np.array(self.left) + self.world.turning_radius * np.array(self.failures))), None
            else:
                sample = self._sample()
                node = int(np.argmin([np.linalg.norm(motion.poses[self.robots, :2] - sample) for motion in self.motions]))
            while node is not None:
                if out_of_time():
                    return None
                start, node = node, self._extend(node, sample)
                if node is None:
                    self.failures[start] += 1
                elif self._at_goals(node):
                    return node
        return None

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

    def _add(self, parent: int, motion: Motion) -> int:
        self.parents.append(parent)
        self.motions.append(motion)
        self.left.append(self._way_left(motion.poses[self.robots, :2]))
        self.failures.append(0)
        return len(self.motions) - 1

    def _at_goals(self, node: int) -> bool:
        places = self.motions[node].poses[self.robots, :2]
        return bool(np.all(np.hypot(*(places - self.goals).T) <= self.world.problem.tolerance))

    def _way_left(self, places: np.ndarray) -> float:
        return float(np.linalg.norm([paths.ahead(place)[0] for paths, place in zip(self.paths, places, strict=True)]))

    def _sample(self) -> np.ndarray:
        """Return places of the subgroup: its goals, some of them replaced at random."""
        sample = self.goals.copy()
        strays = self.rng.choice(len(sample), int(self.rng.integers(1, len(sample) + 1)), replace=False)
        sample[strays] = self.rng.uniform(*self.box, (len(strays), 2))
        return sample

    def _extend(self, node: int, sample: np.ndarray | None) -> int | None:
        """Add the move that comes closer to a sample, or to the goals, at the least cost a unit; return its node, or None."""
        motion = Motion(self.world, self.motions[node].poses)
        if self.failures[node]:
            swarm = self.world.problem.swarm
            if not motion.turn(int(self.rng.integers(1, swarm.m)), float(self.rng.uniform(0, TURN))):
                return None
        places = motion.poses[self.robots, :2]
        if sample is None:
            left = self._way_left
            targets = np.array([paths.nodes[paths.ahead(at)[1]] for paths, at in zip(self.paths, places, strict=True)])
        else:
            targets = sample

            def left(ends):
                return float(np.linalg.norm(targets - ends))

        before = left(places)
        found: list[tuple[float, Motion]] = []
        options = sorted(self._options(motion.poses, targets, before, left), key=lambda option: -option[0])
        for worth, robots, angles, length in options[:CANDIDATES]:
            if worth <= 0:
                break
            branch = motion.branch()
            if not branch.orient(robots, angles):
                continue
            for moved in branch.move(self.subgroup, length, self.rng):
                gain = before - left(moved.poses[self.robots, :2])
                found.append((gain / (moved.path + self.move_cost), moved))
            if len(found) >= ENOUGH:
                break
        if not found:
            return None
        best = max(found, key=lambda pair: pair[0])[1]
        return self._add(node, best)

    def _options(self, poses: np.ndarray, targets: np.ndarray, before: float, left: Callable[[np.ndarray], float]) -> Iterator:
        """Yield (worth, robots to turn, angles, length to move) of moves, none of them checked."""
        swarm = self.world.problem.swarm
        places, headings = poses[self.robots, :2], poses[self.robots, 2]
        way = targets - places
        distance, bearing = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
        farthest = sorted(np.argsort(-distance)[:LARGEST_CHOICE].tolist())
        for choice in (list(c) for size in (3, 2, 1) for c in combinations(farthest, size)):
            robots = tuple((self.robots[choice] + 1).tolist())
            angles = tuple(np.mod(bearing[choice] - headings[choice], TURN).tolist())
            turns = rotation_inputs(swarm, robots, angles)
            heading = headings + self.turning @ turns
            step = np.column_stack([np.cos(heading), np.sin(heading)])
            swings = float(turns[:-1] @ swarm.group_sizes[:-1]) * self.world.turning_radius
            whole = {float(distance[choice].mean()), float(distance[choice].min()), float(distance[choice].max())}
            for length in sorted({share * length for share in SHARES for length in whole}):
                if length > 1e-9:
                    gain = before - left(places + length * step)
                    cost = swings + swarm.group_sizes[self.subgroup.group - 1] * length + self.move_cost
                    yield gain / cost, robots, angles, length


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised.

    A subgroup that finds no way, because another stands in it, comes again after the others.

    Raises:
        StressbotError: as `parallel`.
    """
    check_tolerance(problem)
    begin = settings.clock()
    world = World(problem)
    waiting = disjoint_cover(problem.swarm, settings.order or default_order(problem.swarm))
    count = len(waiting)

    def out_of_time(share: float = 1.0) -> bool:
        return settings.clock() - begin > share * settings.time_limit

    motion, nodes, patience = Motion(world, problem.starts), 0, PATIENCE
    while waiting:
        still_waiting = []
        for subgroup in waiting:
            best: Motion | None = None
            for tree in range(TREES):
                if tree and out_of_time(TREES_SHARE):
                    break
                search = _Search(world, motion.poses, subgroup, rng)
                goal = search.run(patience, out_of_time)
                nodes += len(search.motions)
                if goal is None:
                    break
                way = search.way_to(goal)
                if best is None or way.path < best.path:
                    best = way
            if best is None:
                still_waiting.append(subgroup)
            else:
                motion.append(best)
        if len(still_waiting) == len(waiting):
            patience *= 2
        waiting = still_waiting
        if waiting and out_of_time():
            robots = ", ".join(str(robot) for subgroup in waiting for robot in subgroup.robots)
            reason = (
                f"no plan found within {settings.time_limit:g} s; {count - len(waiting)} of {count} subgroups are at their goals "
                f"after {nodes} nodes, not robots {robots}"
            )
            return Outcome(tuple(motion.primitives), reason, details={"nodes": nodes})
    return Outcome(tuple(motion.primitives), details={"nodes": nodes})
