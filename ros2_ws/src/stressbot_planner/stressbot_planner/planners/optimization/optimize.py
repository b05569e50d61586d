"""`optimize`: durations over a group order, minimised under "every robot at its goal, no bodies overlap". Anytime.

The paper's numerical optimisation, grown up: exact derivatives, clearances, many starts. A pipeline of stages, each a module:

    warm_start            mend the plan that is given, if one is
    random_orders         first plans: collision repair of random group orders;
    receding_horizon      of crowds by windows towards soft goals;
    beam_search_start     where that fails, or takes long, from where beam search has brought the swarm near its goals;
    one_by_one            and where nobody gets past anybody by `pure_control`
    central_path          better plans: some random orders solved (multistart), then
    neighbourhood_search  changes of the best plan, solved again

This module is their schedule: which stage is at work when, and for how long.
"""

from collections.abc import Callable

import numpy as np

from stressbot_planner.collision.clearance import Shapes, clearance_of
from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.planners import Outcome, Settings, prepare
from stressbot_planner.planners.optimization.beam_search_start import approaches, repair_beam_search
from stressbot_planner.planners.optimization.neighbourhood_search import search_neighbour
from stressbot_planner.planners.optimization.one_by_one import ask_pure_control
from stressbot_planner.planners.optimization.random_orders import RandomOrders
from stressbot_planner.planners.optimization.receding_horizon.horizon import RecedingHorizon
from stressbot_planner.planners.optimization.search import Search
from stressbot_planner.planners.optimization.warm_start import mend_warm_start
from stressbot_planner.problem.definition import Problem

WARM_START_SHARE = 0.3
"""Of the time limit, in which a warm start is mended."""

QUICK_STARTS = 6
"""Random orders that are repaired, before beam search."""

REPAIR_SHARE = 0.6
"""Of the time for a first plan, in which random orders are repaired where beam search comes after them."""

BEAM_SEARCH_TIME = 15.0
"""s that it takes for 62 robots at least; it grows with the fourth power. Where there is less, it is left out."""

ONE_BY_ONE_SHARE, ONE_BY_ONE_TIME, ONE_BY_ONE_MOST = 0.4, 100.0, 150
"""`pure_control` is asked last: so many s before the end for 126 robots (by the power of 3.3 of their number), and half a second
more; at most in this share of the time limit. For more robots than the last number its plans are too long to be of use."""

FEW, FEW_SHARE, EACH_ITS_GROUP = 6, 0.25, 2
"""So few robots `pure_control` moves in milliseconds: it is asked after quick starts, for at most this share of the time limit,
but after beam search where the first plan ends the search. Of two, each in a group of its own, its plans are the shortest: it is
asked at once."""

CROWD, CROWD_MEETINGS = 20, 400
"""More robots than this among obstacles, or more meetings of two in a first guess in the open plane, are a crowd: it follows a
receding horizon first, since its random orders take long to be repaired."""

REPAIR_EVERY = 3
"""One in so many tries of a crowd in the open plane is a random order repaired."""

STARTS, STARTS_A_PLAN = 3, 2
"""Random orders solved before the best plan is changed: so many, and so many more for each one that becomes a plan."""

LONG_PLAN = 1.2
"""A best plan with more activations than this, in relation to usual guesses, takes too long to be changed."""


def plan(problem: Problem, settings: Settings, rng: np.random.Generator) -> Outcome:
    """Return the best of the valid plans found, for any turning radii and speeds.

    A try is a group order repaired or solved, new or changed. `pure_control`, where it is asked, has as many tries of its own.

    Raises:
        StressbotError: bodies at starts or goals are closer than the least clearance asked for.
    """
    _check_ends(problem, settings.min_clearance)
    if problem.is_solved_at(problem.starts):
        return Outcome(())
    return _Pipeline(Search(problem, settings, rng)).run()


def warm_up(problem: Problem) -> None:
    """Load what is asked only where random orders fail."""
    prepare("pure_control")
    shapes, rng = Shapes.of(problem.environment), np.random.default_rng(0)
    next(approaches(problem, shapes, 0.0, rng, lambda: False))
    looks = iter(range(50))
    RecedingHorizon(problem, shapes, 0.1, 0.0, np.ones(problem.swarm.m), rng, lambda: next(looks, None) is None).attempt()


def _check_ends(problem: Problem, least_gap: float) -> None:
    if least_gap == 0.0:
        return
    shapes = Shapes.of(problem.environment)
    for name, places in (("start", problem.starts[:, :2]), ("goal", problem.goals)):
        poses = np.column_stack([places, np.zeros(len(places))])[None]
        found = clearance_of(problem.swarm, shapes, poses, np.empty(0, dtype=np.int64), np.empty(0), problem.credit(np.inf))
        if found.gap < least_gap - problem.slack:
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE,
                "min_clearance",
                f"is {least_gap:g} units, but a {name} leaves only {found}: ask for less, or move the {name}",
            )


class _Pipeline:
    """The schedule of one search."""

    def __init__(self, search: Search):
        self.search = search
        problem = search.problem
        self.is_open = problem.environment.is_open_plane
        self.orders = RandomOrders(search)
        self.crowd = self.orders.meetings > CROWD_MEETINGS if self.is_open else problem.swarm.n > CROWD
        self.to_repair = self.orders.to_repair(self.crowd)
        self.horizon = None if not self.crowd else RecedingHorizon(
            problem, search.shapes, search.margin, search.least_gap, search.cost.of_group, search.rng, search.out_of_time
        )
        self.starts = self.valid_starts = 0

    def run(self) -> Outcome:
        """Look for a plan, then for better ones, until time is over or nothing is to be gained."""
        search = self.search
        search.latest = search.until(WARM_START_SHARE)
        mend_warm_start(search, self.orders.used)
        search.latest = search.settings.time_limit
        if not search.done():
            self._find_first()
        while not search.done():
            self._find_better()
        return search.outcome()

    def _find_first(self) -> None:
        """Look for a plan: by repair of some random orders, then by beam search; in a crowd by the receding horizon."""
        search, limit, n = self.search, self.search.settings.time_limit, self.search.problem.swarm.n
        asks = search.problem.swarm.alike and n <= ONE_BY_ONE_MOST
        before = limit - asks * min(ONE_BY_ONE_SHARE * limit, 0.5 + ONE_BY_ONE_TIME * (n / 126) ** 3.3)
        stages: list[tuple[float, Callable[[], None]]]
        if horizon := self.horizon:
            stages = [(before / limit, lambda: self._follow_horizon(horizon))]
        else:
            long_enough = (1 - REPAIR_SHARE) * before > BEAM_SEARCH_TIME * (n / 62) ** 4
            beam_search = not self.orders.large and (long_enough or search.settings.max_tries is not None)
            stages = [((REPAIR_SHARE if beam_search else 1.0) * before / limit, self._repair_some)]
            if beam_search:
                stages.append((before / limit, self._beam_search))
        if asks and n <= FEW:
            place = 0 if n <= EACH_ITS_GROUP else len(stages) if search.settings.first else 1
            stages.insert(place, (1.0, lambda: ask_pure_control(search, search.until(FEW_SHARE))))
        for share, stage in stages:
            search.latest = search.until(share)
            if not search.done():
                stage()
        search.latest = limit
        if asks and search.best.primitives is None and not search.out_of_time():
            ask_pure_control(search, limit)

    def _find_better(self) -> None:
        """Make one try."""
        search, orders = self.search, self.orders
        if self.horizon and (search.tries % REPAIR_EVERY or not self.is_open):
            self._attempt_horizon(self.horizon)
            return
        base = search.best.base
        long = search.only_beam_search or base is None or len(base[0]) > LONG_PLAN * orders.usual_count
        if orders.large or self.crowd or base is None or long and search.tries % 2:
            self._repair_next()
        elif long or self.valid_starts < STARTS and self.starts < STARTS + STARTS_A_PLAN * self.valid_starts:
            self.starts += 1
            search.count()
            self.valid_starts += search.solve(*orders.usual())
        else:
            search_neighbour(search, *base)

    def _repair_next(self) -> None:
        self.search.count()
        self.search.repair(*next(self.to_repair))

    def _repair_some(self) -> None:
        for _ in range(0 if self.search.settings.warm_start else QUICK_STARTS):
            if not self.search.done() and self.search.best.base is None:
                self._repair_next()

    def _beam_search(self) -> None:
        if self.search.best.base is None:
            repair_beam_search(self.search)

    def _follow_horizon(self, horizon: RecedingHorizon) -> None:
        """Follow the receding horizon until it comes to a plan."""
        while not self.search.done() and self.search.best.base is None:
            self._attempt_horizon(horizon)

    def _attempt_horizon(self, horizon: RecedingHorizon) -> None:
        search = self.search
        search.count()
        found = horizon.attempt()
        if found is None:
            return
        groups, lengths = found
        if len(search.problem.headed):
            search.valid += search.repair(search.order(groups), lengths, search.ends(groups, lengths))
        else:
            search.valid += search.keep(search.order(groups), lengths)
