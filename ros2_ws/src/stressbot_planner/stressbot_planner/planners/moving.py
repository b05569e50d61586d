"""Those that move while others are parked: a problem of its own, with fewer groups and with bodies of the parked as obstacles."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stressbot_planner.errors import StressbotError
from stressbot_planner.model.environment import Environment, standing
from stressbot_planner.model.swarm import Swarm, fastest
from stressbot_planner.planners import Finder, Settings, checked, solve_by
from stressbot_planner.primitives.expansion import as_primitives
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.naming import renamed
from stressbot_planner.problem.parking import groups_left, words_left
from stressbot_planner.problem.plan import Failed, Plan, Result

NO_RADIUS = 1e-300
"""Of the disc that a parked point is to others, units: bodies that touch the point touch it."""

_ROWS = re.compile(r"\brobots\[(\d+)\]")
_OBSTACLES = re.compile(r"\bobstacles\[(\d+)\]")


def solve_around_parked(
    find: Finder, problem: Problem, planner: str, settings: Settings, assign: Callable[[Problem], Problem] | None
) -> Result:
    """Plan as `planners.solve_by` for those that are not parked, and check the plan with all.

    Raises:
        StressbotError: as `planners.solve`.
    """
    moving = Moving(problem)
    with moving.named():
        result = solve_by(find, moving.problem, planner, moving.settings(settings), assign)
    plan = None if result.plan is None else moving.plan(result.plan)
    if isinstance(result, Failed):
        return replace(result, plan=plan, reason=moving.in_words(result.reason))
    return checked(replace(result, plan=plan), settings)


@dataclass(frozen=True, eq=False)
class Moving:
    """The part of a problem that is left to planners when some robots are parked."""

    whole: Problem

    @cached_property
    def rows(self) -> np.ndarray:
        """Rows of those that move."""
        return np.delete(np.arange(self.whole.swarm.n), list(self.whole.parked))

    @cached_property
    def groups(self) -> np.ndarray:
        """Their groups, as the whole swarm numbers them, G_m last."""
        return groups_left(self.whole.swarm, self.whole.parked)

    @cached_property
    def stretch(self) -> float:
        """Length of an activation of all over that of the part: lengths are those of the fastest robot."""
        return 1.0 / float(self.whole.swarm.pace[self.rows].max())

    @cached_property
    def problem(self) -> Problem:
        """That of those that move."""
        whole, rows, parked = self.whole, self.rows, list(self.whole.parked)
        swarm = whole.swarm
        speed, pace = fastest(swarm.speed * swarm.pace[rows])
        words = tuple(words_left(swarm, whole.parked).values())
        part = Swarm(speed, swarm.turning_radius[rows], swarm.body_radius[rows], words, pace)
        bodies = standing(whole.starts[parked, :2], swarm.body_radius[parked], part.body_radius, NO_RADIUS)
        return replace(
            whole,
            swarm=part,
            environment=Environment(whole.environment.workspace, (*whole.environment.obstacles, *bodies)),
            starts=whole.starts[rows],
            goals=whole.goals[rows],
            exchangeable=tuple(np.flatnonzero(np.isin(rows, whole.exchangeable)).tolist()),
            goal_headings=whole.goal_headings[rows],
            parked=(),
            contacts=tuple((self._part(i), self._part(j)) for i, j in whole.contacts),
        )

    def _part(self, row: int) -> int:
        return int(np.searchsorted(self.rows, row))

    def settings(self, settings: Settings) -> Settings:
        """Return settings in the part's lengths; a plan to start from would be one of all robots."""
        pulse = None if settings.pulse_length is None else settings.pulse_length / self.stretch
        return replace(settings, pulse_length=pulse, warm_start=None)

    def plan(self, part: Plan) -> Plan:
        """Return the plan of all robots that a plan of the part is."""
        goals = self.whole.goals.copy()
        goals[self.rows] = part.problem.goals
        whole = replace(
            self.whole, goals=goals, tolerance=part.problem.tolerance, heading_tolerance=part.problem.heading_tolerance
        )
        return Plan(whole, as_primitives(self.groups[part.groups - 1], self.stretch * part.lengths))

    @contextmanager
    def named(self) -> Iterator[None]:
        """Let refusals inside name robots as the whole does."""
        try:
            yield
        except StressbotError as error:
            raise StressbotError(error.code, self.in_words(error.field), self.in_words(error.message)) from error

    def in_words(self, text: str) -> str:
        """Return a sentence about the part with the whole's numbers of robots and obstacles."""
        known = len(self.whole.environment.obstacles)
        bodies = [row + 1 for row in self.whole.parked]

        def obstacle(match: re.Match) -> str:
            index = int(match[1])
            return match[0] if index < known else f"parked robot {bodies[index - known]}"

        text = text.replace("walls and obstacles", "walls, obstacles and parked robots")
        text = renamed(text, lambda number: str(self.rows[number - 1] + 1))
        return _OBSTACLES.sub(obstacle, _ROWS.sub(lambda match: f"robots[{self.rows[int(match[1])]}]", text))
