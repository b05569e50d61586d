"""A bench in this process: activations become volts, simulated robots read them, a tracker sees the robots."""

import numpy as np

from stressbot_driver.bench import parse_bench
from stressbot_driver.simulation.imperfections import Imperfections
from stressbot_driver.simulation.substrate import Substrate
from stressbot_driver.simulation.tracker import Tracker
from stressbot_planner.calibration import Record, rest_poses
from stressbot_planner.collision import Shapes
from stressbot_planner.scenario import parse
from stressbot_planner.sequencing import encode

FRAME_RATE = 50.0


class SimulatedBench:
    """What `identify` needs, over the simulated substrate.

    Attributes:
        time: s on the substrate so far.
        gap: smallest true gap between two robots, or a robot and a disc or wall, in any frame, units.
    """

    def __init__(self, text: str, **imperfections):
        self.scenario = parse(text)
        self.bench = parse_bench(text)
        self.settings = Imperfections(**imperfections)
        self.substrate = Substrate(self.bench, self.settings)
        self.tracker = Tracker(self.settings)
        self.time = 0.0
        self.gap = np.inf

    def _frame(self, after: float = 0.0) -> np.ndarray:
        true = self.substrate.poses(after)
        self.gap = min(self.gap, self._smallest_gap(np.column_stack([true.x, true.y]) / self.scenario.length_unit))
        seen = self.tracker.measure(true)
        poses = np.full((len(self.bench.ids), 3), np.nan)
        unit = self.scenario.length_unit
        poses[seen.ids.astype(int) - 1] = np.column_stack([seen.x / unit, seen.y / unit, seen.heading])
        return poses

    def _smallest_gap(self, xy: np.ndarray) -> float:
        body = self.scenario.swarm.body_radius
        first, second = np.triu_indices(len(xy), 1)
        gaps = [np.hypot(*(xy[first] - xy[second]).T) - body[first] - body[second]]
        shapes = Shapes.of(self.scenario.problem.environment)
        gaps += [np.hypot(*(xy - circle[:2]).T) - circle[2] - body for circle in shapes.circles]
        x, y, walls = xy[:, 0], xy[:, 1], shapes.walls
        gaps += [gap - body for gap in (x - walls[0], walls[1] - x, y - walls[2], walls[3] - y)]
        return float(min(gap.min(initial=np.inf) for gap in gaps))

    def measure(self) -> np.ndarray:
        """Poses at rest, from a second of frames."""
        return rest_poses([self._frame() for _ in range(int(FRAME_RATE))])

    def true_poses(self) -> np.ndarray:
        poses = self.substrate.poses()
        return np.column_stack([poses.x / self.scenario.length_unit, poses.y / self.scenario.length_unit, poses.heading])

    def drive(self, motion) -> list[Record]:
        groups, lengths = motion
        program = encode(self.scenario.swarm, self.scenario.electrical, groups, lengths)
        drives = set((program.epoch_ends - 2).tolist())
        records, epoch = [], 0
        for index, (level, dwell) in enumerate(zip(program.levels.tolist(), program.dwells.tolist(), strict=True)):
            self.substrate.apply(level)
            if index in drives:
                first = np.floor(self.time * FRAME_RATE) + 1
                times = np.arange(first / FRAME_RATE, self.time + dwell, 1 / FRAME_RATE) - self.time
                poses = np.array([self._frame(after) for after in times]).reshape(-1, len(self.bench.ids), 3)
                records.append(Record(int(groups[epoch]), times, poses))
                epoch += 1
            self.substrate.advance(dwell)
            self.time += dwell
        return records
