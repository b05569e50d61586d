"""OMPL's control-space RRT on our problems, as a user of its Python wheel would set it up.

A control is a group and a length, a whole activation is one propagation, checked along its way by our own kernel. The wheel cannot
make directed control samplers (their constructors are missing), so that an extension is one random control. KPIECE1 and EST, which
the wheel has too, solved one and none of six runs of the paper's problems in 15 s.
"""

import numpy as np
from numba import njit
from ompl import base, control, util

from stressbot_planner.collision.clearance import Shapes, slide_is_clear
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.trees.tree import sampling_box
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.definition import Problem

HEADING_WEIGHT = 1.0
"""Turning radii that a unit vector of heading counts as. With 0.2 five of six runs fail within 15 s, with 0.5
the six take up to 2.2 s, with 1 up to 0.4 s."""

GOAL_BIAS = 0.5
REACH = 5.0
"""Longest slide, turning radii; G_m turns by up to 2 pi."""

OUTSIDE = 1e9
"""First coordinate of a state that touches something on its way."""


class _Goals(base.GoalSampleableRegion):
    """All robots within tolerance of their goals, whatever their headings."""

    def __init__(self, information, problem: Problem, weight: float, rng: np.random.Generator):
        super().__init__(information)
        self.goals, self.weight, self.rng = problem.goals, weight, rng
        self.setThreshold(problem.tolerance)

    def distanceGoal(self, state) -> float:
        return max(float(np.hypot(state[4 * j] - x, state[4 * j + 1] - y)) for j, (x, y) in enumerate(self.goals))

    def sampleGoal(self, state) -> None:
        headings = self.rng.uniform(-np.pi, np.pi, len(self.goals))
        for j, ((x, y), heading) in enumerate(zip(self.goals, headings, strict=True)):
            state[4 * j], state[4 * j + 1] = float(x), float(y)
            state[4 * j + 2], state[4 * j + 3] = self.weight * float(np.cos(heading)), self.weight * float(np.sin(heading))

    def maxSampleCount(self) -> int:
        return 1_000_000


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found; the objective is not optimised."""
    begin = settings.clock()
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    swarm = problem.swarm
    radius = float(swarm.turning_radius.mean())
    weight, count = HEADING_WEIGHT * radius, 4 * swarm.n
    space = base.RealVectorStateSpace(count)
    space.setBounds(_bounds(problem, weight))
    controls = control.RealVectorControlSpace(space, 2)
    unit = base.RealVectorBounds(2)
    unit.setLow(0.0)
    unit.setHigh(1.0)
    controls.setBounds(unit)
    setup = control.SimpleSetup(controls)
    information = setup.getSpaceInformation()
    information.setPropagationStepSize(1.0)
    information.setMinMaxControlDuration(1, 1)
    reach = np.append(np.full(swarm.m - 1, REACH * radius), 2 * np.pi * radius)
    surroundings = swarm.body_radius, *Shapes.of(problem.environment).kernel_arguments

    def propagate(state, chosen, _duration, result):
        group = min(int(chosen[0] * swarm.m), swarm.m - 1)
        values = np.array([state[k] for k in range(count)])
        after = _after(values, swarm.slides[group], chosen[1] * reach[group], swarm.turning_length, weight, *surroundings)
        for k, value in enumerate(after.tolist()):
            result[k] = value

    setup.setStatePropagator(propagate)
    setup.setStateValidityChecker(lambda state: state[0] < OUTSIDE)
    start = space.allocState()
    for j, (x, y, heading) in enumerate(problem.starts):
        start[4 * j], start[4 * j + 1] = float(x), float(y)
        start[4 * j + 2], start[4 * j + 3] = weight * float(np.cos(heading)), weight * float(np.sin(heading))
    setup.setStartState(start)
    setup.setGoal(_Goals(information, problem, weight, rng))
    tree = control.RRT(information)
    tree.setGoalBias(GOAL_BIAS)
    setup.setPlanner(tree)
    setup.solve(base.PlannerTerminationCondition(lambda: settings.clock() - begin > settings.time_limit))
    if not setup.haveExactSolutionPath():
        return Outcome(None, "no plan found")
    chosen = setup.getSolutionPath().getControls()
    groups = np.array([min(int(one[0] * swarm.m), swarm.m - 1) for one in chosen], dtype=np.int64)
    lengths = np.array([one[1] for one in chosen]) * reach[groups]
    return Outcome(as_primitives(groups + 1, lengths))


def _bounds(problem: Problem, weight: float):
    low, high = sampling_box(problem)
    bounds = base.RealVectorBounds(4 * problem.swarm.n)
    for j in range(problem.swarm.n):
        for axis in range(2):
            bounds.setLow(4 * j + axis, float(low[axis]))
            bounds.setHigh(4 * j + axis, float(high[axis]))
            bounds.setLow(4 * j + 2 + axis, -weight)
            bounds.setHigh(4 * j + 2 + axis, weight)
    return bounds


@njit(cache=True)
def _after(values, slides, length, turning_length, weight, radius, circles, edges, edge_ends, walls):
    """Return the state after an activation, with its first value OUTSIDE if bodies touch on the way."""
    n = len(slides)
    poses = np.empty((n, 3))
    after = values.copy()
    for j in range(n):
        x, y, c, s = values[4 * j : 4 * j + 4]
        heading = np.arctan2(s, c)
        poses[j, 0], poses[j, 1], poses[j, 2] = x, y, heading
        if slides[j]:
            after[4 * j] = x + slides[j] * length * np.cos(heading)
            after[4 * j + 1] = y + slides[j] * length * np.sin(heading)
        else:
            heading += length / turning_length[j]
            after[4 * j + 2], after[4 * j + 3] = weight * np.cos(heading), weight * np.sin(heading)
    if not slide_is_clear(poses, slides, length, radius, circles, edges, edge_ends, walls, 1e-6, 1e-9):
        after[0] = OUTSIDE
    return after
