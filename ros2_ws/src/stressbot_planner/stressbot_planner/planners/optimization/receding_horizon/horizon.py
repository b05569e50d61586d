"""Receding horizon for crowds: plan some hundred activations towards soft goals, keep the first half, begin again from there.

All durations of a crowded swarm at once cost the cube of their number, and one jam spoils the whole plan. A *window* of some
hundred durations is small, and only its first part has to be clear (`window`). Each robot aims at the point of its shortest path
that it can come to within the window (`aims`). Near the goals the end is solved as a problem without residual, and restored
exactly (`ending`). The whole is a depth-first search with a trail of safe prefixes, to go back along when windows fail.

Once there is a plan, ends are tried from cuts of it, that cost less than what they replace.

Lengths are in mean turning lengths throughout (`soft_goals.Crowd`).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.planners.optimization.receding_horizon.ending import GROWTH, find_end, shorten, usual_cost
from stressbot_planner.planners.optimization.receding_horizon.prefixes import Ground, Prefix
from stressbot_planner.planners.optimization.receding_horizon.schedule import Schedule
from stressbot_planner.planners.optimization.receding_horizon.window import look_ahead, walk
from stressbot_planner.problem.definition import Problem

BACK_AFTER = 4
"""Failures in a row, less one, after which the search goes back one prefix."""

REST_COST = 2.0
"""What a unit of the bound of the rest will cost; windows are compared by it."""

END_TRIES, END_TRIES_NEAR, NEAR = 2, 6, 0.15
"""Tries of an end at a prefix, and at one with a smaller rest than the third, share of the whole."""

WALK_SHARE = 1 / 12
"""Least share of a window that is walked along a tail after a failure."""

MOST_FAILURES = 500
"""Of windows, in one attempt."""

RESTARTS = 3
"""Attempts from the start, after the first plan: so many, before the best one is worth being changed."""

ENDS, CUTS, FRESH = 0.75, 0.15, 0.5
"""Shares of the later attempts that look for another end, or begin at a cut of the best plan; of these, share that forget what
came behind the cut. The rest begins at the start again."""

ENDS_A_CUT, SAVED, FARTHEST = 6, (0.75, 0.97), 0.5
"""Tries of an end from a cut, its cost in relation to what it replaces, and the largest rest at the cut, share of the whole."""

WORTH_SHORTENING = 1.1
"""Of the best cost: ends of dearer plans are not made shorter."""


class RecedingHorizon:
    """The search for one problem; each `attempt` is one way from the start, or from a cut of the best plan, to the goals."""

    def __init__(
        self, problem: Problem, shapes: Shapes, margin: float, least_gap: float, cost_of_group: np.ndarray,
        rng: np.random.Generator, out_of_time: Callable[[], bool],
    ):
        """Take gaps below margin as too small and up to least_gap as collisions, units; cost_of_group has shape (m,)."""
        self.ground = Ground(problem, shapes, margin, least_gap, cost_of_group)
        self.rng, self.out_of_time = rng, out_of_time
        self.schedule = Schedule.of(problem.swarm.n)
        self.best: Prefix | None = None
        self._restarts = 0

    def attempt(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return groups (K,) and lengths (K,), units, of a plan that is better than those before, or None.

        The first attempts begin at the start, later ones mostly look for another end of the best plan.
        """
        found = self._first() if self.best is None else self._better(self.best)
        if found is None:
            return None
        if self.best is None or found.done < WORTH_SHORTENING * self.best.done:
            found = shorten(self.ground, found, self.out_of_time)
        if self.best is not None and found.done >= self.best.done:
            return None
        self.best = found
        groups, t = found.activations()
        return groups, t * self.ground.crowd.unit

    def _first(self) -> Prefix | None:
        return self._search(self.ground.root, self.schedule, 1)

    def _better(self, best: Prefix) -> Prefix | None:
        kind = self.rng.random() if self._restarts >= RESTARTS else 1.0
        if kind < ENDS:
            return self._other_end(best)
        schedule = self.schedule.varied(self.rng)
        if kind >= ENDS + CUTS:
            self._restarts += 1
            return self._search(self.ground.root, schedule, 2)
        node = self._cut(best)
        return self._search(node if self.rng.random() >= FRESH else replace(node, tail=None, clean=0), schedule, 2)

    def _cut(self, best: Prefix) -> Prefix:
        """Return a prefix of the best plan, at a random place of its cost."""
        at = self.rng.uniform(0.0, best.done)
        return [node for node in best.trail()[:-1] if node.done <= at][-1]

    def _other_end(self, best: Prefix) -> Prefix | None:
        """Look for an end from a prefix of the best plan that costs less than the one it has."""
        trail = best.trail()[:-1]
        near = [node for node in trail if node.rest < FARTHEST * self.ground.root.rest] or trail[-1:]
        node = near[self.rng.integers(len(near))]
        replaced = best.done - node.done
        for _ in range(ENDS_A_CUT):
            if self.out_of_time():
                break
            end = find_end(self.ground, node, self.rng, replaced * self.rng.uniform(*SAVED), self.out_of_time)
            if end is not None and end.done < best.done:
                return end
        return None

    def _search(self, node: Prefix, schedule: Schedule, kids: int) -> Prefix | None:
        """Return the prefix at the goals, or None: time is over, it cannot win, or too much fails."""
        ground, most = self.ground, np.inf if self.best is None else self.best.done
        begin, failed, failures, ends, tried = node, 0, 0, 0, None
        while not self.out_of_time() and failures < MOST_FAILURES:
            if node.done + REST_COST * node.rest > most:
                return None
            if node.rest < schedule.end_rest * ground.root.rest and tried is not node:
                tried = node
                for _ in range(END_TRIES_NEAR if node.rest < NEAR * ground.root.rest else END_TRIES):
                    longer = GROWTH ** (ends // END_TRIES_NEAR)
                    end = find_end(ground, node, self.rng, longer * usual_cost(ground, node), self.out_of_time)
                    ends += 1
                    if end is not None:
                        return end
            windows = [look_ahead(ground, node, schedule, self.rng, failed, self.out_of_time) for _ in range(kids)]
            onward = min((w for w in windows if w is not None), key=lambda w: w.done + REST_COST * w.rest, default=None)
            if onward is None:
                failures += 1
                failed += 1
                onward = walk(ground, node, int(WALK_SHARE * schedule.activations)) if failed == 1 else None
            if onward is not None:
                node, failed = onward, 0
            elif failed % BACK_AFTER == BACK_AFTER - 1 and node is not begin and node.parent is not None:
                node = node.parent
        return None
