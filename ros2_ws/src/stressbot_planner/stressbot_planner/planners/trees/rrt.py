"""`rrt`: the original tree of the paper (EC1), one group at a time in the space of all poses."""

import numpy as np

from stressbot_planner.collision.clearance import Shapes, slide_is_clear
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.headings import check_free_headings
from stressbot_planner.planners.limit import Limit
from stressbot_planner.planners.trees.tree import MOVE_COST, Tree, check_tolerance, sampling_box
from stressbot_planner.primitives.expansion import TURN, Activate
from stressbot_planner.problem.definition import Problem
from stressbot_planner.system.kernels import kernel

TRIES = 20
"""Activations tried for each extension."""

REACH = 5.0
"""Longest activation, in turning radii; G_m turns by up to 2 pi."""

HEADING_WEIGHT = 1.0
"""Turning radii that a unit vector of heading counts as: without it the tree does not care where robots look."""

GOAL_BIAS = 0.5
"""Share of samples with all robots at their goals; in the others half of the robots are drawn at random."""

LEAST_WORTH = 1e-3
"""Units by which an activation comes closer to a sample, for each unit that it costs."""

LEAST_GAP = 1e-6
"""Gap that each activation keeps, where bodies are not closer already, relative to the smallest `Swarm.girth`."""


class _Search:
    """A rapidly-exploring random tree (LaValle) from a problem's starts."""

    def __init__(self, problem: Problem, rng: np.random.Generator):
        self.problem, self.rng = problem, rng
        swarm = problem.swarm
        radius = float(swarm.turning_radius.mean())
        self.heading_weight = HEADING_WEIGHT * radius
        self.move_cost = MOVE_COST * radius
        self.reach = np.full(swarm.m, REACH * radius)
        self.reach[-1] = TURN * radius
        self.low, self.high = sampling_box(problem)
        gap = LEAST_GAP * float(swarm.girth.min())
        self.surroundings = swarm.body_radius, *Shapes.of(problem.environment).kernel_arguments, gap, problem.slack
        self.tree = Tree(np.array(problem.starts), lambda poses: _features(poses, self.heading_weight))

    def run(self, limit: Limit) -> int | None:
        """Grow until a node has all robots within tolerance of their goals; return it, or None."""
        if self.goal_error(0) <= self.problem.tolerance:
            return 0
        while not limit.over():
            sample = self._sample()
            node: int | None = self.tree.nearest(sample)
            while node is not None and limit.another():
                node = self._extend(node, sample)
                if node is not None and self.goal_error(node) <= self.problem.tolerance:
                    return node
        return None

    def goal_error(self, node: int) -> float:
        return self.problem.goal_error(self.tree.poses[node][:, :2])

    def _sample(self) -> np.ndarray:
        n = self.problem.swarm.n
        sample = np.column_stack([self.problem.goals, self.rng.uniform(-np.pi, np.pi, n)])
        if self.rng.random() > GOAL_BIAS:
            strays = np.flatnonzero(self.rng.random(n) < 0.5)
            sample[strays, :2] = self.rng.uniform(self.low, self.high, (len(strays), 2))
        return sample

    def _extend(self, node: int, sample: np.ndarray) -> int | None:
        """Add the random activation that comes closer to a sample at the least cost a unit; return its node, or None."""
        swarm = self.problem.swarm
        groups = self.rng.integers(swarm.m, size=TRIES)
        lengths = self.rng.uniform(0, self.reach[groups])
        best, poses = _best_activation(
            self.tree.poses[node], sample, groups, lengths, swarm.slides, swarm.turning_length, self.heading_weight,
            self.move_cost, *self.surroundings,
        )
        if best < 0:
            return None
        return self.tree.add(node, (Activate(int(groups[best]) + 1, float(lengths[best])),), poses)


@kernel()
def _features(poses, heading_weight):
    """Return what distances are taken of: places, and headings as vectors, shape (4 n,)."""
    n = poses.shape[0]
    features = np.empty(4 * n)
    for j in range(n):
        features[4 * j], features[4 * j + 1] = poses[j, 0], poses[j, 1]
        features[4 * j + 2] = heading_weight * np.cos(poses[j, 2])
        features[4 * j + 3] = heading_weight * np.sin(poses[j, 2])
    return features


@kernel()
def _best_activation(
    poses, sample, groups, lengths, slides_of, turning_length, heading_weight, move_cost,
    radius, circles, edges, edge_ends, walls, gap, slack,
):
    """Return (index of the clear activation of the largest worth, or -1; poses after it)."""
    wanted = _features(sample, heading_weight)
    distance = np.linalg.norm(_features(poses, heading_weight) - wanted)
    best, best_worth, best_poses = -1, LEAST_WORTH, poses
    for k in range(len(groups)):
        slides, length = slides_of[groups[k]], lengths[k]
        after = poses.copy()
        for j in range(len(after)):
            if slides[j]:
                after[j, 0] += slides[j] * length * np.cos(poses[j, 2])
                after[j, 1] += slides[j] * length * np.sin(poses[j, 2])
            else:
                after[j, 2] += length / turning_length[j]
        gain = distance - np.linalg.norm(_features(after, heading_weight) - wanted)
        worth = gain / (np.sum(slides) * length + move_cost)
        if worth > best_worth:
            if slide_is_clear(poses, slides, length, radius, circles, edges, edge_ends, walls, gap, slack):
                best, best_worth, best_poses = k, worth, after
    return best, best_poses


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised. Takes any turning radii. A try is an attempt to extend the tree.

    Raises:
        StressbotError: the tolerance is too small for a tree, or a goal has a heading.
    """
    check_tolerance(problem)
    check_free_headings(problem, "rrt")
    limit = Limit(settings)
    search = _Search(problem, rng)
    node, reason = search.run(limit), ""
    if node is None:
        errors = [search.goal_error(k) for k in range(len(search.tree))]
        node = int(np.argmin(errors))
        reason = (
            f"no plan found within {limit}; the closest of {len(errors)} nodes leaves a robot "
            f"{errors[node]:.3g} units from its goal"
        )
    return Outcome(search.tree.primitives_to(node), reason, details={"nodes": len(search.tree)})
