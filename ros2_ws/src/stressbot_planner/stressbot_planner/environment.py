"""Where the swarm moves: walls and obstacles."""

from dataclasses import dataclass

import numpy as np

from stressbot_planner.swarm import frozen_array


@dataclass(frozen=True)
class Workspace:
    """Walls of an axis-parallel rectangle that bodies stay inside of, units."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float


@dataclass(frozen=True, eq=False)
class Circle:
    """A disc. Attributes: center, shape (2,), and radius, units."""

    center: np.ndarray
    radius: float

    def __post_init__(self):
        object.__setattr__(self, "center", frozen_array(self.center))


@dataclass(frozen=True, eq=False)
class Polygon:
    """A simple polygon, filled. Attributes: vertices in order, shape (v, 2), units."""

    vertices: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "vertices", frozen_array(self.vertices))


Obstacle = Circle | Polygon


@dataclass(frozen=True)
class Environment:
    """Walls (None: an open plane) and obstacles."""

    workspace: Workspace | None = None
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def is_open_plane(self) -> bool:
        """Whether there is nothing to hit but other robots."""
        return self.workspace is None and not self.obstacles
