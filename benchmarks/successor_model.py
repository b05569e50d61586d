"""The decisions of the benchmark of a learned switcher (docs/successor.md), on its kinematics, without its networks.

Robots turn on the spot, either way, as the five inputs h_1 … h_4, f_5 allow: headings change by A t. In a coarse step all turn so
that the members of a subgroup get nearest to their goals, then these alone slide by one unit. In a precise step every robot that is
not at its goal is driven on its own, one after the other; its turns turn the others by the least inputs that give them.
"""

from functools import cached_property
from math import pi
from typing import NamedTuple

import numpy as np

from stressbot_planner.beam_search.cost_to_go import DistanceMaps, distance_maps, way_left
from stressbot_planner.collision.clearance import Shapes, environment_gap, moving_points_gap
from stressbot_planner.primitives.expansion import (
    TURN,
    Isolate,
    Subgroup,
    Turn,
    TurnAll,
    expand,
    merge,
    orientation_matrix,
)
from stressbot_planner.primitives.subgroups import BracketSubgroup, subgroups
from stressbot_planner.problem.definition import Problem
from stressbot_planner.system.kernels import kernel

THRESHOLD = 0.3
"""From its goal a robot has reached it, units."""

SAFE = 0.3
"""Gap that a coarse step has to keep, without noise, units."""

MOVE = 1.0
"""Of a coarse step, units."""

COARSE_COST = {1: 8.8, 2: 52.7}
"""By the order of the bracket that moves the subgroup: seven robots, or three and four."""

SUBSTEPS, TURN_STEP, SLIDE_STEP = 5, 0.3, 0.15
"""Of a robot in a precise step: how many, rad and units each: 0.3 s at 1 rad/s and 0.5 units/s."""

SUBSTEP_COST = 11.57

WAY_COST = SUBSTEP_COST / SLIDE_STEP
"""Of a unit of one robot's way by precise steps."""

LOOK, FAN, NEAR = SUBSTEPS * SLIDE_STEP, pi / 8, 0.02
"""How far a robot looks ahead in a precise step, units, in directions so far apart, and what gap it keeps."""

AIMED = 0.05
"""rad off its direction up to which it slides."""

ITERATIONS, SETTLED = 60, 1e-4
"""Of the inputs of a coarse step, and the change, rad, at which they are good."""

PRECISE = 22
"""The action after the 22 coarse ones."""


class Step(NamedTuple):
    """What an action leads to.

    Attributes:
        poses: shape (n, 3), units and rad.
        gap: smallest gap of robots that slide, at any time, units.
        turns: inputs of a coarse step, shape (5,), rad.
        ways: of a precise step, what each robot turned and slid, shape (n, 2), rad and units.
    """

    poses: np.ndarray
    gap: float
    turns: np.ndarray | None = None
    ways: np.ndarray | None = None


class Decisions:
    """What can be decided in one episode.

    Attributes:
        coarse: subgroups of brackets of order 1 and 2, by action.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        swarm = problem.swarm
        self.coarse: list[BracketSubgroup] = [group for order in COARSE_COST for group in subgroups(swarm, order)]
        self.members = np.array([np.isin(np.arange(1, swarm.n + 1), group.robots) for group in self.coarse])
        self._matrix = orientation_matrix(swarm)
        self._inverse = np.linalg.pinv(self._matrix)
        self._coupling = self._matrix @ self._matrix.T / np.sum(self._matrix**2, axis=1)
        self._shapes = Shapes.of(problem.environment)
        self._goals = np.ascontiguousarray(problem.goals)

    @cached_property
    def maps(self) -> DistanceMaps:
        """Ways around discs."""
        return distance_maps(self._shapes, self.problem.swarm.body_radius, self.problem.starts[:, :2], self.problem.goals)

    def away(self, poses: np.ndarray) -> np.ndarray:
        """Return which robots are not at their goals, shape (n,)."""
        return np.hypot(*(poses[:, :2] - self._goals).T) > THRESHOLD

    def cost(self, action: int, poses: np.ndarray) -> float:
        """Return what an action costs from here."""
        if action == PRECISE:
            return SUBSTEP_COST * SUBSTEPS * int(self.away(poses).sum())
        return COARSE_COST[self.coarse[action].order]

    def left(self, poses: np.ndarray) -> float:
        """Return what is left: the ways of robots that are not at their goals, by precise steps."""
        return WAY_COST * float(self.maps.ways_left(poses[:, :2])[self.away(poses)].sum())

    def step(self, action: int, poses: np.ndarray, jumps: np.ndarray | None = None) -> Step:
        """Return where an action leads, each heading (n,) of those that slide off by some jump as a coarse slide begins."""
        if action == PRECISE:
            after, ways, gap = _precise(
                poses, self._goals, self.away(poses), self._coupling, self.problem.swarm.body_radius, *self.maps[:3],
                *self._shapes.kernel_arguments,
            )
            return Step(after, gap, ways=ways)
        members = self.members[action]
        turns = _inputs(poses, self._goals, members, self._matrix, self._inverse)
        after = poses.copy()
        after[:, 2] += self._matrix @ turns
        if jumps is not None:
            after[members, 2] += jumps[members]
        gap = _slide(after, members, MOVE, self.problem.swarm.body_radius, *self._shapes.kernel_arguments)
        after[:, 2] = (after[:, 2] + pi) % TURN - pi
        return Step(after, gap, turns)

    def activations(self, action: int, step: Step) -> tuple[int, float]:
        """Return into how many activations a step that was made expands on the substrate, and their length, units.

        By the primitives of this project. A slide restores all headings but its members'; a robot's turns and slides in a precise
        step are taken together.
        """
        if step.turns is not None:
            group = self.coarse[action]
            slide = Subgroup(group.group, MOVE, group.inside, group.outside)
            return self._expanded([*self._turned(step.turns), slide, Turn(group.group, -self._turn_of(MOVE))])
        count, length = 0, 0.0
        for row, (angle, way) in enumerate(step.ways if step.ways is not None else ()):
            moves: list = self._turned(angle * self._matrix[row] / (self._matrix[row] @ self._matrix[row])) if angle else []
            if way:
                group = int(np.flatnonzero(self.problem.swarm.membership[:, row])[0]) + 1
                moves += [Isolate(row + 1, way, group), Turn(group, -self._turn_of(way))]
            more, longer = self._expanded(moves)
            count, length = count + more, length + longer
        return count, length

    def _turn_of(self, length: float) -> float:
        return length / self.problem.swarm.common_turning_radius()

    def _turned(self, turns: np.ndarray) -> list:
        turning = [Turn(k + 1, float(angle) % TURN) for k, angle in enumerate(turns[:-1]) if abs(angle) > 1e-9]
        return [*turning, TurnAll(float(turns[-1]) % TURN)]

    def _expanded(self, primitives: list) -> tuple[int, float]:
        swarm = self.problem.swarm
        groups, lengths = expand(swarm, primitives)
        merged = merge(swarm, list(zip(groups.tolist(), lengths.tolist(), strict=True)))
        return len(merged), sum(length for _, length in merged)


@kernel()
def _inputs(poses, goals, members, matrix, inverse):
    """Return t (k,): with headings turned by A t, the members' distances from their goals after a slide add up to a local minimum.

    From the least-squares turn of all robots to their goals. Majorise and minimise: the distance grows with the square of the
    angle to the goal, at most, by its slope there.
    """
    n, k = matrix.shape
    aim, distance, wanted = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        dx, dy = goals[i, 0] - poses[i, 0], goals[i, 1] - poses[i, 1]
        aim[i], distance[i] = np.arctan2(dy, dx), np.hypot(dx, dy)
        wanted[i] = (aim[i] - poses[i, 2] + np.pi) % (2 * np.pi) - np.pi
    inputs = inverse @ wanted
    for _ in range(ITERATIONS):
        normal, right = 1e-9 * np.eye(k), np.zeros(k)
        for i in range(n):
            if members[i]:
                off = poses[i, 2] - aim[i]
                for c in range(k):
                    off += matrix[i, c] * inputs[c]
                off = (off + np.pi) % (2 * np.pi) - np.pi
                ends = distance[i] ** 2 - 2 * MOVE * distance[i] * np.cos(off) + MOVE**2
                slope = MOVE * distance[i] / np.sqrt(max(ends, 1e-12))
                weight = slope * (np.sin(off) / off if abs(off) > 1e-6 else 1.0)
                for c in range(k):
                    right[c] -= weight * off * matrix[i, c]
                    for d in range(k):
                        normal[c, d] += weight * matrix[i, c] * matrix[i, d]
        change = np.linalg.solve(normal, right)
        inputs += change
        if np.abs(change).max() < SETTLED:
            break
    return inputs


@kernel()
def _slide(poses, members, length, body, circles, edges, edge_ends, walls):
    """Let members slide along their headings, all at once and in place; return the smallest gap of one on the way."""
    n = len(body)
    ux, uy = np.cos(poses[:, 2]) * members, np.sin(poses[:, 2]) * members
    best = np.inf
    for i in range(n):
        if members[i]:
            gap = environment_gap(poses[i, 0], poses[i, 1], ux[i], uy[i], length, body[i], circles, edges, edge_ends, walls)[0]
            best = min(best, gap)
            for j in range(n):
                if j < i or (j > i and not members[j]):
                    dx, dy = poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]
                    best = min(best, moving_points_gap(dx, dy, ux[i] - ux[j], uy[i] - uy[j], length)[0] - body[i] - body[j])
    poses[:, 0] += length * ux
    poses[:, 1] += length * uy
    return best


@kernel()
def _alone(i, direction, length, poses, body, circles, edges, edge_ends, walls):
    """Return the smallest gap of one robot that slides while all others stand."""
    ux, uy = np.cos(direction), np.sin(direction)
    best = environment_gap(poses[i, 0], poses[i, 1], ux, uy, length, body[i], circles, edges, edge_ends, walls)[0]
    for j in range(len(body)):
        if j != i:
            gap, _ = moving_points_gap(poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1], ux, uy, length)
            best = min(best, gap - body[i] - body[j])
    return best


@kernel()
def _precise(poses, goals, away, coupling, body, low, size, excess, circles, edges, edge_ends, walls):
    """Drive robots that are away, one after the other; return poses (n, 3), what each turned and slid (n, 2), the smallest gap.

    Each takes the direction next to that of its shortest way around discs in which it can slide, turns there and slides.
    """
    poses, ways, smallest = poses.copy(), np.zeros((len(body), 2)), np.inf
    for i in range(len(body)):
        if not away[i]:
            continue
        value, gx, gy = way_left(i, poses[i, 0], poses[i, 1], low, size, excess, goals)
        ahead = np.arctan2(-gy, -gx)
        reach = min(LOOK, np.hypot(goals[i, 0] - poses[i, 0], goals[i, 1] - poses[i, 1]))
        keep = min(NEAR, _alone(i, ahead, 0.0, poses, body, circles, edges, edge_ends, walls))
        direction, found = ahead, False
        for fan in range(16):
            direction = ahead + (fan + 1) // 2 * FAN * (1 - 2 * (fan % 2))
            if _alone(i, direction, reach, poses, body, circles, edges, edge_ends, walls) >= keep - 1e-9:
                found = True
                break
        if not found:
            continue
        for _ in range(SUBSTEPS):
            off = (direction - poses[i, 2] + np.pi) % (2 * np.pi) - np.pi
            turn = min(max(off, -TURN_STEP), TURN_STEP)
            for j in range(len(body)):
                poses[j, 2] += coupling[j, i] * turn  # at most as much as its own
            ways[i, 0] += turn
            if abs(off - turn) < AIMED and ways[i, 1] < reach:
                length = min(SLIDE_STEP, reach - ways[i, 1])
                gap = _alone(i, poses[i, 2], length, poses, body, circles, edges, edge_ends, walls)
                if gap < 0.0:
                    break
                smallest = min(smallest, gap)
                poses[i, 0] += length * np.cos(poses[i, 2])
                poses[i, 1] += length * np.sin(poses[i, 2])
                ways[i, 1] += length
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return poses, ways, smallest
