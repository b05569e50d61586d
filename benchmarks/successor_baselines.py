"""Best-first searches over decisions: A*, LevinTS, PHS and PHS*, which differ in what they take up next.

A*: Hart, Nilsson and Raphael 1968. LevinTS: Orseau, Lelis, Lattimore and Weber, NeurIPS 2018.
PHS, PHS*: Orseau and Lelis, AAAI 2021.
"""

import heapq
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import count
from math import log
from typing import Any, NamedTuple


class Child(NamedTuple):
    """A state that an action leads to.

    Attributes:
        action: whatever names it.
        cost: of the action, > 0.
        state: whatever `expand` takes.
        left: estimate of what is left from there; 0 at the end.
        end: whether it is one.
        log_policy: logarithm of the policy's probability of the action, <= 0.
    """

    action: Any
    cost: float
    state: Any
    left: float
    end: bool
    log_policy: float


Order = Callable[[float, float, float], float]
"""Of the cost up to a node, what is left from there and the logarithm of the policy along its way; the least is next."""

ORDERS: dict[str, Order] = {
    "A*": lambda cost, left, log_policy: cost + left,
    "LevinTS": lambda cost, left, log_policy: log(cost) - log_policy,
    "PHS": lambda cost, left, log_policy: log(cost + left) - log_policy,
    "PHS*": lambda cost, left, log_policy: log(cost + left) - (1 + left / cost) * log_policy,
}


@dataclass(frozen=True, eq=False)
class _Node:
    state: Any
    action: Any
    parent: "_Node | None"
    cost: float
    left: float
    end: bool
    log_policy: float

    def actions(self) -> list:
        return [] if self.parent is None else [*self.parent.actions(), self.action]


@dataclass(frozen=True)
class Found:
    """A way.

    Attributes:
        actions: from the first on.
        cost: of them.
        complete: whether they lead to an end.
        expanded: how many nodes were.
    """

    actions: list
    cost: float
    complete: bool
    expanded: int


def best_first(state: Any, expand: Callable[[Any], Iterable[Child]], order: Order, most: int) -> Found:
    """Return the way to the first end that is taken up; after so many nodes, the cheapest end seen, or the best way so far.

    The best way so far has the least sum of its cost and what is left, the root's own left aside. States are not compared: a tree.
    """
    serial, queue = count(), []
    node: _Node | None = _Node(state, None, None, 0.0, float("inf"), False, 0.0)
    best, end, expanded = node, None, 0
    while node is not None and not node.end and expanded < most:
        expanded += 1
        for child in expand(node.state):
            cost, log_policy = node.cost + child.cost, node.log_policy + child.log_policy
            more = _Node(child.state, child.action, node, cost, child.left, child.end, log_policy)
            if more.cost + more.left < best.cost + best.left:
                best = more
            if more.end and (end is None or more.cost < end.cost):
                end = more
            heapq.heappush(queue, (order(cost, child.left, log_policy), next(serial), more))
        node = heapq.heappop(queue)[2] if queue else None
    chosen = node if node is not None and node.end else end or best
    return Found(chosen.actions(), chosen.cost, chosen.end, expanded)
