"""Receding horizon for crowds: plan some hundred activations towards soft goals, keep the first half, begin again from there.

All durations of a crowded swarm at once cost the cube of their number, and one jam spoils the whole plan. A *window* of
`ACTIVATIONS` durations is small, and only its first part has to be clear. Each robot aims at the point of its shortest path that
it can come to within the window; who has more than its groups give it anyway is urgent, who has slack may lag behind. Near the
goals the end is solved as a problem without residual, and restored exactly. The whole is a depth-first search with a trail of
nodes, one a safe prefix, to go back along when windows fail.

Lengths are in mean turning lengths throughout (`soft_goals.Crowd`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from stressbot_planner.beam_search.cost_to_go import distance_maps, way_left
from stressbot_planner.collision.clearance import Shapes
from stressbot_planner.model.kinematics import trajectory
from stressbot_planner.planners.optimization.central_path import GOAL_PRECISION, OF_TOLERANCE
from stressbot_planner.planners.optimization.restoration import restore_goals
from stressbot_planner.planners.optimization.soft_goals import Crowd, SoftGoals, levenberg_marquardt
from stressbot_planner.problem.bounds import least_lengths
from stressbot_planner.problem.definition import Problem
from stressbot_planner.system.kernels import kernel


@dataclass(frozen=True)
class Schedule:
    """Numbers of a search; see `../../docs/optimize.md` for where they come from.

    Attributes:
        activations: of a window.
        length: mean of an activation.
        pace: length of the path that a window asks for is its total by this, in relation to what the groups must slide.
        turning: of all, in relation to the sliding.
        end_rest: the end is tried once the rest is below this share of the bound of the whole.
        end_activations: of the end, per robot.
        end_share: least total of the end, share of the bound of the whole.
    """

    activations: int
    length: float = 0.28
    pace: float = 1.2
    turning: float = 0.25
    end_rest: float = 0.15
    end_activations: float = 7.0
    end_share: float = 0.35

    @classmethod
    def of(cls, n: int) -> "Schedule":
        """Return what suits n robots."""
        return cls(activations=240 if n <= 45 else 300 if n <= 90 else 350, turning=0.25 if n <= 45 else 0.4)

    def varied(self, rng: np.random.Generator) -> "Schedule":
        """Return a schedule near this one: another start of the search."""
        return replace(
            self,
            pace=self.pace * rng.choice([0.85, 1.0, 1.2]),
            turning=self.turning * rng.choice([0.7, 1.0, 1.4]),
            end_rest=rng.choice([0.1, 0.15, 0.2]),
            end_activations=self.end_activations * rng.choice([0.6, 0.8, 1.0, 1.3]),
            end_share=self.end_share * rng.choice([0.8, 1.0, 1.0]),
        )


COMMIT, BUFFER = 0.5, 0.15
"""Shares of a window: what is kept if nothing collides in it nor in the buffer behind."""

LEAST_COMMIT, STEP_BACK = 0.05, 0.6
"""A shorter clear part is a failure; a clear part that ends early is kept up to this share of the buffer before its end."""

AIM_WEIGHTS, FIRST_STEPS, STEPS = (0.3, 0.02, 1e-4, 1e-6), 12, 20
"""Of the aims, falling until the first part is clear; steps with the first of them and with each other one."""

BEHIND = 0.2
"""Weight of gaps behind the first part of a window."""

LEAST_URGENCY, LEAST_LENGTH = 0.2, 0.05
"""Of a robot with all the time that there is; of a group that nobody needs, in relation to the one needed most."""

SPACING, INFLATED = 1.2, 0.35
"""Aims are two bodies and this far apart; paths keep so far from obstacles, in turning lengths."""

SCREENED, SCREENED_TAIL = 60, 8
"""Guesses of which the one that is clear for longest is taken, after a failure and before one."""

FIRST_TURN = 0.3
"""A guess begins with a random turn of all, up to this share of a whole one; after two failures of up to a whole one."""

RAMP, RAMP_CYCLES = (0.1, 1.0), 4
"""A guess begins with short activations, which leave freedom where bodies are close already: these shares, in so many cycles."""

SHRINK, LEAST_SHRINK = 0.8, 0.3
"""Lengths of activations after each failure in a row, and the least."""

TOTAL_WEIGHT = 1 / 62
"""Of the total length, per robot."""

BACK_AFTER = 4
"""Failures in a row, less one, after which the search goes back one node."""

REST_COST = 2.0
"""What a unit of the bound of the rest will cost; windows are compared by it."""

END_WAY, END_TRIES = 25.0, 8
"""The end is tried where nobody has more to go, so often."""

END_STAGES = ((0.1, 0.05, 15, 0.025), (0.01, 0.3, 15, 0.0035), (0.1, 0.0, 25, 1.0))
"""Of the end: weight of aims, of the total, steps, residual per robot above which it is given up."""

END_TURNING, END_LEAST, END_GROWTH = (0.2, 0.35, 0.5), 0.3, 1.1
"""Turning of all in relation to the sliding; least length of a group; growth of the total with each try."""

NEAR_ENOUGH, FEW_OVERLAPS = 0.3, 0.02
"""Largest miss and residual from which the end is restored exactly."""

MOST_FAILURES = 500
"""Of windows, in one attempt."""

CUTS, FRESH = 0.7, 0.5
"""Share of the attempts that begin at a cut of the best plan; of these, share that forget what came behind the cut."""


@dataclass(frozen=True, eq=False)
class Node:
    """A safe prefix.

    Attributes:
        poses: after it, shape (n, 3).
        groups, t: the activations of the last piece.
        parent: the node before, None for the start.
        done: cost of the whole prefix.
        tail: groups and lengths of the last window behind the piece, to go on from; None: nothing known.
        clean: activations of the tail that are clear.
        ways: left to each robot, shape (n,).
        lengths: of the groups that the rest needs at least, shape (m,).
        rest: cost of these.
    """

    poses: np.ndarray
    groups: np.ndarray
    t: np.ndarray
    parent: "Node | None"
    done: float
    tail: tuple[np.ndarray, np.ndarray] | None
    clean: int
    ways: np.ndarray
    lengths: np.ndarray
    rest: float

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Return groups (K,) and lengths (K,) from the start to here."""
        chain, node = [], self
        while node is not None:
            chain.append(node)
            node = node.parent
        return np.concatenate([node.groups for node in chain[::-1]]), np.concatenate([node.t for node in chain[::-1]])


class RecedingHorizon:
    """The search for one problem; each `attempt` is one way from the start, or from a cut of the best plan, to the goals."""

    def __init__(
        self, problem: Problem, shapes: Shapes, margin: float, least_gap: float, cost_of_group: np.ndarray,
        rng: np.random.Generator, out_of_time: Callable[[], bool],
    ):
        """Take gaps below margin as too small and up to least_gap as collisions, units; cost_of_group has shape (m,)."""
        self.swarm = swarm = problem.swarm
        self.crowd = Crowd.of(swarm, shapes)
        unit = self.crowd.unit
        self.margin, self.least_gap = margin / unit, least_gap / unit
        self.cost = cost_of_group / cost_of_group.max()
        self.rng, self.out_of_time = rng, out_of_time
        self.goals = problem.goals / unit
        self.schedule = Schedule.of(swarm.n)
        self.precision = min(GOAL_PRECISION, OF_TOLERANCE * problem.tolerance / unit)
        self.used = np.flatnonzero((swarm.group_sizes > 0) | (np.arange(swarm.m) == swarm.m - 1))
        start = problem.starts.copy()
        start[:, :2] /= unit
        self.maps = None
        if not problem.environment.is_open_plane:
            self.maps = distance_maps(self.crowd.shapes, self.crowd.body + INFLATED, start[:, :2], self.goals)
        self.root = self._node(start, np.empty(0, np.int64), np.empty(0), None)
        self.trail: list[Node] = []
        self.best = np.inf

    def attempt(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return groups (K,) and lengths (K,), units, of a plan that is better than those before, or None.

        The first attempts begin at the start, later ones mostly at a cut of the best plan.
        """
        node, schedule, kids = self.root, self.schedule, 1
        if self.trail:
            schedule, kids = schedule.varied(self.rng), 2
            if self.rng.random() < CUTS:
                node = self._cut()
        found = self._search(node, schedule, kids)
        if found is None or found[-1].done >= self.best:
            return None
        self.trail, self.best = found, found[-1].done
        groups, t = found[-1].pieces()
        return groups, t * self.crowd.unit

    def _cut(self) -> Node:
        at = self.rng.uniform(0.0, self.trail[-1].done)
        node = [node for node in self.trail[:-1] if node.done <= at][-1]
        return node if self.rng.random() >= FRESH else replace(node, tail=None, clean=0)

    def _search(self, node: Node, schedule: Schedule, kids: int) -> list[Node] | None:
        """Return the trail from the root to the goals, or None: time is over, it cannot win, or too much fails."""
        trail = [node]
        while trail[0].parent is not None:
            trail.insert(0, trail[0].parent)
        begin = len(trail)
        row = failures = ends = 0
        patience, tried = 1.0, None
        while not self.out_of_time() and failures < MOST_FAILURES:
            node = trail[-1]
            if node.done + REST_COST * node.rest > self.best:
                return None
            near = node.ways.max() < END_WAY and node.rest < schedule.end_rest * self.root.rest * patience
            if near and tried is not node:
                tried = node
                end = self._end(node, schedule, ends // 2)
                ends += 1
                if end is not None:
                    return [*trail, end]
                patience *= 0.9
            windows = [self._window(node, schedule, row) for _ in range(kids)]
            windows = [window for window in windows if window is not None]
            if windows:
                trail.append(min(windows, key=lambda window: window.done + REST_COST * window.rest))
                row = 0
                continue
            failures += 1
            row += 1
            if row == 1 and node.tail is not None and node.clean >= schedule.activations // 12:
                trail.append(self._walked(node, *node.tail))
                row = 0
            elif row % BACK_AFTER == BACK_AFTER - 1 and len(trail) > begin:
                trail.pop()
        return None

    # Nodes

    def _node(self, poses, groups, t, parent, tail=None, clean=0) -> Node:
        ways = self._ways(poses[:, :2])
        lengths = least_lengths(self.swarm, ways, self.cost)
        done = (parent.done if parent else 0.0) + float(self.cost[groups - 1] @ t)
        return Node(poses, groups, t, parent, done, tail, clean, ways, lengths, float(self.cost @ lengths))

    def _after(self, node: Node, groups: np.ndarray, t: np.ndarray, kept: int, clean: int) -> Node:
        poses = self._end_poses(node.poses, groups[:kept], t[:kept])
        return self._node(poses, groups[:kept], t[:kept], node, (groups[kept:], t[kept:]), clean)

    def _walked(self, node: Node, groups: np.ndarray, t: np.ndarray) -> Node:
        """Go half the way along what is clear of the tail."""
        kept = max(node.clean // 2, 1)
        return self._after(node, groups, t, kept, node.clean - kept)

    def _end_poses(self, start: np.ndarray, groups: np.ndarray, t: np.ndarray) -> np.ndarray:
        poses = trajectory(np.ascontiguousarray(self.crowd.slides_of(groups).T), self.crowd.turning_length, start, t)[-1]
        poses[:, 2] %= 2 * np.pi
        return poses

    def _ways(self, places: np.ndarray) -> np.ndarray:
        return np.hypot(*(self.goals - places).T) if self.maps is None else self.maps.ways_left(places)

    def _aims(self, places: np.ndarray, share: float) -> np.ndarray:
        """Return the places (n, 2) that lie this share further along the shortest paths, spread out."""
        if self.maps is None:
            aims = places + share * (self.goals - places)
        else:
            aims = self.goals.copy() if share >= 1.0 else _along(places, share * self._ways(places), *self.maps)
        return _spread(aims, 2 * self.crowd.body.max() + SPACING)

    # Windows

    def _window(self, node: Node, schedule: Schedule, row: int) -> Node | None:
        """Return the node after one window, None if too little of it is clear. `row` windows have failed here before."""
        count = max(schedule.activations // len(self.used), 2) * len(self.used)
        path = schedule.pace * float(node.lengths.sum())
        longest = schedule.length * max(SHRINK**row, LEAST_SHRINK)
        length = min(longest, max(1.3 * path / count, LEAST_SHRINK * schedule.length))
        total = count * length
        share = min(total / max(path, 1e-9), 1.0)
        wanted = np.maximum(node.lengths * share, LEAST_LENGTH * node.lengths.max() * share)
        wanted[-1] = schedule.turning * wanted[:-1].sum()
        groups, t = self._first_guess(node, wanted, count, length, row)
        available = node.lengths @ self.crowd.slides.T
        urgency = np.maximum(node.ways / np.maximum(available, 1e-9), LEAST_URGENCY)
        commit, safe = int(COMMIT * count), int((COMMIT + BUFFER) * count)
        problem = SoftGoals(
            self.crowd, node.poses, self.crowd.slides_of(groups), self._aims(node.poses[:, :2], share),
            urgency / np.sqrt(np.mean(urgency**2)), total, self.margin, self.least_gap, safe, BEHIND,
        )
        for stage, weight in enumerate(AIM_WEIGHTS):
            if stage == 0 and row > 0 or self.out_of_time():
                continue
            here = levenberg_marquardt(
                problem, t, weight, TOTAL_WEIGHT * self.crowd.n, STEPS if stage else FIRST_STEPS
            )
            t = here.t
            if stage > 0 and here.clear_until(self.least_gap) > safe:
                break
        clear = self.crowd.clear_until(node.poses, groups, t, self.least_gap)
        kept = commit if clear > safe else max(0, min(commit, clear - int(STEP_BACK * BUFFER * count)))
        if kept < LEAST_COMMIT * count:
            return None
        return self._after(node, groups, t, kept, max(clear - kept - 2, 0))

    def _first_guess(
        self, node: Node, wanted: np.ndarray, count: int, length: float, row: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return groups (K,) and lengths (K,): the tail of the window before and random ones, or of random ones the clearest."""
        if node.tail is not None and row == 0:
            groups, t = self._random(count - len(node.tail[0]), wanted, length)
            return np.concatenate([node.tail[0], groups]), np.concatenate([node.tail[1], t])
        ramp = np.linspace(*RAMP, RAMP_CYCLES * len(self.used))[:count]
        whole_turn = 2 * np.pi * self.crowd.turning_length.mean()

        def guesses() -> Iterator[tuple[np.ndarray, np.ndarray]]:
            for _ in range(SCREENED if row > 0 or node.parent is None else SCREENED_TAIL):
                groups, t = self._random(count, wanted, length)
                t[: len(ramp)] *= ramp
                groups[0] = self.crowd.m
                t[0] = self.rng.uniform(0.05, whole_turn) * (1.0 if row > 1 else FIRST_TURN)
                yield groups, t

        return self._clearest(node, guesses(), count // 2)

    def _clearest(
        self, node: Node, guesses: Iterator[tuple[np.ndarray, np.ndarray]], count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the guess of which most of the first activations, so many, are clear."""
        return max(
            guesses, key=lambda guess: self.crowd.clear_until(node.poses, guess[0][:count], guess[1][:count], self.least_gap)
        )

    def _random(self, count: int, wanted: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        groups = np.resize(self.rng.permutation(self.used), count)
        mean = float(wanted[self.used].mean())
        return groups + 1, wanted[groups] / mean * length * self.rng.uniform(0.5, 1.5, count)

    # The end

    def _end(self, node: Node, schedule: Schedule, longer: int) -> Node | None:
        """Return the node at the goals, None if no try gets there."""
        count = max(int(schedule.end_activations * self.crowd.n) // len(self.used), 2) * len(self.used)
        for attempt in range(END_TRIES):
            if self.out_of_time():
                break
            total = END_GROWTH ** (attempt + longer) * max(
                2.0 * float(node.lengths.sum()), schedule.end_share * float(self.root.lengths.sum())
            )
            wanted = np.maximum(node.lengths, END_LEAST * node.lengths.max())
            wanted[-1] = self.rng.choice(END_TURNING) * wanted[:-1].sum()
            guesses = (self._random(count, wanted, 1.0) for _ in range(SCREENED_TAIL))
            scaled = ((groups, t * (total / t.sum())) for groups, t in guesses)
            groups, guess = self._clearest(node, scaled, count)
            t = self._solved(node, groups, guess, total)
            if t is not None:
                return self._after(node, groups, t, len(t), 0)
        return None

    def _solved(self, node: Node, groups: np.ndarray, t: np.ndarray, total: float) -> np.ndarray | None:
        """Return lengths (K,) near t, with about this total, that bring all robots to their goals without a collision."""
        n = self.crowd.n
        problem = SoftGoals(
            self.crowd, node.poses, self.crowd.slides_of(groups), self.goals, np.ones(n), total, self.margin, self.least_gap,
            len(t),
        )
        here = None
        for aim_weight, total_weight, steps, most in END_STAGES:
            here = levenberg_marquardt(problem, t, aim_weight, total_weight, steps, solve=aim_weight < 0.1 or total_weight == 0.0)
            if here.value > most * n or self.out_of_time():
                return None
            t = here.t
        if here is None or np.abs(here.misses).max() > NEAR_ENOUGH or here.value > FEW_OVERLAPS:
            return None
        slides = np.ascontiguousarray(problem.slides.T)
        for _ in range(2):
            exact, there = restore_goals(slides, self.crowd.turning_length, node.poses, self.goals, t, self.precision)
            if there and self.crowd.clear_until(node.poses, groups, exact, self.least_gap) == len(t):
                return exact
            t = levenberg_marquardt(problem, t, 1.0, 0.0, 10, meetings=False, solve=True).t
        return None


@kernel()
def _along(places, ways, low, size, excess, goals):
    """Return where robots come to that go so far down their maps, shape (n, 2)."""
    reached = places.copy()
    for j in range(len(places)):
        x, y, left = places[j, 0], places[j, 1], ways[j]
        while left > 1e-9:
            way, gx, gy = way_left(j, x, y, low, size, excess, goals)
            slope = np.hypot(gx, gy)
            step = min(left, 0.3, np.hypot(x - goals[j, 0], y - goals[j, 1]))
            if way < 1e-9 or slope < 1e-9 or step < 1e-9:
                break
            x -= step * gx / slope
            y -= step * gy / slope
            left -= step
        reached[j] = x, y
    return reached


def _spread(points: np.ndarray, distance: float) -> np.ndarray:
    """Return points (n, 2) that are pushed apart until they are about so far from each other."""
    points = points.copy()
    for _ in range(300):
        apart = points[:, None] - points[None]
        away = np.hypot(apart[..., 0], apart[..., 1])
        np.fill_diagonal(away, distance)
        close = away < distance
        if not close.any():
            break
        push = np.where(close, (1.02 * distance - away) / np.maximum(away, 1e-6 * distance), 0.0)
        points += 0.25 * (push[..., None] * apart).sum(axis=1)
    return points
