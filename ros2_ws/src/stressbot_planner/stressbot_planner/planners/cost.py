"""What plans are compared by."""

import numpy as np

from stressbot_planner.model.kinematics import execution_time, path_length
from stressbot_planner.planners import Settings
from stressbot_planner.problem.definition import Problem

CLOSE_TO_BOUND = 1.0008
"""A plan this close to the lower bound ends the search."""

_TURNING_WEIGHT = 0.01
"""Cost of a unit length of G_m under the path objective, where turning is free, in relation to one robot's slide."""


class Cost:
    """What is minimised: path length and time to execute, each in relation to its lower bound, weighted."""

    def __init__(self, problem: Problem, settings: Settings):
        swarm, bounds, weight = problem.swarm, problem.lower_bounds, settings.time_weight
        smallest = 1e-12 * float(swarm.turning_radius.mean())
        self.swarm, self.selection_time = swarm, settings.selection_time
        self.per_path = (1.0 - weight) / max(bounds.path_length, smallest)
        self.per_second = weight / max(bounds.execution_time, smallest / swarm.speed)
        slid = swarm.slides.sum(axis=1)
        self.of_group = self.per_path * np.maximum(slid, _TURNING_WEIGHT) + self.per_second / swarm.speed
        """Per unit of length, shape (m,)."""

    def of_figures(self, path: float, time: float, activations: int = 0) -> float:
        return self.per_path * path + self.per_second * (time + self.selection_time * activations)

    def of(self, groups: np.ndarray, lengths: np.ndarray) -> float:
        path, time = path_length(self.swarm, groups, lengths), execution_time(self.swarm, lengths)
        return self.of_figures(path, time, len(groups))
