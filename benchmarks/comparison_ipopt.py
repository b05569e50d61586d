"""IPOPT through CasADi on our problems, as a user would set it up: durations of a cyclic group order are the variables.

Exact derivatives are CasADi's; its graph of the motion is built once. First without clearances, then again and again with those
added that the last solution violates, from where that ended; then the next start, since any one may end in a local minimum.
"""

import casadi
import numpy as np

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.kinematics import replay
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.bounds import group_lengths
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Plan

ACTIVATIONS_PER_ROBOT = 10
"""60 for six robots."""

ROUNDS = 8
ITERATIONS = 200
MARGIN = 0.02
"""Clearances are asked for with this margin, units, so that the solver's tolerance costs no validity."""

TURNING_COST = 0.01
"""Cost of a unit of G_m's length in a path, which counts none."""

OPTIONS = {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS, "tol": 1e-6, "constr_viol_tol": 1e-8}


class _Program:
    """The nonlinear program of one group order: its symbols are made once, its clearances grow."""

    def __init__(self, problem: Problem, groups: np.ndarray, cost: np.ndarray):
        swarm = problem.swarm
        self.problem, self.groups, self.count = problem, groups, len(groups)
        self.t = casadi.SX.sym("t", self.count)
        x, y = [casadi.SX(problem.starts[:, axis]) for axis in (0, 1)]
        heading = casadi.SX(problem.starts[:, 2])
        self.places, self.directions = [casadi.horzcat(x, y)], []
        for k, group in enumerate(groups):
            slides = casadi.DM(swarm.slides[group - 1])
            direction = casadi.horzcat(slides * casadi.cos(heading), slides * casadi.sin(heading))
            self.directions.append(direction)
            self.places.append(self.places[-1] + self.t[k] * direction)
            heading = heading + self.t[k] * casadi.DM((swarm.slides[group - 1] == 0) / swarm.turning_length)
        self.cost = casadi.dot(casadi.DM(cost[groups - 1]), self.t)
        self.goals = casadi.vec(self.places[-1] - casadi.DM(problem.goals))
        self.highest = np.where(groups == swarm.m, 2 * np.pi * swarm.turning_length.max(), np.inf)
        self.clearances: dict[tuple, casadi.SX] = {}

    def solve(self, guess: np.ndarray, seconds: float) -> np.ndarray:
        """Return where IPOPT ends, from a guess (K,)."""
        gaps = casadi.vertcat(*self.clearances.values())
        program = {"x": self.t, "f": self.cost, "g": casadi.vertcat(self.goals, gaps)}
        options = {"print_time": False, "ipopt": OPTIONS | {"max_cpu_time": seconds}}
        solver = casadi.nlpsol("solver", "ipopt", program, options)
        goals, more = self.goals.shape[0], gaps.shape[0]
        result = solver(
            x0=guess, lbx=0.0, ubx=self.highest,
            lbg=np.zeros(goals + more), ubg=np.append(np.zeros(goals), np.full(more, np.inf)),
        )
        return np.maximum(np.array(result["x"]).ravel(), 0.0)

    def add_violated(self, t: np.ndarray) -> bool:
        """Add the clearances that durations (K,) violate; return whether there are any."""
        shapes, body = Shapes.of(self.problem.environment), self.problem.swarm.body_radius
        poses = replay(self.problem.swarm, self.problem.starts, self.groups, t)
        before, after = poses[:-1, :, :2], poses[1:, :, :2]
        found = []
        first, second = np.triu_indices(self.problem.swarm.n, 1)
        gaps = _closest(before[:, first] - before[:, second], after[:, first] - after[:, second]) - body[first] - body[second]
        found += [("robots", k, first[p], second[p]) for k, p in np.argwhere(gaps < MARGIN / 2)]
        for index, (cx, cy, radius) in enumerate(shapes.circles):
            gaps = _closest(before - (cx, cy), after - (cx, cy)) - body - radius
            found += [("circle", k, j, index) for k, j in np.argwhere(gaps < MARGIN / 2)]
        for wall, bound in enumerate(shapes.walls):
            gaps = (1 - 2 * (wall % 2)) * (after[:, :, wall // 2] - bound) - body
            found += [("wall", k, j, wall) for k, j in np.argwhere(gaps < MARGIN / 2)]
        for key in found:
            self.clearances.setdefault(key, self._clearance(shapes, *key))
        return bool(found)

    def _clearance(self, shapes: Shapes, kind: str, k: int, j: int, other: int) -> casadi.SX:
        """Return what is to be >= 0: a squared distance less the squared one of a touch, closest approach along the slide."""
        body = self.problem.swarm.body_radius
        if kind == "wall":
            return (1 - 2 * (other % 2)) * (self.places[k + 1][j, other // 2] - shapes.walls[other]) - body[j] - MARGIN
        apart, relative = self.places[k][j, :], self.directions[k][j, :]
        if kind == "robots":
            apart, relative = apart - self.places[k][other, :], relative - self.directions[k][other, :]
            least = body[j] + body[other] + MARGIN
        else:
            apart = apart - casadi.DM(shapes.circles[other, :2]).T
            least = body[j] + shapes.circles[other, 2] + MARGIN
        along = -casadi.dot(apart, relative) / (casadi.dot(relative, relative) + 1e-12)
        closest = apart + casadi.fmin(casadi.fmax(along, 0), self.t[k]) * relative
        return casadi.dot(closest, closest) - least**2


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the best plan of as many starts as fit into the time limit."""
    begin = settings.clock()
    swarm = problem.swarm
    weight = settings.time_weight
    bounds = problem.lower_bounds
    path = np.maximum(swarm.slides.sum(axis=1), TURNING_COST)
    cost = (1 - weight) / bounds.path_length * path + weight / bounds.execution_time / swarm.speed
    lengths = group_lengths(swarm, problem.starts, problem.goals, cost)
    lengths[-1] = 2 * np.pi * float(swarm.turning_length.mean())
    cycles = -(-ACTIVATIONS_PER_ROBOT * swarm.n // swarm.m)
    groups = np.tile(np.arange(1, swarm.m + 1), cycles)
    program = _Program(problem, groups, cost)
    best, least, history, starts = None, np.inf, [], 0
    while True:
        program.clearances.clear()
        t = lengths[groups - 1] / cycles * rng.uniform(0.5, 1.5, len(groups))
        starts += 1
        for _ in range(ROUNDS):
            left = settings.time_limit - (settings.clock() - begin)
            if left <= 0 or settings.first and best:
                return Outcome(best, "" if best else "no plan found", history=tuple(history), details={"starts": starts})
            t = program.solve(t, left)
            kept = t > 1e-7
            found = Plan(problem, as_primitives(groups[kept], t[kept]))
            if found.valid:
                value = float(cost[groups - 1] @ t)
                if value < least:
                    best, least = found.primitives, value
                    history.append((settings.clock() - begin, found.path_length, found.execution_time))
                break
            if not program.add_violated(t):
                break


def _closest(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the least norm on the segment from before (…, 2) to after (…, 2)."""
    step = after - before
    along = -np.sum(before * step, axis=-1) / np.maximum(np.sum(step * step, axis=-1), 1e-300)
    return np.linalg.norm(before + np.clip(along, 0, 1)[..., None] * step, axis=-1)
