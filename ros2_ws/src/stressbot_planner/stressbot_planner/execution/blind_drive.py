"""What would become of a plan that is driven blindly with imperfect robots."""

from dataclasses import dataclass, replace

import numpy as np

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.model.kinematics import replay
from stressbot_planner.problem.plan import Plan


@dataclass(frozen=True, eq=False)
class Risk:
    """What becomes of a plan that is driven blindly with robots whose speeds are wrong.

    Attributes:
        gaps: smallest gap of each swarm that was drawn, units, shape (N,); below zero where bodies would have met.
        goal_errors: largest distance of a robot from its goal, units, shape (N,).
        collisions: how many swarms would have had one.
    """

    gaps: np.ndarray
    goal_errors: np.ndarray
    collisions: int


def risk(plan: Plan, speed_error: float, samples: int, seed: int) -> Risk:
    """Drive a plan with swarms whose robots are faster or slower than they should be, each by a constant share.

    A robot of another speed slides and turns at that speed: what it does follows from the model of a swarm of different paces, and
    the collision checker looks at the whole motion.

    Args:
        plan: to be driven.
        speed_error: standard deviation of the shares, at most three of which are drawn.
        samples: number of swarms, N.
        seed: of their random generator.
    """
    problem = plan.problem
    swarm, shapes = problem.swarm, Shapes.of(problem.environment)
    rng = np.random.default_rng(seed)
    gaps, errors = np.empty(samples), np.empty(samples)
    for k in range(samples):
        speeds = swarm.pace * (1.0 + speed_error * np.clip(rng.standard_normal(swarm.n), -3.0, 3.0))
        fastest = speeds.max()
        drawn = replace(swarm, speed=swarm.speed * fastest, pace=speeds / fastest)
        lengths = fastest * plan.lengths  # in the same time
        poses = replay(drawn, problem.starts, plan.groups, lengths)
        gaps[k] = clearance_of(drawn, shapes, poses, plan.groups, lengths).gap
        errors[k] = problem.goal_error(poses[-1, :, :2])
    return Risk(gaps, errors, int(np.count_nonzero(gaps < -problem.slack)))
