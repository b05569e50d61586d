"""`optimize_paper`: the paper's numerical optimisation as it stands there (section "Implementation of Primitives").

K = 35 control steps, each with a group drawn at random; a general solver then finds their lengths of least path such that
every robot ends at its goal. The paper does not consider collisions. Here groups are drawn anew until a plan passes
the checker, or time is over. The paper takes MATLAB's fmincon, this is SciPy's SLSQP: of the same kind.
"""

import numpy as np
from scipy.optimize import minimize

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.model.goal_reaching import end_jacobian
from stressbot_planner.model.kinematics import replay, trajectory
from stressbot_planner.planners import Outcome, Settings
from stressbot_planner.planners.headings import check_free_headings
from stressbot_planner.planners.limit import Limit
from stressbot_planner.primitives.expansion import TURN, as_primitives
from stressbot_planner.problem.definition import Problem

CONTROL_STEPS = 35
"""K. It is at the edge for six robots, and below 2n no order reaches all goals."""

_REACH = 1 / 4
"""First guesses are drawn up to this part of the longest way from start to goal, those of G_m up to a whole turn. Larger ones
are solved more often, by longer paths: the paper does not tell its own."""

_ITERATIONS = 300
_PRECISION = 1e-8
"""Of goals, in turning radii; and half of the tolerance where that asks for more."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the first plan found that reaches all goals exactly without a collision, for any turning radii. A try is a draw.

    Raises:
        StressbotError: a goal has a heading.
    """
    check_free_headings(problem, "optimize_paper")
    limit = Limit(settings)
    if problem.goal_error(problem.starts[:, :2]) <= problem.tolerance:
        return Outcome(())
    shapes = Shapes.of(problem.environment)
    farthest = float(np.hypot(*(problem.goals - problem.starts[:, :2]).T).max())
    reach = np.full(problem.swarm.m, _REACH * farthest)
    reach[-1] = TURN * float(problem.swarm.turning_radius.mean())
    objective = "path" if settings.time_weight < 0.5 else "time"
    exact = 0
    closest, closest_gap = None, -np.inf
    while limit.another():
        groups = rng.integers(1, problem.swarm.m + 1, CONTROL_STEPS)
        lengths = shortest_lengths(problem, groups, objective, rng.uniform(0, reach[groups - 1]))
        if lengths is None:
            continue
        exact += 1
        groups, lengths = groups[lengths > 0], lengths[lengths > 0]
        poses = replay(problem.swarm, problem.starts, groups, lengths)
        gap = clearance_of(problem.swarm, shapes, poses, groups, lengths).gap
        if gap > closest_gap:
            closest, closest_gap = as_primitives(groups, lengths), gap
        if gap >= -problem.slack:
            return Outcome(closest, details={"draws": limit.tries, "exact_draws": exact})
    reason = f"no plan found within {limit}: of {limit.tries} draws of {CONTROL_STEPS} groups {exact} reach all goals"
    if closest is not None:
        reason += f", the best of them with bodies overlapping by {-closest_gap:.3g} units"
    return Outcome(closest, reason, details={"draws": limit.tries, "exact_draws": exact})


def shortest_lengths(problem: Problem, groups: np.ndarray, objective: str, guess: np.ndarray) -> np.ndarray | None:
    """Return lengths (K,), units, of a fixed order of groups (K,) from a guess (K,), or None where the solver ends elsewhere.

    Minimises sum |G_i| t_i ("path") or sum t_i ("time") subject to t >= 0 and the end of each robot = its goal.
    """
    swarm = problem.swarm
    if problem.goals.size > len(groups):  # more equations than unknowns end the process in SciPy 1.11
        return None
    radius = swarm.turning_length
    unit = float(radius.mean())
    slides = swarm.slides[groups - 1]
    cost = swarm.slides.sum(axis=1)[groups - 1] if objective == "path" else np.ones(len(groups))

    def miss(t: np.ndarray) -> np.ndarray:
        poses = trajectory(slides, radius, problem.starts, unit * t)
        return (poses[-1, :, :2] - problem.goals).T.ravel() / unit

    def slopes(t: np.ndarray) -> np.ndarray:
        _, rows = end_jacobian(slides, radius, problem.starts, unit * t, np.ones(len(t)))
        return np.vstack([rows[0::2], rows[1::2]])

    precision = min(_PRECISION, 0.5 * problem.tolerance / unit)
    longest = [TURN if group == swarm.m and swarm.alike else None for group in groups]
    found = minimize(
        lambda t: (cost @ t, cost), guess / unit, jac=True, method="SLSQP", bounds=[(0, most) for most in longest],
        constraints={"type": "eq", "fun": miss, "jac": slopes}, options={"maxiter": _ITERATIONS, "ftol": 1e-9},
    )
    lengths = np.maximum(found.x, 0.0)
    return unit * lengths if np.all(np.isfinite(lengths)) and np.abs(miss(lengths)).max() <= precision else None
