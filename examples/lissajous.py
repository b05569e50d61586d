"""Ask for a sequence of problems: three robots visit points of a curve, one plan after the other, each from where the last ended.

    python examples/lissajous.py [curve.png]
"""

import sys

import numpy as np

from stressbot_planner import Problem, Settings, Solved, Swarm, solve
from stressbot_planner.model.environment import Environment
from stressbot_planner.reporting.plotting import plot_plan

STOPS = 8
PHASES = 2 * np.pi * np.arange(3) / 3
swarm = Swarm(speed=1.0, turning_radius=1.0, body_radius=0.3, codewords=("011", "101", "110"))


def points(stop: int) -> np.ndarray:
    """Return where the robots should be at a stop, (3, 2), units."""
    t = 2 * np.pi * stop / STOPS + PHASES
    return np.stack([6 * np.sin(t), 3 * np.sin(2 * t)], axis=1)


poses = [np.column_stack([points(0), np.zeros(3)])[None]]
for stop in range(1, STOPS + 1):
    problem = Problem(swarm, Environment(), poses[-1][-1], points(stop))
    result = solve(problem, "optimize", Settings(max_tries=10, seed=stop))
    if not isinstance(result, Solved):
        sys.exit(f"stop {stop}: {result.reason}")
    poses.append(result.plan.poses[1:])
    print(f"stop {stop}: {len(result.plan.groups)} activations, path {result.plan.path_length:.1f} units")
way = np.concatenate(poses)
if sys.argv[1:]:
    problem = Problem(swarm, Environment(), way[0], points(STOPS))
    plot_plan(problem, way, 1e-4, "three robots along a curve").savefig(sys.argv[1])
