"""`pure_control`: one robot after the other, each alone, (the paper's extreme case 2).

Small-time local controllability makes this complete in practice: with a small enough excursion nobody else leaves a
small ball around its place, so that planning reduces to the path of one disc among discs at rest.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.collision import Shapes, is_clear
from stressbot_planner.errors import StressbotError
from stressbot_planner.kinematics import path_length, replay
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.disc_path import shortest_path
from stressbot_planner.primitives import TURN, Extract, Isolate, Primitive, Turn, TurnAll, expand
from stressbot_planner.problem import EXACT, Problem

MARGINS = (0.5, 0.25, 0.1, 0.02)
"""Gaps that a path keeps, tried in turn, relative to the body radius."""

EXCURSIONS = (np.inf, 1.5, 0.75, 0.3, 0.1, 0.03)
"""How far others may swing out, tried in turn, relative to the turning radius. Time grows as they shrink."""

TRIES = 12
"""Relative headings tried for each excursion: who swings where is a matter of chance."""

ENOUGH = 4
"""Of so many collision-free ways the shortest is taken."""

SPLITS = 3
"""A leg is cut in halves this many times before excursions smaller than `LEAST_WHOLE` are tried."""

LEAST_WHOLE = 0.75

MAX_ACTIVATIONS = 200_000
"""More would take days to execute and gigabytes to check."""


class _Slide(NamedTuple):
    """A way to move one robot along a straight line."""

    primitives: list[Primitive]
    activations: int
    cost: float
    poses: np.ndarray


class _Swarm:
    """The motion planned so far."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.shapes = Shapes.of(problem.environment)
        self.poses = problem.starts
        self.primitives: list[Primitive] = []
        self.activations = 0

    def path(self, robot: int, target: np.ndarray) -> np.ndarray | None:
        """Return waypoints of a robot (from 0) to target among all others at rest."""
        body = self.problem.swarm.body_radius
        others = np.arange(len(body)) != robot
        discs = np.column_stack([self.poses[others, :2], body[others]])
        circles = np.vstack([self.shapes.circles, discs])
        for margin in MARGINS:
            way = shortest_path(
                self.poses[robot, :2], target, body[robot], margin * body[robot], circles, *self.shapes.kernel_arguments[1:]
            )
            if way is not None:
                return way
        return None

    def path_to_goal(self, robot: int) -> np.ndarray | None:
        """Return waypoints of a robot to where its goal counts as reached."""
        way = self.path(robot, self.problem.goals[robot])
        if way is None:
            return None
        last = way[-1] - way[-2]
        length = float(np.hypot(*last))
        spare = 0.9 * min(max(self.problem.tolerance - EXACT, 0.0), length)
        return np.vstack([way[:-1], way[-1] - last * spare / length])

    def follow(self, robot: int, way: np.ndarray, rng: np.random.Generator) -> bool:
        """Move a robot along waypoints; return whether all of it was possible without a collision."""
        return all(self._leg(robot, point, rng, SPLITS) for point in way[1:])

    def _leg(self, robot: int, point: np.ndarray, rng: np.random.Generator, splits: int) -> bool:
        r = self.problem.swarm.common_turning_radius()
        for excursion in EXCURSIONS:
            if splits and excursion < LEAST_WHOLE:
                middle = (self.poses[robot, :2] + point) / 2
                return self._leg(robot, middle, rng, splits - 1) and self._leg(robot, point, rng, splits - 1)
            found: list[_Slide] = []
            for attempt in range(TRIES):
                found += self._slides(robot, point, excursion * r, rng if attempt else None)
                if len(found) >= ENOUGH:
                    break
            if found:
                best = min(found, key=lambda slide: slide.cost)
                self.primitives += best.primitives
                self.activations += best.activations
                self.poses = best.poses
                return True
        return False

    def _slides(self, robot: int, point: np.ndarray, excursion: float, rng: np.random.Generator | None) -> list["_Slide"]:
        """Return collision-free ways to move a robot straight to a point, after a random turn of others if given rng."""
        swarm = self.problem.swarm
        groups = np.flatnonzero(swarm.membership[:, robot]) + 1
        if rng is None:
            shuffle, group = [], int(groups[0])
        else:
            shuffle = [Turn(int(rng.integers(1, swarm.m)), float(rng.uniform(0, TURN)), excursion)]
            group = int(rng.choice(groups))
        x, y, heading = replay(swarm, self.poses, *expand(swarm, shuffle))[-1, robot]
        way = point - (x, y)
        distance = float(np.hypot(*way))
        aim = TurnAll(float(np.arctan2(way[1], way[0]) - heading) % TURN)
        found = []
        for alone in (Extract((robot + 1,), group, distance, excursion), Isolate(robot + 1, distance, group, excursion)):
            primitives = [*shuffle, aim, alone]
            try:
                groups, lengths = expand(swarm, primitives)
            except StressbotError:  # too many activations
                continue
            if self.activations + len(groups) > MAX_ACTIVATIONS:
                continue
            poses = replay(swarm, self.poses, groups, lengths)
            if is_clear(swarm, self.shapes, poses, groups, lengths, 1e-6 * self.problem.swarm.body_radius.min()):
                found.append(_Slide(primitives, len(groups), path_length(swarm, groups, lengths), poses[-1]))
        return found


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return a plan that moves one robot at a time; the objective is not optimised.

    Raises:
        StressbotError: turning radii differ between robots.
    """
    problem.swarm.common_turning_radius()
    begin = settings.clock()
    swarm = _Swarm(problem)
    missing = set(np.flatnonzero(np.hypot(*(problem.starts[:, :2] - problem.goals).T) > problem.tolerance).tolist())
    parked = 0
    while missing:
        if settings.clock() - begin > settings.time_limit:
            return _failure(swarm, missing, f"no way found within {settings.time_limit:g} s")
        moved = _move_one(swarm, missing, rng)
        if moved is not None:
            missing.remove(moved)
            continue
        parked += 1
        if not _park_one(swarm, missing, rng):
            return _failure(swarm, missing, "nobody can move without a collision")
    return Outcome(tuple(swarm.primitives), details={"parked": parked})


def _move_one(swarm: _Swarm, missing: set[int], rng: np.random.Generator) -> int | None:
    """Move the first robot that has a way to its goal there; return it, or None if there is no such robot."""
    for robot in sorted(missing):
        way = swarm.path_to_goal(robot)
        if way is not None and swarm.follow(robot, way, rng):
            return robot
    return None


def _park_one(swarm: _Swarm, missing: set[int], rng: np.random.Generator) -> bool:
    """Move some robot out of the way, to a random free place; return whether one could move.

    A robot at its goal that moves becomes a missing one.
    """
    problem = swarm.problem
    places = np.vstack([problem.starts[:, :2], problem.goals])
    low, high = places.min(axis=0) - 3 * problem.swarm.body_radius.max(), places.max(axis=0) + 3 * problem.swarm.body_radius.max()
    for _ in range(50):
        robot = int(rng.integers(problem.swarm.n))
        way = swarm.path(robot, rng.uniform(low, high))
        if way is not None and swarm.follow(robot, way, rng):
            missing.add(robot)
            return True
    return False


def _failure(swarm: _Swarm, missing: set[int], why: str) -> Outcome:
    robots = ", ".join(str(robot + 1) for robot in sorted(missing))
    return Outcome(tuple(swarm.primitives), f"{why}; not at their goals: robots {robots}")
