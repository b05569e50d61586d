"""Motions made piece by piece, each checked as it is added, for robots that are to move while all others stay.

The fields h_j and the subgroup primitives let members of other groups swing out and come back. Where to is free: turning
everyone by f_m(beta) before a swing and by f_m(-beta) after it costs driving time only. So each swing is aimed at where
all who swing have room, and cut in parts only if there is no such direction: that keeps plans of large swarms short.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stressbot_planner.collision.clearance import Shapes, gap_at_rest, is_clear, kept_gap, slide_is_clear
from stressbot_planner.collision.shortest_paths import DiscPaths
from stressbot_planner.model.environment import Environment
from stressbot_planner.model.kinematics import path_length, replay
from stressbot_planner.primitives.expansion import TURN, Activate, Extract, Primitive, Turn, TurnAll, expand, rotation_inputs
from stressbot_planner.primitives.radius_sets import Way, alone, closed
from stressbot_planner.primitives.subgroups import BracketSubgroup
from stressbot_planner.problem.definition import EXACT, Problem
from stressbot_planner.system.kernels import kernel

AIMS = 12
"""Directions tried for a swing, evenly spread."""

PARTS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
"""In how many parts a swing is made, tried in turn; more parts swing out less."""

GAP, LEAST_GAP = 0.05, 1e-6
"""Gap that each slide keeps, where bodies are not closer already, and that of primitives added whole, relative to the smallest
`Swarm.girth`; less where goals leave less."""

MARGINS = (0.5, 0.1, 0.02)
"""Gaps that a way of one robot keeps, tried in turn, relative to its `Swarm.girth`."""

PLACES = 8
"""Tried around a goal that cannot be reached itself, on a circle that still counts as the goal."""

NEARLY = 0.9
"""Radius of that circle, and by how much a way may end before its goal, relative to the tolerance."""

SMALL_GROUP = 3
"""Robots of which a single Rot can turn all but those that are to move, whoever these are."""

LARGEST_PLAN = 45_000_000
"""Activations times robots: the poses along a plan take 24 bytes each, and a plan beyond it would take days to execute."""

_NEGLIGIBLE = 1e-9
"""Angles below this (rad) are left out."""


@dataclass(frozen=True, eq=False)
class World:
    """What stays the same for all motions of a problem."""

    problem: Problem

    @cached_property
    def arguments(self) -> tuple:
        """Bodies, shapes, gap and slack, in the order in which the kernels take them."""
        slack = self.problem.slack
        gap = kept_gap(GAP * self.smallest_girth, 0.5 * self._gap_of(self.problem.goals), slack)
        return self.problem.swarm.body_radius, *self.shapes.kernel_arguments, gap, slack

    @cached_property
    def least_gap(self) -> float:
        """What primitives added whole keep, units: as much as starts and goals leave."""
        gap = min(self._gap_of(self.problem.starts[:, :2]), self._gap_of(self.problem.goals))
        return kept_gap(LEAST_GAP * self.smallest_girth, gap, self.problem.slack)

    def _gap_of(self, places: np.ndarray) -> float:
        return gap_at_rest(self.problem.swarm, self.shapes, places)

    @cached_property
    def shapes(self) -> Shapes:
        """The environment."""
        return Shapes.of(self.problem.environment)

    @cached_property
    def smallest_girth(self) -> float:
        """Of all robots, units."""
        return float(self.problem.swarm.girth.min())

    @cached_property
    def spare(self) -> float:
        """How far from a goal a robot may stay, units."""
        return NEARLY * max(self.problem.tolerance - EXACT, 0.0)

    def paths(self, robot: int, target: np.ndarray, poses: np.ndarray, moving: np.ndarray) -> DiscPaths | None:
        """Return ways of a robot (from 0) to a target among all who rest, with the largest margin; None if there are none."""
        swarm, slack = self.problem.swarm, self.problem.slack
        body, in_the_way = swarm.body_radius, ~moving & (swarm.body_radius + swarm.body_radius[robot] > 0)
        circles = np.vstack([self.shapes.circles, np.column_stack([poses[:, :2], body])[in_the_way]])
        for margin in np.multiply(MARGINS, swarm.girth[robot]):
            paths = DiscPaths(target, body[robot], margin, slack, circles, *self.shapes.kernel_arguments[1:])
            if paths.ahead(poses[robot, :2])[1] >= 0:
                return paths
        return None

    def paths_to_goal(self, robot: int, poses: np.ndarray, moving: np.ndarray, rng: np.random.Generator) -> DiscPaths | None:
        """Return ways to a robot's goal, or if there are none, to a place that counts as reaching it."""
        goal = self.problem.goals[robot]
        paths = self.paths(robot, goal, poses, moving)
        if paths is None and self.spare:
            for angle in TURN * (rng.random() + np.arange(PLACES)) / PLACES:
                paths = self.paths(robot, goal + self.spare * np.array([np.cos(angle), np.sin(angle)]), poses, moving)
                if paths is not None:
                    break
        return paths

    def straight_to_goal(self, robot: int) -> DiscPaths:
        """Return ways of a robot that heed nothing."""
        nothing = Shapes.of(Environment())
        body = self.problem.swarm.body_radius[robot]
        return DiscPaths(self.problem.goals[robot], body, 0.0, self.problem.slack, *nothing.kernel_arguments)

    @cached_property
    def turning_radius(self) -> float:
        """r of all robots; where they differ, the mean of what they turn by 1 rad in, units."""
        swarm = self.problem.swarm
        return swarm.common_turning_radius() if swarm.alike else float(swarm.turning_length.mean())

    @cached_property
    def closed_ways(self) -> list[Way]:
        """For each group but G_m the way after which all of its members are back, see `radius_sets`."""
        return [closed(self.problem.swarm, group) for group in range(1, self.problem.swarm.m)]

    def way_alone(self, group: int, robot: int) -> Way:
        """Return the way after which of a group's members only those of a robot's (from 0) set are displaced."""
        key = group, float(self.problem.swarm.turning_length[robot])
        if key not in self._ways_alone:
            self._ways_alone[key] = alone(self.problem.swarm, group, robot)
        return self._ways_alone[key]

    @cached_property
    def _ways_alone(self) -> dict[tuple[int, float], Way]:
        return {}


class Motion:
    """Primitives from some poses. Every method that adds some returns whether they were clear; if not, the motion is spoilt.

    Robots of one turning length are a set. Where there are several, a motion is for robots of one of them, angles are how far
    these turn, and the others turn as they do: h_i and f_i then are ways of `radius_sets`, made of activations.

    Attributes:
        robot: one of the set, from 0.
        poses: at the end, shape (n, 3).
        primitives: so far.
        activations: that the primitives expand to.
        path: distance slid, summed over robots, units.
    """

    def __init__(self, world: World, poses: np.ndarray, robot: int = 0):
        self.world, self.robot = world, robot
        self.poses = np.array(poses)
        self.primitives: list[Primitive] = []
        self.activations, self.path = 0, 0.0

    @property
    def too_long(self) -> bool:
        """Whether the motion has grown beyond what is of use."""
        return self.activations * len(self.poses) > LARGEST_PLAN

    def branch(self) -> "Motion":
        """Return a copy that goes its own way."""
        copy = Motion(self.world, self.poses, self.robot)
        copy._extend(self.primitives, self.activations, self.path)
        return copy

    def append(self, motion: "Motion") -> None:
        """Add a motion that began at the end of this one."""
        self._extend(motion.primitives, motion.activations, motion.path)
        self.poses = motion.poses

    def add(self, primitive: Primitive) -> bool:
        """Add any primitive as it is."""
        swarm = self.world.problem.swarm
        groups, lengths = expand(swarm, [primitive])
        poses = replay(swarm, self.poses, groups, lengths)
        self._extend([primitive], len(groups), path_length(swarm, groups, lengths))
        self.poses = poses[-1].copy()
        return is_clear(swarm, self.world.shapes, poses, groups, lengths, self.world.least_gap)

    def turn_all(self, angle: float) -> None:
        """Add f_m(angle), which cannot collide."""
        angle %= TURN
        if min(angle, TURN - angle) <= _NEGLIGIBLE:
            return
        swarm = self.world.problem.swarm
        if swarm.alike:
            self._extend([TurnAll(angle)], 1, 0.0)
            self.poses[:, 2] = np.mod(self.poses[:, 2] + angle, TURN)  # no digits lost in long motions
        else:
            self._turn_by_length(angle * self._turning_length)

    def _turn_by_length(self, length: float) -> None:
        swarm = self.world.problem.swarm
        self._extend([Activate(swarm.m, length)], 1, 0.0)
        self.poses[:, 2] = np.mod(self.poses[:, 2] + length / swarm.turning_length, TURN)

    @property
    def _turning_length(self) -> float:
        return float(self.world.problem.swarm.turning_length[self.robot])

    def slide(self, group: int, length: float) -> bool:
        """Add f_i(length)."""
        members, swarm = self._members(group), self.world.problem.swarm
        slides = members if swarm.alike else swarm.slides[group - 1]
        if not slide_is_clear(self.poses, slides, length, *self.world.arguments):
            return False
        self._extend([Activate(group, length)], 1, slides.sum() * length)
        heading = self.poses[members, 2]
        self.poses[members, :2] += length * (swarm.pace[members, None] * np.column_stack([np.cos(heading), np.sin(heading)]))
        self.poses[~members, 2] += length / swarm.turning_length[~members]
        return True

    def turn(self, group: int, angle: float) -> bool:
        """Add h_i(angle), aimed."""
        angle %= TURN
        if min(angle, TURN - angle) <= _NEGLIGIBLE:
            return True
        if not self.world.problem.swarm.alike:
            return self._turn_closed(group, angle)
        members = self._members(group)
        swing = angle * self.world.turning_radius / 2
        aim, parts = _aim_swing(self.poses, members, swing, *self.world.arguments)
        if not parts:
            return False
        self.turn_all(aim)
        excursion = swing / parts if parts > 1 else np.inf
        self._extend([Turn(group, angle, excursion)], 4 * parts, 2 * members.sum() * swing)
        self.poses[~members, 2] += angle
        self.turn_all(-aim)
        return True

    def _turn_closed(self, group: int, angle: float) -> bool:
        """Add what is h_i(angle) for the set: the group's way on which all members come back, aimed, in parts if need be."""
        way = self.world.closed_ways[group - 1]
        for parts in PARTS:
            for aim in range(AIMS):
                branch = Motion(self.world, self.poses, self.robot)
                branch.turn_all(TURN * aim / AIMS)
                scale = angle * self._turning_length / (way.slides * parts)
                if all(branch.drive(group, way, scale) for _ in range(parts)):
                    branch.turn_all(-TURN * aim / AIMS - parts * way.turned / self._turning_length)
                    self.append(branch)
                    return True
        return False

    def drive(self, group: int, way: Way, scale: float) -> bool:
        """Add a way of a group, its slides scaled."""
        for step in way.steps:
            if step < 0:
                self._turn_by_length(-step)
            elif not self.slide(group, step * scale):
                return False
        return True

    def _pulse(self, group: int, distance: float) -> bool:
        """Add a slide of the set's members of a group along their headings, units of the fastest; other members come back."""
        if self.world.problem.swarm.alike:
            return self.slide(group, distance)
        way = self.world.way_alone(group, self.robot)
        aside = float(np.angle(way.gain))
        self.turn_all(-aside)
        if not self.drive(group, way, distance / abs(way.gain)):
            return False
        self.turn_all(aside - way.turned / self._turning_length)
        return True

    def orient(self, robots: tuple[int, ...], angles: tuple[float, ...]) -> bool:
        """Add Rot: robots (ids) of the set turn by angles, the others somehow."""
        turns = rotation_inputs(self.world.problem.swarm, robots, angles)
        if not all(self.turn(group, float(angle)) for group, angle in enumerate(turns[:-1], start=1)):
            return False
        self.turn_all(float(turns[-1]))
        return True

    def halve(self, group: int, factors: list[tuple[int, bool]], distance: float) -> bool:
        """Move by distance only those members of a group that are in (True), or not in, each of some other groups.

        The signs of the 2^f pulses f_i(distance / 2^f) are those of `primitives.Subgroup`, in the order of a Gray code:
        one half turn A_j between two pulses, where the nested form takes up to f. The last factor turns twice only.
        """
        pulses = 2 ** len(factors)
        for pulse in range(1, pulses + 1):
            if not self._pulse(group, distance / pulses):
                return False
            if not factors:
                break
            last = pulse == pulses
            other, keep = factors[-1] if last else factors[(pulse & -pulse).bit_length() - 1]
            if not self.turn(other, np.pi):
                return False
            if not keep:
                self.turn_all(np.pi)
        return True

    def move(self, subgroup: BracketSubgroup, distance: float, rng: np.random.Generator) -> "list[Motion]":
        """Return motions that begin with this one and end by moving a subgroup of the set by distance, those that are clear.

        The distance is that of the fastest robots.
        """
        swarm = self.world.problem.swarm
        found = []
        if swarm.alike and len(subgroup.robots) < swarm.group_sizes[subgroup.group - 1] <= SMALL_GROUP:
            branch = self.branch()
            if branch.add(Extract(subgroup.robots, subgroup.group, distance)):
                found.append(branch)
        factors = [(j, True) for j in subgroup.inside] + [(j, False) for j in subgroup.outside]
        branch = self.branch()
        if branch.halve(subgroup.group, [factors[k] for k in rng.permutation(len(factors))], distance):
            found.append(branch)
        return found

    def _members(self, group: int) -> np.ndarray:
        return self.world.problem.swarm.membership[group - 1]

    def _extend(self, primitives: list[Primitive], activations: int, path: float) -> None:
        self.primitives += primitives
        self.activations += activations
        self.path += float(path)


@kernel()
def _aim_swing(poses, members, swing, radius, circles, edges, edge_ends, walls, gap, slack):
    """Return by how much all turn before members swing, and in how many parts; 0 parts if there is no room at all."""
    turned = poses.copy()
    for parts in PARTS:
        for aim in range(AIMS):
            angle = 2.0 * np.pi * aim / AIMS
            turned[:, 2] = poses[:, 2] + angle
            if slide_is_clear(turned, members, swing / parts, radius, circles, edges, edge_ends, walls, gap, slack):
                return angle, parts
    return 0.0, 0
