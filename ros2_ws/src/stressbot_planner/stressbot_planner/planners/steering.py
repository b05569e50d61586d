"""Steering by subgroups: turn robots of a subgroup toward their targets, then slide the subgroup."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from stressbot_planner.planners.tree import Moves
from stressbot_planner.primitives import TURN, Activate, Extract, Orient, Subgroup
from stressbot_planner.subgroups import BracketSubgroup
from stressbot_planner.swarm import Swarm

EXCURSIONS = (np.inf, 0.75, 0.25)
"""How far others may swing out, tried in turn, relative to the turning radius."""

SHARES = (1.0, 0.5, 0.2)
"""Parts of the whole way to the targets, tried in turn."""

LARGEST_CHOICE = 4


class SubgroupSteering:
    """Moves of some subgroups toward target positions, with small excursions only if large ones collide."""

    def __init__(self, swarm: Swarm, subgroups: list[BracketSubgroup]):
        self.swarm, self.subgroups = swarm, subgroups
        self.radius = swarm.common_turning_radius()

    def __call__(self, poses: np.ndarray, targets: np.ndarray) -> Iterator[Moves]:
        """Yield moves from poses (n, 3) toward targets (n, 3), whose headings do not matter."""
        way = targets[:, :2] - poses[:, :2]
        distance = np.hypot(*way.T)
        bearing = np.arctan2(way[:, 1], way[:, 0])
        for excursion in EXCURSIONS:
            moves = []
            for subgroup in self.subgroups:
                for robots in self._to_align(subgroup, distance):
                    members = np.array(robots) - 1
                    angles = tuple(np.mod(bearing[members] - poses[members, 2], TURN).tolist())
                    whole = float(distance[members].mean())
                    for share in SHARES:
                        if share * whole > 1e-9:
                            moves += self._moves(subgroup, robots, angles, share * whole, excursion * self.radius)
            yield moves

    def _to_align(self, subgroup: BracketSubgroup, distance: np.ndarray) -> list[tuple[int, ...]]:
        """Return sets of robots to turn: each choice of up to three, of the farthest ones in a large subgroup."""
        robots = sorted(subgroup.robots, key=lambda robot: -distance[robot - 1])[:LARGEST_CHOICE]
        return [choice for size in (3, 2, 1) for choice in combinations(robots, size)]

    def _moves(self, subgroup: BracketSubgroup, robots, angles, length: float, excursion: float) -> Moves:
        turn = Orient(robots, angles, excursion)
        if subgroup.order == 1:
            return [(turn, Activate(subgroup.group, length))]
        halving = Subgroup(subgroup.group, length, subgroup.inside, subgroup.outside, excursion)
        if len(subgroup.robots) > 3:
            return [(turn, halving)]
        return [(turn, Extract(subgroup.robots, subgroup.group, length, excursion)), (turn, halving)]
