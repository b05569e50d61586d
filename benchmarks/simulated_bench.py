"""A bench in this process: activations become volts, simulated robots read them, a tracker sees the robots."""

import numpy as np
from volts import sequence_of

from stressbot_driver.bench import parse_bench
from stressbot_driver.sequence import Train, VoltageSequence
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Substrate
from stressbot_driver.simulation.tracker import Tracker
from stressbot_planner.collision.clearance import Shapes, environment_gap, moving_points_gap
from stressbot_planner.estimation.calibration import Record, rest_poses
from stressbot_planner.formats.scenario import parse
from stressbot_planner.sequencing import encode

FRAME_RATE = 50.0


class SimulatedBench:
    """What `identify` needs, over the simulated substrate.

    Attributes:
        time: s on the substrate so far.
        gap: smallest true gap between two robots, or a robot and an obstacle or wall, at any time, units.
    """

    def __init__(self, text: str, **imperfections):
        self.scenario = parse(text)
        self.bench = parse_bench(text)
        self.settings = Imperfections(**imperfections)
        self.substrate = Substrate(self.bench, self.settings)
        self.tracker = Tracker(self.settings)
        self.time = 0.0
        self.gap = np.inf
        self._body = self.scenario.swarm.body_radius
        self._shapes = Shapes.of(self.scenario.problem.environment)

    def _frame(self, after: float = 0.0, train: Train | None = None) -> np.ndarray:
        look = self.substrate
        truth = look.poses(after) if train is None else look.poses_during(train.pattern, train.repeats, after)
        seen = self.tracker.measure(truth)
        poses = np.full((len(self.bench.ids), 3), np.nan)
        unit = self.scenario.length_unit
        poses[seen.ids.astype(int) - 1] = np.column_stack([seen.x / unit, seen.y / unit, seen.heading])
        return poses

    def _encoded(self, groups: np.ndarray, lengths: np.ndarray) -> VoltageSequence:
        """Return the volts of activations: of whole pulses, where the drive has some."""
        scenario = self.scenario
        step = scenario.electrical.pulse_length(scenario.swarm.speed)
        if step is not None:
            lengths = step * np.maximum(np.rint(lengths / step), 1.0)
        return sequence_of(encode(scenario.swarm, scenario.electrical, groups, lengths), self.bench)

    def _play(self, dwell: float, train: Train | None) -> None:
        """Keep the level or send a train, and see how close robots really come, all the way."""
        before = self.true_poses()
        if train is None:
            self.substrate.advance(dwell)
        else:
            self.substrate.repeat(train.pattern, train.repeats, train.duration)
        self.time += dwell
        self.gap = min(self.gap, true_gap(before[:, :2], self.true_poses()[:, :2], self._body, self._shapes))

    def measure(self) -> np.ndarray:
        """Poses at rest, from a second of frames."""
        return rest_poses([self._frame() for _ in range(int(FRAME_RATE))])

    def true_poses(self) -> np.ndarray:
        poses = self.substrate.poses()
        return np.column_stack([poses.x / self.scenario.length_unit, poses.y / self.scenario.length_unit, poses.heading])

    def drive(self, motion) -> list[Record]:
        groups, lengths = motion
        sequence = self._encoded(groups, lengths)
        drives = set((sequence.epoch_ends - 2).tolist())
        records, epoch = [], 0
        for index, (level, dwell) in enumerate(zip(sequence.levels.tolist(), sequence.dwells.tolist(), strict=True)):
            train = sequence.train(index)
            if train is None:
                self.substrate.apply(level)
            if index in drives:
                first = np.floor(self.time * FRAME_RATE) + 1
                times = np.arange(first / FRAME_RATE, self.time + dwell, 1 / FRAME_RATE) - self.time
                poses = np.array([self._frame(after, train) for after in times]).reshape(-1, len(self.bench.ids), 3)
                records.append(Record(int(groups[epoch]), times, poses))
                epoch += 1
            self._play(dwell, train)
        return records

    def execute(self, group: int, length: float) -> np.ndarray:
        """Drive one activation and return one frame after its end."""
        sequence = self._encoded(np.array([group]), np.array([length]))
        for index, (level, dwell) in enumerate(zip(sequence.levels.tolist(), sequence.dwells.tolist(), strict=True)):
            train = sequence.train(index)
            if train is None:
                self.substrate.apply(level)
            self._play(dwell, train)
        return self._frame()


def true_gap(before: np.ndarray, after: np.ndarray, body: np.ndarray, shapes: Shapes) -> float:
    """Return the smallest gap of discs that go straight from (n, 2) to (n, 2), all at once and each at a constant rate."""
    way = after - before
    best = np.inf
    for i in range(len(body)):
        length = float(np.hypot(*way[i]))
        unit = way[i] / length if length else (1.0, 0.0)
        best = min(best, environment_gap(*before[i], *unit, length, body[i], *shapes.kernel_arguments)[0])
        for j in range(i):
            distance, _ = moving_points_gap(*(before[i] - before[j]), *(way[i] - way[j]), 1.0)
            best = min(best, distance - body[i] - body[j])
    return best
