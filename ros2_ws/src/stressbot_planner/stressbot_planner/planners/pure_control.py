"""`pure_control`: one robot after the other, each alone, (the paper's extreme case 2).

Small-time local controllability makes this complete in practice: with small enough swings nobody else leaves a small
ball around its place, so that planning reduces to the path of one disc among discs at rest.
"""

from collections.abc import Callable

import numpy as np

from stressbot_planner.collision.shortest_paths import DiscPaths
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.headings import check_headings_for_rot, turn_to_goals
from stressbot_planner.planners.limit import Limit
from stressbot_planner.planners.motion import SMALL_GROUP, Motion, World
from stressbot_planner.primitives.expansion import TURN, halvings
from stressbot_planner.primitives.radius_sets import set_of
from stressbot_planner.primitives.subgroups import BracketSubgroup
from stressbot_planner.problem.definition import Problem

TRIES = 24
"""Relative headings, groups and orders of factors tried for each leg: who swings where is a matter of chance."""

ENOUGH = 4
"""Number of collision-free ways of which the shortest is taken, in small groups; in large ones all are about as long."""

SPLITS = 5
"""How often a leg is cut in halves before it is given up."""

OTHERS = 0.7
"""Share of tries to make way in which another robot moves aside, not the one that has no way."""

ASIDE = (3.0, 5.0, 7.0, 9.0, 12.0)
"""How far a robot moves aside, tried in turn, in the largest `Swarm.girth`."""


class _Swarm:
    """The motion planned so far."""

    def __init__(self, problem: Problem, rng: np.random.Generator, out_of_time: Callable[[], bool]):
        self.problem, self.rng, self.out_of_time = problem, rng, out_of_time
        self.world = World(problem)
        self.motion = Motion(self.world, problem.starts)
        self.enough = ENOUGH if problem.swarm.group_sizes.max() <= SMALL_GROUP else 1
        self.missing = [int(robot) for robot in np.flatnonzero(self._errors() > problem.tolerance)]

    @property
    def poses(self) -> np.ndarray:
        return self.motion.poses

    def _errors(self) -> np.ndarray:
        return np.hypot(*(self.poses[:, :2] - self.problem.goals).T)

    def move_all(self) -> bool:
        """Move every missing robot that has a way to its goal there; return whether there was any."""
        before = len(self.missing)
        for robot in list(self.missing):
            if self.out_of_time() or self.motion.too_long:
                break
            way = self.way_to_goal(robot)
            if way is not None and self.follow(robot, way):
                self.missing.remove(robot)
        return len(self.missing) < before

    def make_way(self) -> bool:
        """Move a robot aside: the nearest one to the way of a missing robot, or that robot itself; return whether one moved.

        A robot at its goal that moves becomes a missing one.
        """
        body = self.problem.swarm.body_radius
        robot = int(self.rng.choice(self.missing))
        others = np.flatnonzero((np.arange(len(body)) != robot) & (body + body[robot] > 0))
        if self.rng.random() < OTHERS and len(others):
            surroundings = self.problem.slack, *self.world.shapes.kernel_arguments
            way = DiscPaths(self.problem.goals[robot], body[robot], 0.0, *surroundings).way(self.poses[robot, :2])
            if way is not None:
                robot = int(others[np.argmin(_distances_from(way, self.poses[others, :2]) - body[others])])
        for reach in ASIDE:
            if self.out_of_time():
                return False
            angle = self.rng.uniform(0, TURN)
            place = self.poses[robot, :2] + reach * self.problem.swarm.girth.max() * np.array([np.cos(angle), np.sin(angle)])
            way = self.way(robot, place)
            if way is not None and self.follow(robot, way):
                if robot not in self.missing:
                    self.missing.append(robot)
                return True
        return False

    def way(self, robot: int, target: np.ndarray) -> np.ndarray | None:
        """Return waypoints of a robot (from 0) to target among all others at rest."""
        paths = self.world.paths(robot, target, self.poses, self._only(robot))
        return paths and paths.way(self.poses[robot, :2])

    def way_to_goal(self, robot: int) -> np.ndarray | None:
        """Return waypoints of a robot to where its goal counts as reached."""
        paths = self.world.paths_to_goal(robot, self.poses, self._only(robot), self.rng)
        if paths is None:
            return None
        way = paths.way(self.poses[robot, :2])
        if way is None:
            return None
        last = way[-1] - way[-2]
        length = float(np.hypot(*last))
        still = float(np.hypot(*(way[-1] - self.problem.goals[robot])))
        return np.vstack([way[:-1], way[-1] - last * min(max(self.world.spare - still, 0.0), length) / length])

    def _only(self, robot: int) -> np.ndarray:
        return np.arange(self.problem.swarm.n) == robot

    def follow(self, robot: int, way: np.ndarray) -> bool:
        """Move a robot along waypoints; return whether all of it was possible without a collision."""
        return all(self._leg(robot, point, SPLITS) for point in way[1:])

    def _leg(self, robot: int, point: np.ndarray, splits: int) -> bool:
        found: list[Motion] = []
        for attempt in range(TRIES):
            if self.out_of_time():
                return False
            found += self._slides(robot, point, shuffle=attempt > 0)
            if len(found) >= self.enough:
                break
        if found:
            best = min(found, key=lambda motion: motion.path)
            self.motion.append(best)
            return True
        middle = (self.poses[robot, :2] + point) / 2
        return splits > 0 and self._leg(robot, middle, splits - 1) and self._leg(robot, point, splits - 1)

    def _slides(self, robot: int, point: np.ndarray, shuffle: bool) -> list[Motion]:
        """Return clear ways to move a robot straight to a point, after a random turn of others if wanted."""
        swarm = self.problem.swarm
        motion = Motion(self.world, self.poses, robot)
        groups = np.flatnonzero(swarm.membership[:, robot]) + 1
        if shuffle and not motion.turn(int(self.rng.integers(1, swarm.m)), float(self.rng.uniform(0, TURN))):
            return []
        group = int(self.rng.choice(groups) if shuffle else groups[0])
        x, y, heading = motion.poses[robot]
        way = point - (x, y)
        distance = float(np.hypot(*way)) / float(swarm.pace[robot])
        motion.turn_all(float(np.arctan2(way[1], way[0]) - heading))
        inside, outside = halvings(swarm, group, robot + 1, set_of(swarm, robot) & swarm.membership[group - 1])
        return motion.move(BracketSubgroup(group, inside, outside, (robot + 1,)), distance, self.rng)


def _distances_from(way: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (k, 2) from a polyline (w, 2)."""
    nearest = np.full(len(points), np.inf)
    for a, b in zip(way[:-1], way[1:], strict=True):
        along = b - a
        share = np.clip((points - a) @ along / max(along @ along, 1e-300), 0, 1)
        nearest = np.minimum(nearest, np.hypot(*(points - a - share[:, None] * along).T))
    return nearest


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return a plan that moves one robot at a time; the objective is not optimised.

    In a try each robot that has a way goes to its goal; if none has, one moves aside.

    Raises:
        StressbotError: headings at goals are of robots of different turning radii.
    """
    check_headings_for_rot(problem)
    limit = Limit(settings)
    swarm = _Swarm(problem, rng, limit.late)
    fewest, best = list(swarm.missing), ()
    asides = 0
    while swarm.missing:
        if swarm.motion.too_long or not limit.another():
            within = f"{swarm.motion.activations} activations" if swarm.motion.too_long else limit
            robots = ", ".join(str(robot + 1) for robot in sorted(fewest))
            reason = f"no plan found within {within}, {asides} times a robot moved aside; not at their goals: robots {robots}"
            return Outcome(best, reason, details={"moved_aside": asides})
        if not swarm.move_all():
            asides += swarm.make_way()
        if len(swarm.missing) < len(fewest):
            fewest, best = list(swarm.missing), tuple(swarm.motion.primitives)
    reason = turn_to_goals(swarm.motion, rng, limit)
    return Outcome(tuple(swarm.motion.primitives), reason, details={"moved_aside": asides})
