"""What codewords are compared by: what their plans cost, and the least that any plan could."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stressbot_planner.model.swarm import Swarm
from stressbot_planner.planners import time_weight
from stressbot_planner.problem.bounds import least_lengths
from stressbot_planner.problem.definition import Problem


def with_codewords(problem: Problem, codewords: Sequence[str]) -> Problem:
    """Return the problem for a swarm whose robots have other codewords."""
    swarm = problem.swarm
    return replace(
        problem, swarm=Swarm(swarm.speed, swarm.turning_radius, swarm.body_radius, tuple(codewords), swarm.pace)
    )


@dataclass(frozen=True, eq=False)
class Objective:
    """The mean, over tasks, of path length and time to drive and to select groups, weighted as `stressbot plan` does.

    It is s where time alone counts and units where the path does. Between, each stands in relation to what robots would need that
    went straight, all at once.

    Attributes:
        objective: "path", "time" or the weight of the time.
        tasks: problems for the same robots; their codewords make no difference.
        selection_time: of an activation, s.
    """

    objective: str
    tasks: tuple[Problem, ...]
    selection_time: float

    @property
    def weight(self) -> float:
        """Of the time, 0..1."""
        return time_weight(self.objective)

    @property
    def unit(self) -> str:
        """What it is measured in."""
        return {0.0: "units", 1.0: "s"}.get(self.weight, "× the straight ways")

    def of_plan(self, task: int, path_length: float, driving_time: float, activations: int) -> float:
        """Return what a plan for a task costs; the objective is the mean over tasks."""
        per_unit, per_second = self._prices(task)
        return per_unit * path_length + per_second * (driving_time + self.selection_time * activations)

    def least(self) -> float:
        """Return what no codewords can go below, however many groups there are: everybody straight, all at once."""
        return float(np.mean([self.of_plan(k, *self._straight(k), 0) for k in range(len(self.tasks))]))

    def bound(self, codewords: Sequence[str]) -> float:
        """Return what no plan for these codewords can go below, by the linear program of `problem.bounds`, turns included."""
        swarm = with_codewords(self.tasks[0], codewords).swarm
        return float(np.mean([self._bound(k, swarm) for k in range(len(self.tasks))]))

    def needs(self, task: int) -> np.ndarray:
        """Return how far each robot has to go at least, shape (n,), units."""
        problem = self.tasks[task]
        distances = np.hypot(*(problem.goals - problem.starts[:, :2]).T)
        for row in problem.exchangeable:
            ways = problem.goals[list(problem.exchangeable)] - problem.starts[row, :2]
            distances[row] = np.hypot(*ways.T).min()
        return np.maximum(distances - problem.tolerance, 0.0)

    def prices(self, task: int) -> tuple[np.ndarray, float]:
        """Return what it costs that each robot slides by a unit, shape (n,), and that groups are driven by one."""
        swarm = self.tasks[task].swarm
        per_unit, per_second = self._prices(task)
        return per_unit * swarm.pace, per_second / swarm.speed

    def _bound(self, task: int, swarm: Swarm) -> float:
        per_slide, per_length = self.prices(task)
        cost = swarm.membership @ per_slide + per_length
        return float(least_lengths(swarm, self.needs(task), cost, turning=self.tasks[task].turning_rows(swarm)) @ cost)

    def _prices(self, task: int) -> tuple[float, float]:
        if self.weight in (0.0, 1.0):
            return 1.0 - self.weight, self.weight
        swarm = self.tasks[task].swarm
        smallest = 1e-12 * float(swarm.turning_radius.mean())
        path, time = self._straight(task)
        return (1.0 - self.weight) / max(path, smallest), self.weight / max(time, smallest / swarm.speed)

    def _straight(self, task: int) -> tuple[float, float]:
        """Return the path, units, and the time, s, that robots need at least."""
        needs, swarm = self.needs(task), self.tasks[task].swarm
        return float(needs.sum()), float((needs / swarm.pace).max()) / swarm.speed
