"""Closed-form motion of the swarm under activations (paper, Eq. 2).

In one activation of group G_i for length d (time d / u) members slide forward by d along their heading and all
others turn counter-clockwise on the spot by d / r_j. Nothing ever goes backward or clockwise. The paper's robots are equally
fast; here u is the speed of the fastest, and robot j does s_j <= 1 of it: it slides by s_j d or turns by s_j d / r_j.
"""

from typing import NamedTuple

import numpy as np

from stressbot_planner.model.swarm import Swarm
from stressbot_planner.system.kernels import kernel


class Activation(NamedTuple):
    """Group i in 1..m, and the length that its fastest members slide, units, >= 0."""

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
    slides = swarm.slides[np.asarray(groups, dtype=np.int64) - 1]
    return trajectory(slides, swarm.turning_length, np.asarray(start, dtype=float), np.asarray(lengths, dtype=float))


@kernel()
def trajectory(slides, turning_length, start, t):
    """Return poses at every knot, shape (K + 1, n, 3).

    Args:
        slides: distance that a robot slides for each unit of t, shape (K, n); where 0 (or False) it turns.
        turning_length: t in which it turns by 1 rad, shape (n,).
        start: poses, shape (n, 3).
        t: lengths, shape (K,), units.
    """
    count, n = slides.shape
    poses = np.empty((count + 1, n, 3))
    for j in range(n):
        x, y, heading = start[j]
        # whole turns are counted apart: a long plan turns a robot so often that the sum of all angles would lose digits
        turns = 0.0
        poses[0, j, 0], poses[0, j, 1], poses[0, j, 2] = x, y, heading
        cosine, sine = np.cos(heading), np.sin(heading)
        for k in range(count):
            if slides[k, j]:
                x += t[k] * slides[k, j] * cosine
                y += t[k] * slides[k, j] * sine
            elif t[k] != 0.0:
                heading += t[k] / turning_length[j]
                if heading > 2.0 * np.pi:
                    whole = np.floor(heading / (2.0 * np.pi))
                    heading -= whole * 2.0 * np.pi
                    turns += whole
                cosine, sine = np.cos(heading), np.sin(heading)
            poses[k + 1, j, 0], poses[k + 1, j, 1], poses[k + 1, j, 2] = x, y, heading + turns * 2.0 * np.pi
    return poses


def path_length(swarm: Swarm, groups: np.ndarray, lengths: np.ndarray) -> float:
    """Return the distance that robots slide, summed over robots, units: sum of |G_i| t_i for robots of one speed."""
    return float(np.dot(swarm.slides.sum(axis=1)[np.asarray(groups, dtype=int) - 1], lengths))


def execution_time(swarm: Swarm, lengths: np.ndarray) -> float:
    """Return the driving time sum of t_i / u, s; the time to select groups is not in it."""
    return float(np.sum(lengths)) / swarm.speed
