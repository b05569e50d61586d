"""Goals in stages: one plan after the other, each from where the one before ends, make one plan that is checked whole."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count as ticks
from typing import Any

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.angles import wrapped
from stressbot_planner.planners import Finder, Progress, Settings, checked, search, solve_by, with_leeway
from stressbot_planner.primitives.expansion import Primitive
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Failed, Plan, Result, Solved
from stressbot_planner.system.fields import FREE, NO_ENTRIES


def solve_in_stages(
    find: Finder, problem: Problem, planner: str, settings: Settings, assign: Callable[[Problem], Problem] | None
) -> Result:
    """Plan for waypoints and goals in turn. Stages share the time left evenly and have `max_tries` each.

    Robots take each other's goals in the last stage; headings at goals are those of the last one, too.

    Raises:
        StressbotError: as `planners.solve`.
    """
    _refuse_headings(problem, planner, settings)
    begin, count = settings.clock(), len(problem.waypoints) + 1
    done, primitives, details = problem, (), []
    path, time, tries = 0.0, 0.0, 0
    poses = problem.starts
    for index in range(count):
        is_last = index + 1 == count
        spent = settings.clock() - begin
        left = _settings(settings, (settings.time_limit - spent) / (count - index), primitives, problem)
        told = _Told(settings, tries, path, time, is_last)
        if left is None:
            reason = f"max_epochs is {settings.max_epochs}, and the stages before took them all: allow more"
            code = ErrorCode.NO_PLAN_FOUND
            result = Failed(plan=None, code=code, reason=reason, planner=planner, seed=settings.seed, planning_time=0.0)
        else:
            left = replace(left, on_progress=told if settings.on_progress else None)
            try:
                result = solve_by(find, _stage(problem, index, poses), planner, left, assign if is_last else None)
            except StressbotError as error:
                where = f"in stage {index + 1} of {count}" + ("" if is_last else ", whose goals are waypoints")
                raise StressbotError(error.code, error.field, f"{error.message} ({where})") from error
        details.append(result.details)
        if result.plan is not None:
            primitives = (*primitives, *result.plan.primitives)
            if is_last:
                done = replace(problem, goals=result.plan.problem.goals)
        figures: dict[str, Any] = {
            "plan": Plan(with_leeway(done, settings.pulse_length), primitives) if primitives or result.success else None,
            "planner": planner,
            "seed": settings.seed,
            "planning_time": settings.clock() - begin,
            "details": {"stages": details},
        }
        if isinstance(result, Failed):
            return Failed(code=result.code, reason=f"stage {index + 1} of {count}: {result.reason}", **figures)
        if is_last:
            history = tuple((spent + at, path + slid, time + driven) for at, slid, driven in result.history)
            return checked(Solved(history=history, **figures), settings)
        end, tries = result.plan.poses[-1], told.tries
        poses = np.column_stack([end[:, :2], wrapped(end[:, 2])])
        path, time = path + result.plan.path_length, time + result.plan.execution_time
    raise AssertionError("there is a last stage")


def _refuse_headings(problem: Problem, planner: str, settings: Settings) -> None:
    """Let a planner that cannot meet the headings at the goals say so before it plans for the stages before: time is over."""
    if len(problem.headed):
        begin = np.column_stack([problem.waypoints[-1], np.zeros(problem.swarm.n)])
        over = replace(settings, clock=ticks().__next__, time_limit=0.5, on_progress=None)
        solve_by(search, _stage(problem, len(problem.waypoints), begin), planner, over, None)


def _stage(problem: Problem, index: int, poses: np.ndarray) -> Problem:
    """Return the problem of one stage, from poses (n, 3)."""
    if index == len(problem.waypoints):
        return replace(problem, starts=poses, waypoints=NO_ENTRIES)
    goals = problem.waypoints[index]
    return replace(problem, starts=poses, goals=goals, waypoints=NO_ENTRIES, goal_headings=FREE, exchangeable=())


def _settings(settings: Settings, seconds: float, primitives: tuple[Primitive, ...], problem: Problem) -> Settings | None:
    """Return what is left of the settings for a stage, None if no activation is."""
    most = settings.max_epochs
    if most is not None:
        most -= len(Plan(problem, primitives).groups)
        if most < 1:
            return None
    return replace(settings, time_limit=max(seconds, 1e-3), max_epochs=most, warm_start=None)


class _Told:
    """Hands progress on: of a stage before the last there is no plan yet."""

    def __init__(self, settings: Settings, tries: int, path: float, time: float, is_last: bool):
        self.settings, self.before, self.tries, self.path, self.time = settings, tries, tries, path, time
        self.is_last = is_last

    def __call__(self, progress: Progress) -> None:
        self.tries = self.before + progress.tries
        news = Progress(self.tries)
        if self.is_last:
            news = Progress(self.tries, self.path + progress.path_length, self.time + progress.execution_time)
        if self.settings.on_progress:
            self.settings.on_progress(news)
