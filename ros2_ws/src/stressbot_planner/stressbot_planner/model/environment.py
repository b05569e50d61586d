"""Where the swarm moves: walls and obstacles."""

from dataclasses import dataclass

import numpy as np

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.model.swarm import Remade, check_coordinates, check_positive, frozen_array
from stressbot_planner.system.fields import FrozenArray


@dataclass(frozen=True)
class Workspace:
    """Walls of an axis-parallel rectangle that bodies stay inside of, units.

    Raises:
        StressbotError: a bound is not finite, or the lower one is not below the upper one.
    """

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    def __post_init__(self):
        for axis, bounds in (("x", [self.x_min, self.x_max]), ("y", [self.y_min, self.y_max])):
            check_coordinates(f"workspace.{axis}", bounds)
            if bounds[0] >= bounds[1]:
                raise StressbotError(
                    ErrorCode.OUT_OF_RANGE, f"workspace.{axis}", f"is {bounds}: give the lower bound first"
                )


@dataclass(frozen=True, eq=False)
class Circle(Remade):
    """A disc. Attributes: center, shape (2,), and radius, units.

    Raises:
        StressbotError: not finite, or a radius that is not positive.
    """

    center: FrozenArray
    radius: float

    def __post_init__(self):
        object.__setattr__(self, "center", frozen_array(self.center))
        check_coordinates("circle.center", self.center)
        check_positive("circle.radius", self.radius)


@dataclass(frozen=True, eq=False)
class Polygon(Remade):
    """A simple polygon, filled. Attributes: vertices in order, either way round, shape (v, 2), units.

    Raises:
        StressbotError: not finite, or edges that touch or cross each other, so that inside and outside are unclear.
    """

    vertices: FrozenArray

    def __post_init__(self):
        object.__setattr__(self, "vertices", frozen_array(self.vertices))
        check_coordinates("polygon", self.vertices)
        check_simple("polygon", self.vertices)


Obstacle = Circle | Polygon

SMALLEST_DISC = 1e-9
"""Radius of the disc that a point becomes in a file, units: files have none smaller."""


def standing(
    places: np.ndarray, radii: np.ndarray, others: np.ndarray, smallest: float = SMALLEST_DISC
) -> tuple[Circle, ...]:
    """Return robots that stand for good at places (k, 2) as obstacles for others of body radii (n,): their bodies (k,).

    A point is in the way of bodies only, and only where there is any: as a disc of the smallest radius, units.
    """
    return tuple(
        Circle(place, max(float(radius), smallest))
        for place, radius in zip(places, radii, strict=True) if radius > 0 or np.any(others > 0)
    )


@dataclass(frozen=True)
class Environment:
    """Walls (None: an open plane) and obstacles."""

    workspace: Workspace | None = None
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def is_open_plane(self) -> bool:
        """Whether there is nothing to hit but other robots."""
        return self.workspace is None and not self.obstacles


SHORTEST_EDGE = 1e-9
"""Of a polygon, units: products of lengths far below would vanish."""


def check_simple(field: str, vertices: np.ndarray) -> None:
    """Raise unless the closed chain of vertices (v, 2) is a simple polygon: only neighbouring edges touch, at their vertex."""
    if vertices.ndim != 2 or vertices.shape[0] < 3 or vertices.shape[1] != 2:
        raise StressbotError(ErrorCode.WRONG_COUNT, field, "needs at least three vertices of two coordinates each")
    begin, end = vertices, np.roll(vertices, -1, axis=0)
    edge = end - begin
    count = len(vertices)
    for k in np.flatnonzero(np.hypot(*edge.T) < SHORTEST_EDGE)[:1]:
        raise StressbotError(
            ErrorCode.OUT_OF_RANGE,
            field,
            f"has vertices {k + 1} and {(k + 1) % count + 1} less than {SHORTEST_EDGE:g} apart: leave one of the two out",
        )
    for k in range(count):
        behind = (k + 1) % count
        if _cross(edge[k], edge[behind]) == 0 and edge[k] @ edge[behind] < 0:
            raise StressbotError(ErrorCode.OUT_OF_RANGE, field, f"turns back on itself at vertex {behind + 1}: move the vertex")
        others = np.arange(k + 2, count - (k == 0))
        # the ends of each other edge lie on one side of this edge, or the other way round
        this_side = _cross(edge[k], begin[others] - begin[k]), _cross(edge[k], end[others] - begin[k])
        that_side = _cross(edge[others], begin[k] - begin[others]), _cross(edge[others], end[k] - begin[others])
        apart = (np.sign(this_side[0]) * np.sign(this_side[1]) > 0) | (np.sign(that_side[0]) * np.sign(that_side[1]) > 0)
        # and so do edges on one line that do not overlap
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        apart |= np.any((high[others] < low[k]) | (low[others] > high[k]), axis=1)
        if not np.all(apart):
            other = int(others[np.argmin(apart)])
            raise StressbotError(
                ErrorCode.OUT_OF_RANGE, field, f"crosses or touches itself: the edges from vertices {k + 1} and {other + 1} meet"
            )


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
