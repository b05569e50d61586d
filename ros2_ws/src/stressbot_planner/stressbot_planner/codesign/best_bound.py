"""The best bound over all codewords, by a mixed-integer linear program: what is proved before any plan is made."""

from typing import NamedTuple

import numpy as np

from stressbot_planner.codesign.objective import Objective
from stressbot_planner.codesign.words import Words

MOST_CHOICES = 500
"""Pairs of a robot and a word: where there are more, words suffice for everybody to go as straight as it is counted here."""

SHORTEST = 0.01
"""s that the solver takes for a time limit."""

NODES = 1000
"""Of the tree of the solver, so that what is found does not depend on the machine."""


class BestBound(NamedTuple):
    """What the program says.

    Attributes:
        proved: no plan costs less, whichever codewords robots have.
        codewords: those of the least bound found; None: none were looked for.
    """

    proved: float
    codewords: tuple[str, ...] | None


def best_bound(objective: Objective, words: Words, time_limit: float = np.inf) -> BestBound:
    """Minimise the bound over codewords that tell n robots apart.

    Robot j has word w if y_jw = 1, group i is driven for t_i, robot j slides z_ij = t_i where its word has i, else 0: minimise
    the cost of all t and z, subject to sum_w y_jw = 1, sum_j y_jw <= 1 and sum_i z_ij >= need_j.

    Args:
        objective: with tasks, each of which has t and z of its own.
        words: that there are.
        time_limit: s.
    """
    if words.n * words.count > MOST_CHOICES:
        return BestBound(objective.least(), None)
    return _Program(objective, words).solve(time_limit)


class _Program:
    """Variables: y (n, W), then t (q,) and z (q, n) of each task, in units of its farthest way."""

    def __init__(self, objective: Objective, words: Words):
        self.objective, self.words = objective, words
        self.bits = words.all_bits()  # (W, q)
        self.choices = words.n * len(self.bits)
        self.task_size = words.bits * (1 + words.n)
        self.size = self.choices + len(objective.tasks) * self.task_size

    def solve(self, time_limit: float) -> BestBound:
        from scipy.optimize import Bounds, milp

        costs, unit = self._costs()
        integrality = np.zeros(self.size)
        integrality[: self.choices] = 1
        options = {"node_limit": NODES} | ({} if np.isinf(time_limit) else {"time_limit": max(time_limit, SHORTEST)})
        result = milp(
            costs, integrality=integrality, bounds=Bounds(0.0, 1.0), constraints=self._constraints(), options=options
        )
        proved = self.objective.least()
        if result.mip_dual_bound is not None and np.isfinite(result.mip_dual_bound):
            proved = max(proved, unit * float(result.mip_dual_bound))
        return BestBound(proved, None if result.x is None else self._codewords(result.x))

    def _codewords(self, solution: np.ndarray) -> tuple[str, ...]:
        chosen = solution[: self.choices].reshape(self.words.n, -1).argmax(axis=1)
        return self.words.as_text(self.bits[chosen])

    def _costs(self) -> tuple[np.ndarray, float]:
        """Return the cost of each variable, of sizes around 1, and its unit."""
        costs, count = np.zeros(self.size), len(self.objective.tasks)
        for k in range(count):
            per_slide, per_length = self.objective.prices(k)
            t, z = self._places(k)
            unit = self._farthest(k) / count
            costs[t], costs[z] = unit * per_length, unit * per_slide
        unit = float(costs.max()) or 1.0
        return costs / unit, unit

    def _constraints(self):
        from scipy.optimize import LinearConstraint
        from scipy.sparse import coo_array

        rows: list[tuple[np.ndarray, np.ndarray, float, float]] = []
        n, count = self.words.n, len(self.bits)
        y = np.arange(self.choices).reshape(n, count)
        rows += [(y[j], np.ones(count), 1.0, 1.0) for j in range(n)]
        rows += [(y[:, w], np.ones(n), 0.0, 1.0) for w in range(count)]
        for k in range(len(self.objective.tasks)):
            t, z = self._places(k)
            needs = self._needs(k) / self._farthest(k)
            rows += [(z[:, j], np.ones(len(t)), needs[j], np.inf) for j in range(n)]
            for i in range(len(t)):
                has = np.flatnonzero(self.bits[:, i])
                if k == 0 and i:  # groups have no order
                    rows.append((t[i - 1 : i + 1], np.array([1.0, -1.0]), 0.0, np.inf))
                for j in range(n):
                    rows.append((np.r_[z[i, j], t[i]], np.array([1.0, -1.0]), -np.inf, 0.0))
                    member = np.r_[z[i, j], y[j, has]], np.r_[1.0, -np.ones(len(has))]
                    rows.append((*member, -np.inf, 0.0))
                    slides = np.r_[z[i, j], t[i], y[j, has]], np.r_[1.0, -1.0, -np.ones(len(has))]
                    rows.append((*slides, -1.0, np.inf))
        columns = np.concatenate([row[0] for row in rows]).astype(np.int32)  # HiGHS of scipy 1.11 takes no other
        values = np.concatenate([row[1] for row in rows])
        numbers = np.repeat(np.arange(len(rows), dtype=np.int32), [len(row[0]) for row in rows])
        matrix = coo_array((values, (numbers, columns)), shape=(len(rows), self.size))
        low, high = np.array([row[2:] for row in rows]).T
        return LinearConstraint(matrix.tocsr(), low, high)  # pyright: ignore[reportArgumentType] # its stubs know one number only

    def _needs(self, task: int) -> np.ndarray:
        return self.objective.needs(task) / self.objective.tasks[task].swarm.pace

    def _farthest(self, task: int) -> float:
        return float(self._needs(task).max()) or 1.0

    def _places(self, task: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where the variables of a task are: t (q,), z (q, n)."""
        q, n = self.words.bits, self.words.n
        first = self.choices + task * self.task_size
        return first + np.arange(q), first + q + np.arange(q * n).reshape(q, n)
