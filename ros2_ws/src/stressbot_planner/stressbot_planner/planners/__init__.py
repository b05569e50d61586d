"""Planners: each a function (problem, settings, rng) -> Outcome, registered by entry point.

`solve` is the way in. It hands out nothing that the collision checker has not passed.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from itertools import count
from numbers import Integral
from typing import Any

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError, quoted
from stressbot_planner.model.environment import Circle, Environment, Polygon, Workspace
from stressbot_planner.model.swarm import Swarm, check_positive
from stressbot_planner.model.whole_pulses import LEEWAY, whole
from stressbot_planner.primitives.expansion import TURN, Activate, Primitive, as_primitives
from stressbot_planner.problem.definition import Problem
from stressbot_planner.problem.plan import Failed, Plan, Result, Solved
from stressbot_planner.problem.reachability import walled_in
from stressbot_planner.system.fields import USUAL, Seconds

ENTRY_POINT_GROUP = "stressbot_planner.planners"
OBJECTIVES = ("path", "time")
"""Or a number between: the weight of the time, the rest is that of the path, each in relation to its lower bound."""

TIME_LIMIT, LONGEST, LONGEST_REQUEST = 10.0, 1e6, 3600.0
"""Time limits, s: the usual one; the largest, since who waits for a planner cannot wait for any number of seconds; and the largest
that a node takes, where others want to plan too."""

MARGIN, MOST_ROUNDS, QUARTERS = 20.0, 3, 4
"""Pulses: the gap that plans keep so that pulses can be whole; how often activations may be added for it; and how often all turn in
between, once around."""

_LONGEST_NUMBER = 30
"""Letters of a weight."""


def time_weight(objective: str) -> float:
    """Return the weight of the time in an objective, 0..1.

    Raises:
        StressbotError: it is no objective.
    """
    with suppress(ValueError):
        if len(objective) > _LONGEST_NUMBER:
            raise ValueError
        weight = float(OBJECTIVES.index(objective) if objective in OBJECTIVES else objective)
        if 0.0 <= weight <= 1.0:
            return weight
    raise StressbotError(
        ErrorCode.UNKNOWN_OBJECTIVE,
        "objective",
        f"is {quoted(objective)}: use {', '.join(OBJECTIVES)}, or the weight of the time, a number from 0 to 1",
    )


@dataclass(frozen=True)
class Progress:
    """How far a search has got.

    Attributes:
        tries: so far.
        path_length, execution_time: of the best plan so far, units and s; infinite as long as there is none.
    """

    tries: int
    path_length: float = np.inf
    execution_time: float = np.inf


@dataclass(frozen=True)
class Settings:
    """What to optimise and how long to try. Planners use what they know of; what all check is the clearance.

    Attributes:
        objective: "path" (length summed over robots), "time" (driving time and selection of groups), or the weight of the
            time as a number in [0, 1], such as "0.3".
        time_limit: s, by the clock: how far a planner gets in it depends on the machine and its load. None: TIME_LIMIT, or with
            `max_tries` LONGEST.
        max_tries: how often a planner may try, see each of them; None: any number. A search that ends before its time limit gives
            the same plan for the same settings, at any load: nothing in it but the time limit looks at the clock then.
        first: whether the first plan will do.
        min_clearance: gap that all bodies keep from each other, from obstacles and walls, units; above 0 two points keep it too.
        max_epochs: most activations that a plan may have; None: any number.
        selection_time: that each activation takes besides driving, s.
        pulse_length: of an activation of one pulse, units: plans are made of whole pulses, and their problem's tolerance is wider
            by `LEEWAY`. None: the drive is constant.
        warm_start: groups (K,) and lengths (K,) of a plan that nearly fits, such as what remains of one; None: nothing known.
        order: of the Lie brackets whose subgroups a planner moves, 1..m-1 (the paper's M(n, r)); None: its default.
        seed: of the random generator.
        jobs: processes that search side by side, each with `max_tries` of its own; their number, like the seed, changes the plan.
            The others have clocks of their own, and end when this one says that time is over.
        clock: seconds, monotonic; planners read no other clock. One that jumps ahead ends a search.
        on_progress: told of tries and better plans; None: nobody listens.

    Raises:
        StressbotError: naming the setting.
    """

    objective: str = "path"
    time_limit: Seconds = USUAL
    max_tries: int | None = None
    first: bool = False
    min_clearance: float = 0.0
    max_epochs: int | None = None
    selection_time: float = 0.0
    pulse_length: float | None = None
    warm_start: tuple[Sequence[int], Sequence[float]] | None = field(default=None, compare=False)
    order: int | None = None
    seed: int = 0
    jobs: int = 1
    clock: Callable[[], float] = field(default=time.monotonic, compare=False)
    on_progress: Callable[[Progress], None] | None = field(default=None, compare=False)

    def __post_init__(self):
        time_weight(self.objective)
        if self.time_limit is None:
            object.__setattr__(self, "time_limit", TIME_LIMIT if self.max_tries is None else LONGEST)
        check_positive("time_limit", self.time_limit)
        if self.time_limit > LONGEST:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, "time_limit", f"is {self.time_limit:g} s: give a number of at most {LONGEST:g} s"
            )
        for name in ("min_clearance", "selection_time"):
            if not 0 <= getattr(self, name) < np.inf:
                raise StressbotError(ErrorCode.OUT_OF_RANGE, name, f"is {getattr(self, name)}: give a number of 0 or more")
        if self.pulse_length is not None:
            check_positive("pulse_length", self.pulse_length)
        for name in ("max_tries", "max_epochs", "jobs"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, Integral) and int(value) >= 1):
                raise StressbotError(ErrorCode.OUT_OF_RANGE, name, f"is {value}: give a whole number of 1 or more")

    @property
    def time_weight(self) -> float:
        """Weight of the time in the objective, 0..1."""
        return time_weight(self.objective)


@dataclass(frozen=True)
class Outcome:
    """What a planner function found: the primitives of its best plan (None: nothing at all), or why not.

    Attributes:
        primitives: of the best plan, or of the closest attempt.
        reason: why no valid plan was found; empty otherwise.
        infeasible: whether it was proved that no plan exists.
        history: improvements, as (seconds, path length, execution time).
        details: figures of this planner.
    """

    primitives: tuple[Primitive, ...] | None
    reason: str = ""
    infeasible: bool = False
    history: tuple[tuple[float, float, float], ...] = ()
    details: dict[str, Any] = field(default_factory=dict)


Planner = Callable[[Problem, Settings, np.random.Generator], Outcome]
Finder = Callable[[Problem, str, Settings], Outcome]
"""By a planner of that name, in one process or several."""


@cache
def _registered() -> dict[str, EntryPoint]:
    # looking through all installed packages takes milliseconds
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def names() -> list[str]:
    """Return the names of all registered planners."""
    return sorted(_registered())


def check_known(name: str) -> None:
    """Raise StressbotError unless a planner has this name; the message lists the known ones."""
    if name not in _registered():
        raise StressbotError(ErrorCode.UNKNOWN_PLANNER, "planner", f"is {quoted(name)}: use one of {', '.join(names())}")


def get(name: str) -> Planner:
    """Return a planner by name.

    Raises:
        StressbotError: unknown; the message lists the known ones.
    """
    check_known(name)
    return _registered()[name].load()


def usable_jobs(jobs: int) -> int:
    """Return how many of the processes asked for can search side by side here: no more than there are processors for this one."""
    if jobs == 1:
        return 1
    from joblib import cpu_count

    return min(jobs, cpu_count())


def solve(
    problem: Problem, planner: str, settings: Settings, assign: Callable[[Problem], Problem] | None = None
) -> Result:
    """Run a planner, in `usable_jobs` processes of those asked for, and check its plan whole.

    Args:
        problem: to be solved.
        planner: its name.
        settings: what to optimise and how long to try.
        assign: makes another problem of it first, within the time limit, see `assignment`.

    Raises:
        StressbotError: the planner is unknown or does not support such a problem. A plan that is merely not found is
            not an error but a result with a reason.
    """
    get(planner)
    jobs = usable_jobs(settings.jobs)
    if jobs == 1:
        prepare(planner)
        return solve_by(search, problem, planner, settings, assign)
    from stressbot_planner.planners.side_by_side import LATE, READY_WITHIN, Others

    with Others(planner, jobs - 1) as others:
        prepare(planner)
        others.wait_until_ready(LATE if settings.max_tries is None else READY_WITHIN)
        return solve_by(others.search, problem, planner, settings, assign)


def solve_by(
    find: Finder, problem: Problem, planner: str, settings: Settings, assign: Callable[[Problem], Problem] | None
) -> Result:
    """Do what `solve` does, with a search that is ready."""
    if len(problem.waypoints):
        from stressbot_planner.planners.stages import solve_in_stages

        return solve_in_stages(find, problem, planner, settings, assign)
    if problem.parked:
        from stressbot_planner.planners.moving import solve_around_parked

        return solve_around_parked(find, problem, planner, settings, assign)
    return _solve(find, problem, planner, settings, assign)


def seed_of(seed: int, place: int) -> int:
    """Return the seed of one of several searches that follow from one seed, in 63 bits."""
    return int(np.random.SeedSequence((seed, place)).generate_state(1, np.uint64)[0]) >> 1


def checked(result: Solved, settings: Settings) -> Result:
    """Return what was put together from plans that were checked, checked whole."""
    reason = _failing(result.plan, settings)
    return Failed(code=ErrorCode.NO_PLAN_FOUND, reason=reason, **vars(result)) if reason else result


def _failing(plan: Plan, settings: Settings) -> str:
    """Why a plan fails the check; empty if it passes."""
    if settings.max_epochs is not None and len(plan.groups) > settings.max_epochs:
        return f"max_epochs is {settings.max_epochs}, and the plan has {len(plan.groups)} activations: allow more"
    if plan.valid and plan.keeps(settings.min_clearance):
        return ""
    asked = f"; min_clearance is {settings.min_clearance:g} units" if settings.min_clearance else ""
    return f"the plan fails the check: {plan.account}{asked}"


@cache
def prepare(planner: str) -> None:
    """Load a planner's compiled kernels, or compile them, by a tiny problem. The time it takes is nobody's planning time.

    What a planner needs for harder problems only, its module loads in a function `warm_up(problem)`.
    """
    swarm = Swarm(1.0, 1.0, 0.1, ("011", "101", "110"))
    environment = Environment(Workspace(-9, 9, -9, 9), (Circle((1, 0.5), 0.2), Polygon([[5, 5], [6, 5], [5, 6]])))
    problem = Problem(swarm, environment, [[0, 0, 0], [0, 3, 0], [0, 6, 0]], [[2, 1], [2, 2], [2, 7]], tolerance=0.5)
    Plan(problem, (Activate(1, 0.1),)).clearance  # noqa: B018
    with suppress(StressbotError):  # it may not support this problem
        # a clock that ticks when it is looked at
        search(problem, planner, Settings(time_limit=500, clock=count().__next__))
    warm_up = getattr(import_module(get(planner).__module__), "warm_up", None)
    if warm_up:
        warm_up(problem)


def search(problem: Problem, planner: str, settings: Settings) -> Outcome:
    """Run a planner in this process, unless there is a proof that it would find nothing. Its plan is yet to be checked."""
    robot = walled_in(problem)
    if robot is not None:
        reason = f"robot {robot} cannot get from its start to its goal: walls and obstacles leave no way that is wide enough"
        return Outcome(None, reason, infeasible=True)
    return get(planner)(problem, settings, np.random.default_rng(settings.seed))


def _solve(
    find: Finder, problem: Problem, planner: str, settings: Settings, assign: Callable[[Problem], Problem] | None
) -> Result:
    begin = settings.clock()
    left, spent = settings, 0.0
    if assign is not None:
        problem = assign(problem)
        spent = settings.clock() - begin
        left = replace(settings, time_limit=max(settings.time_limit - spent, 1e-3))
    aimed = problem
    if settings.pulse_length is not None:
        from stressbot_planner.planners.apart import aims_apart

        with suppress(StressbotError):  # where there is no room to go aside
            aimed = replace(problem, goals=aims_apart(problem, settings.min_clearance, settings.pulse_length))
        left = replace(left, min_clearance=settings.min_clearance + _margin(aimed, settings.min_clearance, settings.pulse_length))
    outcome = find(aimed, planner, left)
    plan = None if outcome.primitives is None else Plan(problem, outcome.primitives)
    reason = outcome.reason
    if plan is not None and not reason:
        if settings.pulse_length is not None:
            plan = in_whole_pulses(plan, settings.pulse_length)
        reason = _failing(plan, settings)
    figures: dict[str, Any] = {
        "planner": planner,
        "seed": settings.seed,
        "planning_time": settings.clock() - begin,
        "history": tuple((seconds + spent, path, time) for seconds, path, time in outcome.history),
        "details": outcome.details,
    }
    if plan is not None and not reason:
        return Solved(plan=plan, **figures)
    code = ErrorCode.INFEASIBLE if outcome.infeasible else ErrorCode.NO_PLAN_FOUND
    return Failed(plan=plan, code=code, reason=reason or "the planner returns neither a plan nor a reason", **figures)


def in_whole_pulses(plan: Plan, pulse_length: float) -> Plan:
    """Return a plan of activations of whole pulses that leads where another one does, within `LEEWAY` of them.

    Where numbers of pulses leave no such choice, the plan gets more activations at its end, of each group one, of a few pulses
    each; where that does not do, all turn once around meanwhile, so that there are some in each direction.
    """
    problem, eased, found = plan.problem, with_leeway(plan.problem, pulse_length), []
    swarm, headed = problem.swarm, problem.headed.tolist()
    quarter = TURN / QUARTERS * float(swarm.turning_length.mean())
    for more in range(1 + MOST_ROUNDS * eased.is_solved_at(plan.poses[-1])):
        rounds, turn = (more, 0.0) if more < 2 or headed and not swarm.alike else (QUARTERS * (more - 1), quarter)
        groups = np.concatenate([plan.groups, np.tile(np.arange(1, swarm.m + 1), rounds)])
        lengths = np.concatenate([plan.lengths, np.tile([*[0.0] * (swarm.m - 1), turn], rounds)])
        counts = whole(swarm, problem.starts, groups, lengths, pulse_length, headed)
        driven = counts > 0
        found.append(Plan(eased, as_primitives(groups[driven], counts[driven] * pulse_length)))
        if eased.is_solved_at(found[-1].poses[-1]):
            return found[-1]
    return min(found, key=lambda one: one.goal_error)


def with_leeway(problem: Problem, pulse_length: float | None) -> Problem:
    """Return the problem that plans of whole pulses are for: robots may end `LEEWAY` pulses further from their goals."""
    if pulse_length is None:
        return problem
    more = LEEWAY * pulse_length
    angle = more / float(problem.swarm.turning_length[problem.headed].min(initial=np.inf))
    return replace(
        problem, tolerance=problem.tolerance + more, heading_tolerance=problem.heading_tolerance + angle
    )


def _margin(problem: Problem, min_clearance: float, pulse_length: float) -> float:
    """Return the gap, beside the one asked for, that a plan may lose when its pulses get whole, units: where there is room."""
    if np.any(problem.swarm.body_radius == 0):
        return 0.0  # points need none, and would keep apart for it
    turned = np.column_stack([problem.goals, np.zeros(problem.swarm.n)])
    gaps = (Plan(one, ()).clearance_of_others.gap for one in (problem, replace(problem, starts=turned)))
    room = 0.5 * (min(gaps) - min_clearance)
    return max(0.0, min(MARGIN * pulse_length, room))
