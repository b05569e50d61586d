"""Closed-form motion of the swarm under activations (paper, Eq. 2).

In one activation of group G_i for length d (time d / u) members slide forward by d along their heading and all
others turn counter-clockwise on the spot by d / r_j. Nothing ever goes backward or clockwise.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.swarm import Swarm


class Activation(NamedTuple):
    """Group i in 1..m, and the length that its members slide, units, >= 0."""

    group: int
    length: float


def advance(swarm: Swarm, poses: np.ndarray, group: int, length: float) -> np.ndarray:
    """Return the poses (n, 3) after one activation from poses (n, 3)."""
    return replay(swarm, poses, np.array([group]), np.array([length]))[-1]


def replay(swarm: Swarm, start: np.ndarray, groups: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return every pose along a sequence of K activations.

    Args:
        swarm: the robots.
        start: poses x, y (units), heading (rad), shape (n, 3).
        groups: group numbers 1..m, shape (K,).
        lengths: units, >= 0, shape (K,).

    Returns:
        Poses before the first and after each activation, shape (K + 1, n, 3). Headings are not wrapped.
    """
    lengths = np.asarray(lengths, dtype=float)
    slides = swarm.membership[np.asarray(groups, dtype=int) - 1]
    poses = np.empty((len(lengths) + 1, swarm.n, 3))
    poses[0] = start
    poses[1:, :, 2] = np.where(slides, 0.0, lengths[:, None] / swarm.turning_radius)
    np.cumsum(poses[:, :, 2], axis=0, out=poses[:, :, 2])
    step = np.where(slides, lengths[:, None], 0.0)
    heading = poses[:-1, :, 2]
    poses[1:, :, 0] = start[:, 0] + np.cumsum(step * np.cos(heading), axis=0)
    poses[1:, :, 1] = start[:, 1] + np.cumsum(step * np.sin(heading), axis=0)
    return poses


def path_length(swarm: Swarm, groups: np.ndarray, lengths: np.ndarray) -> float:
    """Return the distance that robots slide, summed over robots, units: sum of |G_i| t_i."""
    return float(np.dot(swarm.group_sizes[np.asarray(groups, dtype=int) - 1], lengths))


def execution_time(swarm: Swarm, lengths: np.ndarray) -> float:
    """Return the driving time sum of t_i / u, s; the time to select groups is not in it."""
    return float(np.sum(lengths)) / swarm.speed
