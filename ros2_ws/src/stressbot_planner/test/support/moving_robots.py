"""Robots as the estimates take them to be, and a tracker: what tests of calibration and identification share."""

import numpy as np

from stressbot_planner.estimation.calibration import Record

RATE = 50.0


def wrapped(angle):
    return np.angle(np.exp(1j * np.asarray(angle)))


class Robots:
    """Robots that move as the docstring of `calibration` says, and a tracker. `always`: +1 slides, -1 turns, 0 stands."""

    def __init__(self, swarm, speed, radius, bias, seed=0, always=None, membership=None, position=0.0, orientation=0.0, jump=0.0):
        self.swarm, self.speed, self.radius, self.bias = swarm, np.asarray(speed), np.asarray(radius), np.asarray(bias)
        self.always = always or {}
        self.membership = swarm.membership if membership is None else membership
        self.rng = np.random.default_rng(seed)
        self.poses = np.column_stack([self.rng.uniform(-9, 9, (swarm.n, 2)), self.rng.uniform(-4, 4, swarm.n)])
        self.position, self.orientation, self.jump = position, orientation, jump
        self.hidden = np.zeros(swarm.n, dtype=bool)

    def drive(self, group, length, rate=RATE):
        duration = length / self.swarm.speed
        slides = self.membership[group - 1].copy()
        moves = np.ones(self.swarm.n)
        for j, what in self.always.items():
            slides[j], moves[j] = what > 0, what != 0
        self.poses[:, 2] += self.jump * self.rng.standard_normal(self.swarm.n)
        times = np.arange(0.5 / rate, duration, 1 / rate)
        way = np.append(times, duration)[:, None] * moves * self.speed
        x, y, heading = self.poses.T
        direction = heading + self.bias
        places = np.stack(
            [
                x + slides * way * np.cos(direction), y + slides * way * np.sin(direction),
                heading + ~slides * way / self.radius,
            ],
            axis=2,
        )
        self.poses = places[-1]
        seen = places[:-1].copy()
        seen[..., :2] += self.position * self.rng.standard_normal(seen[..., :2].shape)
        seen[..., 2] = wrapped(seen[..., 2] + self.orientation * self.rng.standard_normal(seen.shape[:2]))
        seen[:, self.hidden] = np.nan
        return Record(group, times, seen)

    def rounds(self, count, slide=1.5, turn=3.0):
        swarm = self.swarm
        return [self.drive(*entry) for _ in range(count) for i in range(1, swarm.m) for entry in ((i, slide), (swarm.m, turn))]
