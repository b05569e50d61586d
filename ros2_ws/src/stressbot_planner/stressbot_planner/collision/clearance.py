"""The only validity checker: exact and continuous clearance of discs along activations.

During an activation every body is at rest or slides along a straight segment, each at a constant rate. The gap between
two bodies is thus the norm of a vector linear in the length slid, and the gap to a disc, a polygon edge or a wall is
a segment distance: each has a closed-form minimum, and nothing is sampled.

Computed lengths are rounded. Bodies touch, and do not overlap, where their gap is less than the scene's `slack` below zero.
A robot of radius 0 is a point. The gap of two points is their distance, which is never below zero: they pass each other.
"""

from dataclasses import dataclass

import numpy as np

from stressbot_planner.model.environment import Circle, Environment
from stressbot_planner.model.kinematics import replay
from stressbot_planner.model.swarm import Swarm
from stressbot_planner.system.kernels import kernel

TOUCHING = 1e-9
"""See `touching_slack`. The driver has the same."""

_COORDINATE_SHARE = 0.01

_ROUND_OFF = 1e-9
"""By which bounds on a gap are widened, units: they are sums of distances."""

NO_CREDIT = np.empty((0, 0))
"""Of no pair of robots: see `clearance_of`."""

_ROBOT, _CIRCLE, _POLYGON, _WALL = 0, 1, 2, 3
_WALL_NAMES = ("x_min", "x_max", "y_min", "y_max")


@dataclass(frozen=True)
class Clearance:
    """The smallest gap along a motion, and where it occurs.

    Attributes:
        gap: units; negative if bodies overlap, infinite if there is nothing to hit.
        activation: index of the activation, from 0; -1 for the start.
        length: length slid within that activation, units.
        robot: id of the robot, from 1.
        other: what it comes close to (``robot 3``, ``obstacles[0]``, ``wall x_max``).
    """

    gap: float
    activation: int = -1
    length: float = 0.0
    robot: int = 0
    other: str = ""

    def __str__(self):
        if not self.other:
            return "nothing to hit"
        where = "at the start" if self.activation < 0 else f"in activation {self.activation} after {self.length:.4g} units"
        return f"{self.gap:.6g} units between robot {self.robot} and {self.other} {where}"


def touching_slack(body: np.ndarray, environment: Environment, places: np.ndarray) -> float:
    """Return by how much the gap of bodies that touch may be below zero, units.

    It is `TOUCHING` times the largest body radius (n,) and a hundredth of the largest coordinate, of places (k, 2), walls and
    obstacles: far more than round-off, far less than anybody can place a robot.
    """
    shapes = Shapes.of(environment)
    sizes = [places.ravel(), shapes.edges.ravel(), np.abs(shapes.circles[:, :2]) + shapes.circles[:, 2:]]
    sizes.append(shapes.walls[np.isfinite(shapes.walls)])
    largest = max(float(np.abs(size).max(initial=0.0)) for size in sizes)
    return TOUCHING * (float(body.max()) + _COORDINATE_SHARE * largest)


@dataclass(frozen=True, eq=False)
class Shapes:
    """An environment as flat arrays for the kernels.

    Attributes:
        circles: x, y, radius, shape (c, 3).
        edges: x1, y1, x2, y2 of all polygons' edges, shape (e, 4).
        edge_ends: index behind the last edge of each polygon, shape (p,).
        walls: x_min, x_max, y_min, y_max, infinite where there are none.
        names: how the scenario calls each circle, then each polygon.
    """

    circles: np.ndarray
    edges: np.ndarray
    edge_ends: np.ndarray
    walls: np.ndarray
    names: tuple[str, ...]

    @classmethod
    def of(cls, environment: Environment) -> "Shapes":
        """Flatten an environment."""
        circles, edges, ends, circle_names, polygon_names = [], [], [], [], []
        for index, obstacle in enumerate(environment.obstacles):
            if isinstance(obstacle, Circle):
                circles.append((*obstacle.center, obstacle.radius))
                circle_names.append(f"obstacles[{index}]")
            else:
                edges.append(np.hstack([obstacle.vertices, np.roll(obstacle.vertices, -1, axis=0)]))
                ends.append(len(edges[-1]) + (ends[-1] if ends else 0))
                polygon_names.append(f"obstacles[{index}]")
        w = environment.workspace
        return cls(
            circles=np.array(circles, dtype=float).reshape(-1, 3),
            edges=np.concatenate(edges) if edges else np.empty((0, 4)),
            edge_ends=np.array(ends, dtype=np.int64),
            walls=np.array([w.x_min, w.x_max, w.y_min, w.y_max] if w else [-np.inf, np.inf, -np.inf, np.inf], dtype=float),
            names=(*circle_names, *polygon_names),
        )

    @property
    def kernel_arguments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The arrays in the order in which the kernels take them."""
        return self.circles, self.edges, self.edge_ends, self.walls

    def name(self, kind: int, index: int) -> str:
        """Return how a user would call the other body."""
        if kind == _ROBOT:
            return f"robot {index + 1}"
        if kind == _WALL:
            return f"wall {_WALL_NAMES[index]}"
        return self.names[index if kind == _CIRCLE else index + len(self.circles)]


def clearance(
    swarm: Swarm, environment: Environment, start: np.ndarray, groups: np.ndarray, lengths: np.ndarray
) -> Clearance:
    """Return the smallest gap along a whole sequence of activations.

    Args:
        swarm: the robots, with their bodies.
        environment: walls and obstacles.
        start: poses, shape (n, 3).
        groups: shape (K,), 1..m.
        lengths: shape (K,), units.
    """
    return clearance_of(swarm, Shapes.of(environment), replay(swarm, start, groups, lengths), groups, lengths)


def clearance_of(
    swarm: Swarm, shapes: Shapes, poses: np.ndarray, groups: np.ndarray, lengths: np.ndarray, credit: np.ndarray = NO_CREDIT
) -> Clearance:
    """Return the smallest gap along activations whose poses (K + 1, n, 3) are known.

    The gap of two robots counts as larger by their entry of `credit`, shape (n, n), symmetric and not negative, units.
    """
    nobody, radius = np.zeros(swarm.n, dtype=bool), swarm.body_radius
    gap, activation, length, robot, kind, index = _search(swarm, shapes, poses, groups, lengths, np.inf, radius, nobody, credit)
    if np.isinf(gap):
        return Clearance(np.inf)
    return Clearance(gap, activation, length, robot + 1, shapes.name(kind, index))


def is_clear(
    swarm: Swarm,
    shapes: Shapes,
    poses: np.ndarray,
    groups: np.ndarray,
    lengths: np.ndarray,
    gap: float,
    grown: np.ndarray | float = 0.0,
) -> bool:
    """Return whether all gaps along activations with known poses are at least gap; quicker than `clearance_of`.

    Bodies are larger by `grown`, a number or (n,), units. Two points need no gap, whatever they grow by.
    """
    return np.isinf(_search(swarm, shapes, poses, groups, lengths, gap, swarm.body_radius + grown, swarm.body_radius == 0)[0])


def gap_at_rest(swarm: Swarm, shapes: Shapes, positions: np.ndarray, credit: np.ndarray = NO_CREDIT) -> float:
    """Return the smallest gap of bodies at rest at positions (n, 2), that of two points left out; infinite if there is none.

    `credit` is that of `clearance_of`.
    """
    poses = np.column_stack([positions, np.zeros(swarm.n)])[None]
    nothing = np.empty(0, dtype=np.int64), np.empty(0)
    return float(_search(swarm, shapes, poses, *nothing, np.inf, swarm.body_radius, swarm.body_radius == 0, credit)[0])


def _search(
    swarm: Swarm, shapes: Shapes, poses, groups, lengths, below: float, radius: np.ndarray, passing: np.ndarray,
    credit: np.ndarray = NO_CREDIT,
):
    slides = swarm.membership[np.asarray(groups, dtype=np.int64) - 1]
    return _smallest_gap(
        np.ascontiguousarray(poses), slides, np.asarray(lengths, dtype=float), radius, passing, credit, *shapes.kernel_arguments,
        below,
    )


def environment_clearances(swarm: Swarm, environment: Environment, positions: np.ndarray) -> list[Clearance]:
    """Return the gap of each body at rest at positions (n, 2) to walls and obstacles, other robots left out."""
    shapes = Shapes.of(environment)
    found = []
    for k, (x, y) in enumerate(positions):
        gap, _, kind, index = environment_gap(x, y, 1.0, 0.0, 0.0, swarm.body_radius[k], *shapes.kernel_arguments)
        found.append(Clearance(np.inf) if np.isinf(gap) else Clearance(gap, robot=k + 1, other=shapes.name(kind, index)))
    return found


@kernel()
def moving_points_gap(dx, dy, vx, vy, length):
    """Return (smallest norm of (dx, dy) + s (vx, vy) for s in [0, length], the s where it occurs)."""
    speed2 = vx * vx + vy * vy
    s = 0.0
    if speed2 > 0.0:
        s = min(max(-(dx * vx + dy * vy) / speed2, 0.0), length)
    x = dx + s * vx
    y = dy + s * vy
    return np.sqrt(x * x + y * y), s


@kernel()
def segments_gap(ax, ay, ux, uy, length, edge):
    """Return (distance of the segment a + s u, s in [0, length], |u| <= 1, from an edge; s where it occurs)."""
    bx, by = edge[0], edge[1]
    ex, ey = edge[2] - bx, edge[3] - by
    cross = ux * ey - uy * ex
    if cross != 0.0:
        s = ((bx - ax) * ey - (by - ay) * ex) / cross
        t = ((bx - ax) * uy - (by - ay) * ux) / cross
        if 0.0 <= s <= length and 0.0 <= t <= 1.0:
            return 0.0, s
    best, at = _point_edge(ax, ay, edge), 0.0
    gap = _point_edge(ax + length * ux, ay + length * uy, edge)
    if gap < best:
        best, at = gap, length
    gap, s = moving_points_gap(ax - bx, ay - by, ux, uy, length)
    if gap < best:
        best, at = gap, s
    gap, s = moving_points_gap(ax - edge[2], ay - edge[3], ux, uy, length)
    if gap < best:
        best, at = gap, s
    return best, at


@kernel()
def _point_edge(px, py, edge):
    ex, ey = edge[2] - edge[0], edge[3] - edge[1]
    t = ((px - edge[0]) * ex + (py - edge[1]) * ey) / max(ex * ex + ey * ey, 1e-300)
    t = min(max(t, 0.0), 1.0)
    return np.hypot(px - edge[0] - t * ex, py - edge[1] - t * ey)


@kernel()
def inside_polygon(px, py, edges):
    """Return whether a point lies in the polygon of these edges (even-odd rule)."""
    inside = False
    for e in range(edges.shape[0]):
        y1, y2 = edges[e, 1], edges[e, 3]
        if (y1 > py) != (y2 > py):
            if px < edges[e, 0] + (py - y1) * (edges[e, 2] - edges[e, 0]) / (y2 - y1):
                inside = not inside
    return inside


@kernel()
def polygon_gap(ax, ay, ux, uy, length, edges):
    """Return (distance of a segment from a filled polygon, the length where it occurs); if they meet, minus how deep it gets."""
    best, at = np.inf, 0.0
    for e in range(edges.shape[0]):
        gap, s = segments_gap(ax, ay, ux, uy, length, edges[e])
        if gap < best:
            best, at = gap, s
    if best > _ROUNDED * (abs(ax) + abs(ay) + length) and not inside_polygon(ax, ay, edges):
        return best, at
    return _depth(ax, ay, ux, uy, length, edges)


_ROUNDED = 1e-12
"""Of coordinates: closer than that to an edge nobody knows on which side of it a point is."""

_WITHIN = (0.0, 0.25, 0.5, 0.8)
"""Shares of the way between two crossings at which a segment's depth in a polygon is looked at."""


@kernel()
def _depth(ax, ay, ux, uy, length, edges):
    """Return (minus how deep a segment gets into a polygon, the length where it does), looked for between its crossings."""
    knots = np.empty(edges.shape[0] + 2)
    knots[0], knots[1], count = 0.0, length, 2
    for e in range(edges.shape[0]):
        ex, ey = edges[e, 2] - edges[e, 0], edges[e, 3] - edges[e, 1]
        cross = ux * ey - uy * ex
        if cross != 0.0:
            s = ((edges[e, 0] - ax) * ey - (edges[e, 1] - ay) * ex) / cross
            if 0.0 < s < length:
                knots[count] = s
                count += 1
    knots = np.sort(knots[:count])
    deepest, at = 0.0, 0.0
    for k in range(count):
        for share in _WITHIN:
            if k + 1 == count and share > 0.0:
                break
            s = knots[k] + (share * (knots[k + 1] - knots[k]) if share > 0.0 else 0.0)
            x, y = ax + s * ux, ay + s * uy
            if inside_polygon(x, y, edges):
                depth = np.inf
                for e in range(edges.shape[0]):
                    depth = min(depth, _point_edge(x, y, edges[e]))
                if depth > deepest:
                    deepest, at = depth, s
    return -deepest, at


@kernel()
def environment_gap(ax, ay, ux, uy, length, radius, circles, edges, edge_ends, walls):
    """Return (smallest gap of one sliding body to walls and obstacles, length, kind, index)."""
    best, at, kind, index = np.inf, 0.0, _WALL, -1
    for c in range(circles.shape[0]):
        gap, s = moving_points_gap(ax - circles[c, 0], ay - circles[c, 1], ux, uy, length)
        gap -= radius + circles[c, 2]
        if gap < best:
            best, at, kind, index = gap, s, _CIRCLE, c
    first = 0
    for p in range(edge_ends.shape[0]):
        gap, s = polygon_gap(ax, ay, ux, uy, length, edges[first : edge_ends[p]])
        first = edge_ends[p]
        gap -= radius
        if gap < best:
            best, at, kind, index = gap, s, _POLYGON, p
    for end in range(2):
        s = end * length
        x, y = ax + s * ux, ay + s * uy
        for w, gap in enumerate((x - walls[0], walls[1] - x, y - walls[2], walls[3] - y)):
            if gap - radius < best:
                best, at, kind, index = gap - radius, s, _WALL, w
    return best, at, kind, index


REACH, REACH_OF_SLIDES = 4.0, 8.0
"""Displacement of a robot from its reference place up to which lists of neighbours hold, in largest body radii; and in mean
lengths of activations, if that is more."""


@kernel()
def _smallest_gap(poses, slides, lengths, radius, passing, credit, circles, edges, edge_ends, walls, below):
    """Return (gap, activation, length, robot, kind, index) of the smallest gap of a motion, that of two who are passing left out,
    that of two with credit larger by it.

    Every robot has a reference place, with its gap to the environment there and a list of the robots so near that they
    could come closer than the smallest gap found so far while both are within reach of their places. A robot that
    leaves its reach gets a new place and list; if it leaves by a single slide, all pairs are looked at. So pairs that
    rest or are far apart, nearly all pairs of a large swarm, cost nothing, and nothing is lost. With a finite `below`
    only gaps below it count, the search ends at the first, and an infinite gap says that there is none.
    """
    n = poses.shape[1]
    reach = REACH * radius.max()
    if lengths.shape[0] > 0:
        reach = max(reach, REACH_OF_SLIDES * lengths.mean())
    best, best_k, best_s, best_i, best_kind, best_index = below, -1, 0.0, 0, _ROBOT, -1
    any_will_do = not np.isinf(below)
    place = poses[0, :, :2].copy()
    free = np.empty(n)
    for i in range(n):
        x, y = place[i]
        gap, s, kind, index = environment_gap(x, y, 1.0, 0.0, 0.0, radius[i], circles, edges, edge_ends, walls)
        free[i] = gap
        if gap < best:
            best, best_k, best_s, best_i, best_kind, best_index = gap, -1, 0.0, i, kind, index
        for j in range(i):
            gap = np.hypot(x - place[j, 0], y - place[j, 1]) - radius[i] - radius[j]
            if credit.shape[0] > 0:
                gap += credit[i, j]
            if gap < best and not (passing[i] and passing[j]):
                best, best_k, best_s, best_i, best_kind, best_index = gap, -1, 0.0, i, _ROBOT, j
    near = np.zeros((n, n), dtype=np.int64)
    count = np.zeros(n, dtype=np.int64)
    for i in range(n):
        _list_neighbours(i, i, place, radius, best + 2.0 * reach + _ROUND_OFF, near, count)
    unit = np.zeros((n, 2))
    for k in range(lengths.shape[0]):
        if any_will_do and best < below:
            break
        length = lengths[k]
        if length <= 0.0:
            continue
        anybody, everybody = False, False
        for i in range(n):
            if not slides[k, i]:
                unit[i] = 0.0
                continue
            anybody = True
            x, y = poses[k, i, 0], poses[k, i, 1]
            end_x, end_y = poses[k + 1, i, 0], poses[k + 1, i, 1]
            unit[i, 0], unit[i, 1] = (end_x - x) / length, (end_y - y) / length
            away = max(np.hypot(x - place[i, 0], y - place[i, 1]), np.hypot(end_x - place[i, 0], end_y - place[i, 1]))
            if away > reach:
                place[i, 0], place[i, 1] = end_x, end_y
                away = np.hypot(end_x - x, end_y - y)
                everybody = everybody or away > reach
                free[i], _, _, _ = environment_gap(end_x, end_y, 1.0, 0.0, 0.0, radius[i], circles, edges, edge_ends, walls)
                _list_neighbours(i, n, place, radius, best + 2.0 * reach + _ROUND_OFF, near, count)
            if free[i] - away < best + _ROUND_OFF:
                gap, s, kind, index = environment_gap(
                    x, y, unit[i, 0], unit[i, 1], length, radius[i], circles, edges, edge_ends, walls
                )
                if gap < best:
                    best, best_k, best_s, best_i, best_kind, best_index = gap, k, s, i, kind, index
        if not anybody:
            continue
        for i in range(n):
            for c in range(i if everybody else count[i]):
                j = c if everybody else near[i, c]
                if not (slides[k, i] or slides[k, j]) or passing[i] and passing[j]:
                    continue
                dx = poses[k, i, 0] - poses[k, j, 0]
                dy = poses[k, i, 1] - poses[k, j, 1]
                gap, s = moving_points_gap(dx, dy, unit[i, 0] - unit[j, 0], unit[i, 1] - unit[j, 1], length)
                gap -= radius[i] + radius[j]
                if credit.shape[0] > 0:
                    gap += credit[i, j]
                if gap < best:
                    best, best_k, best_s, best_i, best_kind, best_index = gap, k, s, i, _ROBOT, j
    if any_will_do and best == below:
        best = np.inf
    return best, best_k, best_s, best_i, best_kind, best_index


@kernel()
def _list_neighbours(i, among, place, radius, within, near, count):
    """List robots j < i nearer than a gap with i, and i with robots from i + 1 to among; drop i where it was listed.

    Row i of `near` holds `count[i]` robots below i, in ascending order.
    """
    count[i] = 0
    for j in range(i):
        if np.hypot(place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]) - radius[i] - radius[j] < within:
            near[i, count[i]] = j
            count[i] += 1
    for j in range(i + 1, among):
        kept, position = 0, -1
        for c in range(count[j]):
            if near[j, c] != i:
                near[j, kept] = near[j, c]
                kept += 1
        if np.hypot(place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]) - radius[i] - radius[j] < within:
            position = kept
            while position > 0 and near[j, position - 1] > i:
                near[j, position] = near[j, position - 1]
                position -= 1
            near[j, position] = i
            kept += 1
        count[j] = kept


@kernel()
def kept_gap(gap, now, slack):
    """Return the gap that two bodies keep which have `now`: that which all shall keep, or if they are closer they come no closer.

    No closer but for round-off: who touches a wall may slide along it.
    """
    return min(gap, max(now - 0.01 * slack, min(now, -0.5 * slack)))


@kernel()
def slide_is_clear(poses, slides, length, radius, circles, edges, edge_ends, walls, gap, slack):
    """Return whether robots that slide from poses (n, 3) in an activation keep a gap to all others and the environment.

    Bodies that are closer than that to begin with need only not come closer, see `kept_gap`; two points keep none. `slides`
    (n,) is how far each robot slides in a length of 1, see `Swarm.slides`; True serves for 1.
    """
    n = poses.shape[0]
    for i in range(n):
        if not slides[i]:
            continue
        x, y, ux, uy = poses[i, 0], poses[i, 1], slides[i] * np.cos(poses[i, 2]), slides[i] * np.sin(poses[i, 2])
        for j in range(n):
            if j == i or slides[j] and j > i or radius[i] + radius[j] == 0.0:
                continue
            dx, dy, bodies = x - poses[j, 0], y - poses[j, 1], radius[i] + radius[j]
            now2 = dx * dx + dy * dy
            if now2 > (bodies + max(gap, 0.0) + 2.0 * length) ** 2:
                continue
            vx = ux - slides[j] * np.cos(poses[j, 2])
            vy = uy - slides[j] * np.sin(poses[j, 2])
            found = moving_points_gap(dx, dy, vx, vy, length)[0] - bodies
            if found < gap and found < kept_gap(gap, np.sqrt(now2) - bodies, slack):
                return False
        found = environment_gap(x, y, ux, uy, length, radius[i], circles, edges, edge_ends, walls)[0]
        if found < gap:
            now = environment_gap(x, y, ux, uy, 0.0, radius[i], circles, edges, edge_ends, walls)[0]
            if found < kept_gap(gap, now, slack):
                return False
    return True
