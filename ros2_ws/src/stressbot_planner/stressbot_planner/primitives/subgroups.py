"""Subgroups: which robots a Lie bracket of given order moves, and disjoint subgroups that cover a swarm.

A bracket of order r with one translation field g_i and r - 1 rotation fields h_j moves the members of G_i that are
in, or not in, each of r - 1 other groups (paper, Table 2): every further field halves the subgroup.
"""

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Swarm

MOST_NODES = 1000
"""Of the search for a cover, which takes one or none with binary groups up to 1022 robots. Seconds would depend on the machine."""


@dataclass(frozen=True)
class BracketSubgroup:
    """The members of G_i inside all of some groups and outside all of others.

    Attributes:
        group: i.
        inside: groups that all of them belong to.
        outside: groups that none of them belongs to.
        robots: ids.
    """

    group: int
    inside: tuple[int, ...]
    outside: tuple[int, ...]
    robots: tuple[int, ...]

    @property
    def order(self) -> int:
        """Number of generators of the bracket."""
        return 1 + len(self.inside) + len(self.outside)


def largest_order(swarm: Swarm) -> int:
    """Return k_max = m - 1: brackets of that order move any robot alone. (The paper bounds it by m.)"""
    return swarm.m - 1


def default_order(swarm: Swarm) -> int:
    """Return the order whose subgroups hold one or two robots, as in the paper's examples."""
    return max(1, largest_order(swarm) - 1)


def subgroups(swarm: Swarm, order: int) -> list[BracketSubgroup]:
    """Return the subgroups of brackets of one order; the same robots appear once.

    Where turning lengths differ, they are those of each set of robots with equal ones, which turns of all tell apart.

    Raises:
        StressbotError: the order is not in 1..k_max.
    """
    _check_order(swarm, order)
    member = swarm.membership
    found: dict[tuple[int, ...], BracketSubgroup] = {}
    groups = range(1, swarm.m)
    sets = [swarm.turning_length == length for length in np.unique(swarm.turning_length)]
    for i, one_set in product(groups, sets):
        for others in combinations([j for j in groups if j != i], order - 1):
            for signs in product((True, False), repeat=order - 1):
                moves = member[i - 1] & one_set
                for j, sign in zip(others, signs, strict=True):
                    moves &= member[j - 1] == sign
                robots = tuple((np.flatnonzero(moves) + 1).tolist())
                if robots and robots not in found:
                    inside = tuple(j for j, sign in zip(others, signs, strict=True) if sign)
                    outside = tuple(j for j, sign in zip(others, signs, strict=True) if not sign)
                    found[robots] = BracketSubgroup(i, inside, outside, robots)
    return list(found.values())


def _check_order(swarm: Swarm, order: int) -> None:
    if not 1 <= order <= largest_order(swarm):
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE, "order", f"is {order}: brackets of this swarm have order 1 to {largest_order(swarm)}"
        )


def disjoint_cover(swarm: Swarm, order: int) -> list[BracketSubgroup]:
    """Return disjoint subgroups of brackets up to an order that cover all robots.

    Subgroups of that very order are preferred, and of those the fewest that will do.

    Raises:
        StressbotError: the order is out of range, or no such subgroups exist; the message says from
            which order on they do (of order k_max any robot is one).
    """
    k_max = largest_order(swarm)
    _check_order(swarm, order)
    found = _cover(swarm, order)
    if found is not None:
        return found
    least = next((r for r in range(order + 1, k_max) if _cover(swarm, r)), k_max)
    raise StressbotError(
        ErrorCode.UNSUPPORTED,
        "order",
        f"is {order}, which is too small: the subgroups of Lie brackets of order up to {order} cannot be chosen so that each of "
        f"the {swarm.n} robots is in exactly one; use order {k_max if least == k_max else f'{least} to {k_max}'}",
    )


def cover(swarm: Swarm, order: int | None) -> list[BracketSubgroup]:
    """Return the cover of `disjoint_cover`; without an order that of the least one that has any, from `default_order` on."""
    if order is not None:
        return disjoint_cover(swarm, order)
    covers = (_cover(swarm, one) for one in range(default_order(swarm), largest_order(swarm)))
    return next((found for found in covers if found is not None), None) or disjoint_cover(swarm, largest_order(swarm))


def _cover(swarm: Swarm, order: int) -> list[BracketSubgroup] | None:
    candidates = [group for r in range(1, order + 1) for group in subgroups(swarm, r)]
    # a set partitioning problem
    contains = np.array([[robot in group.robots for group in candidates] for robot in range(1, swarm.n + 1)], dtype=float)
    cost = np.array([1.0 if group.order == order else 1.0 + swarm.n for group in candidates])
    cost += 1e-3 / len(candidates) * np.arange(len(candidates))  # of equally good covers always the same
    result = milp(
        cost,
        constraints=LinearConstraint(contains, 1, 1),
        bounds=Bounds(0, 1),
        integrality=np.ones(len(candidates)),
        options={"node_limit": MOST_NODES},
    )
    if result.x is None:
        return None
    return [group for group, used in zip(candidates, result.x, strict=True) if used > 0.5]
