"""What would become of a plan that is driven blindly with imperfect robots: swarms are drawn, and the checker looks at them."""

from dataclasses import dataclass, replace

import numpy as np

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.problem.plan import Plan

_MOST_POSES = 1_000_000
"""Of robots in swarms that are driven at once."""


@dataclass(frozen=True)
class Noise:
    """What robots are wrong by: standard deviations, as those of the simulated robots (docs/imperfections.md).

    Attributes:
        speed_error: of a robot's speed, a share; it slides and turns faster by it.
        radius_error: of its turning radius, a share.
        heading_bias: from its heading to the direction that it slides in, rad.
        heading_noise: of the jump of its heading as each activation begins, rad.
    """

    speed_error: float = 0.0
    radius_error: float = 0.0
    heading_bias: float = 0.0
    heading_noise: float = 0.0


@dataclass(frozen=True, eq=False)
class Risk:
    """What becomes of a plan that is driven blindly with robots that are wrong.

    Attributes:
        gaps: smallest gap of each swarm that was drawn, units, shape (N,); below zero where bodies would have met.
        goal_errors: largest distance of a robot from its goal, units, shape (N,).
        collisions: how many swarms would have had one.
    """

    gaps: np.ndarray
    goal_errors: np.ndarray
    collisions: int


@dataclass(frozen=True, eq=False)
class Driven:
    """Swarms as they were drawn, and where they went.

    Attributes:
        paces: speed of each robot in relation to the u of the plan, shape (N, n).
        poses: x and y, units, and the direction that a robot slides in, rad, before the first activation and after each, shape
            (N, K + 1, n, 3); in the directions of an activation its jump is.
    """

    paces: np.ndarray
    poses: np.ndarray


def drive(plan: Plan, noise: Noise, samples: int, rng: np.random.Generator) -> Driven:
    """Drive a plan with N = samples swarms; of errors at most three standard deviations are drawn."""
    problem = plan.problem
    swarm, count = problem.swarm, len(plan.groups)

    def drawn(sigma: float) -> np.ndarray:
        return sigma * np.clip(rng.standard_normal((samples, swarm.n)), -3.0, 3.0)

    paces = swarm.pace * (1.0 + drawn(noise.speed_error))
    turning = swarm.turning_radius * (1.0 + drawn(noise.radius_error)) / paces
    poses = np.empty((samples, count + 1, swarm.n, 3))
    poses[:, 0] = problem.starts
    poses[:, 0, :, 2] += drawn(noise.heading_bias)
    for k, (group, length) in enumerate(zip(plan.groups.tolist(), plan.lengths.tolist(), strict=True)):
        here = poses[:, k]
        if noise.heading_noise:
            here[:, :, 2] += drawn(noise.heading_noise)
        slid = np.where(swarm.membership[group - 1], length * paces, 0.0)
        there = poses[:, k + 1]
        there[:, :, 0] = here[:, :, 0] + slid * np.cos(here[:, :, 2])
        there[:, :, 1] = here[:, :, 1] + slid * np.sin(here[:, :, 2])
        there[:, :, 2] = here[:, :, 2] + np.where(swarm.membership[group - 1], 0.0, length / turning)
    return Driven(paces, poses)


def risk(plan: Plan, noise: Noise, samples: int, seed: int) -> Risk:
    """Drive a plan with swarms of robots that are wrong, each in its own way; the checker looks at the whole of each motion.

    Args:
        plan: to be driven.
        noise: what robots are wrong by.
        samples: number of swarms, N.
        seed: of their random generator.
    """
    problem = plan.problem
    shapes = Shapes.of(problem.environment)
    rng = np.random.default_rng(seed)
    gaps, errors = np.empty(samples), np.empty(samples)
    at_once = max(1, _MOST_POSES // ((len(plan.groups) + 1) * problem.swarm.n))
    for begin in range(0, samples, at_once):
        driven = drive(plan, noise, min(at_once, samples - begin), rng)
        for k, (paces, poses) in enumerate(zip(driven.paces, driven.poses, strict=True), begin):
            fastest = float(paces.max())
            swarm = _of_paces(problem.swarm, paces, fastest)
            gaps[k] = clearance_of(swarm, shapes, poses, plan.groups, fastest * plan.lengths).gap
            errors[k] = problem.goal_error(poses[-1, :, :2])
    return Risk(gaps, errors, int(np.count_nonzero(gaps < -problem.slack)))


def _of_paces(swarm: Swarm, paces: np.ndarray, fastest: float) -> Swarm:
    """Return a swarm that slides at these speeds, in relation to the u of another; how it turns is in its poses."""
    return replace(swarm, speed=swarm.speed * fastest, pace=paces / fastest)
